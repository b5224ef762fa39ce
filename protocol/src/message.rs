//! Messages between operator and robot.
//!
//! There are four kinds: a [`Command`] from the operator, and from the robot a [`Reply`] to one
//! command, a periodic [`Telemetry`], or an [`Event`] that is sent once. They travel in
//! [`ToRobot`] and [`ToOperator`], inside the sessions of [`crate::session`], encoded by postcard.

mod crash;
mod fault;
mod link;
mod names;
mod operator;
mod order;
mod parameter;
mod refusal;
mod reset;
mod scope;
mod setpoint;
mod telemetry;
mod trial;

use heapless::{String, Vec};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

pub use crash::{
    BuildId, CrashReport, FaultSummary, MotorCurrents, PANIC_MESSAGE_LENGTH, PROGRAM_COUNTERS,
    PanicMessage, ProgramCounters,
};
pub use fault::{Fault, Faults};
pub use link::{DropReason, Dropped, LinkQuality};
pub(crate) use operator::is_label;
pub use operator::{OPERATOR_NAME_LENGTH, OperatorName, OperatorNameError};
pub use order::{Halt, Order, Permit, Withheld};
pub use parameter::{Mark, NAME_LENGTH, Name, PARAMETERS_PER_REPLY, Parameter, ParameterCommand};
pub use refusal::Refusal;
pub use reset::ResetReason;
pub use scope::{
    Channel, Quantity, SCOPE_CHANNELS, SCOPE_RATE_HZ, SCOPE_VALUES, SCOPE_VALUES_PER_REPLY,
    ScopeCommand, ScopePlan, ScopeRows, ScopeState, ScopeStatus, Trigger,
};
pub use setpoint::{MAXIMUM_DIRECTION, MAXIMUM_FREQUENCY, Setpoint};
pub use telemetry::{
    EncoderHealth, Event, EventReport, LoopTiming, Magnet, MotorTelemetry, State, Telemetry,
};
pub use trial::{
    Bridges, FASTEST_FIELD, GATHER_TICKS, LEAST_TRIAL_CURRENT_MA, LONGEST_PATTERN_TICKS,
    MOST_TRIAL_CURRENT_MA, Pattern, TRIAL_BOUND_MA, Trial,
};

/// A command to the robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum Command {
    /// Shake with this pair. Also the sign of life that the command deadline waits for.
    Setpoint(Setpoint),
    /// Make the motors ready: align them where needed, then hold them at rest.
    Arm,
    /// Ramp down, then let the motors coast.
    Disarm,
    /// Ramp down now, and stay stopped until [`Command::Clear`]. Idempotent; accepted in every state.
    Stop,
    /// Clear the latched stop and every latched fault whose cause is gone.
    Clear,
    /// Read or change settings.
    Parameter(ParameterCommand),
    /// Report name, board and firmware.
    Identify,
    /// Return this number.
    Ping(u32),
    /// Capture inner values of the fast loop, or read them.
    Scope(ScopeCommand),
    /// Drive motors that nobody knows yet, in bounds; the robot is disarmed before and after.
    Trial(Trial),
    /// Report what was kept of the last accident.
    Crash,
    /// Report what the board's description says of its bridges.
    Bridges,
    /// Obey this order, until the next one. Answered by telemetry alone.
    Order(Order),
}

impl Command {
    /// Returns whether it only asks: it changes nothing, however often and whenever it arrives.
    #[must_use]
    pub const fn is_question(&self) -> bool {
        matches!(
            self,
            Self::Identify
                | Self::Crash
                | Self::Bridges
                | Self::Ping(_)
                | Self::Parameter(
                    ParameterCommand::Get(_) | ParameterCommand::List(_) | ParameterCommand::Check,
                )
                | Self::Scope(ScopeCommand::Status | ScopeCommand::Read(_))
        )
    }

    /// Returns whether it counts at any age and in any order: it only brings the rotors to rest.
    #[must_use]
    pub const fn is_always_safe(&self) -> bool {
        matches!(self, Self::Stop | Self::Disarm)
    }
}

