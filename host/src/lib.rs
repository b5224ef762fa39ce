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
//! | [`experiment`] | records what a robot is identified from |
//! | [`teleop`], [`cockpit`] | drives by hand, in a terminal and in a browser |
//! | [`record`] | writes a run as MCAP, and reads it |
//! | [`plot`], [`view`] | draws figures as SVG and PNG; scenes in pages |
//! | [`symbols`] | names functions and lines of the firmware |
//! | [`explain`], [`interrupt`] | words for people; Ctrl-C and signals |
//! | [`cli`] | the commands of `flix`, one file each |
//!
//! What decides is sans-IO: [`link::Client`], [`nav::Navigator`] and [`pilot::Pilot`] take time,
//! datagrams and poses as arguments and return what to send. Only [`link::udp`], [`link::serial`],
//! [`pose::natnet`], [`teleop::screen`], [`cockpit::server`] and [`cli`] touch sockets, clocks and terminals. So the
//! simulator runs the same code in virtual time, and without the feature `program` it builds for targets that have
//! none of these. Frames, signs and units are those of
//! [`flix_protocol`].
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

#[cfg(feature = "program")]
pub mod cli;
pub mod cockpit;
pub mod commission;
#[cfg(feature = "program")]
pub mod experiment;
pub mod explain;
pub mod file;
#[cfg(feature = "program")]
pub mod interrupt;
#[cfg(feature = "program")]
pub mod keys;
pub mod link;
pub mod nav;
#[cfg(feature = "program")]
pub mod pilot;
#[cfg(feature = "program")]
pub mod plot;
pub mod pose;
#[cfg(feature = "program")]
pub mod record;
pub mod scope;
#[cfg(feature = "program")]
pub mod steering;
#[cfg(feature = "program")]
pub mod symbols;
pub mod system;
pub mod teleop;
pub mod text;
pub mod view;
