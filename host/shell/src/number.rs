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
