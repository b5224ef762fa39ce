//! The default controller: of all modes, the one whose predicted future is best.
//!
//! It looks [`SEGMENTS`] segments of [`SEGMENT`] seconds ahead. In each segment the robot may be in
//! any mode; every sequence is rolled through the robot's own response (ramps, reversals) and costs
//!
//! ```text
//! J = integral of error(t) dt  -  reward for progress  +  switches  +  what the end promises
//! ```
//!
//! where the error counts squared near the path and linearly far from it. The sequences are grown
//! segment by segment and only the best [`BEAM`] are kept. The first mode of the best one is
//! driven, until the next decision. Hysteresis is the price of a switch; a minimum dwell is the
//! navigator's.

use super::geometry::{PlanarPose, wrap};
use super::motion::{Gait, Motion, REST, Response};
use super::path::{Path, Projection};

/// Length of a segment, s: what a change of mode takes.
pub const SEGMENT: f64 = 0.4;
/// Segments looked ahead: 2.4 s, longer than half a turn.
pub const SEGMENTS: usize = 6;
/// Sequences kept.
pub const BEAM: usize = 40;
/// Steps of the prediction in a segment.
const STEPS: usize = 4;
const STEP: f64 = SEGMENT / STEPS as f64;

/// Error that costs one second a second, m.
const ERROR_SCALE: f64 = 0.025;
/// Errors beyond this many scales count linearly.
const LINEAR_FROM: f64 = 2.0;
/// Worth of progress at full speed, seconds a second.
const PROGRESS: f64 = 2.0;
/// Price of a switch, s.
const SWITCH: f64 = 0.06;
/// Weight of the course at the end, s.
const COURSE: f64 = 2.0;
/// Seconds for which the error at the end is taken to last.
const TAIL: f64 = 0.6;
/// The course aims back at the path from this far ahead, m.
const RETURN_LENGTH: f64 = 0.12;

/// What is to be reached.
#[derive(Debug, Clone, Copy)]
pub enum Goal<'a> {
    /// Follow a path, being at this arc length now.
    Follow {
        /// The path.
        path: &'a Path,
        /// Arc length of the robot's place, m.
        arc_length: f64,
    },
    /// Come to a point and stand there.
    Reach {
        /// Where, m.
        point: (f64, f64),
    },
}

/// What the search may use.
#[derive(Debug, Clone, Copy)]
pub struct Prospects<'a> {
    /// Motions of all modes, standing still first.
    pub motions: &'a [Motion],
    /// How the robot follows commands.
    pub response: &'a Response,
    /// Fastest translation of any mode, m/s, and its course against the heading, rad.
    cruise: (f64, f64),
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
    promise: f64,
}

impl<'a> Prospects<'a> {
    /// What these motions allow.
    #[must_use]
    pub fn new(motions: &'a [Motion], response: &'a Response) -> Self {
        let fastest = motions
            .iter()
            .max_by(|a, b| a.twist.speed().total_cmp(&b.twist.speed()))
            .map_or((1e-3, 0.0), |m| (m.twist.speed().max(1e-3), m.twist.course()));
        let turn = motions.iter().map(|m| m.twist.yaw.abs()).fold(1e-2, f64::max);
        Self { motions, response, cruise: fastest, turn }
    }

    /// The mode to be in now. `pose` and `gait`: as predicted for the moment when a command sent
    /// now arrives.
    #[must_use]
    pub fn best_mode(&self, pose: PlanarPose, gait: Gait, goal: Goal<'_>) -> usize {
        let arc_length = match goal {
            Goal::Follow { arc_length, .. } => arc_length,
            Goal::Reach { .. } => 0.0,
        };
        let start = Node { pose, gait, arc_length, first: REST, cost: 0.0, promise: 0.0 };
        let mut beam = vec![start];
        let mut grown = Vec::with_capacity(BEAM * self.motions.len());
        for depth in 0..SEGMENTS {
            grown.clear();
            for node in &beam {
                for mode in self.candidates(goal) {
                    grown.push(self.grow(node, mode, depth == 0, goal));
                }
            }
            grown.sort_unstable_by(|a, b| a.promise.total_cmp(&b.promise));
            beam.clear();
            beam.extend(grown.iter().take(BEAM));
        }
        beam.first().map_or(REST, |best| best.first)
    }

