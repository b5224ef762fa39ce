//! How a command ends: an exit code for scripts, a sentence for people.

use std::fmt;
use std::process::ExitCode;

use flix_host::experiment::SheetError;
use flix_host::link::LinkError;
use flix_host::link::keys::KeyError;
use flix_host::link::serial::SerialError;
use flix_host::nav::ModeTableError;
use flix_host::pose::PoseError;
use flix_host::pose::natnet::NatNetError;
use flix_host::record::{ReadError, RecordError, RepairError};
use flix_protocol::message::{Refusal, State};
use flix_protocol::session::ConnectError;

/// Exit code of a command: a contract with scripts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// The command is done.
    Done = 0,
    /// The run failed, or a figure is outside its limit: of `flix-sim` alone.
    Failed = 1,
    /// An option, a file or a value is wrong.
    Usage = 2,
    /// The robot did not answer, or fell silent.
    NoAnswer = 10,
    /// The robot refused this operator.
    Refused = 20,
    /// Another operator holds the robot.
    Held = 21,
    /// The robot has a fault.
    RobotFault = 30,
    /// A stop is latched.
    Stopped = 31,
    /// The robot cannot do this in its state, or did not come to do it.
    NotNow = 32,
    /// There is nothing to show.
    Nothing = 33,
    /// The rotors came to rest because commands stayed away.
    Rested = 34,
    /// A signal, or a closed terminal.
    Interrupted = 40,
    /// The page of a cockpit cannot be served any more.
    PageLost = 41,
}

impl Exit {
    /// Every code of `flix` and what it means.
    pub const ALL: [(Self, &str); 12] = [
        (Self::Done, "done"),
        (Self::Usage, "usage: an option, a file or a value is wrong"),
        (Self::NoAnswer, "no answer from the robot"),
        (Self::Refused, "the robot refused: other key or other version"),
        (Self::Held, "another operator, or another program of yours, holds the robot"),
        (Self::RobotFault, "the robot has a fault"),
        (Self::Stopped, "a stop is latched: `flix clear` ends it"),
        (Self::NotNow, "the robot cannot do this now, or did not do it in time"),
        (Self::Nothing, "there is nothing to show: no fault, no accident, no run yet"),
        (Self::Rested, "the rotors came to rest because commands stayed away: start again"),
        (Self::Interrupted, "interrupted; the message states whether a driven robot has stopped"),
        (Self::PageLost, "the page cannot be served any more; the robot was stopped first"),
    ];

