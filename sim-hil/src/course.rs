//! The closed loop in virtual time: cameras, navigation, link, the robot's software and its plant.
//!
//! The host's own [`Pilot`] drives, exactly as `flix track` does in real time; only clock, network
//! and cameras are simulated. Poses are taken every [`POSE_PERIOD`], are wrong by [`POSITION_NOISE`]
//! and [`HEADING_NOISE`], and arrive [`POSE_DELAY`] later.

use std::collections::VecDeque;
use std::time::Duration;

use flix_host::nav::{ModeTable, PlanarPose};
use flix_host::pilot::{Ending, Helm, Pilot};
use flix_host::pose::{Pose, PoseSample};
use flix_protocol::message::State;
use flix_protocol::session::Key;
use flix_protocol::units::Instant;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::channel::ChannelParameters;
use crate::model::{ModelError, RobotModel};
use crate::operation::Operation;
use crate::plant::{Diverged, Plant};
use crate::robot::{RobotParameters, SimulatedRobot};

/// From one camera frame to the next: OptiTrack at 100 Hz.
pub const POSE_PERIOD: Duration = Duration::from_millis(10);
/// From exposure to arrival: OptiTrack states 5 to 10 ms for its Prime cameras.
pub const POSE_DELAY: Duration = Duration::from_millis(8);
/// Standard deviation of each coordinate, m: OptiTrack states 0.2 to 0.3 mm in a small volume; doubled.
pub const POSITION_NOISE: f64 = 0.5e-3;
/// Standard deviation of the heading, rad: of markers 150 mm apart.
pub const HEADING_NOISE: f64 = 5e-3;

/// The mode tables that come with models: learnt on them by `flix-sim identify`.
const TABLES: [(&str, &str); 2] = [
    ("W", include_str!("../models/W.modes.toml")),
    ("calibrated", include_str!("../models/calibrated.modes.toml")),
];

/// What a run is made of, besides who drives.
#[derive(Debug, Clone)]
pub struct Conditions {
    /// The robot.
    pub model: RobotModel,
    /// All chance comes from here.
    pub seed: u64,
    /// Of the link, each way.
    pub latency: Duration,
    /// Share of datagrams lost, each way.
    pub loss: f64,
    /// Where the robot stands at first.
    pub start: PlanarPose,
}

/// A run under way.
pub struct Course<H> {
    operation: Operation<Plant>,
    pilot: Pilot<H>,
    eyes: Eyes,
}

/// Simulated cameras.
pub(crate) struct Eyes {
    random: Xoshiro256PlusPlus,
    under_way: VecDeque<(Instant, PoseSample)>,
    covered: bool,
}

impl<H: Helm> Course<H> {
    /// A robot on its place and a pilot who has not begun.
    ///
    /// # Errors
    /// When the model is refused.
    pub fn new(conditions: &Conditions, pilot: Pilot<H>) -> Result<Self, ModelError> {
        let mut plant = Plant::new(&conditions.model)?;
        let start = conditions.start;
        plant.disturb(conditions.seed, false);
        plant.displace([0.0; 3], start.heading);
        plant.displace([start.x, start.y, 0.0], 0.0);
        let key = Key::new([0x5a; 32]);
        let robot = SimulatedRobot::new(RobotParameters::new(key, conditions.seed), plant);
        let network = ChannelParameters {
            delay: conditions.latency,
            loss: conditions.loss,
            ..ChannelParameters::PERFECT
        };
        Ok(Self {
            operation: Operation::new(robot, network),
            pilot,
            eyes: Eyes::new(conditions.seed),
        })
    }

