//! Numbers on the command line.

use std::ops::RangeInclusive;

pub use flix_host::system::number::in_unit;

/// Returns a reader of numbers within limits, in `unit`, which has a space before it and may be written behind the number, as for
/// [`in_unit`]. A refusal calls the number `name`.
pub fn within(
    limits: RangeInclusive<f64>,
    name: &'static str,
    unit: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone {
    move |text| {
        let (low, high) = (limits.start(), limits.end());
        let number = if unit.is_empty() { text.parse().ok() } else { in_unit(text, unit).ok() };
        number
            .filter(|number| limits.contains(number))
            .ok_or_else(|| format!("{text:?} is no {name} from {low} to {high}{unit}"))
    }
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
        let height = within(5.0..=100.0, "height", " mm");
        assert_eq!([height("30"), height("0.03 m")], [Ok(30.0), Ok(30.0)]);
        for refused in ["4mm", "1 m", "30 s", "on"] {
            assert!(height(refused).unwrap_err().ends_with("is no height from 5 to 100 mm"));
        }
        assert!(within(0.0..=1.0, "share", "")("on").is_err());
    }
}
