//! Reasons for which a robot does not obey: one list for requests, for runs, and for programs that show them.

use core::net::SocketAddr;

use flix_protocol::message::{Fault, Faults, OperatorName, Refusal, State, Telemetry};
use flix_protocol::session::ConnectError;

use super::{Update, explain};

/// Reason for which a robot does not obey, or cannot be reached.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LinkError {
    /// The network failed.
    #[error("the network failed: {0}")]
    Network(String),
    /// The operating system sends nothing to the robot.
    #[error("this computer sends nothing to {to}: {why}")]
    Unsent {
        /// The robot's address.
        to: SocketAddr,
        /// The cause, and the remedy.
        why: &'static str,
    },
    /// The operating system gave no randomness for the handshake.
    #[error("the operating system gave no random numbers for the handshake: {0}")]
    Random(String),
    /// There is no session.
    #[error("{0}")]
    Connect(ConnectError),
    /// There is no session with a robot of this computer: only a simulated one is there.
    #[error(
        "the robot does not answer at {0}, which is this computer: start `flix-sim serve` here, or name your robot"
    )]
    NoneHere(SocketAddr),
    /// The robot fell silent.
    #[error("the robot fell silent: it stops by itself; check its battery and the network")]
    Silent,
    /// The robot fell silent, and answers again.
    #[error(
        "the robot was silent for a second, or restarted, or this computer stood still; it answers again: see its battery \
         with `flix status`"
    )]
    Back,
    /// The robot closed the session.
    #[error("the robot ended the session: it restarts, or got another key")]
    Left,
    /// No reply to this request, although the session stands.
    #[error("the robot did not answer within {} s: the link loses too much; see `flix link-test`", super::REQUEST_PATIENCE.as_secs())]
    Unanswered,
    /// The answer was of another kind.
    #[error("the robot answered something else than was asked; is its firmware of this version?")]
    OtherAnswer,
    /// The robot proved that it has the key, and has not said that it stopped.
    #[error(
        "the robot answers, but has not acknowledged the stop: it may be stopped or not; the link is very slow: ask again"
    )]
    StopUnacknowledged,
    /// The robot refused the request.
    #[error("the robot refused: {0}{hint}", hint = hint(.0))]
    Refused(Refusal),
    /// The robot has a fault.
    #[error("the robot has a fault: {}; `flix clear` clears it once its cause is gone", describe(*.first, *.all))]
    Faulted {
        /// The first fault: the cause of the rest.
        first: Option<Fault>,
        /// All latched faults.
        all: Faults,
    },
    /// The robot did not reach the requested state, or left it by itself.
    #[error("the robot is {actual} where it should be {wanted}: see `flix status`")]
    State {
        /// The requested state.
        wanted: State,
        /// The present state.
        actual: State,
    },
    /// The robot disarmed while it was driven, as it does without commands in time.
    #[error(
        "the robot stopped by itself: commands came too late, or not at all; `flix link-test` measures the link"
    )]
    Lapsed,
    /// A stop is latched; the name is that of its operator.
    #[error("{0} stopped the robot; `flix clear` makes it ready again")]
    StoppedBy(OperatorName),
    /// The robot does not know this key any more.
    #[error(
        "your key was revoked: the robot stops by itself; have a key added at its cable (`flix provision --help`)"
    )]
    Revoked,
    /// The robot does not clear the latched stop.
    #[error("the stop is still latched: the rotors have not come to rest; see `flix status`")]
    StillStopped,
    /// A signal arrived.
    #[error("interrupted")]
    Interrupted,
}

impl LinkError {
    /// Returns the faults that telemetry reports, as an error.
    #[must_use]
    pub const fn faulted(telemetry: &Telemetry) -> Self {
        Self::Faulted { first: telemetry.first_fault, all: telemetry.faults }
    }

    /// Returns why a robot that is not driven cannot be armed: its faults, or the operator that stopped it.
    pub(crate) fn of_idle(telemetry: &Telemetry) -> Option<Self> {
        match telemetry.stopped_by {
            _ if !telemetry.faults.is_empty() => Some(Self::faulted(telemetry)),
            Some(by) => Some(Self::StoppedBy(by)),
            None => None,
        }
    }

    /// Returns why a robot that was armed is driven no more, if this update says so.
    #[must_use]
    pub fn while_driven(update: &Update) -> Option<Self> {
        match update {
            Update::Telemetry(telemetry) => match (telemetry.state, telemetry.stopped_by) {
                (State::Faulted, _) => Some(Self::faulted(telemetry)),
                (_, Some(by)) => Some(Self::StoppedBy(by)),
                // Without a stop or a fault, its deadlines for commands are all that disarm it. One that ramps down because
                // commands came late, as of a busy computer, goes on with the next that comes in time.
                (State::Disarmed, None) => Some(Self::Lapsed),
                _ => None,
            },
            Update::Ended { why, .. } => Self::ended(why.as_ref()),
            _ => None,
        }
    }

    /// Returns why a wish ended; `None` where telemetry states the reason in full: faults, or the operator that stopped the robot.
    pub(crate) fn ended(why: Option<&Refusal>) -> Option<Self> {
        match why {
            Some(Refusal::Stopped | Refusal::Faulted(_)) => None,
            Some(Refusal::State(State::Disarmed)) => Some(Self::Lapsed),
            Some(refusal) => Some(Self::Refused(refusal.clone())),
            None => Some(Self::Unanswered),
        }
    }

    /// Returns why a robot that is being armed will not be, if this update says so.
    #[must_use]
    pub fn while_arming(update: &Update) -> Option<Self> {
        match update {
            Update::Ended { why: Some(Refusal::Rested), .. } => Some(Self::Lapsed),
            Update::Ended { why: Some(refusal), .. } => Some(Self::Refused(refusal.clone())),
            Update::Ended { why: None, .. } => Some(Self::Unanswered),
            _ => None,
        }
    }
}

fn hint(refusal: &Refusal) -> String {
    explain::refusal(refusal).map_or_else(String::new, |hint| format!("; {hint}"))
}

fn describe(first: Option<Fault>, all: Faults) -> String {
    let Some(first) = first.or_else(|| all.iter().next()) else { return all.to_string() };
    let others = all.without(first);
    let and = if others.is_empty() { String::new() } else { format!(", then {others}") };
    format!("{first} ({}){and}", explain::fault(first))
}
