//! Seals and opens the datagrams of one session.

use core::time::Duration;

use chacha20poly1305::aead::AeadInOut;
use chacha20poly1305::{ChaCha20Poly1305, KeyInit};
use serde::Serialize;
use zeroize::Zeroizing;

use super::OLD_KEYS_LIFE;
use super::key::SessionKeys;
use super::replay::ReplayWindow;
use crate::frame::{
    ECHO_LENGTH, Frame, HandshakeFrame, MAXIMUM_MESSAGE, Nonce, SEALED_HEADER, Sealed, TAG_LENGTH,
    sealed_header,
};
use crate::message::DropReason;
use crate::units::Instant;

/// Why a message was not sealed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SendError {
    /// There is no session.
    #[error("there is no session: connect first")]
    NoSession,
    /// The message is longer than a datagram holds.
    #[error("the message is longer than {MAXIMUM_MESSAGE} bytes")]
    TooLong,
    /// All 2^64 counters of the session are used.
    #[error("the session has used all its counters: connect again")]
    Exhausted,
}

/// A plain message, as opened from a sealed datagram. Empty: goodbye.
pub(super) type Plain = heapless::Vec<u8, MAXIMUM_MESSAGE>;

/// Keys of one direction each, and the number under which they are used.
struct Ciphers {
    session: u32,
    seal: ChaCha20Poly1305,
    open: ChaCha20Poly1305,
    /// Secret from which a renewal derives the next keys.
    next: Zeroizing<[u8; 32]>,
}

/// One end of a session. Its counters count on when its keys are renewed.
pub(super) struct Channel {
    /// Keys that seal.
    present: Ciphers,
    /// Other keys that open: the next ones until the other end uses them, or the former ones for datagrams under way.
    other: Option<Ciphers>,
    /// When the former keys are erased; `None` while the other keys are the next.
    erase_at: Option<Instant>,
    /// When the present keys were made.
    since: Instant,
    next_counter: u64,
    window: ReplayWindow,
    /// Whether sealed messages begin with the echo.
    echoes: bool,
}

impl Channel {
    pub(super) fn operator(keys: &SessionKeys, now: Instant) -> Self {
        Self::new(keys, true, now)
    }

    pub(super) fn robot(keys: &SessionKeys, now: Instant) -> Self {
        Self::new(keys, false, now)
    }

    fn new(keys: &SessionKeys, echoes: bool, now: Instant) -> Self {
        Self {
            present: Ciphers::new(keys, echoes),
            other: None,
            erase_at: None,
            since: now,
            next_counter: 0,
            window: ReplayWindow::new(),
            echoes,
        }
    }

    pub(super) const fn session(&self) -> u32 {
        self.present.session
    }

    /// Returns whether keys of this session number are known.
    pub(super) fn knows(&self, session: u32) -> bool {
        self.present.session == session
            || self.other.as_ref().is_some_and(|other| other.session == session)
    }

    /// Returns how old the present keys are.
    pub(super) fn age(&self, now: Instant) -> Duration {
        now.since(self.since)
    }

    /// Makes the next keys ready, from the present ones and a fresh nonce of each end, the operator's first: they are used
    /// from the moment at which the other end uses them.
    pub(super) fn prepare(&mut self, nonces: [&Nonce; 2]) {
        let keys = SessionKeys::renewed(&self.present.next, nonces);
        self.other = Some(Ciphers::new(&keys, self.echoes));
        self.erase_at = None;
    }

    /// Uses the keys that were made ready, if any, and keeps the former ones for datagrams under way.
    pub(super) fn switch(&mut self, now: Instant) {
        if let Some(other) = self.other.as_mut().filter(|_| self.erase_at.is_none()) {
            core::mem::swap(&mut self.present, other);
            self.erase_at = Some(now + OLD_KEYS_LIFE);
            self.since = now;
        }
    }

    /// Erases keys that have served.
    pub(super) fn expire(&mut self, now: Instant) {
        if self.erase_at.is_some_and(|at| now >= at) {
            (self.other, self.erase_at) = (None, None);
        }
    }

    pub(super) const fn window(&self) -> &ReplayWindow {
        &self.window
    }

    /// Returns how many datagrams were sealed.
    pub(super) const fn sealed(&self) -> u64 {
        self.next_counter
    }

