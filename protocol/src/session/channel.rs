//! Seals and opens the datagrams of one session.

use core::fmt;

use chacha20poly1305::aead::AeadInOut;
use chacha20poly1305::{ChaCha20Poly1305, KeyInit};
use serde::Serialize;

use super::key::SessionKeys;
use super::replay::ReplayWindow;
use crate::frame::{
    ECHO_LENGTH, Frame, MAXIMUM_MESSAGE, SEALED_HEADER, TAG_LENGTH, Tag, sealed_header,
};
use crate::message::DropReason;

/// Why a message was not sealed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SendError {
    /// There is no session.
    NoSession,
    /// The message is longer than a datagram holds.
    TooLong,
    /// All 2^64 counters of the session are used.
    Exhausted,
}

impl fmt::Display for SendError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoSession => f.write_str("there is no session: connect first"),
            Self::TooLong => write!(f, "the message is longer than {MAXIMUM_MESSAGE} bytes"),
            Self::Exhausted => f.write_str("the session has used all its counters: connect again"),
        }
    }
}

impl core::error::Error for SendError {}

/// A plain message, as opened from a sealed datagram. Empty: goodbye.
pub(super) type Plain = heapless::Vec<u8, MAXIMUM_MESSAGE>;

/// One end of a session.
pub(super) struct Channel {
    session: u32,
    seal: ChaCha20Poly1305,
    open: ChaCha20Poly1305,
    next_counter: u64,
    window: ReplayWindow,
    /// Whether what is sealed begins with the echo.
    echoes: bool,
}

impl Channel {
    pub(super) fn operator(keys: &SessionKeys) -> Self {
        Self::new(keys.session, &keys.to_robot, &keys.to_operator, true)
    }

    pub(super) fn robot(keys: &SessionKeys) -> Self {
        Self::new(keys.session, &keys.to_operator, &keys.to_robot, false)
    }

    fn new(session: u32, seal: &[u8; 32], open: &[u8; 32], echoes: bool) -> Self {
        Self {
            session,
            seal: ChaCha20Poly1305::new(seal.into()),
            open: ChaCha20Poly1305::new(open.into()),
            next_counter: 0,
            window: ReplayWindow::new(),
            echoes,
        }
    }

    pub(super) const fn session(&self) -> u32 {
        self.session
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
        let echo = self.window.newest().map_or(0, |newest| newest + 1).to_le_bytes();
        let mut plain = Plain::from_slice(if self.echoes { &echo } else { &[] })
            .map_err(|_| SendError::TooLong)?;
        plain.extend_from_slice(message).map_err(|_| SendError::TooLong)?;
        self.seal_bytes(&mut plain)
    }

    fn seal_bytes(&mut self, plain: &mut [u8]) -> Result<Frame, SendError> {
        let counter = self.next_counter;
        let next_counter = counter.checked_add(1).ok_or(SendError::Exhausted)?;
        let header = sealed_header(self.session, counter);
        let tag = self
            .seal
            .encrypt_inout_detached(&nonce(counter), &header, (&mut *plain).into())
            .map_err(|_| SendError::TooLong)?;
        let mut frame = Frame::new();
        for part in [&header, &*plain, &tag] {
            frame.extend_from_slice(part).map_err(|_| SendError::TooLong)?;
        }
        self.next_counter = next_counter;
        Ok(frame)
    }

    /// Opens a datagram of this session, at most once.
    pub(super) fn open(
        &mut self,
        counter: u64,
        header: &[u8],
        ciphertext: &[u8],
        tag: &Tag,
    ) -> Result<Plain, DropReason> {
        if !self.window.is_new(counter) {
            return Err(DropReason::Replayed);
        }
        let mut plain = Plain::from_slice(ciphertext).map_err(|_| DropReason::Malformed)?;
        self.open
            .decrypt_inout_detached(
                &nonce(counter),
                header,
                plain.as_mut_slice().into(),
                tag.into(),
            )
            .map_err(|_| DropReason::Forged)?;
        self.window.accept(counter);
        Ok(plain)
    }
}

const _: () =
    assert!(SEALED_HEADER + MAXIMUM_MESSAGE + TAG_LENGTH == crate::frame::MAXIMUM_DATAGRAM);

/// Splits what an operator sealed into its echo and its message.
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
