//! The operator's end of the link: from setpoints to datagrams and back.
//!
//! [`Client`] has no clock and no socket: it takes time and datagrams as arguments, and returns what
//! to send and what happened. The simulator runs it in virtual time; [`udp`] runs it on a socket in
//! real time.
//!
//! # What the client does by itself
//!
//! - **Sign of life**: every [`KEEP_ALIVE`] it sends the held setpoint, or a ping when none is held,
//!   so the robot hears from it four times before it warns, and eleven times before its command deadline
//!   ([`flix_protocol::failsafe`]).
//! - **Requests** (arm, parameters, ...) carry a number and are repeated every [`REQUEST_RETRY`]
//!   until answered or [`REQUEST_PATIENCE`] is over. All commands are idempotent. One that was too
//!   old when it arrived ([`Refusal::Late`]) is repeated at once. When the robot halts by itself,
//!   requests to arm, to clear and for a trial are given up: the robot would refuse them.
//! - **Stop** comes before everything: held setpoint and pending requests are dropped, and stop is
//!   repeated every [`STOP_RETRY`] until the robot acknowledges it, also over reconnections, and without a session
//!   while there is none: another operator may hold the robot.
//! - **Silence** of [`SILENCE`] ends the session. The client connects again and drops the held
//!   setpoint, because a robot that comes back must not start by itself.
//!
//! # Terms
//!
//! *Held*: the setpoint that is repeated. *Round trip*: from sending a command to its reply, only
//! of commands sent once (Karn's rule: for a repeated one it is unknown which was answered).
//! *Unanswered*: no reply within [`ANSWER_TIME`]; either direction may have lost it.

mod arming;
mod as_commanded;
mod client;
#[cfg(not(target_family = "wasm"))]
pub mod discovery;
mod error;
pub mod explain;
#[cfg(not(target_family = "wasm"))]
pub mod keys;
mod robot_link;
#[cfg(not(target_family = "wasm"))]
pub mod serial;
pub mod statistics;
#[cfg(not(target_family = "wasm"))]
pub mod udp;

pub use arming::Arming;
pub use as_commanded::{errors, is_reached, line_difference};
pub use client::{Client, StopState, Update};
pub use error::LinkError;
pub use robot_link::RobotLink;
#[cfg(not(target_family = "wasm"))]
pub use udp::transient;

use std::time::Duration;

use flix_protocol::message::{Refusal, State};
use flix_protocol::session::{HINT_PATIENCE, HOLDER_SILENCE};

/// Interval of the setpoint or ping: a fifth of the robot's first deadline of 100 ms.
pub const KEEP_ALIVE: Duration = Duration::from_millis(20);
/// Interval at which an unanswered request is repeated. Longer than the slowest ordinary round trip
/// on Wi-Fi.
pub const REQUEST_RETRY: Duration = Duration::from_millis(100);
/// Time for which a request is repeated: 20 times, so that a link that loses 30 % each way fails
/// one request in a million.
pub const REQUEST_PATIENCE: Duration = Duration::from_secs(2);
/// Interval of stop until it is acknowledged.
pub const STOP_RETRY: Duration = Duration::from_millis(20);
/// Time after the end of a session in which a robot has disarmed by itself: a second of silence, and the ramp.
pub const DISARMED_AFTER: Duration = Duration::from_secs(2);
/// Time after which a stop that the robot has not acknowledged in the session is also asked for without one.
pub const STOP_BESIDE_AFTER: Duration = Duration::from_millis(100);
/// Silence of the robot after which the session ends: the robot, without commands, has disarmed.
pub const SILENCE: Duration = HOLDER_SILENCE;
/// Time after which a command without a reply counts as unanswered.
pub const ANSWER_TIME: Duration = Duration::from_secs(1);

/// Interval at which a request that was refused because of a state that passes is repeated.
pub const TRY_AGAIN: Duration = Duration::from_millis(50);
/// Time for which the answer to the last copy of such a request is awaited: a robot does not obey older ones.
pub(crate) const LAST_ANSWER: Duration = Duration::from_millis(500);
/// Longest time in which a state that passes by itself ends: the motors are aligned, the rotors at
/// rest, the link proven.
pub const PASSING_PATIENCE: Duration = Duration::from_secs(3);

/// Longest time in which a robot proves its link and aligns its motors.
pub const ARM_PATIENCE: Duration = Duration::from_secs(20);
/// Time after a reply from which telemetry shows the state after the command.
pub const TELEMETRY_LAG: Duration = Duration::from_millis(500);
/// Time for which a robot that fell silent is asked whether it refuses this key now: a refusal counts when no better
/// answer has come for [`HINT_PATIENCE`].
pub const REVOKED_PATIENCE: Duration = HINT_PATIENCE.saturating_add(Duration::from_millis(500));

/// Returns whether a refusal passes by itself, so that the same request succeeds some time later.
#[must_use]
pub const fn passes_by_itself(refusal: &Refusal) -> bool {
    matches!(refusal, Refusal::LinkUnproven | Refusal::State(State::Aligning | State::Stopping))
}