    /// The robot's time.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.operation.now()
    }

    /// Who drives.
    #[must_use]
    pub fn pilot(&self) -> &Pilot<H> {
        &self.pilot
    }

    /// Who drives, to be told something.
    pub fn pilot_mut(&mut self) -> &mut Pilot<H> {
        &mut self.pilot
    }

    /// Who drove.
    #[must_use]
    pub fn into_pilot(self) -> Pilot<H> {
        self.pilot
    }

    /// Where the robot truly is.
    #[must_use]
    pub fn truth(&self) -> PlanarPose {
        let body = self.plant().body();
        PlanarPose { x: body.position[0], y: body.position[1], heading: body.yaw() }
    }

    /// The robot's mechanics, to be looked at.
    #[must_use]
    pub fn plant(&self) -> &Plant {
        self.operation.robot.mechanics()
    }

    /// Energy that the battery gave so far, J.
    #[must_use]
    pub fn energy(&self) -> f64 {
        let robot = &self.operation.robot;
        robot.electronics().ledger(robot.truth().rotor_angle).battery
    }

    /// Somebody pushes the robot: an offset in the world, m, and a turn to the left, rad.
    pub fn push(&mut self, offset: (f64, f64), turn: f64) {
        self.operation.robot.mechanics_mut().displace([offset.0, offset.1, 0.0], turn);
    }

    /// Covers the cameras, or uncovers them: poses go on coming, but are not valid.
    pub fn cover_cameras(&mut self, covered: bool) {
        self.eyes.covered = covered;
    }

    /// Where the robot's supervisor stands, and how fast the robot shakes, Hz.
    #[must_use]
    pub fn robot(&self) -> (State, f64) {
        let robot = &self.operation.robot;
        (robot.report().state, robot.truth().frequency())
    }

    /// Asks the pilot to end the run.
    pub fn interrupt(&mut self) {
        let now = self.now();
        self.pilot.interrupt(now, self.operation.client());
    }

    /// One camera frame of everything; `Some` once the run is over.
    ///
    /// # Errors
    /// When the mechanics diverge.
    pub fn step(&mut self) -> Result<Option<Ending>, Diverged> {
        let end = self.now() + POSE_PERIOD;
        while self.now() < end {
            self.operation.tick()?;
        }
        let now = self.now();
        self.eyes.look(now, &self.operation.robot);
        let poses = self.eyes.seen(now);
        Ok(self.pilot.step(now, self.operation.client(), &poses))
    }
}

impl Eyes {
    /// Cameras whose noise comes from this seed.
    pub(crate) fn new(seed: u64) -> Self {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        // Another stream than the plant's, the robot's and the network's.
        random.long_jump();
        random.long_jump();
        Self { random, under_way: VecDeque::new(), covered: false }
    }

    /// The robot's pose as they measure it.
    pub(crate) fn measure(&mut self, robot: &SimulatedRobot<Plant>) -> Pose {
        let body = robot.mechanics().body();
        let mut noisy = |value: f64, sigma: f64| {
            let chance: f64 = StandardNormal.sample(&mut self.random);
            value + sigma * chance
        };
        let position = body.position.map(|coordinate| noisy(coordinate, POSITION_NOISE));
        let heading = noisy(0.0, HEADING_NOISE);
        let turned = Pose::planar(PlanarPose { x: 0.0, y: 0.0, heading }, 0.0);
        Pose { position, orientation: product(turned.orientation, body.orientation) }
    }

    fn look(&mut self, now: Instant, robot: &SimulatedRobot<Plant>) {
        let pose = self.measure(robot);
        let sample = PoseSample { time: now, pose, valid: !self.covered };
        self.under_way.push_back((now + POSE_DELAY, sample));
    }

    fn seen(&mut self, now: Instant) -> Vec<PoseSample> {
        let ready = self.under_way.iter().take_while(|(due, _)| *due <= now).count();
        self.under_way.drain(..ready).map(|(_, sample)| sample).collect()
    }
}

/// The turn `b`, then the turn `a`; quaternions w, x, y, z.
fn product(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

/// The table of a shipped model, learnt on it.
///
/// # Errors
/// When the model has none; the sentence says how to learn one.
pub fn shipped_table(model: &str) -> Result<ModeTable, String> {
    let Some((_, table)) = TABLES.iter().find(|(name, _)| *name == model) else {
        return Err(format!(
            "model {model} has no mode table: learn one with \
             `flix-sim identify --model {model} --modes FILE` and name it with --modes"
        ));
    };
    ModeTable::from_toml(table).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_table_is_that_of_its_model_and_a_model_without_one_is_told_how() {
        for (model, _) in TABLES {
            assert_eq!(shipped_table(model).unwrap().robot, model);
        }
        assert!(shipped_table("A").unwrap_err().contains("flix-sim identify --model A"));
    }
}