/// A command with its request number, as sent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub struct ToRobot {
    /// Counts up in a session; comes back in the reply. What is asked again keeps its number. A robot obeys nothing that changes
    /// it and has a smaller number than what it obeyed last, but `Stop` and `Disarm`.
    pub request: u32,
    /// Counts what a person wants, wrapping: a key press, a touch, the start of a program. Rotors that came to rest because
    /// commands stayed away turn again only by a [`Command::Setpoint`] with another number here than the last that was obeyed, and the present
    /// `halts`.
    pub intent: u8,
    /// The newest [`Telemetry::halts`] that had arrived when this was asked for; of a setpoint, when its intent was counted. Who
    /// could not know that the robot had halted has not asked it to go on: neither to move, nor to arm, nor to clear a fault or a
    /// stop of somebody else.
    pub halts: u8,
    /// The command.
    pub command: Command,
}

/// Returns the answer to an authentic command that cannot be read: its request number, and the
/// range when it was a setpoint outside every range (NaN, infinite, absurd),
/// [`Refusal::Malformed`] otherwise. `None` when not even the numbers before it can be read.
///
/// Never panics.
#[must_use]
pub fn unreadable(plain: &[u8]) -> Option<(u32, Refusal)> {
    let ((request, ..), rest) = postcard::take_from_bytes::<(u32, u8, u8)>(plain).ok()?;
    let refusal = match postcard::from_bytes(rest) {
        Ok(UncheckedSetpoint::Setpoint(f, _)) if Setpoint::from_numbers(f, 0.0).is_err() => {
            Refusal::frequency()
        }
        Ok(UncheckedSetpoint::Setpoint(_, theta))
            if Setpoint::from_numbers(0.0, theta).is_err() =>
        {
            Refusal::direction()
        }
        _ => Refusal::Malformed,
    };
    Some((request, refusal))
}

/// [`Command::Setpoint`] before its numbers are checked; the same bytes.
#[derive(Deserialize)]
enum UncheckedSetpoint {
    Setpoint(f32, f32),
}

/// A message of the robot.
// Telemetry is the largest and by far the most frequent; nothing is kept in collections.
#[allow(clippy::large_enum_variant, reason = "sent and dropped, never stored")]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum ToOperator {
    /// The answer to one command.
    Reply(Reply),
    /// The state of the robot, many times a second.
    Telemetry(Telemetry),
    /// Something that happened.
    Event(EventReport),
}

/// The answer to the command with this request number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub struct Reply {
    /// [`ToRobot::request`] of the command.
    pub request: u32,
    /// The result of the command.
    pub outcome: Outcome,
}

/// The result of a command.
#[allow(clippy::large_enum_variant, reason = "sent and dropped, never stored")]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum Outcome {
    /// Accepted.
    Done,
    /// Not done, and nothing changed.
    Refused(Refusal),
    /// One setting.
    Parameter(Parameter),
    /// Some of `total` settings.
    Parameters {
        /// Number of all settings.
        total: u16,
        /// Consecutive settings of the list.
        entries: Vec<Parameter, PARAMETERS_PER_REPLY>,
    },
    /// The robot's identity.
    Identity(Identity),
    /// The number of a ping.
    Pong(u32),
    /// How far the scope is.
    Scope(ScopeStatus),
    /// Rows of the scope.
    ScopeRows(ScopeRows),
    /// The board's bridges; of a trial, which begins.
    Bridges(Bridges),
    /// What was kept of the last accident; `None`: there was none since power came.
    Crash(Option<CrashReport>),
}

/// The robot's name, its firmware, and what it last started after.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub struct Identity {
    /// Chosen when the robot was provisioned.
    pub name: Name,
    /// The driver board, for example `MKS DUAL FOC V3.3 PLUS`.
    pub board: Name,
    /// Version of the firmware.
    pub version: String<16>,
    /// Why it last started.
    pub reset: ResetReason,
}
