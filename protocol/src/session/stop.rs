//! The operator's end of a stop outside a session.

use super::connect::{ConnectError, Greeting};
use super::key::{Entropy, Key, Signer};
use super::{STOP_ANSWER_PATIENCE, STOP_COOKIE_LIFE, STOP_RETRY, VERSION};
use crate::frame::{self, Datagram, HandshakeFrame, KeyId, Nonce, Purpose};
use crate::message::DropReason;
use crate::units::Instant;

/// Progress of a stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopStatus {
    /// The robot has not answered yet.
    Asking,
    /// The robot has latched the stop, and ramps down.
    Latched,
    /// The stop is latched, and the motors are not driven.
    AtRest,
    /// No robot answered, or it refused.
    Failed(ConnectError),
}

/// Stops a robot without a session, also while another operator holds the robot.
///
/// Call [`StopSession::poll`] at the time of [`StopSession::poll_at`], and send each datagram that it returns, until
/// the robot is at rest. Never panics on any datagram.
pub struct StopSession {
    key_id: KeyId,
    handshake: Signer,
    stop: Signer,
    entropy: Entropy,
    greeting: Greeting,
    /// The robot's cookie, and when it arrived.
    challenged: Option<(Nonce, Instant)>,
    status: StopStatus,
}

impl StopSession {
    /// Creates a stop that begins at once.
    ///
    /// `entropy` comes from the operating system's random source, fresh for every stop.
    #[must_use]
    pub fn new(key: &Key, entropy: [u8; 32], now: Instant) -> Self {
        let mut entropy = Entropy::new(entropy);
        Self {
            key_id: key.id(),
            handshake: Signer::new(key),
            stop: Signer::for_stop(key),
            greeting: Greeting::new(&mut entropy, now),
            entropy,
            challenged: None,
            status: StopStatus::Asking,
        }
    }

    /// Returns the progress.
    #[must_use]
    pub const fn status(&self) -> StopStatus {
        self.status
    }

    /// Returns whether the robot has proved that it has the key.
    #[must_use]
    pub const fn is_challenged(&self) -> bool {
        self.challenged.is_some()
    }

    /// Returns when [`StopSession::poll`] is due next; `None` once the robot is at rest, or the stop
    /// failed.
    #[must_use]
    pub fn poll_at(&self) -> Option<Instant> {
        match self.status {
            StopStatus::Asking => Some(self.greeting.send_at.min(self.patience_ends_at())),
            StopStatus::Latched => Some(self.greeting.send_at),
            StopStatus::AtRest | StopStatus::Failed(_) => None,
        }
    }

    /// Returns the datagram that is due, if any.
    pub fn poll(&mut self, now: Instant) -> Option<HandshakeFrame> {
        // Anybody can forge a refusal: a stop is tried for as long as if there were none.
        if self.status == StopStatus::Asking && now >= self.patience_ends_at() {
            self.status = StopStatus::Failed(self.greeting.error());
        }
        if self.poll_at().is_none_or(|due| now < due) {
            return None;
        }
        let begins_anew = now < self.greeting.patience_ends_at();
        if self.challenged.is_some_and(|(_, since)| now.since(since) >= STOP_ANSWER_PATIENCE)
            && begins_anew
        {
            // The cookie is about to become invalid.
            self.challenged = None;
            self.greeting.renew(&mut self.entropy);
        }
        let repetition = self.greeting.repetition(now, STOP_RETRY);
        let client_nonce = &self.greeting.client_nonce;
        Some(match &self.challenged {
            Some((robot_nonce, _)) => {
                frame::stop(client_nonce, robot_nonce, &self.key_id, repetition, |signed| {
                    self.stop.tag(signed, &[])
                })
            }
            None => {
                let tag = |signed: &[u8]| self.handshake.tag(signed, &[]);
                let (purpose, key_id) = (Purpose::Stop, &self.key_id);
                frame::hello(VERSION, client_nonce, purpose, key_id, repetition, tag)
            }
        })
    }

    /// Returns when no answer is waited for any more: as long as the robot may obey, and as its answer may take then.
    fn patience_ends_at(&self) -> Instant {
        let patience = self.greeting.patience_ends_at();
        self.challenged.map_or(patience, |(_, since)| patience.max(since + STOP_COOKIE_LIFE))
    }

    /// Receives a datagram from the robot's address.
    ///
    /// # Errors
    /// When the datagram is dropped.
    pub fn receive(&mut self, now: Instant, datagram: &[u8]) -> Result<(), DropReason> {
        let greeting = &mut self.greeting;
        match (Datagram::parse(datagram), &self.challenged) {
            (Some(Datagram::Challenge { robot_nonce, signed, tag }), None) => {
                if !self.handshake.verify(signed, &[&greeting.client_nonce], &tag) {
                    return Err(DropReason::Forged);
                }
                self.challenged = Some((robot_nonce, now));
                (greeting.send_at, greeting.hint) = (now, None);
                Ok(())
            }
            (Some(Datagram::Stopped { at_rest, signed, tag }), Some((robot_nonce, _))) => {
                if !self.stop.verify(signed, &[&greeting.client_nonce, robot_nonce], &tag) {
                    return Err(DropReason::Forged);
                }
                // Of answers that overtake each other, rest is the last.
                if self.status != StopStatus::AtRest {
                    self.status = if at_rest { StopStatus::AtRest } else { StopStatus::Latched };
                }
                Ok(())
            }
            (Some(Datagram::Refusal { reason, version, client_nonce, .. }), None) => {
                greeting.refused(now, ConnectError::refused(reason, version), &client_nonce)
            }
            (
                Some(
                    Datagram::Challenge { .. }
                    | Datagram::Stopped { .. }
                    | Datagram::Refusal { .. },
                ),
                _,
            ) => Err(DropReason::Session),
            _ => Err(DropReason::Malformed),
        }
    }
}
