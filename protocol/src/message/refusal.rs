//! Why the robot refuses a command.

use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::fault::Faults;
use super::parameter::Name;
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

/// Writes the position bandwidth, Hz, that would be accepted; 0 when none would be.
struct Instead(f32);

impl fmt::Display for Instead {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0 > 0.0 {
            write!(f, "lower position_bandwidth to {} Hz, or raise tracker_bandwidth", self.0)
        } else {
            f.write_str("raise tracker_bandwidth and current_bandwidth, or lower encoder_latency where it is not that of the encoder")
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
    /// A value is assumed, and nothing is armed on assumed values; the board measures phase currents.
    #[error(
        "{name} is assumed, and the robot does not arm on assumed values: measure the motors with `flix commission`, or look at what `flix parameters list` marks with ? and take it with `flix parameters accept`"
    )]
    Assumed {
        /// The first such setting.
        name: Name,
    },
    /// A value is assumed on a board that measures no phase currents, so that nothing else bounds them.
    #[error(
        "{name} is assumed, and this board measures no phase currents that would show whether it is right: enter it with `flix parameters set`, as for every value that `flix parameters list` marks with ?"
    )]
    AssumedUnmeasured {
        /// The first such setting.
        name: Name,
    },
    /// The loops that hold f and theta would oscillate, or nearly.
    #[error(
        "the rotors would shiver: position_bandwidth {position_bandwidth} Hz beside tracker_bandwidth {tracker_bandwidth} Hz, encoder_latency {encoder_latency} us and current_bandwidth {current_bandwidth} Hz has a stability margin of {margin:.2}, and at least {least} is needed: {}",
        Instead(*position_bandwidth_instead)
    )]
    UnstablePosition {
        /// The margin: 1 is a loop that amplifies no disturbance, less than 0 one that oscillates by itself.
        margin: f32,
        /// The least with which the robot arms.
        least: f32,
        /// Setting, Hz.
        position_bandwidth: f32,
        /// Setting, Hz.
        tracker_bandwidth: f32,
        /// Setting, microseconds.
        encoder_latency: f32,
        /// Setting, Hz.
        current_bandwidth: f32,
        /// The largest position bandwidth that has margin enough beside the others, Hz; 0 when none has.
        position_bandwidth_instead: f32,
    },
    /// The current loops would oscillate, or nearly.
    #[error(
        "the motors would whistle: current_bandwidth {current_bandwidth} Hz beside actuation_delay {actuation_delay} us has a stability margin of {margin:.2}, and at least {least} is needed: lower current_bandwidth, or actuation_delay where it is not that of the board"
    )]
    UnstableCurrent {
        /// As of [`Refusal::UnstablePosition`].
        margin: f32,
        /// The least with which the robot arms.
        least: f32,
        /// Setting, Hz.
        current_bandwidth: f32,
        /// Setting, microseconds.
        actuation_delay: f32,
    },
    /// The robot halted by itself, and no operator has asked for movement since.
    #[error(
        "the robot halted by itself, for a fault or because no command came, and moves again only when a person asks for it"
    )]
    Rested,
}

impl Refusal {
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
