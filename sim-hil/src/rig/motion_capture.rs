//! Motion capture by cameras around the floor.
//!
//! Poses are taken every [`POSE_PERIOD`], are wrong by [`POSITION_NOISE`] and [`HEADING_NOISE`], and arrive
//! [`POSE_DELAY`] later.

use std::collections::VecDeque;
use std::time::Duration;

use flix_host::pose::{Picture, Pose, PoseSample, Quaternion};
use flix_protocol::units::Instant;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::plant::mechanics::multiply;
use crate::rig::simulated::SimulatedRobot;

/// From one camera frame to the next: OptiTrack at 100 Hz.
pub const POSE_PERIOD: Duration = Duration::from_millis(10);
/// From exposure to arrival: OptiTrack states 5 to 10 ms for its Prime cameras.
pub const POSE_DELAY: Duration = Duration::from_millis(8);
/// Standard deviation of each coordinate, m: OptiTrack states 0.2 to 0.3 mm in a small volume; doubled.
pub const POSITION_NOISE: f64 = 0.5e-3;
/// Standard deviation of the heading, rad: of markers 150 mm apart.
pub const HEADING_NOISE: f64 = 5e-3;

/// Simulated cameras.
pub struct MotionCapture {
    random: Xoshiro256PlusPlus,
    under_way: VecDeque<(Instant, PoseSample)>,
    /// Whether the cameras are covered: poses go on coming, but are not valid.
    pub covered: bool,
}

impl MotionCapture {
    /// Cameras whose noise comes from this seed.
    pub fn new(seed: u64) -> Self {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        // Another stream than the plant's, the robot's and the network's.
        random.long_jump();
        random.long_jump();
        Self { random, under_way: VecDeque::new(), covered: false }
    }

    /// Measures the robot's pose.
    pub fn measure(&mut self, robot: &SimulatedRobot) -> Pose {
        let body = robot.mechanics().body();
        let mut noisy = |value: f64, sigma: f64| {
            let chance: f64 = StandardNormal.sample(&mut self.random);
            value + sigma * chance
        };
        let position = body.position.map(|coordinate| noisy(coordinate, POSITION_NOISE)).into();
        let error = Quaternion::about_z(noisy(0.0, HEADING_NOISE)).components();
        Pose { position, orientation: multiply(error, body.orientation).into() }
    }

    /// Exposes one frame.
    pub fn look(&mut self, now: Instant, robot: &SimulatedRobot) {
        let pose = self.measure(robot);
        // The time of the sample is that of the exposure already.
        let picture = Some(Picture { exposed: now, sent: now, late: Duration::ZERO });
        let sample = PoseSample { time: now, pose, valid: !self.covered, picture };
        self.under_way.push_back((now + POSE_DELAY, sample));
    }

    /// Returns the frames that have arrived by now.
    pub fn seen(&mut self, now: Instant) -> Vec<PoseSample> {
        let ready = self.under_way.iter().take_while(|(due, _)| *due <= now).count();
        self.under_way.drain(..ready).map(|(_, sample)| sample).collect()
    }
}
