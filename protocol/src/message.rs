//! Messages between operator and robot.
//!
//! The operator sends an [`Order`], repeated, or a [`Request`], which the robot answers with one [`Reply`]. The robot also sends
//! [`Telemetry`] periodically, and each [`Event`] once. They travel in [`ToRobot`] and [`ToOperator`], inside the sessions of
//! [`crate::session`], encoded by postcard.

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

/// A message to the robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum ToRobot {
    /// Obey this order until the next one. Telemetry answers it.
    Order(Order),
    /// Answer this request with one [`Reply`].
    Request(Request),
}

impl ToRobot {
    /// Returns the request with this number.
    #[must_use]
    pub const fn request(number: u32, command: Command) -> Self {
        Self::Request(Request { number, command })
    }
}

/// A command with its number. A request moves no motor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub struct Request {
    /// Counts up in a session; comes back in the reply. A request that is repeated keeps its number. The robot passes over a
    /// request that would change something and has a smaller number than the last that did.
    pub number: u32,
    /// The command.
    pub command: Command,
}

/// Contents of a request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum Command {
    /// Read or change settings.
    Parameter(ParameterCommand),
    /// Report name, board and firmware.
    Identify,
    /// Return this number.
    Ping(u32),
    /// Capture inner values of the fast loop, or read them.
    Scope(ScopeCommand),
    /// Report the crash of the run before the last start.
    Crash,
    /// Report dead time and PWM frequency of the bridges.
    Bridges,
}

impl Command {
    /// Returns whether it only asks: it changes nothing, however often and whenever it arrives.
    #[must_use]
    pub const fn is_question(&self) -> bool {
        match self {
            Self::Identify | Self::Crash | Self::Bridges | Self::Ping(_) => true,
            Self::Parameter(command) => matches!(
                command,
                ParameterCommand::Get(_) | ParameterCommand::List(_) | ParameterCommand::Check
            ),
            Self::Scope(command) => {
                matches!(command, ScopeCommand::Status | ScopeCommand::Read(_))
            }
        }
    }
}

/// Returns the number of an authentic request whose command cannot be read, for [`Refusal::Malformed`]; `None` for an order, and
/// where not even the number can be read.
#[must_use]
pub fn unreadable(plain: &[u8]) -> Option<u32> {
    match postcard::from_bytes(plain).ok()? {
        Numbered::Request(number) => Some(number),
        Numbered::Order => None,
    }
}

/// [`ToRobot`] up to its number; the same bytes.
#[derive(Deserialize)]
enum Numbered {
    Order,
    Request(u32),
}

/// A message of the robot.
// Telemetry is the largest and by far the most frequent; nothing is kept in collections.
#[allow(clippy::large_enum_variant, reason = "sent and dropped, never stored")]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum ToOperator {
    /// The answer to one request.
    Reply(Reply),
    /// The state of the robot, many times a second.
    Telemetry(Telemetry),
    /// Something that happened.
    Event(EventReport),
}

/// The answer to the request with this number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub struct Reply {
    /// [`Request::number`].
    pub request: u32,
    /// The result.
    pub outcome: Outcome,
}

/// The result of a request.
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
    /// The board's bridges.
    Bridges(Bridges),
    /// Crash of the run before the last start; `None`: none since power-on.
    Crash(Option<CrashReport>),
}

/// Name, firmware and reset reason of a robot.
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
