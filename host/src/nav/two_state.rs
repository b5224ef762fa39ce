//! The paper's controller (section IV-A): two states, turn left and turn right.
//!
//! The error is the desired heading minus the heading. Above the dead band the robot turns left,
//! below it right; inside, it continues. It advances because the two turns do not cancel: while
//! they alternate, the robot drifts in one direction of the body. The paper does not state which; here
//! the mode table gives it. The controller keeps this direction on the desired one.

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

/// The switching heading controller.
#[derive(Debug, Clone, PartialEq)]
pub struct TwoState {
    left: usize,
    right: usize,
    drift: f64,
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
        Ok(Self { left: left + 1, right: right + 1, drift })
    }

    /// Returns the turn with which the robot drifts towards `target`. `present`: the mode in force.
    #[must_use]
    pub fn choose(&self, pose: &PlanarPose, target: Position, present: usize) -> usize {
        let desired = pose.position().bearing_to(target);
        let error = wrap(desired - self.drift - pose.heading);
        let turning = present == self.left || present == self.right;
        if turning && present != REST && error.abs() <= DEAD_BAND {
            present
        } else if error > 0.0 {
            self.left
        } else {
            self.right
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::modes::tests::model_w;
    use super::*;

    const LEFT_INDEX: usize = 3;
    const RIGHT_INDEX: usize = 5;

    #[test]
    fn turns_towards_the_side_of_the_error_and_keeps_on_inside_the_dead_band() {
        let two_state = TwoState::new(&model_w()).unwrap();
        let facing = |heading| PlanarPose { x: 0.0, y: 0.0, heading: heading - two_state.drift };
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
}
