//! Where the robot is on the floor, for an operator whose cameras see it: its way, and a heading to hold.

use std::collections::VecDeque;
use std::f64::consts::PI;
use std::time::Duration;

use flix_protocol::message::Setpoint;
use flix_protocol::units::{Hertz, Instant};

use super::paper_modes::PaperMode;
use crate::nav::{Commanded, EndReason, PlanarPose, Plausibility, Position, wrap};
use crate::pose::{Pose, PoseSample};

/// Distance between two points of the way, m.
const STEP: f64 = 0.01;
/// Points of the way that are kept: 10 m.
const LONGEST: usize = 1000;
/// A pose older than this is not steered by.
const POSE_DEADLINE: Duration = Duration::from_millis(100);
/// Time without a pose after which the robot's place counts as unknown.
const UNSEEN_AFTER: Duration = Duration::from_millis(500);
/// Error of the heading at which the robot turns back to it, rad (10 degrees).
const TURNS_AT: f64 = PI / 18.0;
/// Error of the heading at which it walks on, rad (3 degrees).
const WALKS_AT: f64 = PI / 60.0;
/// Yaw rate of a turn that is expected, rad/s: of the paper's turns.
const TURN_RATE: f64 = 1.5;
/// Turn on a walk forward that is called a curve, rad (20 degrees).
const CURVE: f64 = PI / 9.0;

/// The robot on the floor.
#[derive(Debug, Clone)]
pub struct Floor {
    /// Newest trusted pose.
    pub pose: PlanarPose,
    /// The same as it came, with height and tilt.
    pub body: Pose,
    /// The way of the robot, oldest first.
    pub way: VecDeque<Position>,
    time: Instant,
    hold: Option<Hold>,
    /// Pair that was commanded last, by which the robot walks.
    commanded: Setpoint,
    plausibility: Plausibility,
    /// Heading at which the present walk forward began; none once its curve was reported.
    forward_from: Option<f64>,
}

/// A heading that is held.
#[derive(Debug, Clone, Copy)]
struct Hold {
    heading: f64,
    is_turning: bool,
}

impl Floor {
    /// Takes a trusted pose; other poses leave everything as it is. Returns why no heading can be held by these poses.
    pub fn observe(floor: &mut Option<Self>, sample: &PoseSample) -> Option<EndReason> {
        let pose = sample.trusted()?;
        let floor = floor.get_or_insert_with(|| Self {
            pose,
            body: sample.pose,
            way: VecDeque::from([pose.position()]),
            time: sample.time,
            hold: None,
            commanded: Setpoint::REST,
            plausibility: Plausibility::default(),
            forward_from: None,
        });
        let passed = sample.time.since(floor.time).as_secs_f64();
        if !floor.believes(sample.time, pose, passed) {
            return floor.plausibility.end();
        }
        (floor.pose, floor.body, floor.time) = (pose, sample.pose, sample.time);
        if floor.way.back().is_none_or(|last| last.distance_to(pose.position()) >= STEP) {
            if floor.way.len() == LONGEST {
                floor.way.pop_front();
            }
            floor.way.push_back(pose.position());
        }
        floor.plausibility.end()
    }

    /// Returns whether a robot that keeps a heading can be there by its commands. Another one may be carried, and shows where.
    fn believes(&mut self, time: Instant, pose: PlanarPose, passed: f64) -> bool {
        if self.hold.is_none() || self.commanded == Setpoint::REST {
            self.plausibility = Plausibility::default();
        }
        let turns = |turn: f64| Commanded::Moved([[0.0, 0.0, turn * TURN_RATE * passed]; 2]);
        let commanded = match self.commanded {
            left if left == PaperMode::LeftTurn.setpoint() => turns(1.0),
            right if right == PaperMode::RightTurn.setpoint() => turns(-1.0),
            _ => Commanded::Walks,
        };
        self.plausibility.observe(time, pose, commanded)
    }

    /// Returns the heading that is held, rad.
    #[must_use]
    pub fn held(&self) -> Option<f64> {
        self.hold.map(|hold| hold.heading)
    }

    /// Holds the present heading, or ends holding it.
    pub fn hold(&mut self, is_held: bool) {
        self.hold = is_held.then_some(Hold { heading: self.pose.heading, is_turning: false });
    }

    /// Returns whether no pose has been trusted for half a second.
    #[must_use]
    pub(crate) fn is_unseen(&self, now: Instant) -> bool {
        now.since(self.time) >= UNSEEN_AFTER
    }

    /// Begins to watch a walk for curves, or ends that.
    pub fn begin(&mut self, is_forward: bool) {
        self.forward_from = is_forward.then_some(self.pose.heading);
    }

    /// Returns the turn of a walk forward that curves, rad to the left; once for each walk.
    pub fn curve(&mut self) -> Option<f64> {
        let turn = wrap(self.pose.heading - self.forward_from?);
        let is_curve = turn.abs() > CURVE && self.hold.is_none();
        is_curve.then(|| {
            self.forward_from = None;
            turn
        })
    }

    /// Returns the pair that keeps the heading of a walk: `setpoint` itself, or a turn back to the heading with the same shaking
    /// frequency. At rest, and with poses older than 0.1 s, returns `setpoint`.
    pub fn steer(&mut self, now: Instant, setpoint: Setpoint) -> Setpoint {
        self.commanded = self.steered(now, setpoint);
        self.commanded
    }

