//! The search of the default and of the learned controller: chooses the mode whose predicted future is best.
//!
//! It looks [`SEGMENTS`] segments of [`SEGMENT`] seconds ahead. In each segment every mode is tried
//! (rest only towards a point), with the response of the robot (ramps, reversals); a sequence costs
//!
//! ```text
//! J = integral of error(t) dt  -  reward for progress  +  switches  +  terminal cost
//! ```
//!
//! where the error counts squared near the path and linearly far from it, and with it what is not known of a motion. This is a beam search:
//! the sequences grow segment by segment, and only the best [`BEAM`] are kept. The first mode of the
//! best one is driven, until the next decision. The cost of a switch gives hysteresis; the navigator
//! adds a minimum dwell.

use super::motion::{Gait, Motion, REST, Response};
use super::outlook::Outlook;
use super::pace::Pace;
use super::path::Path;
use super::weights::Weights;
use crate::pose::geometry::{PlanarPose, Position, Twist, wrap};

/// Length of a segment, s: the time of a change of mode.
pub const SEGMENT: f64 = 0.4;
/// Number of segments: 2.4 s, longer than half a turn.
pub const SEGMENTS: usize = 6;
/// Number of sequences kept.
pub const BEAM: usize = 40;
/// Steps of the prediction in a segment.
const STEPS: usize = 4;
const STEP: f64 = SEGMENT / STEPS as f64;

/// The goal of a decision.
#[derive(Debug, Clone, Copy)]
pub enum Goal<'a> {
    /// Follow a path from this arc length on.
    Follow {
        /// The path.
        path: &'a Path,
        /// Arc length of the robot, m.
        arc_length: f64,
    },
    /// Come to a point and rest there.
    Reach {
        /// The point.
        point: Position,
    },
}

/// What the search knows about the robot.
#[derive(Debug, Clone, Copy)]
pub struct Prospects<'a> {
    /// Motions of all modes, standing still first.
    pub motions: &'a [Motion],
    /// How the robot follows commands.
    pub response: &'a Response,
    /// What counts how much.
    pub weights: Weights,
    /// How fast the robot can go on, where that is known.
    pub pace: Option<&'a Pace>,
    /// What the way ahead costs, where that is known.
    pub outlook: Option<&'a Outlook>,
    /// Distance to the right of the path that is steered along, m: the search leaves a robot to one side of what it steers along.
    pub trim: f64,
    /// Fastest translation of any mode, m/s.
    cruise_speed: f64,
    /// Direction of that translation relative to the heading, rad.
    cruise_course: f64,
    /// Fastest turn of any mode, rad/s.
    turn: f64,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    pose: PlanarPose,
    gait: Gait,
    arc_length: f64,
    first: usize,
    cost: f64,
    total: f64,
}

impl<'a> Prospects<'a> {
    /// Prepares the search of the predictive controller. With a pace it judges by it how long a way takes, with an outlook by
    /// that what comes after its last segment.
    #[must_use]
    pub fn new(motions: &'a [Motion], response: &'a Response) -> Self {
        let fastest = motions
            .iter()
            .map(|motion| motion.twist)
            .max_by(|a, b| a.speed().total_cmp(&b.speed()))
            .unwrap_or(Twist::REST);
        let turn = motions.iter().map(|m| m.twist.yaw.abs()).fold(1e-2, f64::max);
        let cruise_speed = fastest.speed().max(1e-3);
        let cruise_course = fastest.course();
        Self {
            motions,
            response,
            weights: Weights::PREDICTIVE,
            pace: None,
            outlook: None,
            trim: 0.0,
            cruise_speed,
            cruise_course,
            turn,
        }
    }

    /// Returns the mode to command now. `pose` and `gait`: as the [`Estimator`](super::estimator::Estimator) predicts them for
    /// the moment when a command sent now arrives.
    #[must_use]
    pub fn best_mode(&self, pose: PlanarPose, gait: Gait, goal: Goal<'_>) -> usize {
        let arc_length = match goal {
            Goal::Follow { arc_length, .. } => arc_length,
            Goal::Reach { .. } => 0.0,
        };
        let start = Node { pose, gait, arc_length, first: REST, cost: 0.0, total: 0.0 };
        let mut beam = vec![start];
        let mut grown = Vec::with_capacity(BEAM * self.motions.len());
        for depth in 0..SEGMENTS {
            grown.clear();
            for node in &beam {
                for mode in self.candidates(goal) {
                    grown.push(self.grow(node, mode, depth == 0, goal));
                }
            }
            grown.sort_unstable_by(|a, b| a.total.total_cmp(&b.total));
            beam.clear();
            beam.extend(grown.iter().take(BEAM));
        }
        beam.first().map_or(REST, |best| best.first)
    }

    /// Returns the modes to try. Rest makes no progress on a path; it holds a point.
    fn candidates(&self, goal: Goal<'_>) -> std::ops::Range<usize> {
        match goal {
            Goal::Follow { .. } => 1..self.motions.len(),
            Goal::Reach { .. } => 0..self.motions.len(),
        }
    }

