//! Sessions: who may command the robot, and how each datagram proves it.
//!
//! Operator and robot share one 256-bit [`Key`]. A robot has up to [`MAXIMUM_OPERATORS`] operators, each
//! with a name and a key of its own. A handshake of four datagrams, with a fresh nonce and an ephemeral key
//! from each end, makes the keys of one session:
//!
//! ```text
//! operator                                  robot
//!   Hello    version, nonce, key id     ->          stores nothing
//!            <-  Challenge    robot nonce           (a cookie: it can recompute it)
//!   Confirm  both nonces, key id,       ->          checks tag and cookie, then multiplies,
//!            ephemeral key                          opens the session
//!            <-  Accept       session id, ephemeral key
//!   Sealed   counter, echo, command     ->
//!            <-  Sealed       counter, reply, telemetry or event
//! ```
//!
//! - **Tags of the handshake** are HMAC-SHA256 under a key derived from the pre-shared key, cut to
//!   16 bytes, over every byte of the datagram, the schema key and a link to the datagram that is answered: Challenge covers
//!   the client nonce, Accept the tag of Confirm. Challenge proves the robot fresh to the operator, Confirm the operator to
//!   the robot.
//! - **Key id**: a public number that is derived from the key ([`Key::id`]) states which of its keys the
//!   robot is to try, so that a forged datagram costs it one tag at most, however many it has.
//! - **The robot's nonce is a cookie**: HMAC-SHA256 over epoch, the operator's address and the
//!   client nonce, under a secret that only the robot knows and changes with every session that it
//!   accepts. So it stores no state for an operator that has not proved to hold the key, and an
//!   old Confirm never opens a session again. Cookies are good for [`COOKIE_LIFE`].
//! - **Keys of a session**, one for each direction, and the session's id are HKDF-SHA256 with both nonces as
//!   salt and the schema key as info. The input is the pre-shared key, the shared secret of the ephemeral keys
//!   by X25519 (RFC 7748), and their public halves.
//! - **Sealed datagrams** are ChaCha20-Poly1305 with the counter as nonce and the header as
//!   associated data. Counters are 64-bit, start at 0 and refuse to wrap. A sliding
//!   [`ReplayWindow`] lets each through once.
//! - **Newest wins**: the robot drops a message older than one already taken. The operator drops telemetry older than that already
//!   shown.
//! - An empty sealed message closes the session (goodbye).
//!
//! # Forward secrecy
//!
//! An ephemeral key is made for one handshake and wiped once the keys of the session are derived. So an attacker
//! who recorded a session and learns the pre-shared key later can neither read it nor seal for it. The shape is that of
//! Noise's NNpsk0: the ephemeral keys prove nothing by themselves, the tags under the pre-shared key do. It is kept in the
//! handshake above and not left to a library of Noise (clatter 2.3 was weighed): such a library knows neither cookies nor
//! lost and repeated datagrams, which are most of this module, and its messages would be wrapped in ours.
//!
//! A multiplication on the curve costs the robot a hundred times a tag. The robot does two for each session, and none
//! before tag and cookie of a Confirm hold; a cookie pays for one try. An ephemeral key of small order, which makes the
//! secret public, is refused.
//!
//! # Freshness
//!
//! Each sealed datagram of the operator carries its *echo*: the newest counter of the robot's datagrams that
//! the operator has seen in this session (the idea of the Echo option, RFC 9175). The robot remembers when it
//! sent its recent datagrams, so the echo names a *moment* on its own clock, and the operator sealed
//! the command after that moment: the robot knows how old a command is at most, on any
//! way through the network. The *age* of a command is the time since its moment. Rounding
//! ([`SEND_SLOT`]) makes it look older, never younger.
//!
//! A command is *fresh* while its age is at most the command age
//! ([`RobotSession::set_command_age`]); otherwise it is [`RobotReceived::Late`], is no sign of life
//! and holds no session. So a network that delays, collects or releases datagrams cannot move
//! a robot later than the command age after its operator's last intent.
//!
//! # One operator at a time
//!
//! A session belongs to the address and port that opened it: its holder. While the holder's
//! newest fresh datagram arrived within the last [`HOLDER_SILENCE`], the robot refuses all others as
//! held, even with the right key, and names the holder. A session that has just opened counts as heard
//! at the moment of its Challenge, or when its holder was last heard in its session before.
//! There are three exceptions. A holder that said goodbye is gone at once. A handshake with the
//! holder's own key from its address and port is the holder, which lost its session; it takes over at
//! once. A session whose operator is revoked ends at once ([`RobotSession::set_operators`]).
//! The robot forgets a holder that is silent for [`SESSION_EXPIRY`].
//!
//! # A stop from any operator
//!
//! A stop must not wait for the holder of the session, whose program may hang. So a Hello names its purpose, and a stop is
//! never refused as busy:
//!
//! ```text
//! operator                                  robot
//!   Hello    purpose stop               ->          stores nothing
//!            <-  Challenge    robot nonce           (a cookie, of stops alone)
//!   Stop     both nonces, key id        ->          checks tag and cookie, latches the stop
//!            <-  Stopped      whether at rest
//! ```
//!
//! Stop and Stopped are tagged under a key derived for stops alone. A cookie stops the robot once:
//! a repeated Stop is answered again and changes nothing, and none counts longer than
//! [`STOP_COOKIE_LIFE`] after its Challenge. The session of the holder goes on, and an event names
//! the operator who stopped the robot. [`StopSession`] repeats an unanswered datagram every [`STOP_RETRY`].
//!
//! # Life of the keys
//!
//! Keys of a session live for [`SESSION_LIFE`]. From [`SESSION_RENEWAL`] on the operator asks for new
//! ones, every [`HANDSHAKE_RETRY`]: both ends send a fresh nonce, sealed, and derive keys and id from these nonces and a
//! secret that was derived with the present keys for this alone. That costs hashes, no multiplication, so a robot renews
//! while it moves; the pre-shared key opens no renewal, and no later secret an earlier one. Counters, replay window and echo count on,
//! and nothing waits: the operator seals with the new keys once it has the robot's nonce, the robot
//! once it has opened a datagram that they sealed. Datagrams under way under the former keys count for
//! [`OLD_KEYS_LIFE`] more, then these keys are erased. A session that is not renewed ends with its keys.
//!
//! # Refusals
//!
//! Before there is a session the robot refuses in the clear, and never with more bytes than it
//! received. That it is held it says with a tag, which the operator verifies; any other refusal is a
//! hint that any machine on the network could have sent. So the operator tries again ([`CONNECT_PATIENCE`], [`HINT_PATIENCE`]) and reports a refusal only when
//! it received no valid answer.
//!
//! # Shape
//!
//! [`RobotSession`], [`OperatorSession`] and [`StopSession`] are state machines: time, addresses and datagrams are
//! arguments; datagrams to send and messages received are results. They read no clock, own no
//! socket, allocate nothing and never panic on any input. Randomness comes in once, as a 256-bit seed that
//! **must be fresh from a hardware source at every start**: with an old seed, old sessions could be
//! replayed.