    /// Standing still leads nowhere on a path; it is how a point is held.
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
            next.cost += SWITCH;
            next.gait = node.gait.commanded(mode, self.motions, self.response);
        }
        for _ in 0..STEPS {
            next.gait.advance(&mut next.pose, STEP, self.motions, self.response);
            next.cost += STEP * self.price(&mut next, goal);
        }
        next.promise = next.cost + self.outlook(&next, goal);
        next
    }

    /// Cost of a second at this node.
    fn price(&self, node: &mut Node, goal: Goal<'_>) -> f64 {
        match goal {
            Goal::Follow { path, .. } => {
                let place = path.follow((node.pose.x, node.pose.y), node.arc_length);
                let progress = (place.arc_length - node.arc_length) / STEP;
                node.arc_length = place.arc_length;
                robust(place.error) - PROGRESS * (progress / self.cruise.0).clamp(-2.0, 2.0)
            }
            Goal::Reach { point } => robust(node.pose.distance_to(point)),
        }
    }

    /// What is still to come after the last segment.
    fn outlook(&self, node: &Node, goal: Goal<'_>) -> f64 {
        match goal {
            Goal::Follow { path, .. } => {
                let place = path.follow((node.pose.x, node.pose.y), node.arc_length);
                let astray = self.course_error(node, course_on(&place));
                TAIL * robust(place.error) + COURSE * (1.0 - astray.cos())
            }
            Goal::Reach { point } => {
                let (dx, dy) = (point.0 - node.pose.x, point.1 - node.pose.y);
                let distance = dx.hypot(dy);
                // To turn first matters when there is some way to go.
                let turning = self.course_error(node, dy.atan2(dx)).abs() / self.turn;
                let way = distance / self.cruise.0;
                let seconds = way + turning * (distance / RETURN_LENGTH).min(1.0);
                0.5 * seconds * robust(distance)
            }
        }
    }

    /// Angle between where the fastest mode would lead and where it should, rad.
    fn course_error(&self, node: &Node, course: f64) -> f64 {
        wrap(course - node.pose.heading - self.cruise.1)
    }
}

/// The direction that leads back to the path and along it.
fn course_on(place: &Projection) -> f64 {
    place.tangent - (place.error / RETURN_LENGTH).atan()
}

/// Huber's function of an error in scales: square near zero, straight beyond.
fn robust(error: f64) -> f64 {
    let scales = error.abs() / ERROR_SCALE;
    if scales <= LINEAR_FROM { scales * scales } else { LINEAR_FROM * (2.0 * scales - LINEAR_FROM) }
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
        assert_eq!(best(PlanarPose::default(), Goal::Reach { point: (0.002, 0.0) }), "rest");
    }

    #[test]
    fn a_goal_behind_is_turned_to() {
        let name = best(PlanarPose::default(), Goal::Reach { point: (-0.5, 0.1) });
        assert!(name.starts_with("left"), "{name}");
    }

    #[test]
    fn a_goal_ahead_is_walked_to() {
        let name = best(PlanarPose::default(), Goal::Reach { point: (0.5, 0.0) });
        assert!(name.starts_with("forward"), "{name}");
    }

    #[test]
    fn a_small_offset_to_the_right_is_strafed_away() {
        let pose = PlanarPose { x: 0.0, y: 0.05, heading: 0.0 };
        assert_eq!(best(pose, Goal::Reach { point: (0.0, 0.0) }), "strafe-right");
    }

    #[test]
    fn the_price_of_errors_has_no_kink() {
        let edge = LINEAR_FROM * ERROR_SCALE;
        let slope = |at: f64| (robust(at + 1e-9) - robust(at)) / 1e-9;
        assert!((slope(edge - 1e-6) / slope(edge + 1e-6) - 1.0).abs() < 1e-3);
    }
}