    /// Returns all codes as lines of help.
    #[must_use]
    pub fn help() -> String {
        let line = |(exit, meaning): (Self, &str)| format!("\n  {:>2}  {meaning}", exit as u8);
        "Exit codes:".to_owned() + &Self::ALL.map(line).concat()
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// Why a command failed: an exit code for scripts, a sentence for people.
#[derive(Debug)]
pub struct Error {
    /// Exit code for scripts.
    pub exit: Exit,
    /// Sentence for people.
    pub sentence: String,
}

impl Error {
    /// Makes an error from an exit code and a sentence.
    pub fn new(exit: Exit, sentence: impl fmt::Display) -> Self {
        Self { exit, sentence: sentence.to_string() }
    }

    /// Makes an error about a wrong option, file or value.
    pub fn usage(sentence: impl fmt::Display) -> Self {
        Self::new(Exit::Usage, sentence)
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.sentence)
    }
}

impl std::error::Error for Error {}

impl From<LinkError> for Error {
    fn from(error: LinkError) -> Self {
        let exit = match &error {
            LinkError::Network(_)
            | LinkError::Unsent { .. }
            | LinkError::Random(_)
            | LinkError::Connect(ConnectError::NoAnswer)
            | LinkError::NoneHere(_)
            | LinkError::Silent
            | LinkError::Back
            | LinkError::Left
            | LinkError::Unanswered
            | LinkError::StopUnacknowledged
            | LinkError::Refused(Refusal::LinkUnproven | Refusal::Late { .. }) => Exit::NoAnswer,
            LinkError::Connect(ConnectError::Busy(_)) => Exit::Held,
            LinkError::Connect(_)
            | LinkError::Revoked
            | LinkError::OtherAnswer
            | LinkError::Refused(Refusal::Malformed) => Exit::Refused,
            LinkError::Refused(
                Refusal::OutOfRange { .. } | Refusal::NotWhole { .. } | Refusal::UnknownParameter,
            ) => Exit::Usage,
            // Flash that cannot be written is broken.
            LinkError::Refused(
                Refusal::Faulted(_) | Refusal::State(State::Faulted) | Refusal::Storage,
            )
            | LinkError::Faulted { .. }
            | LinkError::State { actual: State::Faulted, .. } => Exit::RobotFault,
            LinkError::Refused(Refusal::Stopped)
            | LinkError::StoppedBy(_)
            | LinkError::StillStopped => Exit::Stopped,
            LinkError::Refused(Refusal::NotCaptured) => Exit::Nothing,
            LinkError::Refused(Refusal::Rested) | LinkError::Lapsed => Exit::Rested,
            LinkError::Refused(_) | LinkError::State { .. } => Exit::NotNow,
            LinkError::Interrupted => Exit::Interrupted,
        };
        Self::new(exit, error)
    }
}

/// What is wrong with a file that a command was given.
macro_rules! of_usage {
    ($($kind:ty),*) => {
        $(impl From<$kind> for Error {
            fn from(error: $kind) -> Self {
                Self::usage(error)
            }
        })*
    };
}

of_usage!(KeyError, ModeTableError, RecordError, RepairError, SheetError);

impl From<SerialError> for Error {
    fn from(error: SerialError) -> Self {
        let exit = match error {
            SerialError::Open { .. } => Exit::Usage,
            SerialError::Port(_) | SerialError::Random(_) | SerialError::NoAnswer(_) => {
                Exit::NoAnswer
            }
            SerialError::Confused => Exit::Refused,
            SerialError::Refused(_) => Exit::NotNow,
            SerialError::Interrupted => Exit::Interrupted,
        };
        Self::new(exit, error)
    }
}

impl From<ReadError> for Error {
    fn from(error: ReadError) -> Self {
        let exit = match error {
            ReadError::NoRuns(_) => Exit::Nothing,
            _ => Exit::Usage,
        };
        Self::new(exit, error)
    }
}

impl From<NatNetError> for Error {
    fn from(error: NatNetError) -> Self {
        let exit = match error {
            NatNetError::NoSuchBody { .. }
            | NatNetError::WhichBody(_)
            | NatNetError::Ambiguous(_)
            | NatNetError::Socket { .. } => Exit::Usage,
            _ => Exit::NoAnswer,
        };
        Self::new(exit, error)
    }
}

impl From<PoseError> for Error {
    fn from(error: PoseError) -> Self {
        Self::new(Exit::NoAnswer, error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_ended_a_command_has_the_exit_code_of_its_kind() {
        let state = |actual| LinkError::Refused(Refusal::State(actual));
        for (error, exit) in [
            (LinkError::Silent, Exit::NoAnswer),
            (LinkError::Revoked, Exit::Refused),
            (state(State::Faulted), Exit::RobotFault),
            (LinkError::StillStopped, Exit::Stopped),
            (state(State::Aligning), Exit::NotNow),
            (LinkError::Refused(Refusal::NotCaptured), Exit::Nothing),
            (LinkError::Refused(Refusal::Rested), Exit::Rested),
            (LinkError::Lapsed, Exit::Rested),
            (LinkError::Interrupted, Exit::Interrupted),
        ] {
            assert_eq!(Error::from(error).exit, exit);
        }
        let none_yet = ReadError::NoRuns("out".into());
        assert_eq!(Error::from(none_yet).exit, Exit::Nothing);
    }
}
