//! Who may command the robot, and how each datagram proves it.
//!
//! Operator and robot share one 256-bit [`Key`]. A handshake of four datagrams, with a fresh nonce
//! from each end, makes the keys of one session:
//!
//! ```text
//! operator                                  robot
//!   Hello    version, client nonce      ->          keeps nothing
//!            <-  Challenge    robot nonce           (a cookie: it can recompute it)
//!   Confirm  both nonces                ->          checks the cookie: now there is a session
//!            <-  Accept       session id
//!   Sealed   counter, command           ->
//!            <-  Sealed       counter, reply, telemetry or event
//! ```
//!
//! - **Tags of the handshake** are HMAC-SHA256 under a key derived from the pre-shared key, cut to
//!   16 bytes, over every byte of the datagram, the schema key and all nonces that its sender
//!   knows. Challenge proves the robot fresh to the operator, Confirm the operator to the robot.
//! - **The robot's nonce is a cookie**: HMAC-SHA256 over epoch, the operator's address and the
//!   client nonce, under a secret that only the robot knows and changes with every session that it
//!   accepts. So it keeps no state for anyone who has not proved to hold the key, and an old
//!   Confirm never opens a session again. Cookies are good for [`COOKIE_EPOCH`] to twice that.
//! - **Keys of a session**, one for each direction, and the session's id are HKDF-SHA256 of the
//!   pre-shared key with both nonces as salt and the schema key as info.
//! - **Sealed datagrams** are ChaCha20-Poly1305 with the counter as nonce and the header as
//!   associated data. Counters are 64-bit, start at 0 and refuse to wrap. A sliding
//!   [`ReplayWindow`] lets each through once.
//! - **Newest wins**: the robot drops a command older than one already obeyed, except a
//!   [`Stop`](crate::message::Command::Stop), which is honoured whenever it is authentic and not
//!   replayed. The operator drops telemetry older than what it has already shown.
//! - An empty sealed message says goodbye.
//!
//! # One operator at a time
//!
//! A session belongs to the address and port that opened it. While its holder was heard within the
//! last [`HOLDER_SILENCE`], everybody else is refused as busy, even with the right key: all
//! operators of a robot hold the same key, so the robot cannot tell an impatient owner from a second
//! one. Two exceptions, where it can tell: a holder that said goodbye is gone at once, and a
//! handshake from the holder's own address and port is the holder itself, having lost its session,
//! and takes over at once. A holder that is silent for [`SESSION_EXPIRY`] is forgotten.
//!
//! # Refusals
//!
//! Before there is a session the robot refuses in the clear and never with more bytes than it was
//! sent. A refusal carries a tag, which the operator can verify when both hold one key (busy, other
//! version); otherwise it is a hint that anybody on the network could have sent. So the operator
//! keeps trying ([`CONNECT_PATIENCE`], [`HINT_PATIENCE`]) and reports a refusal only when no valid
//! answer came.
//!
//! # Shape
//!
//! [`RobotSession`] and [`OperatorSession`] are state machines: time, addresses and datagrams come
//! in as arguments, what to send and what was said come out. They read no clock, own no socket,
//! allocate nothing and never panic on any input. Randomness comes in once, as a 256-bit seed that
//! **must be fresh from a hardware source at every start**: with an old seed, old sessions could be
//! replayed.

mod channel;
mod key;
mod operator;
mod replay;
mod robot;

use core::time::Duration;

use postcard_schema::key::Key as SchemaKey;

use crate::frame::Version;
use crate::message::{ToOperator, ToRobot};

pub use channel::SendError;
pub use key::{KEY_TEXT_LENGTH, Key, KeyError};
pub use operator::{ConnectError, LinkHealth, OperatorReceived, OperatorSession, Status};
pub use replay::{REPLAY_WINDOW, ReplayWindow};
pub use robot::{RobotReceived, RobotSession};

/// Counted up when the meaning of messages changes though their schema does not, or when the
/// handshake changes.
pub const PROTOCOL_VERSION: u16 = 1;

/// What this build speaks: [`PROTOCOL_VERSION`] and a hash over the schema of [`ToRobot`] and
/// [`ToOperator`], names and types of all fields included.
pub const VERSION: Version = Version {
    number: PROTOCOL_VERSION,
    schema_key: combine(&[
        PROTOCOL_VERSION as u64,
        u64::from_le_bytes(SchemaKey::for_path::<ToRobot>("flix/to-robot").to_bytes()),
        u64::from_le_bytes(SchemaKey::for_path::<ToOperator>("flix/to-operator").to_bytes()),
    ]),
};

/// FNV-1a over 64-bit words.
const fn combine(words: &[u64]) -> u64 {
    let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
    let mut index = 0;
    while index < words.len() {
        hash = (hash ^ words[index]).wrapping_mul(0x0100_0000_01b3);
        hash ^= hash >> 32;
        index += 1;
    }
    hash
}

/// How long the holder of a session must be silent before another operator may take over.
///
/// The last step of the failsafe ladder, at which the robot is disarmed.
pub const HOLDER_SILENCE: Duration = Duration::from_secs(1);
/// How long a silent session is kept for its holder when nobody else wants it.
pub const SESSION_EXPIRY: Duration = Duration::from_secs(10);
/// How often the cookie's epoch advances. Ample for a handshake on the worst link, short for a
/// thief of datagrams.
pub const COOKIE_EPOCH: Duration = Duration::from_secs(4);
/// How often the operator repeats an unanswered Hello or Confirm.
pub const HANDSHAKE_RETRY: Duration = Duration::from_millis(100);
/// How long the operator repeats a Confirm before it starts over with a new nonce.
pub const CONFIRM_PATIENCE: Duration = Duration::from_millis(500);
/// How long the operator tries before it reports that nobody answered or that the robot is busy.
/// Longer than [`HOLDER_SILENCE`], so that an operator that died can be replaced in one attempt.
pub const CONNECT_PATIENCE: Duration = Duration::from_secs(3);
/// How long the operator goes on trying after the first refusal that will not pass by itself
/// (other key, other version, no key).
pub const HINT_PATIENCE: Duration = Duration::from_millis(500);
