//! Motions on the floor.

use crate::pose::geometry::{PlanarPose, wrap};

/// Motion on the floor: east, m, north, m, and turn to the left, rad.
pub(super) type Moved = [f64; 3];

/// Length by which a turn counts as a motion, m: half the robot's.
pub(super) const ARM: f64 = 0.1;

/// Returns one motion after the other.
pub(super) fn sum(a: Moved, b: Moved) -> Moved {
    std::array::from_fn(|axis| a[axis] + b[axis])
}

/// Returns the motion from one pose to another.
pub(super) fn between(from: &PlanarPose, to: &PlanarPose) -> Moved {
    [to.x - from.x, to.y - from.y, wrap(to.heading - from.heading)]
}

/// Length of the way, m.
pub(super) fn length(moved: Moved) -> f64 {
    moved[0].hypot(moved[1])
}

/// Size of a motion with its turn, m.
pub(super) fn size(moved: Moved) -> f64 {
    length(moved).hypot(ARM * moved[2])
}
