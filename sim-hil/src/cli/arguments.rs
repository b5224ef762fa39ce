//! Arguments that several commands share.

use std::ops::RangeInclusive;
use std::str::FromStr;

use flix_protocol::message::Setpoint;

use crate::model::{LEGS, ModelError, RobotModel};
use crate::rig::bench::setpoint;

/// Which robot to simulate.
#[derive(Debug, Clone, clap::Args)]
pub struct ModelArgs {
    /// A model file (TOML), or the name of a shipped one: A, W, calibrated, bench-fixed, bench-planar
    #[arg(long, value_name = "FILE|NAME", default_value = "W")]
    pub model: String,
}

impl ModelArgs {
    /// Reads and checks it.
    ///
    /// # Errors
    /// When it is missing or refused; the sentence names key, value and range.
    pub fn load(&self) -> Result<RobotModel, ModelError> {
        RobotModel::named(&self.model)
    }
}

/// f and theta.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct SetpointArgs {
    /// Shaking frequency, -35 to 35 Hz; positive: the top rotor turns clockwise seen from above
    #[arg(long, value_name = "HZ", allow_hyphen_values = true)]
    pub frequency: f32,
    /// Shaking direction, -90 to 90 degrees from forward, positive to the right
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    pub direction: f32,
}

impl SetpointArgs {
    /// Checks them.
    ///
    /// # Errors
    /// When one is not a number or out of range; the sentence names the range.
    pub fn check(self) -> Result<Setpoint, flix_protocol::units::OutOfRange> {
        setpoint(self.frequency.into(), self.direction.into())
    }
}

/// Three numbers with commas between: x forward, y left, z up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vector(pub [f64; 3]);

impl FromStr for Vector {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Vec<f64> = text
            .split(',')
            .map(|part| part.trim().parse::<f64>().ok().filter(|number| number.is_finite()))
            .collect::<Option<_>>()
            .unwrap_or_default();
        let three = numbers.try_into().map_err(|_| {
            format!("{text:?} is not three finite numbers with commas between, for example 0.2,0,0")
        })?;
        Ok(Self(three))
    }
}

/// One of the four legs, as its index in [`LEGS`].
///
/// # Errors
/// When there is no such leg.
pub fn parse_leg(text: &str) -> Result<usize, String> {
    LEGS.iter()
        .position(|leg| *leg == text)
        .ok_or_else(|| format!("{text:?} is no leg: choose one of {}", LEGS.join(", ")))
}

/// A duration in seconds from text like `0.1ms`, `50us`, `8s`, or a plain number of seconds.
///
/// # Errors
/// When it is not a positive time.
pub fn parse_seconds(text: &str) -> Result<f64, String> {
    let text = text.trim();
    let (number, scale) = [("us", 1e-6), ("ms", 1e-3), ("s", 1.0)]
        .into_iter()
        .find_map(|(unit, scale)| text.strip_suffix(unit).map(|number| (number, scale)))
        .unwrap_or((text, 1.0));
    number
        .trim()
        .parse::<f64>()
        .ok()
        .map(|value| value * scale)
        .filter(|seconds| seconds.is_finite() && *seconds > 0.0)
        .ok_or_else(|| format!("{text:?} is no time: give for example 0.1ms, 50us or 8s"))
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_units() {
        assert_eq!(parse_seconds("0.1ms"), Ok(1e-4));
        assert_eq!(parse_seconds("8"), Ok(8.0));
        assert!(parse_seconds("-1s").is_err() && parse_seconds("NaN").is_err());
    }

    #[test]
    fn vectors_have_three_finite_numbers() {
        assert_eq!("0.2, 0,-1".parse(), Ok(Vector([0.2, 0.0, -1.0])));
        assert!("1,2".parse::<Vector>().is_err() && "1,2,inf".parse::<Vector>().is_err());
    }
}
