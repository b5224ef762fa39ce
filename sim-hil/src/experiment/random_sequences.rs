//! Walks whose f and theta change again and again, on ideal drives and under the robot's software.

use core::time::Duration;
use flix_host::link::RobotLink;

use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::walk::{Start, WalkError};
use crate::batch::{Batch, Precision};
use crate::model::RobotModel;
use crate::plant::BodyState;
use crate::rig::bench::{bench_key, setpoint};
use crate::rig::lossy_network::ChannelParameters;
use crate::rig::operation::Operation;
use crate::rig::simulated::{RobotParameters, SimulatedRobot};

/// Commands of a drawn sequence, before it rests.
const COMMANDS: usize = 6;
/// How long a robot stands before a sequence begins, and rests at its end, s: rotors and body stand then, so that where it is
/// does not depend on where in a turn the rotors were.
const STANDING: f64 = 0.6;
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

/// Draws a sequence: 25 to 35 Hz either way, any theta, 0.1 to 1 s each; then rest.
#[must_use]
pub fn drawn(seed: u64) -> Vec<Held> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut held = || {
        let f = random.random_range(25.0..35.0);
        Held {
            frequency_hz: if random.random() { f } else { -f },
            theta_deg: random.random_range(-90.0..90.0),
            seconds: f64::from(random.random_range(100..=1000)) * 1e-3,
        }
    };
    let mut sequence: Vec<Held> = (0..COMMANDS).map(|_| held()).collect();
    sequence.extend(sequence.last().map(|last| Held {
        frequency_hz: 0.0,
        seconds: STANDING,
        ..*last
    }));
    sequence
}

/// Returns how far a body came, seen from where it was: forward and to the left, m.
fn displacement(from: &BodyState, to: &BodyState) -> [f64; 2] {
    let (sin, cos) = from.yaw().sin_cos();
    let [dx, dy] = [to.position[0] - from.position[0], to.position[1] - from.position[1]];
    [cos * dx + sin * dy, cos * dy - sin * dx]
}

/// Walks a sequence from each start on an ideal drive in the batch engine, single precision, its rotors standing at this theta
/// (rad) before; returns how far it came.
///
/// # Errors
/// If the model is refused or diverges.
pub fn in_batch(
    model: &RobotModel,
    starts: &[(Start, f64)],
    sequence: &[Held],
) -> Result<Vec<[f64; 2]>, WalkError> {
    let plants = starts.iter().map(|(start, _)| start.plant(model));
    let plants = plants.collect::<Result<Vec<_>, _>>()?;
    let robots = 0..starts.len();
    let models = vec![model.clone(); starts.len()];
    let mut batch = Batch::of(models, &plants.iter().collect::<Vec<_>>(), Precision::Single)?;
    let steps = |seconds: f64| (seconds / STEP).round() as usize;
    robots.clone().for_each(|robot| batch.set_drive(robot, 0.0, starts[robot].1));
    batch.run(steps(STANDING), STEP);
    let began: Vec<BodyState> = robots.clone().map(|robot| batch.body(robot)).collect();
    for held in sequence {
        let theta_rad = held.theta_deg.to_radians();
        robots.clone().for_each(|robot| batch.set_drive(robot, held.frequency_hz, theta_rad));
        batch.run(steps(held.seconds), STEP);
    }
    let came = robots.map(|robot| match batch.diverged(robot) {
        Some(diverged) => Err(diverged.into()),
        None => Ok(displacement(&began[robot], &batch.body(robot))),
    });
    came.collect()
}

/// Walks a sequence under the robot's software; returns how far it came, and theta where the rotors stood before, rad.
///
/// # Errors
/// If the model is refused or diverges, or the robot refuses a command.
pub fn under_software(
    model: &RobotModel,
    start: Start,
    sequence: &[Held],
) -> Result<([f64; 2], f64), WalkError> {
    let plant = start.plant(model)?;
    let parameters = RobotParameters::of(&model.electrical, bench_key(), start.seed)?;
    let robot = SimulatedRobot::new(parameters, plant);
    let mut operation: Operation = Operation::new(robot, ChannelParameters::PERFECT);
    operation.arm()?;
    let (began, theta_rad) =
        (operation.robot.mechanics().body(), operation.robot.truth().direction);
    for held in sequence {
        operation.want(setpoint(held.frequency_hz, held.theta_deg)?);
        operation.run(Duration::from_secs_f64(held.seconds), |_| {})?;
    }
    Ok((displacement(&began, &operation.robot.mechanics().body()), theta_rad))
}

/// Returns the root of the mean square of the lengths of vectors.
#[must_use]
pub fn root_mean_square(vectors: &[[f64; 2]]) -> f64 {
    let sum: f64 = vectors.iter().map(|[x, y]| x * x + y * y).sum();
    (sum / vectors.len().max(1) as f64).sqrt()
}
