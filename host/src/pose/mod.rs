//! Where the robot is: poses from a motion-capture system or a simulator.
//!
//! Poses are in a world frame ENU with z up, m, and turn the body frame FLU (REP 103) into it.
//! Every source delivers the same [`PoseSample`]; a sample that its source does not trust says so
//! and is never used to move.

pub mod natnet;

use flix_protocol::units::Instant;

use crate::nav::{PlanarPose, wrap};

/// Position and attitude of the robot's body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// East, north, up, m.
    pub position: [f64; 3],
    /// Unit quaternion w, x, y, z: turns body FLU into world ENU.
    pub orientation: [f64; 4],
}

/// A pose at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseSample {
    /// When the pose was taken, on the clock of the program that reads it.
    pub time: Instant,
    /// The pose.
    pub pose: Pose,
    /// Whether the source trusts it: the rigid body was tracked.
    pub valid: bool,
}

/// Something that tells poses as they come.
pub trait PoseSource {
    /// The next pose that arrived, if one did; never waits. `now` is the clock of the samples.
    ///
    /// # Errors
    /// When the source is broken for good; a pose that is merely missing is `None`.
    fn poll(&mut self, now: Instant) -> Result<Option<PoseSample>, PoseError>;
}

/// Why a source of poses cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum PoseError {
    /// The network failed.
    #[error("poses cannot be received: {0}")]
    Network(#[from] std::io::Error),
}

impl Pose {
    /// A robot that stands flat on the floor.
    #[must_use]
    pub fn planar(pose: PlanarPose, height: f64) -> Self {
        let (sin, cos) = (pose.heading / 2.0).sin_cos();
        Self { position: [pose.x, pose.y, height], orientation: [cos, 0.0, 0.0, sin] }
    }

    /// The pose seen from above. The heading is where the body's x axis points.
    #[must_use]
    pub fn on_the_floor(&self) -> PlanarPose {
        let [w, x, y, z] = self.orientation;
        let heading = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
        PlanarPose { x: self.position[0], y: self.position[1], heading: wrap(heading) }
    }

    /// Whether every number is finite and the quaternion is one.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let norm: f64 = self.orientation.iter().map(|q| q * q).sum();
        // Motive sends single precision; a body it does not see has the zero quaternion.
        self.position.iter().all(|p| p.is_finite()) && (norm - 1.0).abs() < 1e-2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_pose_keeps_its_heading() {
        for heading in [-3.0, -1.0, 0.0, 0.5, 3.1] {
            let pose = PlanarPose { x: 1.0, y: -2.0, heading };
            let back = Pose::planar(pose, 0.05).on_the_floor();
            assert!((back.heading - heading).abs() < 1e-12 && back.x == 1.0 && back.y == -2.0);
        }
    }

    #[test]
    fn a_quaternion_that_is_none_is_not_sound() {
        let lost = Pose { position: [0.0; 3], orientation: [0.0; 4] };
        assert!(!lost.is_sound() && Pose::planar(PlanarPose::default(), 0.0).is_sound());
    }
}
