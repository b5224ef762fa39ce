//! The closed loop in virtual time: cameras, navigation, link, the robot's software and its plant.
//!
//! The host's own [`Pilot`] drives, exactly as `flix track` does in real time; only clock, network
//! and cameras are simulated. See [`crate::rig::motion_capture`] for what the cameras measure.

use std::time::Duration;

use flix_host::nav::PlanarPose;
use flix_host::pilot::{Ending, Helm, Pilot};
use flix_protocol::message::State;
use flix_protocol::session::Key;
use flix_protocol::units::Instant;

use crate::model::{ModelError, RobotModel};
use crate::plant::{Diverged, Plant};
use crate::rig::lossy_network::ChannelParameters;
use crate::rig::motion_capture::{MotionCapture, POSE_PERIOD, TrackerFault};
use crate::rig::operation::Operation;
use crate::rig::simulated::{RobotParameters, SimulatedRobot};

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
    operation: Operation,
    pilot: Pilot<H>,
    cameras: MotionCapture,
    pose_period: Duration,
    next_picture: Instant,
    push: Option<Push>,
}

/// A push under way: a motion in the world, m/s and m/s, a turn to the left, rad/s, and the end.
struct Push {
    motion: [f64; 3],
    ends: Instant,
}

impl<H: Helm> Course<H> {
    /// Creates a robot on its place and a pilot who has not begun.
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
        let parameters = RobotParameters::of(&conditions.model.electrical, key, conditions.seed)?;
        let robot = SimulatedRobot::new(parameters, plant);
        let network = ChannelParameters {
            delay: conditions.latency,
            loss: conditions.loss,
            ..ChannelParameters::PERFECT
        };
        Ok(Self {
            operation: Operation::new(robot, network),
            pilot,
            cameras: MotionCapture::new(conditions.seed),
            pose_period: POSE_PERIOD,
            next_picture: Instant::START,
            push: None,
        })
    }

    /// Returns the robot's time.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.operation.now()
    }

    /// Returns who drives.
    #[must_use]
    pub fn pilot(&self) -> &Pilot<H> {
        &self.pilot
    }

    /// Returns who drives, to be given an order.
    pub fn pilot_mut(&mut self) -> &mut Pilot<H> {
        &mut self.pilot
    }

    /// Returns who drove.
    #[must_use]
    pub fn into_pilot(self) -> Pilot<H> {
        self.pilot
    }

    /// Returns where the robot truly is.
    #[must_use]
    pub fn truth(&self) -> PlanarPose {
        let body = self.plant().body();
        PlanarPose { x: body.position[0], y: body.position[1], heading: body.yaw() }
    }

    /// Returns the robot's mechanics, to be looked at.
    #[must_use]
    pub fn plant(&self) -> &Plant {
        self.operation.robot.mechanics()
    }

    /// Returns the energy that the battery gave so far, J.
    #[must_use]
    pub fn energy(&self) -> f64 {
        let robot = &self.operation.robot;
        robot.electronics().ledger(robot.truth().rotor_angle).battery
    }

    /// Sets the robot down elsewhere, unseen on its way: an offset in the world, m, and a turn to the left, rad.
    pub fn set_down(&mut self, offset: (f64, f64), turn: f64) {
        self.operation.robot.mechanics_mut().displace([offset.0, offset.1, 0.0], turn);
    }

    /// Pushes the robot for so long: an offset in the world, m, and a turn to the left, rad.
    pub fn push(&mut self, offset: (f64, f64), turn: f64, lasts: Duration) {
        let seconds = lasts.as_secs_f64();
        let motion = [offset.0 / seconds, offset.1 / seconds, turn / seconds];
        self.push = Some(Push { motion, ends: self.now() + lasts });
    }

    /// Returns whether a push is under way.
    #[must_use]
    pub fn is_pushed(&self) -> bool {
        self.push.is_some()
    }

    /// Makes the tracker lie, or ends that.
    pub fn deceive(&mut self, fault: Option<TrackerFault>) {
        self.cameras.deceive(fault);
    }

    /// Hangs the robot on cords, this high over the floor, m.
    pub fn hang(&mut self, height: f64) {
        self.operation.robot.mechanics_mut().hang(height);
    }

    /// Takes pictures at this interval from now on; the pilot looks at what has arrived as often, and every [`POSE_PERIOD`] at least.
    pub fn set_pose_period(&mut self, period: Duration) {
        self.pose_period = period;
    }

    /// Covers the cameras, or uncovers them: poses go on coming, but are not valid.
    pub fn cover_cameras(&mut self, covered: bool) {
        self.cameras.covered = covered;
    }

    /// Returns where the robot's supervisor stands, and how fast the robot shakes, Hz.
    #[must_use]
    pub fn robot(&self) -> (State, f64) {
        let robot = &self.operation.robot;
        (robot.report().state, robot.truth().frequency())
    }

    /// Asks the pilot to end the run early.
    pub fn end(&mut self, ending: Ending) {
        let now = self.now();
        self.pilot.end(now, self.operation.client(), ending);
    }

    /// Advances by one camera frame, [`POSE_PERIOD`] at most; returns `Some` once the run is over.
    ///
    /// # Errors
    /// When the mechanics diverge.
    pub fn step(&mut self) -> Result<Option<Ending>, Diverged> {
        let step = self.pose_period.min(POSE_PERIOD);
        let end = self.now() + step;
        while self.now() < end {
            self.operation.tick()?;
        }
        let now = self.now();
        if let Some(Push { motion: [x, y, turn], ends }) = self.push {
            let seconds = step.as_secs_f64();
            self.set_down((x * seconds, y * seconds), turn * seconds);
            self.push = self.push.take().filter(|_| now < ends);
        }
        if now >= self.next_picture {
            self.next_picture = now + self.pose_period;
            self.cameras.look(now, &self.operation.robot);
        }
        let poses = self.cameras.seen(now);
        Ok(self.pilot.step(now, self.operation.client(), &poses))
    }
}