mod channel;
mod connect;
mod cookie;
mod key;
mod operator;
mod operators;
mod replay;
mod robot;
mod send_times;
mod stop;

use core::time::Duration;

use postcard_schema::key::Key as SchemaKey;

use crate::frame::Version;
use crate::message::{ToOperator, ToRobot};

pub use channel::SendError;
pub use connect::ConnectError;
pub use key::{KEY_TEXT_LENGTH, Key, KeyError};
pub use operator::{LinkHealth, OperatorReceived, OperatorSession, Status};
pub use operators::{AddError, MAXIMUM_OPERATORS, Operator, Operators};
pub use replay::{REPLAY_WINDOW, ReplayWindow};
pub use robot::{RobotReceived, RobotSession};
pub use send_times::{LONGEST_COMMAND_AGE, SEND_SLOT};
pub use stop::{StopSession, StopStatus};

/// Version of the protocol, incremented when the meaning of messages changes and their schema does
/// not, or when the handshake changes.
pub const PROTOCOL_VERSION: u16 = 9;

/// Version of this build: [`PROTOCOL_VERSION`] and a hash over the schema of [`ToRobot`] and
/// [`ToOperator`], names and types of all fields included.
pub const VERSION: Version = Version {
    number: PROTOCOL_VERSION,
    schema_key: combine(&[
        PROTOCOL_VERSION as u64,
        u64::from_le_bytes(SchemaKey::for_path::<ToRobot>("flix/to-robot").to_bytes()),
        u64::from_le_bytes(SchemaKey::for_path::<ToOperator>("flix/to-operator").to_bytes()),
    ]),
};

/// Returns FNV-1a over 64-bit words.
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

/// Silence of the holder of a session, from the arrival of its newest fresh datagram, after which
/// another operator may take over.
///
/// The last step of the failsafe ladder, at which the robot is disarmed.
pub const HOLDER_SILENCE: Duration = crate::failsafe::LINK_LOST;
/// Silence of the holder after which its session ends.
pub const SESSION_EXPIRY: Duration = Duration::from_secs(10);
/// Time after which keys that were not renewed are erased, and the session ends.
pub const SESSION_LIFE: Duration = Duration::from_secs(600);
/// Age of its keys from which the operator asks for new ones: half their life, so that a network that is
/// gone for minutes does not end the session.
pub const SESSION_RENEWAL: Duration = Duration::from_secs(300);
/// Time for which former keys open datagrams under way: the largest command age.
pub const OLD_KEYS_LIFE: Duration = LONGEST_COMMAND_AGE;
/// Length of the cookie's epoch: the resolution of the moment at which a session counts as held.
pub const COOKIE_EPOCH: Duration = Duration::from_millis(250);
/// Time for which a cookie is good, at most; one [`COOKIE_EPOCH`] less at least. Ample for a
/// handshake on the slowest link that can be driven, short for an attacker that delays a Confirm.
pub const COOKIE_LIFE: Duration = COOKIE_EPOCH.saturating_mul(COOKIE_EPOCHS);
const COOKIE_EPOCHS: u32 = 5;
/// The same of a cookie of stops, which stops the robot once: a link that is too slow to drive still stops it.
pub const STOP_COOKIE_LIFE: Duration = COOKIE_EPOCH.saturating_mul(STOP_COOKIE_EPOCHS);
const STOP_COOKIE_EPOCHS: u32 = 8;
/// Interval at which the operator repeats an unanswered Hello or Confirm.
pub const HANDSHAKE_RETRY: Duration = Duration::from_millis(100);
/// Interval at which a stop outside a session is repeated.
pub const STOP_RETRY: Duration = Duration::from_millis(20);
/// Time for which the operator repeats a Confirm before it starts over with a new nonce.
pub const CONFIRM_PATIENCE: Duration = Duration::from_secs(1);
/// The same of a Stop, whose link may be too slow to drive.
pub const STOP_ANSWER_PATIENCE: Duration = Duration::from_millis(1500);
/// Time after which the operator reports that no robot answered or that the robot is busy.
/// Longer than [`HOLDER_SILENCE`], so that one attempt can replace an operator that crashed.
pub const CONNECT_PATIENCE: Duration = Duration::from_secs(3);
/// Time for which the operator tries again after the first refusal that does not pass by itself
/// (other key, other version, no key).
pub const HINT_PATIENCE: Duration = Duration::from_millis(500);