    /// Seals a message.
    pub(super) fn seal(&mut self, message: &impl Serialize) -> Result<Frame, SendError> {
        let mut message_bytes = [0; MAXIMUM_MESSAGE];
        let message =
            postcard::to_slice(message, &mut message_bytes).map_err(|_| SendError::TooLong)?;
        self.seal_copy(message)
    }

    /// Seals any bytes; none: the message that says goodbye.
    pub(super) fn seal_copy(&mut self, message: &[u8]) -> Result<Frame, SendError> {
        self.seal_kind(false, message)
    }

    /// Seals a nonce that renews the keys.
    pub(super) fn seal_renewal(&mut self, nonce: &Nonce) -> Option<HandshakeFrame> {
        let frame = self.seal_kind(true, nonce).ok()?;
        HandshakeFrame::from_slice(&frame).ok()
    }

    fn seal_kind(&mut self, is_renewal: bool, message: &[u8]) -> Result<Frame, SendError> {
        let echo = self.window.newest().map_or(0, |newest| newest + 1).to_le_bytes();
        let mut plain = Plain::from_slice(if self.echoes { &echo } else { &[] })
            .map_err(|_| SendError::TooLong)?;
        plain.extend_from_slice(message).map_err(|_| SendError::TooLong)?;
        let counter = self.next_counter;
        let next_counter = counter.checked_add(1).ok_or(SendError::Exhausted)?;
        let header = sealed_header(is_renewal, self.present.session, counter);
        let tag = self
            .present
            .seal
            .encrypt_inout_detached(&nonce(counter), &header, plain.as_mut_slice().into())
            .map_err(|_| SendError::TooLong)?;
        let mut frame = Frame::new();
        for part in [&header[..], &plain, &tag] {
            frame.extend_from_slice(part).map_err(|_| SendError::TooLong)?;
        }
        self.next_counter = next_counter;
        Ok(frame)
    }

    /// Opens a datagram of this session, at most once, and switches to the keys that it shows to be
    /// ready at the other end.
    pub(super) fn open(&mut self, now: Instant, sealed: &Sealed<'_>) -> Result<Plain, DropReason> {
        let Sealed { session, counter, header, ciphertext, ref tag, .. } = *sealed;
        if !self.window.is_new(counter) {
            return Err(DropReason::Replayed);
        }
        let ciphers = match &self.other {
            Some(other) if other.session == session => other,
            _ if self.present.session == session => &self.present,
            _ => return Err(DropReason::Session),
        };
        let mut plain = Plain::from_slice(ciphertext).map_err(|_| DropReason::Malformed)?;
        ciphers
            .open
            .decrypt_inout_detached(
                &nonce(counter),
                header,
                plain.as_mut_slice().into(),
                tag.into(),
            )
            .map_err(|_| DropReason::Forged)?;
        self.window.accept(counter);
        if session != self.present.session {
            self.switch(now);
        }
        Ok(plain)
    }
}

impl Ciphers {
    /// `is_operator`: whether this end seals towards the robot.
    fn new(keys: &SessionKeys, is_operator: bool) -> Self {
        let (to_robot, to_operator) = (&keys.to_robot, &keys.to_operator);
        let (seal, open) =
            if is_operator { (to_robot, to_operator) } else { (to_operator, to_robot) };
        Self {
            session: keys.session,
            seal: ChaCha20Poly1305::new(seal.into()),
            open: ChaCha20Poly1305::new(open.into()),
            next: Zeroizing::new(keys.next),
        }
    }
}

const _: () =
    assert!(SEALED_HEADER + MAXIMUM_MESSAGE + TAG_LENGTH == crate::frame::MAXIMUM_DATAGRAM);

/// Splits the opened bytes of an operator's datagram into echo and message.
pub(super) fn split_echo(plain: &Plain) -> Option<(u64, &[u8])> {
    let (echo, message) = plain.split_first_chunk::<ECHO_LENGTH>()?;
    Some((u64::from_le_bytes(*echo), message))
}

/// Returns the nonce of a counter. Each key serves one direction of one session, so the counter
/// makes it unique.
fn nonce(counter: u64) -> chacha20poly1305::Nonce {
    let mut nonce = [0; 12];
    nonce[4..].copy_from_slice(&counter.to_le_bytes());
    nonce.into()
}