    fn grow(&self, node: &Node, mode: usize, is_first: bool, goal: Goal<'_>) -> Node {
        let mut next = *node;
        if is_first {
            next.first = mode;
        }
        if mode != node.gait.mode() {
            next.cost += self.weights.switch;
            let (from, to) = (&self.motions[node.gait.mode()], &self.motions[mode]);
            if from.frequency * to.frequency < 0.0 {
                next.cost += self.weights.reversal;
            }
            let heading = node.pose.heading;
            next.gait = node.gait.commanded(mode, heading, self.motions, self.response);
        }
        for _ in 0..STEPS {
            next.gait.advance(&mut next.pose, STEP, self.motions, self.response);
            next.cost += STEP * self.cost_rate(&mut next, goal);
        }
        // Who comes to a point may rest; doubt must not keep the robot from it.
        if matches!(goal, Goal::Follow { .. }) {
            next.cost += SEGMENT * self.weights.risk(self.motions[mode].spread);
        }
        next.total = next.cost + self.terminal_cost(&next, goal);
        next
    }

    /// Returns the cost per second at this node.
    fn cost_rate(&self, node: &mut Node, goal: Goal<'_>) -> f64 {
        match goal {
            Goal::Follow { path, .. } => {
                let place = path.follow(node.pose.position(), node.arc_length);
                let progress = (place.arc_length - node.arc_length) / STEP;
                node.arc_length = place.arc_length;
                let usual = self.speed_along(place.tangent);
                self.weights.robust(place.error + self.trim)
                    - self.weights.progress * (progress / usual).clamp(-2.0, 2.0)
            }
            Goal::Reach { point } => self.weights.robust(node.pose.distance_to(point)),
        }
    }

    /// Returns the estimated cost after the last segment.
    fn terminal_cost(&self, node: &Node, goal: Goal<'_>) -> f64 {
        match goal {
            Goal::Follow { path, .. } => {
                let place = path.follow(node.pose.position(), node.arc_length);
                if let Some(outlook) = self.outlook {
                    return outlook.cost(place.arc_length, place.error, node.pose.heading);
                }
                let course = path.course(node.pose.position(), &place, self.weights.return_length);
                let astray = 1.0 - self.course_error(node, course).cos();
                self.weights.tail * self.weights.robust(place.error + self.trim)
                    + self.weights.course * astray
            }
            Goal::Reach { point } => {
                let distance = node.pose.distance_to(point);
                let course = node.pose.position().bearing_to(point);
                let turning = match self.pace {
                    Some(pace) => pace.loss(node.pose.heading, course),
                    None => self.course_error(node, course).abs() / self.turn,
                };
                let way = distance / self.speed_along(course);
                // To turn first matters when there is some way to go.
                let seconds = way + turning * (distance / self.weights.return_length).min(1.0);
                0.5 * seconds * self.weights.robust(distance)
            }
        }
    }

    /// Returns the fastest speed that is reckoned with along a course (rad), m/s.
    fn speed_along(&self, course: f64) -> f64 {
        self.pace.map_or(self.cruise_speed, |pace| pace.best(course))
    }

    /// Returns the angle from the course of the fastest mode to this course, rad.
    fn course_error(&self, node: &Node, course: f64) -> f64 {
        wrap(course - node.pose.heading - self.cruise_course)
    }
}

#[cfg(test)]
mod tests {
    use super::super::modes::tests::model_w;
    use super::super::motion::motions;
    use super::*;

    const RESPONSE: Response =
        Response { frequency_ramp: 60.0, direction_slew: 360.0, settling: 0.1 };

    fn best(pose: PlanarPose, goal: Goal<'_>) -> String {
        let table = model_w();
        let motions = motions(&table);
        let mode = Prospects::new(&motions, &RESPONSE).best_mode(pose, Gait::at_rest(), goal);
        if mode == REST { "rest".into() } else { table.modes()[mode - 1].name.clone() }
    }

    #[test]
    fn at_its_goal_the_robot_rests() {
        assert_eq!(
            best(PlanarPose::default(), Goal::Reach { point: Position::new(0.002, 0.0) }),
            "rest"
        );
    }

    #[test]
    fn a_goal_behind_is_turned_to() {
        let name = best(PlanarPose::default(), Goal::Reach { point: Position::new(-0.5, 0.1) });
        assert!(name.starts_with("left"), "{name}");
    }

    #[test]
    fn a_goal_ahead_is_walked_to() {
        let name = best(PlanarPose::default(), Goal::Reach { point: Position::new(0.5, 0.0) });
        assert!(name.starts_with("forward"), "{name}");
    }

    #[test]
    fn a_small_offset_to_the_right_is_strafed_away() {
        let pose = PlanarPose { x: 0.0, y: 0.05, heading: 0.0 };
        assert_eq!(best(pose, Goal::Reach { point: Position::ORIGIN }), "strafe-right");
    }

    #[test]
    fn the_cost_of_errors_has_no_kink() {
        let motions = motions(&model_w());
        let search = Prospects::new(&motions, &RESPONSE);
        let edge = search.weights.linear_from * search.weights.error_scale;
        let slope = |at: f64| (search.weights.robust(at + 1e-9) - search.weights.robust(at)) / 1e-9;
        assert!((slope(edge - 1e-6) / slope(edge + 1e-6) - 1.0).abs() < 1e-3);
    }
}
