//! Numbers on the command line.

use std::ops::RangeInclusive;

/// Reads a number within limits; `what` it is and its unit, with a space before it, are for the refusal.
///
/// # Errors
/// When it is no number or beyond them.
pub fn parse_within(
    text: &str,
    limits: RangeInclusive<f64>,
    what: &str,
    unit: &str,
) -> Result<f64, String> {
    let (low, high) = (limits.start(), limits.end());
    text.parse::<f64>()
        .ok()
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

/// Returns a number with so many decimals, and never a negative zero.
#[must_use]
pub fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|c| matches!(c, b'0' | b'.')) => rest.to_owned(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_zero_is_negative() {
        let texts = [fixed(-0.0, 0), fixed(-0.004, 2), fixed(-0.006, 2), fixed(0.5, 1)];
        assert_eq!(texts, ["0", "0.00", "-0.01", "0.5"]);
    }
}
