#![no_std]
#![forbid(unsafe_code)]
//! Units, messages, frames and authenticated sessions between a Flix-Walker and its operator.
//!
//! # Conventions, fixed here for all crates
//!
//! - Body frame FLU: x forward, y left, z up; yaw positive to the left (ROS REP 103). World frame
//!   ENU.
//! - Shaking direction `theta`: degrees in [-90, 90] from forward, **positive to the right**.
//!   Shaking frequency `f`: Hz in [-35, 35], **positive when the top rotor turns clockwise seen
//!   from above**. Both are compass-like: counted clockwise (paper, section II-E, text).
//! - In FLU, counted counter-clockwise, the rotors stand at `-(omega t + theta)` (top) and
//!   `-(-omega t + theta)` (bottom), `omega = 2 pi f`. [`shaker`] converts both ways.
//! - The rotors' state is read as *mean* and *difference* of the clockwise angles:
//!   `theta = (top + bottom) / 2`, `phase = (top - bottom) / 2`, `f = d(phase)/dt / 2 pi`.
//!   Half a turn added to theta only shifts the phase: +90 and -90 degrees are one line of force.
//! - Motors and rotors are always listed top, bottom. Legs are `fl fr rl rr`.

pub mod failsafe;
pub mod frame;
pub mod message;
pub mod provision;
pub mod session;
pub mod shaker;
pub mod units;

/// UDP port on which a robot listens unless told otherwise: 1, then "flix" on a telephone's keys.
/// Not assigned by IANA, and below the ports that systems hand out by themselves.
pub const DEFAULT_PORT: u16 = 13549;

/// DNS-SD service type under which robots announce themselves on the local network.
pub const SERVICE_TYPE: &str = "_flix._udp.local.";
