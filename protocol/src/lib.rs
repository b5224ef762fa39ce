#![no_std]
#![forbid(unsafe_code)]
//! Units, messages, frames and authenticated sessions between a Flix-Walker and its operator.
//!
//! # Layers
//!
//! | module | contents |
//! |---|---|
//! | [`units`] | physical quantities and moments as types with ranges |
//! | [`message`] | commands, replies, telemetry and events |
//! | [`frame`] | the layout of datagrams in bytes |
//! | [`failsafe`] | deadlines for a silent operator, and the battery warning |
//! | [`session`] | handshake, encryption and replay protection of an authorised operator |
//! | [`provision`] | name, network and key of a robot, over its serial port |
//! | [`network_key`] | the key of a WPA2 network, derived from its pass phrase in slices |
//! | [`network_name`] | the name of a Wi-Fi network as bytes, and as text |
//! | [`shaker`] | the two rotors' angles from phase and theta, and back |
//!
//! Everything is sans-IO: time, addresses and received datagrams are arguments, datagrams to send are
//! returned. Nothing reads a clock, owns a socket, allocates, or panics on any input.
//!
//! # Example
//!
//! Both ends of the link on one thread: the handshake, then one sealed order.
//!
//! ```
//! use flix_protocol::message::{Order, Permit, Setpoint, ToRobot};
//! use flix_protocol::session::{Key, OperatorSession, RobotReceived, RobotSession};
//! use flix_protocol::units::Instant;
//!
//! let now = Instant::from_micros(1_000);
//! let operator_address = ([192, 168, 4, 2], 4000).into();
//! let key = Key::new([7; 32]);
//! // In earnest, the two seeds are fresh random numbers.
//! let mut robot = RobotSession::new(Some(key.clone()), [1; 32]);
//! let mut operator = OperatorSession::new(key, [2; 32], now);
//!
//! // Hello, Challenge; Confirm, Accept.
//! while let Some(datagram) = operator.poll(now) {
//!     match robot.receive(now, operator_address, &datagram) {
//!         RobotReceived::Answer(answer) | RobotReceived::Connected(answer) => {
//!             operator.receive(now, &answer);
//!         }
//!         other => panic!("unexpected: {other:?}"),
//!     }
//! }
//!
//! // The permit that the robot's telemetry states.
//! let permit = Permit::new(3);
//! let walk = ToRobot::Order(Order::Shake(permit, Setpoint::from_numbers(-30.0, 30.0)?));
//! let datagram = operator.send(now, &walk)?;
//! assert_eq!(robot.receive(now, operator_address, &datagram), RobotReceived::Message(walk));
//! # Ok::<(), Box<dyn core::error::Error>>(())
//! ```
//!
//! # Conventions, fixed here for all crates
//!
//! - Lengths are in metres, times in seconds, angles in radians unless a type or name states
//!   another unit. People read and write theta in degrees.
//! - Body frame FLU: x forward, y left, z up; yaw positive to the left (ROS REP 103). World frame
//!   ENU: x east, y north, z up; headings counter-clockwise from x.
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
pub mod network_key;
pub mod network_name;
pub mod provision;
pub mod session;
pub mod settings;
pub mod shaker;
pub mod units;

/// Default UDP port of a robot: 1, then "flix" on a telephone's keys.
/// Not assigned by IANA, and below the ports that systems hand out by themselves.
pub const DEFAULT_PORT: u16 = 13549;

/// DNS-SD service type under which robots announce themselves on the local network.
pub const SERVICE_TYPE: &str = "_flix._udp.local.";

/// Prefix of a robot's host name, before the robot's name in lower case.
pub const HOST_PREFIX: &str = "flix-";
