#![forbid(unsafe_code)]
//! A simulated Flix-Walker under the robot's own software.
//!
//! The robot's own firmware ([`flix_firmware::robot::Robot`]) and the client that drives ([`flix_host::link::Client`])
//! run here unchanged; motors, bridges, battery, sensors, body, legs, floor, network and cameras are simulated. Time is
//! virtual, and everything random comes from seeds: the same call gives the same bits.
//!
//! # Layers
//!
//! Each wing uses those above it in this table, never one below. The first two are the package `flix-plant`, the third is
//! `flix-batch`. Above this library are `flix-study`, the paper's studies and the identification of robots, and
//! `flix-sim-cli`, the program `flix-sim`.
//!
//! | wing | what it holds |
//! |---|---|
//! | [`model`] | the robot as data: TOML with units in the names, ranges checked; MJCF for MuJoCo |
//! | [`plant`] | the physics: [`plant::mechanics`] (rotors, body, four soft legs, contact), [`plant::electronics`] (motors, bridges, battery, sensors) |
//! | [`batch`] | thousands of plants at once, a robot in each lane of a vector unit |
//! | [`rig`] | the robot's software on the plant, its network, cameras, hardware faults, operators; the bench |
//! | [`study`] | measurements as data: cells, columns with limits, tables |
//! | [`experiment`] | a walk, a closed loop, probes of the mechanics, the metrics, the reference table |
//! | [`reliability`] | what is promised, measured: accuracy, fault matrix, soak test, adversary |
//! | [`view`] | a replay of a run for the browser |
//!
//! Two journeys through them:
//!
//! - a model file to a physics step: `model` (TOML, checked) -> `plant::mechanics::build` (constants and state) ->
//!   `plant::mechanics::system` (one implicit step of all legs at once);
//! - a pose to a command: `rig::motion_capture` (cameras) -> `experiment::course` -> `flix_host::pilot` (navigation) ->
//!   `rig::operation` (client and network) -> `rig::simulated` (the firmware, on its plant).
//!
//! # Example
//!
//! A tenth of a second of the model W at 30 Hz, shaken sideways, with the rotors turned exactly as commanded
//! ([`experiment::walk::WalkDrive::Firmware`] puts the robot's software and its motors in between):
//!
//! ```
//! use flix_sim::experiment::walk::{DEFAULT_STEP, Shaking, Walk, WalkDrive, walk};
//! use flix_sim::model::RobotModel;
//!
//! let model = RobotModel::named("W")?;
//! let what = Walk {
//!     shaking: Shaking::new(30.0, 90.0)?,
//!     seconds: 0.1,
//!     drive: WalkDrive::Ideal,
//!     step: DEFAULT_STEP,
//!     heading: Some(0.0),
//! };
//! let mut highest = 0.0_f64;
//! let walked = walk(&model, &what, 1, |plant| highest = highest.max(plant.body().position[2]))?;
//! assert!(walked.path_m < 0.1 && highest < 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! `examples/own-controller.rs` drives the closed loop with a controller of its own, `examples/own-model.rs` walks a
//! changed robot.

#[cfg(not(target_family = "wasm"))]
pub use flix_batch as batch;
pub use flix_plant::{model, plant};

#[cfg(not(target_family = "wasm"))]
pub mod experiment;
pub mod reliability;
pub mod rig;
#[cfg(not(target_family = "wasm"))]
pub mod study;
pub mod view;
