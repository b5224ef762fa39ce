//! The bench: a shaker without legs on a stand, and an operator on a network before it.

use flix_host::link::RobotLink;
use flix_protocol::message::Setpoint;
use flix_protocol::session::Key;
use flix_protocol::units::OutOfRange;
use serde::Serialize;

use crate::model::{ModelError, RobotModel};
use crate::plant::Plant;
use crate::rig::lossy_network::ChannelParameters;
use crate::rig::operation::{Operation, OperationError};
use crate::rig::simulated::{RobotParameters, SimulatedRobot};

/// Frequencies of the grid of walks, Hz. The paper gives its limits alone (section III-B: -35 to 35 Hz); the steps between
/// them are a choice that holds every pair of tables III and IV.
pub const FREQUENCIES: [f64; 8] = [-35.0, -30.0, -20.0, -10.0, 10.0, 20.0, 30.0, 35.0];
/// Directions of the same grid, degrees; the paper's limits are -90 and 90.
pub const DIRECTIONS: [f64; 7] = [-90.0, -60.0, -30.0, 0.0, 30.0, 60.0, 90.0];
/// What the shaker stands on.
pub const BASES: [Base; 2] = [Base::Fixed, Base::Free];

/// What the shaker stands on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Base {
    /// A stand that does not move.
    Fixed,
    /// A body of 350 g that slides in the plane.
    Free,
}

impl Base {
    /// Returns the name of its model.
    #[must_use]
    pub const fn model(self) -> &'static str {
        match self {
            Self::Fixed => "bench-fixed",
            Self::Free => "bench-planar",
        }
    }
}

impl std::fmt::Display for Base {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Self::Fixed => "fixed",
            Self::Free => "free",
        })
    }
}

/// A robot on a bench could not be brought to run.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The bench.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The run.
    #[error(transparent)]
    Operation(#[from] OperationError),
    /// f or theta.
    #[error(transparent)]
    Setpoint(#[from] OutOfRange),
}

impl From<crate::plant::Diverged> for BenchError {
    fn from(error: crate::plant::Diverged) -> Self {
        Self::Operation(error.into())
    }
}

/// Returns the setpoint of a shaking frequency (-35 to 35 Hz) and a direction (-90 to 90 degrees, right positive).
///
/// # Errors
/// When one of them is no number or out of its range.
pub fn setpoint(frequency_hz: f64, direction_deg: f64) -> Result<Setpoint, OutOfRange> {
    Setpoint::from_numbers(frequency_hz as f32, direction_deg as f32)
}

/// The robot that stands on a bench.
#[derive(Debug, Clone)]
pub struct Subject {
    /// Body, shaker and electrical part; none is the shipped bench.
    pub model: Option<RobotModel>,
    /// Motors, wiring, sensor errors and noise.
    pub seed: u64,
}

impl Subject {
    /// Chooses the shipped bench's robot of this seed.
    #[must_use]
    pub const fn of_seed(seed: u64) -> Self {
        Self { model: None, seed }
    }

    /// Puts it on a base, with an operator on a quiet network.
    ///
    /// # Errors
    /// When the model is damaged.
    pub fn on(&self, base: Base) -> Result<Operation, ModelError> {
        match &self.model {
            None => bench(base, self.seed),
            Some(model) => bench_of(model, base, self.seed),
        }
    }
}

/// Builds an operator on a quiet network and a robot of this seed on this base, powered up.
///
/// # Errors
/// When the model is damaged.
pub fn bench(base: Base, seed: u64) -> Result<Operation, ModelError> {
    bench_knowing(base, seed, None, ChannelParameters::QUIET_WIFI)
}

/// Builds the same as [`bench()`], on another network and with this in the robot's flash.
///
/// # Errors
/// When the model is damaged.
pub fn bench_knowing(
    base: Base,
    seed: u64,
    flash: Option<Vec<u8>>,
    network: ChannelParameters,
) -> Result<Operation, ModelError> {
    bench_of_board(base, true, seed, flash, network)
}

/// Builds the same as [`bench_knowing`], of a board with or without current sense.
///
/// # Errors
/// When the model is damaged.
pub fn bench_of_board(
    base: Base,
    senses_current: bool,
    seed: u64,
    flash: Option<Vec<u8>>,
    network: ChannelParameters,
) -> Result<Operation, ModelError> {
    let mut model = RobotModel::named(base.model())?;
    model.electrical.sense.current = senses_current;
    operation(&model, seed, flash, network)
}

/// As [`bench()`], with the body, the shaker and the electrical part of this model.
///
/// # Errors
/// When the model is damaged.
fn bench_of(model: &RobotModel, base: Base, seed: u64) -> Result<Operation, ModelError> {
    let stand = RobotModel::named(base.model())?.base;
    let on_stand = RobotModel { base: stand, legs: None, ..model.clone() };
    operation(&on_stand, seed, None, ChannelParameters::QUIET_WIFI)
}

/// Returns the key of the robots of the bench.
#[must_use]
pub const fn bench_key() -> Key {
    Key::new([0x5a; 32])
}

fn operation(
    model: &RobotModel,
    seed: u64,
    flash: Option<Vec<u8>>,
    network: ChannelParameters,
) -> Result<Operation, ModelError> {
    let parameters = RobotParameters::of(&model.electrical, bench_key(), seed)?;
    if flash.is_some() {
        parameters.flash.overwrite(flash);
    }
    Ok(Operation::new(SimulatedRobot::new(parameters, Plant::new(model)?), network))
}

/// Returns what the flash of the robot of this seed on this base holds once it was aligned.
///
/// # Errors
/// When it cannot be armed.
pub fn learnt(base: Base, seed: u64) -> Result<Option<Vec<u8>>, BenchError> {
    let mut operation = bench(base, seed)?;
    operation.arm()?;
    operation.disarm()?;
    Ok(operation.robot.parameters().flash.content())
}
