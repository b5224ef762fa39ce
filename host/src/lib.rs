#![forbid(unsafe_code)]
//! Drives, watches and records a Flix-Walker from a computer.
//!
//! # Layers
//!
//! | module | what it does |
//! |---|---|
//! | [`keys`], [`link`] | connects to the robot: keys, sessions, requests, stop, discovery, serial port |
//! | [`pose`] | takes poses from motion capture |
//! | [`nav`] | chooses the walking mode from pose and task |
//! | [`pilot`] | drives a whole run: link, poses, navigation, record |
//! | [`steering`] | runs a controller of one's own, and reads mode tables |
//! | [`commission`], [`experiment`] | measures motors that nobody knows; records what a robot is identified from |
//! | [`teleop`], [`cockpit`] | drives by hand, in a terminal and in a browser |
//! | [`scope`], [`record`] | fetches inner values of the fast loop; writes a run as MCAP, and reads it |
//! | [`view`] | draws scenes in pages |
//! | [`explain`], [`text`], [`mod@file`], [`interrupt`], [`system`] | words for people; files; Ctrl-C and signals; what differs by system |
//!
//! Above this library are three packages: `flix-plot` draws figures, `flix-shell` is what the command lines of `flix` and
//! `flix-sim` share, `flix-cli` is the program `flix`.
//!
//! What decides is sans-IO: [`link::Client`], [`nav::Navigator`] and [`pilot::Pilot`] take time,
//! datagrams and poses as arguments and return what to send. Only [`link::udp`], [`link::serial`], [`pose`], [`keys`],
//! [`interrupt`] and [`system`] touch sockets, clocks, files and processes. So the
//! simulator runs the same code in virtual time, and what needs none of these builds for browsers, too. Frames, signs and
//! units are those of [`flix_protocol`].
//!
//! # Example
//!
//! Follow a circle with a robot that moves exactly as its mode table says, in virtual time:
//!
//! ```
//! use std::time::Duration;
//!
//! use flix_host::nav::{Decision, ModeTable, Navigator, Path, Settings, Task};
//! use flix_host::pose::{Pose, PoseSample};
//! use flix_protocol::units::Instant;
//!
//! let modes = ModeTable::from_toml(r#"
//!     [[mode]]
//!     name = "left"
//!     frequency_hz = -30.0
//!     direction_deg = 90.0
//!     forward_m_s = { mean = 0.08, spread = 0.01 }
//!     lateral_m_s = { mean = 0.0, spread = 0.01 }
//!     yaw_rad_s = { mean = 0.9, spread = 0.1 }
//!
//!     [[mode]]
//!     name = "right"
//!     frequency_hz = 30.0
//!     direction_deg = 90.0
//!     forward_m_s = { mean = 0.08, spread = 0.01 }
//!     lateral_m_s = { mean = 0.0, spread = 0.01 }
//!     yaw_rad_s = { mean = -0.9, spread = 0.1 }
//! "#)?;
//! let path = Path::circle(0.3)?;
//! let (mut pose, mut now) = (path.start(), Instant::START);
//! let task = Task::Follow { path, laps: 1 };
//! let settings = Settings { latency: Duration::ZERO, ..Settings::for_task(&task) };
//! let mut navigator = Navigator::new(task, &modes, settings)?;
//!
//! let step = Duration::from_millis(10);
//! loop {
//!     let pose_now = Pose::planar(pose, 0.05);
//!     navigator.observe(&PoseSample { time: now, pose: pose_now, valid: true, picture: None });
//!     match navigator.decide(now) {
//!         Decision::Drive { mode, .. } => {
//!             pose = pose.moved(modes.modes()[mode].twist(), step.as_secs_f64());
//!         }
//!         Decision::Rest(_) => {}
//!         Decision::Finished => break,
//!         Decision::Stopped(stop) => panic!("{stop}"),
//!     }
//!     now = now + step;
//! }
//! assert!(navigator.progress().error_rms < 0.05);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod commission;
#[cfg(not(target_family = "wasm"))]
pub mod experiment;
pub mod link;
pub mod nav;
#[cfg(not(target_family = "wasm"))]
pub mod pilot;
pub mod pose;
#[cfg(not(target_family = "wasm"))]
pub mod record;
pub mod scope;
pub mod system;
pub mod teleop;

#[cfg(test)]
extern crate self as flix_host;
#[cfg(test)]
#[path = "../tests/support/walked.rs"]
mod walked;
