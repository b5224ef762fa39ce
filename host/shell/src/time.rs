//! Times on the command line: one grammar for `flix` and `flix-sim`.

use std::time::Duration;

/// Units with one number before them, and their length in seconds. Longer names come first.
const UNITS: [(&str, f64); 5] = [("us", 1e-6), ("ms", 1e-3), ("s", 1.0), ("min", 60.0), ("", 1.0)];

/// Longest time that an option takes, s: a year.
const LONGEST: f64 = 366.0 * 86_400.0;

/// Reads a time in seconds: `5`, `5s`, `0.5ms`, `50us`, `10min`, `1h 30m`.
///
/// # Errors
/// When it is not a time from 0 to a year.
pub fn seconds(text: &str) -> Result<f64, String> {
    let text = text.trim();
    UNITS
        .iter()
        .find_map(|(unit, scale)| {
            let number = text.strip_suffix(unit)?.trim().parse::<f64>().ok()?;
            Some(number * scale)
        })
        .or_else(|| humantime::parse_duration(text).ok().map(|time| time.as_secs_f64()))
        .filter(|seconds| (0.0..=LONGEST).contains(seconds))
        .ok_or_else(|| {
            format!("\"{text}\" is not a time from 0 to a year: write 5, 5s, 500ms or 10min")
        })
}

/// Reads a time as [`seconds`] does, to the nanosecond.
///
/// # Errors
/// When it is not a time from 0 to a year.
pub fn duration(text: &str) -> Result<Duration, String> {
    Duration::try_from_secs_f64(seconds(text)?).map_err(|error| error.to_string())
}

/// Reads a time as [`duration`] does, above 0.
///
/// # Errors
/// When it is not such a time.
pub fn positive_duration(text: &str) -> Result<Duration, String> {
    match duration(text)? {
        Duration::ZERO => Err("the time must be longer than 0: write 5, 5s or 500ms".to_owned()),
        time => Ok(time),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_alone_is_in_seconds_and_units_are_understood() {
        for (text, milliseconds) in [
            ("5", 5000),
            ("5s", 5000),
            ("500ms", 500),
            (" 20 ms", 20),
            ("0.5", 500),
            ("2min", 120_000),
            ("10m", 600_000),
            ("1h 30m", 5_400_000),
            ("24h", 86_400_000),
            ("0", 0),
        ] {
            assert_eq!(duration(text), Ok(Duration::from_millis(milliseconds)), "{text}");
        }
        assert_eq!(seconds("0.1ms"), Ok(1e-4));
    }

    #[test]
    fn what_is_not_a_time_is_refused_with_what_would_be() {
        for text in ["", "s", "-1s", "-1", "NaN", "inf", "infs", "1e300", "5x", "one second"] {
            assert!(duration(text).unwrap_err().contains("500ms"), "{text}");
        }
    }
}
