//! Arguments that several commands share.

use std::str::FromStr;
use std::time::Duration;

use flix_protocol::message::Setpoint;
use flix_shell::time::duration;

use super::error::Error;
use flix_sim::model::{LEGS, ModelError, RobotModel};
use flix_sim::rig::bench::setpoint;

/// Robot to simulate.
#[derive(Debug, Clone, clap::Args)]
pub struct ModelArgs {
    /// Model: a TOML file or the name of a shipped one (A, W, calibrated, flix, bench-fixed, bench-planar, random-SEED,
    /// stranger-SEED)
    #[arg(long, value_name = "FILE|NAME", default_value = "W")]
    pub model: String,
}

impl ModelArgs {
    /// Reads and checks it.
    pub fn load(&self) -> Result<RobotModel, ModelError> {
        RobotModel::named(&self.model)
    }
}

/// The robot of a study that repeats the paper.
#[derive(Debug, Clone, clap::Args)]
pub struct PaperModelArgs {
    /// Model: a TOML file or the name of a shipped one (A, W, calibrated, flix, random-SEED); `flix` has the paper's own
    /// friction and leg
    #[arg(long, value_name = "FILE|NAME", default_value = "flix")]
    pub model: String,
}

impl PaperModelArgs {
    /// Reads and checks it.
    pub fn load(&self) -> Result<RobotModel, ModelError> {
        RobotModel::named(&self.model)
    }
}

/// f and theta.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct SetpointArgs {
    /// Shaking frequency, -35 to 35 Hz; positive: the top rotor turns clockwise seen from above
    #[arg(long, value_name = "HZ", allow_hyphen_values = true, value_parser = parse_part)]
    pub frequency: f32,
    /// Shaking direction, -90 to 90 degrees from forward, positive to the right
    #[arg(long, value_name = "DEG", allow_hyphen_values = true, value_parser = parse_part)]
    pub direction: f32,
}

impl SetpointArgs {
    /// Checks them.
    pub fn check(self) -> Result<Setpoint, Error> {
        setpoint(self.frequency.into(), self.direction.into()).map_err(|error| {
            Error::usage(format_args!(
                "{error}; the robot takes -35 to 35 Hz and -90 to 90 degrees"
            ))
        })
    }
}

/// Parses f or theta; a negative zero is zero.
fn parse_part(text: &str) -> Result<f32, std::num::ParseFloatError> {
    text.parse::<f32>().map(|number| number + 0.0)
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

/// Parses one of the four legs, as its index in [`LEGS`].
pub fn parse_leg(text: &str) -> Result<usize, String> {
    LEGS.iter()
        .position(|leg| *leg == text)
        .ok_or_else(|| format!("{text:?} is no leg: choose one of {}", LEGS.join(", ")))
}

/// Reads a time above 0 and up to a day: `50us`, `0.1ms`, `8s`, `10m`, or a plain number of seconds.
pub fn parse_time(text: &str) -> Result<Duration, String> {
    const LONGEST: Duration = Duration::from_secs(86_400);
    let time = duration(text)?;
    if time.is_zero() || time > LONGEST {
        return Err(format!("{text:?} is not a time above 0 and up to a day"));
    }
    Ok(time)
}

/// Reads the step of a simulation: a time from 1 us to 5 ms. Beyond, the contact of a foot diverges.
pub fn parse_step(text: &str) -> Result<Duration, String> {
    const SHORTEST: Duration = Duration::from_micros(1);
    const LONGEST: Duration = Duration::from_millis(5);
    let step = parse_time(text)?;
    if !(SHORTEST..=LONGEST).contains(&step) {
        return Err(format!("{text:?} is no step from 1us to 5ms"));
    }
    Ok(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_units() {
        assert_eq!(parse_time("0.1ms").map(|time| time.as_secs_f64()), Ok(1e-4));
        assert_eq!(parse_time("8"), parse_time("8s"));
        assert!(["-1s", "-1", "NaN", "0s", "2days"].into_iter().all(|it| parse_time(it).is_err()));
    }

    #[test]
    fn vectors_have_three_finite_numbers() {
        assert_eq!("0.2, 0,-1".parse(), Ok(Vector([0.2, 0.0, -1.0])));
        assert!("1,2".parse::<Vector>().is_err() && "1,2,inf".parse::<Vector>().is_err());
    }
}
