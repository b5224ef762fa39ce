//! Why the robot refuses a command.

use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::fault::Faults;
use super::parameter::Name;
use super::setpoint::{MAXIMUM_DIRECTION, MAXIMUM_FREQUENCY};
use super::telemetry::State;
use crate::failsafe::PROVING_TIME;
use crate::units::OutOfRange;

/// Writes an age in milliseconds, `u16::MAX` for one older than the robot remembers.
struct Age(u16);

impl fmt::Display for Age {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            u16::MAX => f.write_str("more than a second"),
            age => write!(f, "{age} ms"),
        }
    }
}

/// Why a command was not done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema, thiserror::Error)]
pub enum Refusal {
    /// The command could not be read: another version, or a NaN in it.
    #[error("the robot could not read the command")]
    Malformed,
    /// A value is outside its range.
    #[error("{name} must be from {minimum} to {maximum}")]
    OutOfRange {
        /// The quantity or setting.
        name: Name,
        /// Smallest accepted value.
        minimum: f32,
        /// Largest accepted value.
        maximum: f32,
    },
    /// There is no setting of this name.
    #[error("the robot has no setting of this name")]
    UnknownParameter,
    /// The command is not possible in this state.
    #[error("the robot is {0} and cannot do this now")]
    State(State),
    /// A fault is latched; see [`Telemetry::faults`](super::Telemetry::faults).
    #[error("a fault is latched ({0}): clear it first")]
    Faulted(Faults),
    /// The stop is latched: clear it first.
    #[error("a stop is latched: clear it first")]
    Stopped,
    /// The link has not been steady for long enough to arm.
    #[error("the link has not been steady for {} ms yet", PROVING_TIME.as_millis())]
    LinkUnproven,
    /// The settings could not be written.
    #[error("the robot could not write its settings")]
    Storage,
    /// The setting takes whole numbers only.
    #[error("{name} must be a whole number")]
    NotWhole {
        /// The setting.
        name: Name,
    },
    /// The scope cannot capture this.
    #[error(
        "the scope cannot capture this: it takes 1 to 8 channels, and keeps fewer rows before the trigger than fit its memory"
    )]
    Scope,
    /// The scope has no complete capture.
    #[error("the scope has no complete capture yet")]
    NotCaptured,
    /// The link is slow: the command was too old when it arrived.
    #[error("the link is slow: commands arrive {} old, at most {limit_ms} ms are allowed", Age(*age_ms))]
    Late {
        /// Its age, milliseconds; `u16::MAX` when it was older than the robot remembers.
        age_ms: u16,
        /// The largest age at which it counts, milliseconds.
        limit_ms: u16,
    },
    /// The board measures no phase currents, so that nothing bounds a trial.
    #[error("the board measures no phase currents, so that its motors cannot be measured")]
    NoCurrentSense,
    /// A value of a motor is unknown, so that nothing that follows from it can be trusted.
    #[error(
        "{name} is unknown: measure the motors with `flix commission`, enter their values with `flix parameters set`, or, where they are the defaults, with `flix parameters confirm`"
    )]
    MotorUnknown {
        /// The first such setting.
        name: Name,
    },
}

impl Refusal {
    /// Refuses a shaking frequency out of range.
    #[must_use]
    pub fn frequency() -> Self {
        Self::out_of_range("shaking frequency", -MAXIMUM_FREQUENCY.get(), MAXIMUM_FREQUENCY.get())
    }

    /// Refuses a shaking direction out of range.
    #[must_use]
    pub fn direction() -> Self {
        Self::out_of_range("shaking direction", -MAXIMUM_DIRECTION.get(), MAXIMUM_DIRECTION.get())
    }

    /// Refuses a value outside this range. A name longer than
    /// [`NAME_LENGTH`](super::NAME_LENGTH) is cut.
    #[must_use]
    pub fn out_of_range(name: &str, minimum: f32, maximum: f32) -> Self {
        let mut kept = Name::new();
        // Cutting is all that a full buffer means here.
        let _ = name.chars().try_for_each(|character| kept.push(character));
        Self::OutOfRange { name: kept, minimum, maximum }
    }
}

impl From<OutOfRange> for Refusal {
    fn from(error: OutOfRange) -> Self {
        Self::out_of_range(error.quantity, error.minimum, error.maximum)
    }
}
