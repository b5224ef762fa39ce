//! Numbers on the command line.

use std::ops::RangeInclusive;

pub use flix_host::system::number::in_unit;

/// Reads a number within limits, in `unit`, which has a space before it and may be written behind the number, as for
/// [`in_unit`]; `what` it is is for the refusal.
///
/// # Errors
/// When it is no number, in another unit, or beyond the limits.
pub fn parse_within(
    text: &str,
    limits: RangeInclusive<f64>,
    what: &str,
    unit: &str,
) -> Result<f64, String> {
    let (low, high) = (limits.start(), limits.end());
    let number = if unit.is_empty() { text.parse().ok() } else { in_unit(text, unit).ok() };
    number
        .filter(|number| limits.contains(number))
        .ok_or_else(|| format!("{text:?} is no {what} from {low} to {high}{unit}"))
}

/// Returns a reader of whole numbers within limits.
pub fn whole<T: TryFrom<u64>>(
    limits: RangeInclusive<u64>,
) -> impl Fn(&str) -> Result<T, String> + Clone {
    move |text| {
        let number = text.parse().ok().filter(|number| limits.contains(number));
        number.and_then(|number| T::try_from(number).ok()).ok_or_else(|| {
            format!("{text:?} is no whole number from {} to {}", limits.start(), limits.end())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_within_limits_may_have_its_unit_behind_it_too() {
        let height = |text| parse_within(text, 5.0..=100.0, "height", " mm");
        assert_eq!([height("30"), height("0.03 m")], [Ok(30.0), Ok(30.0)]);
        for refused in ["4mm", "1 m", "30 s", "on"] {
            assert!(height(refused).unwrap_err().ends_with("is no height from 5 to 100 mm"));
        }
        assert!(parse_within("on", 0.0..=1.0, "share", "").is_err());
    }
}
