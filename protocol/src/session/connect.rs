//! One attempt of an operator to reach a robot, and why it failed.

use core::time::Duration;

use core::fmt;

use super::key::Entropy;
use super::{CONNECT_PATIENCE, HINT_PATIENCE, PROTOCOL_VERSION};
use crate::frame::{Nonce, RefusalReason, Version};
use crate::message::{DropReason, OperatorName};
use crate::units::Instant;

/// Why there is no session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ConnectError {
    /// No answer arrived.
    NoAnswer,
    /// The robot does not hold this key.
    WrongKey,
    /// The robot uses another version: its number. The same number means that one end was changed
    /// without incrementing it.
    OtherVersion(u16),
    /// This other operator holds the robot; `None`: another program with the same key.
    Busy(Option<OperatorName>),
    /// The robot has no key yet.
    Unprovisioned,
}

impl fmt::Display for ConnectError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoAnswer => f.write_str(
                "the robot does not answer: check that it is on, its address, and that both are on one network",
            ),
            Self::WrongKey => f.write_str(
                "the robot has another key, or yours was revoked: use its key file, or have it provisioned again over its serial port",
            ),
            Self::OtherVersion(robot) if *robot > PROTOCOL_VERSION => write!(
                f,
                "the robot uses version {robot} of the protocol and this program {PROTOCOL_VERSION}: update this program"
            ),
            Self::OtherVersion(robot) if *robot < PROTOCOL_VERSION => write!(
                f,
                "the robot uses version {robot} of the protocol and this program {PROTOCOL_VERSION}: update the robot's firmware"
            ),
            Self::OtherVersion(robot) => write!(
                f,
                "the robot uses another build of version {robot} of the protocol: update the robot's firmware and this program to one release"
            ),
            Self::Busy(None) => f.write_str(
                "you hold the robot already, with another program or from another address: end that program, or wait for a second",
            ),
            Self::Busy(Some(holder)) => write!(
                f,
                "another operator holds the robot, {holder}: wait until it disconnects or is silent for a second"
            ),
            Self::Unprovisioned => {
                f.write_str("the robot has no key yet: provision it over its serial port")
            }
        }
    }
}

impl core::error::Error for ConnectError {}

impl ConnectError {
    /// Returns the error of a refusal for this reason by a robot of this version.
    pub(super) const fn refused(reason: RefusalReason, robot: Version) -> Self {
        match reason {
            RefusalReason::Version => Self::OtherVersion(robot.number),
            RefusalReason::Key => Self::WrongKey,
            RefusalReason::Unprovisioned => Self::Unprovisioned,
        }
    }

    /// Returns whether a longer attempt cannot help.
    const fn is_lasting(self) -> bool {
        matches!(self, Self::WrongKey | Self::OtherVersion(_) | Self::Unprovisioned)
    }
}

/// One attempt to connect.
#[derive(Clone, Copy)]
pub(super) struct Greeting {
    pub(super) client_nonce: Nonce,
    since: Instant,
    pub(super) send_at: Instant,
    /// Datagrams that were sent, wrapping: no two in a row are the same.
    sent: u8,
    /// The newest refusal, and when the first lasting one came.
    pub(super) hint: Option<(ConnectError, Instant)>,
}

impl Greeting {
    pub(super) fn new(entropy: &mut Entropy, now: Instant) -> Self {
        Self { client_nonce: entropy.nonce(), since: now, send_at: now, sent: 0, hint: None }
    }

    /// Starts over with a new nonce, within the same patience.
    pub(super) fn renew(&mut self, entropy: &mut Entropy) {
        self.client_nonce = entropy.nonce();
    }

    /// Returns the number of the datagram that is sent now; the next is due after this time.
    pub(super) fn repetition(&mut self, now: Instant, retry: Duration) -> u8 {
        self.send_at = now + retry;
        self.sent = self.sent.wrapping_add(1);
        self.sent
    }

    /// Returns when the attempt is over without an answer.
    pub(super) fn gives_up_at(&self) -> Instant {
        match self.hint {
            Some((error, since)) if error.is_lasting() => {
                self.patience_ends_at().min(since + HINT_PATIENCE)
            }
            _ => self.patience_ends_at(),
        }
    }

    /// Returns when an attempt is over that no hint ends.
    pub(super) fn patience_ends_at(&self) -> Instant {
        self.since + CONNECT_PATIENCE
    }

    /// Returns why the attempt failed, once it is over.
    pub(super) fn failure(&self, now: Instant) -> Option<ConnectError> {
        (now >= self.gives_up_at()).then(|| self.error())
    }

    /// Returns why the attempt fails, as far as is known.
    pub(super) fn error(&self) -> ConnectError {
        self.hint.map_or(ConnectError::NoAnswer, |(error, _)| error)
    }

    /// Records a refusal of this attempt.
    pub(super) fn refused(
        &mut self,
        now: Instant,
        error: ConnectError,
        client_nonce: &Nonce,
    ) -> Result<(), DropReason> {
        if *client_nonce != self.client_nonce {
            return Err(DropReason::Session);
        }
        let since = match self.hint {
            Some((known, since)) if known == error => since,
            _ => now,
        };
        self.hint = Some((error, since));
        Ok(())
    }
}