    fn steered(&mut self, now: Instant, setpoint: Setpoint) -> Setpoint {
        let is_walking = setpoint.frequency() != Hertz::ZERO;
        let Some(hold) = self.hold.as_mut().filter(|_| is_walking) else { return setpoint };
        if now.since(self.time) > POSE_DEADLINE {
            hold.is_turning = false;
            return setpoint;
        }
        let error = wrap(hold.heading - self.pose.heading);
        hold.is_turning = error.abs() > if hold.is_turning { WALKS_AT } else { TURNS_AT };
        let turn = match hold.is_turning {
            false => return setpoint,
            true if error > 0.0 => PaperMode::LeftTurn.setpoint(),
            true => PaperMode::RightTurn.setpoint(),
        };
        let frequency = setpoint.frequency().get().copysign(turn.frequency().get());
        Setpoint::saturating(frequency, turn.direction().get())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::Pose;

    fn at(milliseconds: u64, heading: f64) -> PoseSample {
        let pose = Pose::planar(PlanarPose { x: 0.0, y: 0.0, heading }, 0.06);
        PoseSample {
            time: Instant::from_micros(milliseconds * 1000),
            pose,
            valid: true,
            picture: None,
        }
    }

    fn seen(sample: &PoseSample) -> Floor {
        let mut floor = None;
        Floor::observe(&mut floor, sample);
        floor.unwrap()
    }

    #[test]
    fn a_robot_that_turns_away_from_a_held_heading_is_turned_back_to_it() {
        let mut floor = seen(&at(0, 3.0));
        floor.hold(true);
        let forward = PaperMode::Forward.setpoint();
        let mut now = 0;
        let mut steered = |heading: f64| {
            now += 10;
            let mut some = Some(floor.clone());
            Floor::observe(&mut some, &at(now, heading));
            floor = some.unwrap();
            floor.steer(Instant::from_micros(1000 * now), forward)
        };
        assert_eq!(steered(3.1), forward);
        // Across the wrap: 0.28 rad to the left of it.
        assert_eq!(steered(-3.0), PaperMode::RightTurn.setpoint());
        assert_eq!(
            steered(3.1),
            PaperMode::RightTurn.setpoint(),
            "it turns until it is well within"
        );
        assert_eq!(steered(3.03), forward);
        assert_eq!(steered(2.75), PaperMode::LeftTurn.setpoint());
    }

    /// Why no heading is held any more where each pose of 3 s shows this heading, by the time, s; the robot is turned to the left.
    fn doubt(heading: impl Fn(f64) -> f64) -> Option<EndReason> {
        let mut floor = None;
        (0..300).find_map(|number| {
            let (now, seconds) = (10 * number, 0.01 * number as f64);
            let doubt = Floor::observe(&mut floor, &at(now, heading(seconds)));
            let floor = floor.as_mut().unwrap();
            floor.hold = Some(Hold { heading: 2.0, is_turning: false });
            floor.steer(Instant::from_micros(1000 * now), PaperMode::Forward.setpoint());
            doubt
        })
    }

    #[test]
    fn a_heading_that_jumps_or_turns_against_the_commands_is_held_no_more() {
        assert_eq!(doubt(|seconds| 0.3 * seconds), None, "a slow turn to the left");
        assert!(matches!(doubt(|s| -0.3 * s), Some(EndReason::NotAnswering { .. })));
        assert!(matches!(doubt(|_| 0.0), Some(EndReason::NotMoving { .. })));
        let flipped = doubt(|s| 0.5 * s + if s > 1.0 { PI } else { 0.0 });
        assert!(matches!(flipped, Some(EndReason::Jumped { .. })), "{flipped:?}");
    }

    #[test]
    fn a_held_heading_is_turned_to_at_the_frequency_of_the_walk() {
        let mut floor = seen(&at(0, 0.0));
        floor.hold(true);
        for (heading, frequency) in [(1.0, 12.0), (-1.0, -12.0)] {
            floor.pose.heading = heading;
            for walk in [12.0, -12.0] {
                let setpoint = Setpoint::saturating(walk, 20.0);
                let steered = floor.steer(Instant::from_micros(20_000), setpoint);
                assert_eq!(steered, Setpoint::saturating(frequency, 90.0));
            }
        }
    }

    #[test]
    fn nothing_is_turned_at_rest_or_by_old_poses() {
        let mut floor = seen(&at(0, 0.0));
        floor.hold(true);
        floor.pose.heading = 1.0;
        let forward = PaperMode::Forward.setpoint();
        assert_eq!(floor.steer(Instant::from_micros(50_000), Setpoint::REST), Setpoint::REST);
        assert_eq!(floor.steer(Instant::from_micros(150_000), forward), forward);
        assert_ne!(floor.steer(Instant::from_micros(50_000), forward), forward);
    }

    #[test]
    fn a_curve_is_reported_once_a_walk() {
        let mut floor = seen(&at(0, 0.0));
        floor.begin(true);
        assert_eq!(floor.curve(), None);
        floor.pose.heading = 0.5;
        assert_eq!((floor.curve(), floor.curve()), (Some(0.5), None));
        floor.begin(false);
        floor.pose.heading = 2.0;
        assert_eq!(floor.curve(), None);
    }

    #[test]
    fn poses_that_are_not_trusted_are_not_shown() {
        let mut floor = None;
        Floor::observe(&mut floor, &PoseSample { valid: false, ..at(0, 0.0) });
        assert!(floor.is_none());
    }
}
