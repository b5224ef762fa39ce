#![no_std]
#![forbid(unsafe_code)]
//! The software of a Flix-Walker, without a chip: motor control, shaker, supervisor and link.
//!
//! [`robot::Robot`] is the whole of it. It reads no clock, opens no socket, owns no peripheral and
//! allocates nothing: time, sensors and datagrams come in as arguments, actuation and datagrams go out.
//! A chip (`src/bin/flix-robot`) and the simulator (`flix-sim`) call the same code.
//!
//! # Layers
//!
//! From the border to the motors; each layer knows only those below it:
//!
//! | module | what it does |
//! |---|---|
//! | [`provision`] | takes name, network and key over the serial port |
//! | [`robot`] | puts the two halves together |
//! | `net`, `neighbours`, `mdns` | carry datagrams between an embassy-net stack and the slow half (feature `net`) |
//! | [`link`] | authenticates operators, answers commands, sends telemetry and events |
//! | [`blackbox`] | keeps the last fault and panic over a restart |
//! | [`fast`] | decides the duties, 10,000 times a second, in integers alone; takes and reports by [`fast::exchange`] |
//! | [`settings`] | names, checks and stores what can be tuned |
//! | [`scope`] | captures inner values of the fast loop |
//! | [`backtrace`] | finds the calls that led to a panic on a stack |
//! | [`board`] | describes boards and encoders as data, and keeps settings in flash |
//! | [`stored`] | keeps values over power-off, with version and check sum |
//! | [`hardware`] | defines what crosses the border in each tick |
//!
//! [`trace`] records ticks, to compare them on another processor.
//!
//! # A robot on a bench
//!
//! ```
//! use flix_firmware::board::DENGFOC_V3_01;
//! use flix_firmware::hardware::{
//!     Actuation, Bridge, Encoder, EncoderAngle, EncoderReading, Magnet, NoStore, Sensors, TICK,
//! };
//! use flix_firmware::robot::Robot;
//! use flix_protocol::frame::Frame;
//! use flix_protocol::message::State;
//! use flix_protocol::session::{Key, OperatorSession};
//! use flix_protocol::units::Instant;
//!
//! let key = Key::new([7; 32]);
//! let hardware = DENGFOC_V3_01.hardware;
//! let mut robot = Robot::new(hardware, "daisy", Some(key.clone()), [1; 32], NoStore);
//!
//! // Rotors at rest, no current; this board does not measure its battery.
//! let reading = EncoderReading { angle: EncoderAngle::ZERO, age_us: 0 };
//! let still = Sensors {
//!     encoders: [Encoder::Reading(reading); 2],
//!     magnets: [Magnet::Good; 2],
//!     phase_current: Some([[2_048; 2]; 2]),
//!     bus_voltage: None,
//! };
//!
//! // At power-up the rotors may be spinning: the robot brakes.
//! let mut now = Instant::START;
//! assert_eq!(robot.tick(now, &still), Actuation { bridges: [Bridge::BRAKE; 2] });
//! // Half a second later it switches both bridges off.
//! for _ in 0..6_000 {
//!     now = now + TICK;
//!     robot.tick(now, &still);
//! }
//! assert_eq!(robot.tick(now + TICK, &still), Actuation::OFF);
//! assert_eq!(robot.report().state, State::Disarmed);
//!
//! // An operator's first datagram comes in, and the answer goes back to the same address.
//! let operator = ([192, 0, 2, 1], 40_000).into();
//! let hello = OperatorSession::new(key, [2; 32], now).poll(now).expect("it connects at once");
//! robot.slow.receive(now, operator, &hello);
//! let mut answer = Frame::new();
//! assert_eq!(robot.slow.transmit(now, &mut answer), Some(operator));
//! ```

#[cfg(test)]
extern crate std;

pub mod alignment;
pub mod backtrace;
pub mod blackbox;
pub mod board;
#[cfg(feature = "net")]
mod claim;
#[cfg(feature = "net")]
mod dhcp;
pub mod fast;
pub mod hardware;
#[cfg(feature = "net")]
mod icmp;
pub mod joining;
pub mod link;
#[cfg(feature = "net")]
pub mod mdns;
#[cfg(feature = "net")]
pub mod neighbours;
#[cfg(feature = "net")]
pub mod net;
pub mod provision;
pub mod robot;
pub mod scan;
pub mod scope;
pub mod settings;
pub mod stored;
pub mod trace;
pub mod units;
