//! Motion capture by cameras around the floor.
//!
//! Poses are taken every [`POSE_PERIOD`], are wrong by [`POSITION_NOISE`] and [`HEADING_NOISE`], and arrive
//! [`POSE_DELAY`] later. They are trusted as [`Continuity`] says, as those of every source of the host are. A
//! [`TrackerFault`] makes the tracker report poses that are not the robot's.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use flix_host::nav::{PlanarPose, Twist};
use flix_host::pose::continuity::{Continuity, STEADY_TIME};
use flix_host::pose::{Picture, Pose, PoseSample, Quaternion, Vector};
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

/// Poses that a tracker reports in place of the robot's.
#[derive(Debug, Clone, PartialEq)]
pub enum Lie {
    /// Those of another body, which was at this pose when the fault began and walks with this constant motion.
    OtherBody(PlanarPose, Twist),
    /// The default pose of a body that is not seen: the origin, without a rotation.
    DefaultPose,
    /// Those of a body whose axes are turned by this angle to the left, rad: half a turn is a flip of the markers.
    Turned(f64),
    /// The robot's in a mirrored world: y points to the right.
    Mirrored,
    /// The first pose since the fault began, again and again.
    Frozen,
    /// Those of a recording, played from its beginning, one a picture, and once more at its end.
    Recording(Arc<[Pose]>),
}

/// When a tracker reports which [`Lie`].
#[derive(Debug, Clone, PartialEq)]
pub struct TrackerFault {
    /// What it reports.
    pub lie: Lie,
    /// When that begins.
    pub from: Instant,
    /// For how long it lasts.
    pub lasts: Duration,
    /// From one beginning to the next; as [`Duration::MAX`] it does not recur.
    pub every: Duration,
}

impl TrackerFault {
    /// A lie from this time on for ever.
    #[must_use]
    pub fn for_ever(lie: Lie, from: Instant) -> Self {
        Self { lie, from, lasts: Duration::MAX, every: Duration::MAX }
    }

    /// Returns the time since the present lie began; `None` while the tracker is right.
    fn age(&self, now: Instant) -> Option<Duration> {
        let since = (now >= self.from).then(|| now.since(self.from))?;
        let age = since.as_micros() % self.every.as_micros().max(1);
        let age = Duration::from_micros(u64::try_from(age).unwrap_or(u64::MAX));
        (age < self.lasts).then_some(age)
    }
}

/// Simulated cameras.
pub struct MotionCapture {
    random: Xoshiro256PlusPlus,
    under_way: VecDeque<(Instant, PoseSample)>,
    /// Whether the cameras are covered: poses go on coming, but are not valid.
    pub covered: bool,
    fault: Option<TrackerFault>,
    /// Pose of the robot when the present lie began, and pictures since then.
    lied: Option<(Pose, usize)>,
    /// None before the first picture.
    continuity: Option<Continuity>,
}

impl MotionCapture {
    /// Cameras whose noise comes from this seed.
    pub fn new(seed: u64) -> Self {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        // Another stream than the plant's, the robot's and the network's.
        random.long_jump();
        random.long_jump();
        Self {
            random,
            under_way: VecDeque::new(),
            covered: false,
            fault: None,
            lied: None,
            continuity: None,
        }
    }

    /// Makes the tracker lie, or ends that.
    pub fn deceive(&mut self, fault: Option<TrackerFault>) {
        self.fault = fault;
    }

    /// Measures a pose of the robot, or what the tracker reports in its place.
    pub fn measure(&mut self, now: Instant, robot: &SimulatedRobot) -> Pose {
        let body = robot.mechanics().body();
        let seen = self.noisy(body.position, body.orientation);
        let lie = self.fault.as_ref().and_then(|fault| Some((fault.age(now)?, fault.lie.clone())));
        let Some((age, lie)) = lie else {
            self.lied = None;
            return seen;
        };
        let (first, pictures) = self.lied.map_or((seen, 0), |(first, count)| (first, count + 1));
        self.lied = Some((first, pictures));
        match lie {
            Lie::OtherBody(start, twist) => {
                let other = start.moved(twist, age.as_secs_f64());
                let Pose { position, orientation } = Pose::planar(other, seen.position.z);
                self.noisy(position.coordinates(), orientation.components())
            }
            Lie::DefaultPose => Pose::planar(PlanarPose::default(), 0.0),
            Lie::Turned(angle) => {
                let orientation = seen.orientation.after(Quaternion::about_z(angle));
                Pose { orientation, ..seen }
            }
            Lie::Mirrored => {
                let (Vector { x, y, z }, q) = (seen.position, seen.orientation);
                let orientation = Quaternion { x: -q.x, y: q.y, z: -q.z, w: q.w };
                Pose { position: Vector { x, y: -y, z }, orientation }
            }
            Lie::Frozen => first,
            Lie::Recording(poses) => poses[pictures % poses.len()],
        }
    }

    fn noisy(&mut self, position: [f64; 3], orientation: [f64; 4]) -> Pose {
        let mut noisy = |value: f64, sigma: f64| {
            let chance: f64 = StandardNormal.sample(&mut self.random);
            value + sigma * chance
        };
        let position = position.map(|coordinate| noisy(coordinate, POSITION_NOISE)).into();
        let error = Quaternion::about_z(noisy(0.0, HEADING_NOISE)).components();
        Pose { position, orientation: multiply(error, orientation).into() }
    }

    /// Exposes one frame.
    pub fn look(&mut self, now: Instant, robot: &SimulatedRobot) {
        let pose = self.measure(now, robot);
        // The tracker saw the robot stand before the first picture.
        let continuity = self.continuity.get_or_insert_with(|| {
            let mut continuity = Continuity::default();
            continuity.take(Instant::START, &pose);
            continuity.take(Instant::START + STEADY_TIME, &pose);
            continuity
        });
        let valid = continuity.take(now + STEADY_TIME, &pose) && !self.covered;
        // The time of the sample is that of the exposure already.
        let picture = Some(Picture { exposed: now, sent: now, late: Duration::ZERO });
        let sample = PoseSample { time: now, pose, valid, picture };
        self.under_way.push_back((now + POSE_DELAY, sample));
    }

    /// Returns the frames that have arrived by now.
    pub fn seen(&mut self, now: Instant) -> Vec<PoseSample> {
        let ready = self.under_way.iter().take_while(|(due, _)| *due <= now).count();
        self.under_way.drain(..ready).map(|(_, sample)| sample).collect()
    }
}
