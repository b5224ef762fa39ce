//! Walks whose f and theta change again and again, on ideal drives and under the robot's software.

use core::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::walk::{Start, WalkError};
use crate::batch::{Batch, Precision};
use crate::model::RobotModel;
use crate::plant::{BodyState, Plant};
use crate::rig::bench::{bench_key, setpoint};
use crate::rig::channel::ChannelParameters;
use crate::rig::operation::Operation;
use crate::rig::robot::{RobotParameters, SimulatedRobot};

/// Commands of a drawn sequence after its first.
const CHANGES: usize = 6;
/// How long the first command is held before a sequence counts, s.
const SETTLING: f64 = 1.5;
/// Step of the ideal drive, s.
const STEP: f64 = 1e-4;

/// One command of a sequence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Held {
    /// f, Hz.
    pub frequency_hz: f64,
    /// theta, degrees.
    pub theta_deg: f64,
    /// How long, s; whole milliseconds.
    pub seconds: f64,
}

/// Draws a sequence: 25 to 35 Hz either way, any theta, 0.1 to 1 s each.
#[must_use]
pub fn drawn(seed: u64) -> Vec<Held> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut held = |first: bool| {
        let f = random.random_range(25.0..35.0);
        let milliseconds = random.random_range(100..=1000);
        Held {
            frequency_hz: if random.random() { f } else { -f },
            theta_deg: random.random_range(-90.0..90.0),
            seconds: if first { SETTLING } else { f64::from(milliseconds) * 1e-3 },
        }
    };
    core::iter::once(true).chain([false; CHANGES]).map(&mut held).collect()
}

/// Returns how far a body came, seen from where it was: forward and to the left, m.
fn displacement(from: &BodyState, to: &BodyState) -> [f64; 2] {
    let (sin, cos) = from.yaw().sin_cos();
    let [dx, dy] = [to.position[0] - from.position[0], to.position[1] - from.position[1]];
    [cos * dx + sin * dy, cos * dy - sin * dx]
}

/// Walks a sequence on an ideal drive in the batch engine, single precision; returns how far it came after the first command.
///
/// # Errors
/// If the model is refused or diverges.
pub fn in_batch(
    model: &RobotModel,
    start: Start,
    sequence: &[Held],
) -> Result<[f64; 2], WalkError> {
    let plant = start.plant(model)?;
    let mut batch = Batch::of(vec![model.clone()], &[&plant], Precision::Single)?;
    let mut began = plant.body();
    for (index, held) in sequence.iter().enumerate() {
        batch.set_drive(0, held.frequency_hz, held.theta_deg.to_radians());
        batch.run((held.seconds / STEP).round() as usize, STEP);
        if let Some(diverged) = batch.diverged(0) {
            return Err(diverged.into());
        }
        if index == 0 {
            began = batch.body(0);
        }
    }
    Ok(displacement(&began, &batch.body(0)))
}

/// Walks a sequence under the robot's software; returns how far it came after the first command.
///
/// # Errors
/// If the model is refused or diverges, or the robot refuses a command.
pub fn under_software(
    model: &RobotModel,
    start: Start,
    sequence: &[Held],
) -> Result<[f64; 2], WalkError> {
    let plant = start.plant(model)?;
    let parameters = RobotParameters::of(&model.electrical, bench_key(), start.seed)?;
    let robot = SimulatedRobot::new(parameters, plant);
    let mut operation: Operation<Plant> = Operation::new(robot, ChannelParameters::PERFECT);
    operation.arm()?;
    let mut began = operation.robot.mechanics().body();
    for (index, held) in sequence.iter().enumerate() {
        operation.hold(setpoint(held.frequency_hz, held.theta_deg)?);
        operation.run(Duration::from_secs_f64(held.seconds), |_| {})?;
        if index == 0 {
            began = operation.robot.mechanics().body();
        }
    }
    Ok(displacement(&began, &operation.robot.mechanics().body()))
}

/// Returns the root of the mean square of the lengths of vectors.
#[must_use]
pub fn root_mean_square(vectors: &[[f64; 2]]) -> f64 {
    let sum: f64 = vectors.iter().map(|[x, y]| x * x + y * y).sum();
    (sum / vectors.len().max(1) as f64).sqrt()
}
