//! What acts on the body, and how it moves.

use flix_host::pose::Quaternion;
use serde::{Deserialize, Serialize};

use super::spatial::{Spatial, Vec3};

/// Force and couple.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// N.
    pub force: [f64; 3],
    /// N m.
    pub torque: [f64; 3],
}

impl Wrench {
    pub(super) fn spatial(&self) -> Spatial<f64> {
        Spatial::new(Vec3(self.torque), Vec3(self.force))
    }
}

/// Pose and velocity of the body's origin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BodyState {
    /// World position, m.
    pub position: [f64; 3],
    /// Unit quaternion w, x, y, z from body to world.
    pub orientation: [f64; 4],
    /// World velocity, m/s.
    pub velocity: [f64; 3],
    /// World angular velocity, rad/s.
    pub angular_velocity: [f64; 3],
}

impl BodyState {
    /// Returns the heading about world z, rad, positive to the left, -pi to pi.
    pub fn yaw(&self) -> f64 {
        Quaternion::from(self.orientation).heading()
    }

    /// Returns the vertical component of the body's upward axis: 1 upright, 0 on its side, -1 on its back.
    #[must_use]
    pub fn upward(&self) -> f64 {
        let Quaternion { x, y, .. } = Quaternion::from(self.orientation);
        1.0 - 2.0 * (x * x + y * y)
    }

    /// Returns whether the body is upright, within 60 degrees.
    #[must_use]
    pub fn is_upright(&self) -> bool {
        self.upward() > 0.5
    }
}
