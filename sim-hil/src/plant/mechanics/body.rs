//! What acts on the body, and how it moves.

use flix_host::pose::Quaternion;

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
#[derive(Clone, Copy, Debug, PartialEq)]
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
}
