//! The operator's end of the link: from setpoints to datagrams and back.
//!
//! [`Client`] has no clock and no socket: it takes time and datagrams as arguments, and returns
//! datagrams to send and updates. The simulator runs it in virtual time; [`udp`] runs it on a socket in
//! real time.
//!
//! # Behaviour without a call
//!
//! - **Order**: every [`KEEP_ALIVE`], and at once when it changes, the client sends the one order of its operator
//!   ([`Order`](flix_protocol::message::Order)): its sign of life. Without a wish that is `Off`. The robot hears it four times
//!   before it warns, and eleven times before its command deadline ([`flix_protocol::failsafe`]).
//! - **Permit**: a wish carries the permit that telemetry showed when it was pressed. When the robot states another one, it has
//!   halted: a walk becomes rest, other wishes `Off`, and the reason is reported.
//! - **Requests** (parameters, scope, identity) carry a number and are repeated every [`REQUEST_RETRY`]
//!   until answered or [`REQUEST_PATIENCE`] is over. All requests are idempotent.
//! - **Stop** comes before everything: wishes and requests end, and stop is the order until the robot acknowledges it, also over
//!   reconnections, and without a session while there is none: another operator may hold the robot.
//! - **Silence** of [`SILENCE`] ends the session. The client connects again, and every wish has ended,
//!   because a robot that comes back must not start by itself.
//!
//! # Terms
//!
//! *Held*: the setpoint of a walk in force. *Round trip*: from sending an order to the telemetry that states it, less the time
//! for which the robot held it. *Loss*: the share of orders that do not arrive, or whose answer does not.

mod as_commanded;
mod client;
#[cfg(not(target_family = "wasm"))]
pub mod discovery;
mod error;
pub mod explain;
pub mod joining;
#[cfg(not(target_family = "wasm"))]
pub mod keys;
#[cfg(not(target_family = "wasm"))]
mod path;
mod port_log;
mod robot_link;
#[cfg(not(target_family = "wasm"))]
pub mod serial;
pub mod statistics;
#[cfg(not(target_family = "wasm"))]
pub mod udp;

pub use as_commanded::{errors, is_reached, line_difference};
pub use client::{Client, NotTaken, StopState, Update, Wish};
pub use error::LinkError;
pub use robot_link::RobotLink;
#[cfg(not(target_family = "wasm"))]
pub use udp::transient;

use std::time::Duration;

use flix_protocol::message::{Refusal, State};
use flix_protocol::session::{HINT_PATIENCE, HOLDER_SILENCE};

/// Interval of the order: a fifth of the robot's first deadline of 100 ms.
pub const KEEP_ALIVE: Duration = Duration::from_millis(20);
/// Interval at which an unanswered request is repeated, the first time up to 10 ms sooner or later. Longer than the slowest ordinary
/// round trip on Wi-Fi.
pub const REQUEST_RETRY: Duration = Duration::from_millis(100);
/// Time for which a request is repeated: 30 times, so that a link that loses 30 % each way fails one request in 500 million. To find
/// the values of motors takes thousands of requests.
pub const REQUEST_PATIENCE: Duration = Duration::from_secs(3);
/// Time after the end of a session in which a robot has disarmed by itself: a second of silence, and the ramp.
pub const DISARMED_AFTER: Duration = Duration::from_secs(2);
/// Time after which a stop that the robot has not acknowledged in the session is also asked for without one.
pub const STOP_BESIDE_AFTER: Duration = Duration::from_millis(100);
/// Silence of the robot after which the session ends: the robot, without commands, has disarmed.
pub const SILENCE: Duration = HOLDER_SILENCE;
/// Age at which an order is counted as answered or not.
pub const ANSWER_TIME: Duration = Duration::from_secs(1);

/// Interval at which a request that was refused because of a state that passes is repeated.
pub const TRY_AGAIN: Duration = Duration::from_millis(50);
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

/// Returns whether a refusal passes by itself: the same request, with a newer echo, succeeds some time later.
#[must_use]
pub const fn passes_by_itself(refusal: &Refusal) -> bool {
    matches!(refusal, Refusal::Late { .. } | Refusal::State(State::Aligning | State::Stopping))
}
