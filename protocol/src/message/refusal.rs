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

/// Why a command was not done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum Refusal {
    /// The command could not be read: another version, or a NaN in it.
    Malformed,
    /// A value is outside its range.
    OutOfRange {
        /// The quantity or setting.
        name: Name,
        /// Smallest accepted value.
        minimum: f32,
        /// Largest accepted value.
        maximum: f32,
    },
    /// There is no setting of this name.
    UnknownParameter,
    /// The command is not possible in this state.
    State(State),
    /// A fault is latched; see [`Telemetry::faults`](super::Telemetry::faults).
    Faulted(Faults),
    /// The stop is latched: clear it first.
    Stopped,
    /// The link has not been steady for long enough to arm.
    LinkUnproven,
    /// The settings could not be written.
    Storage,
    /// The setting takes whole numbers only.
    NotWhole {
        /// The setting.
        name: Name,
    },
    /// The link is slow: the command was too old when it arrived.
    Late {
        /// Its age, milliseconds; `u16::MAX` when it was older than the robot remembers.
        age_ms: u16,
        /// The largest age at which it counts, milliseconds.
        limit_ms: u16,
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

/// Writes that commands arrive too old.
fn late(f: &mut fmt::Formatter<'_>, age_ms: u16, limit_ms: u16) -> fmt::Result {
    if age_ms == u16::MAX {
        write!(
            f,
            "the link is slow: commands arrive more than a second old, at most {limit_ms} ms are allowed"
        )
    } else {
        write!(
            f,
            "the link is slow: commands arrive {age_ms} ms old, at most {limit_ms} ms are allowed"
        )
    }
}

impl From<OutOfRange> for Refusal {
    fn from(error: OutOfRange) -> Self {
        Self::out_of_range(error.quantity, error.minimum, error.maximum)
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Malformed => f.write_str("the robot could not read the command"),
            Self::OutOfRange { name, minimum, maximum } => {
                write!(f, "{name} must be from {minimum} to {maximum}")
            }
            Self::UnknownParameter => f.write_str("the robot has no setting of this name"),
            Self::State(state) => write!(f, "the robot is {state} and cannot do this now"),
            Self::Faulted(faults) => write!(f, "a fault is latched ({faults}): clear it first"),
            Self::Stopped => f.write_str("a stop is latched: clear it first"),
            Self::LinkUnproven => {
                write!(f, "the link has not been steady for {} ms yet", PROVING_TIME.as_millis())
            }
            Self::Storage => f.write_str("the robot could not write its settings"),
            Self::NotWhole { name } => write!(f, "{name} must be a whole number"),
            Self::Late { age_ms, limit_ms } => late(f, *age_ms, *limit_ms),
        }
    }
}
