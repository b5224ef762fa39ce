//! The paper's controller (section IV-A): two states, turn left and turn right.
//!
//! The error is the desired heading minus the heading. Above the dead band the robot turns left,
//! below it right; inside, it continues. It advances because the two turns do not cancel: while
//! they alternate, the robot drifts in one direction of the body. The paper does not state which; here
//! the mode table gives it. The controller keeps this direction on the desired one.
//!
//! A rule of our own is added. From a target within its turning circle the error never comes to zero, and the robot would circle
//! for ever: a full turn to one side that brings it no nearer is followed by a turn to the other side, until the error calls for
//! that side too. The target lies outside the circle of that turn, which touches the first from outside.

use std::f64::consts::TAU;

use super::modes::ModeTable;
use super::motion::REST;
use crate::pose::geometry::{PlanarPose, Position, wrap};

/// Names of the two modes (Table IV, E and D).
pub const LEFT: &str = "left";
/// See [`LEFT`].
pub const RIGHT: &str = "right";

/// Half the width of the dead band, rad.
pub const DEAD_BAND: f64 = 0.12;

/// Distance ahead on a path at which the controller aims, m: two thirds of the robot's length.
pub const LOOK_AHEAD: f64 = 0.15;

/// By so much a turn has to bring the robot nearer to its target, or a target has to move, to count, m.
const NEARER: f64 = 0.005;

/// The switching heading controller.
#[derive(Debug, Clone, PartialEq)]
pub struct TwoState {
    left: usize,
    right: usize,
    drift: f64,
    turn: Turn,
    /// The turn that leads away from a circle around the target.
    other: Option<usize>,
}

/// The turn under way.
#[derive(Debug, Clone, PartialEq)]
struct Turn {
    mode: usize,
    target: Position,
    /// Least distance from the target, m.
    nearest: f64,
    /// Heading at the last decision, rad.
    heading: f64,
    /// Angle turned since the least distance, rad.
    turned: f64,
}

/// The mode table lacks a turn.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the two-state controller needs the modes \"left\" and \"right\" in the mode table; \
     \"{0}\" is missing: identify them with `flix identify`"
)]
pub struct MissingTurn(pub &'static str);

impl TwoState {
    /// Makes the controller for the turns of a robot.
    ///
    /// # Errors
    /// When the table has no mode of one of the two names.
    pub fn new(table: &ModeTable) -> Result<Self, MissingTurn> {
        let find = |name: &'static str| {
            let index = table.modes().iter().position(|m| m.name == name);
            index.ok_or(MissingTurn(name))
        };
        let (left, right) = (find(LEFT)?, find(RIGHT)?);
        let (l, r) = (table.modes()[left].twist(), table.modes()[right].twist());
        // Each turn lasts as long as the other needs to turn back.
        let drift = l.scaled(r.yaw.abs()).plus(r.scaled(l.yaw.abs())).course();
        let turn = Turn {
            mode: REST,
            target: Position::default(),
            nearest: f64::INFINITY,
            heading: 0.0,
            turned: 0.0,
        };
        Ok(Self { left: left + 1, right: right + 1, drift, turn, other: None })
    }

    /// Returns the turn with which the robot drifts towards `target`. `present`: the mode in force.
    pub fn choose(&mut self, pose: &PlanarPose, target: Position, present: usize) -> usize {
        let desired = pose.position().bearing_to(target);
        let error = wrap(desired - self.drift - pose.heading);
        let turn = if error > 0.0 { self.left } else { self.right };
        if self.turn.is_in_vain(pose, target, present) {
            self.other = Some(self.left + self.right - present);
        }
        self.other = self.other.filter(|&other| other != turn);
        if let Some(other) = self.other {
            return other;
        }
        let turning = present == self.left || present == self.right;
        if turning && error.abs() <= DEAD_BAND { present } else { turn }
    }
}

impl Turn {
    /// Returns whether the robot has turned by 360 degrees and came no nearer to a target that stands.
    fn is_in_vain(&mut self, pose: &PlanarPose, target: Position, mode: usize) -> bool {
        let distance = pose.distance_to(target);
        let goes_on = mode == self.mode
            && mode != REST
            && target.distance_to(self.target) < NEARER
            && distance > self.nearest - NEARER;
        let turned = self.turned + wrap(pose.heading - self.heading);
        if goes_on && turned.abs() < TAU {
            (self.heading, self.turned) = (pose.heading, turned);
            return false;
        }
        *self = Self { mode, target, nearest: distance, heading: pose.heading, turned: 0.0 };
        goes_on
    }
}

#[cfg(test)]
mod tests {
    use super::super::modes::tests::model_w;
    use std::f64::consts::TAU;

    use super::*;

    const LEFT_INDEX: usize = 3;
    const RIGHT_INDEX: usize = 5;

    #[test]
    fn turns_towards_the_side_of_the_error_and_keeps_on_inside_the_dead_band() {
        let mut two_state = TwoState::new(&model_w()).unwrap();
        let drift = two_state.drift;
        let facing = |heading| PlanarPose { x: 0.0, y: 0.0, heading: heading - drift };
        let target = Position::new(1.0, 0.0);
        assert_eq!(two_state.choose(&facing(-0.3), target, RIGHT_INDEX), LEFT_INDEX);
        assert_eq!(two_state.choose(&facing(0.3), target, LEFT_INDEX), RIGHT_INDEX);
        assert_eq!(two_state.choose(&facing(0.05), target, LEFT_INDEX), LEFT_INDEX);
        assert_eq!(two_state.choose(&facing(-0.05), target, RIGHT_INDEX), RIGHT_INDEX);
    }

    #[test]
    fn a_table_without_turns_is_refused_by_name() {
        let table = model_w();
        let rest: Vec<_> = table.modes().iter().filter(|m| m.name != "right").cloned().collect();
        let table = ModeTable::new("", "", rest).unwrap();
        assert_eq!(TwoState::new(&table), Err(MissingTurn("right")));
    }

    /// Returns how many of 144 starts around a target end within 25 mm of it after 120 s at most; a decision each 0.1 s.
    fn arrivals(table: &ModeTable) -> usize {
        const STEP: f64 = 0.1;
        let starts = (0..144_u32).map(|index| {
            let (direction, heading) = (f64::from(index % 12), f64::from(index / 12));
            let distance = 0.03 * (1.0 + f64::from(index % 7));
            let (y, x) = (direction * TAU / 12.0).sin_cos();
            PlanarPose { x: distance * x, y: distance * y, heading: heading * TAU / 12.0 }
        });
        starts
            .filter(|&start| {
                let mut two_state = TwoState::new(table).unwrap();
                let (mut pose, mut mode) = (start, REST);
                (0..1_200).any(|_| {
                    mode = two_state.choose(&pose, Position::default(), mode);
                    pose = pose.moved(table.modes()[mode - 1].twist(), STEP);
                    pose.distance_to(Position::default()) < 0.025
                })
            })
            .count()
    }

    #[test]
    fn comes_to_a_point_within_its_turning_circle() {
        let mut modes = model_w().modes().to_vec();
        for mode in modes.iter_mut().filter(|it| it.name == LEFT || it.name == RIGHT) {
            // A circle of 120 mm.
            mode.forward.mean = 0.06;
            mode.yaw.mean = 0.5_f64.copysign(mode.yaw.mean);
        }
        let wide = ModeTable::new("", "", modes).unwrap();
        assert_eq!([arrivals(&model_w()), arrivals(&wide)], [144; 2]);
    }
}
