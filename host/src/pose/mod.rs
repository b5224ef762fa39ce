//! Poses of the robot, from a motion-capture system or a simulator.
//!
//! A pose is in the world frame ENU (metres, z up); its orientation rotates the body frame FLU
//! (REP 103) into the world. Every source delivers the same [`PoseSample`]; a sample that its source
//! does not trust is marked and is never used to move.

#[cfg(not(target_family = "wasm"))]
pub mod any;
pub mod continuity;
#[cfg(not(target_family = "wasm"))]
mod delay;
pub mod geometry;
#[cfg(not(target_family = "wasm"))]
pub mod natnet;
#[cfg(not(target_family = "wasm"))]
mod order;
pub mod rate;
#[cfg(not(target_family = "wasm"))]
mod stream;
#[cfg(not(target_family = "wasm"))]
pub mod udp;

use std::time::Duration;

use flix_protocol::units::Instant;
use serde::{Deserialize, Serialize};

use crate::pose::geometry::{FARTHEST, PlanarPose, wrap};

/// A body that is tilted by more is on its side or back, rad.
pub(crate) const MOST_TILT: f64 = core::f64::consts::FRAC_PI_3;
/// A pose that comes by more than this later than the fastest one is not trusted: twice the age at which a pose is too old to
/// steer by.
pub const LATE: Duration = Duration::from_millis(200);
/// Height of the markers of a robot on the floor, m: its plate is 0.06 m above its soles.
const HEIGHTS: std::ops::RangeInclusive<f64> = 0.01..=0.3;

/// A position in the world, m.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Vector {
    /// East, m.
    pub x: f64,
    /// North, m.
    pub y: f64,
    /// Up, m.
    pub z: f64,
}

/// A rotation as a unit quaternion. The default is all zeros, which is not a rotation: trackers
/// report it for a body that they do not see.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Quaternion {
    /// Factor of i.
    pub x: f64,
    /// Factor of j.
    pub y: f64,
    /// Factor of k.
    pub z: f64,
    /// Real part.
    pub w: f64,
}

/// Position and attitude of the robot's body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Position in the world ENU.
    pub position: Vector,
    /// Rotation from body FLU to world ENU.
    pub orientation: Quaternion,
}

/// A pose at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseSample {
    /// Time of the pose, on the clock of the program that reads it.
    pub time: Instant,
    /// The pose.
    pub pose: Pose,
    /// Whether the robot may be steered by the pose: tracked, in order, steady, not late, and of one sender alone.
    pub valid: bool,
    /// When the picture was taken that shows it, if the source states that.
    pub picture: Option<Picture>,
}

/// When a picture was taken, on the clock of the cameras: it differs from any other clock by an unknown time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Picture {
    /// Middle of the exposure.
    pub exposed: Instant,
    /// When the pose was sent; where the source does not state it, as `exposed`.
    pub sent: Instant,
    /// By how much later than the fastest one it came; see [`LATE`].
    pub late: Duration,
}

impl PoseSample {
    /// Returns the pose on the floor if the source trusts it and it is a pose.
    #[must_use]
    pub fn trusted(&self) -> Option<PlanarPose> {
        (self.valid && self.pose.is_sound()).then(|| self.pose.on_the_floor())
    }

    /// Returns by how much later than the fastest one it came; zero where its source does not state when pictures are taken.
    #[must_use]
    pub fn late(&self) -> Duration {
        self.picture.map_or(Duration::ZERO, |picture| picture.late)
    }
}

/// A source of poses.
pub trait PoseSource {
    /// Returns the next pose that has arrived, if any. Never waits. `now` is the clock of the samples.
    ///
    /// # Errors
    /// When the source has failed; a pose that is merely missing is `None`.
    fn poll(&mut self, now: Instant) -> Result<Option<PoseSample>, PoseError>;
}

/// Why a source of poses failed.
#[derive(Debug, thiserror::Error)]
pub enum PoseError {
    /// The network failed.
    #[error("poses cannot be received: {0}")]
    Network(#[from] std::io::Error),
}

impl Vector {
    /// Returns the three coordinates x, y, z, m.
    #[must_use]
    pub const fn coordinates(self) -> [f64; 3] {
        [self.x, self.y, self.z]
    }
}

impl From<[f64; 3]> for Vector {
    fn from([x, y, z]: [f64; 3]) -> Self {
        Self { x, y, z }
    }
}

impl Quaternion {
    /// Returns the four components in the order w, x, y, z.
    #[must_use]
    pub const fn components(self) -> [f64; 4] {
        [self.w, self.x, self.y, self.z]
    }

    /// Returns the rotation about z by this angle, rad counter-clockwise.
    #[must_use]
    pub fn about_z(angle: f64) -> Self {
        let (sin, cos) = (angle / 2.0).sin_cos();
        Self { x: 0.0, y: 0.0, z: sin, w: cos }
    }

    /// Returns the direction of the rotated x axis seen from above, rad counter-clockwise, from -pi
    /// to pi.
    #[must_use]
    pub fn heading(self) -> f64 {
        let Self { x, y, z, w } = self;
        (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
    }
}

impl Quaternion {
    /// Returns the opposite rotation.
    #[must_use]
    pub fn inverse(self) -> Self {
        Self { x: -self.x, y: -self.y, z: -self.z, w: self.w }
    }

    /// Returns the rotation by `first`, then by this one, both about fixed axes.
    #[must_use]
    pub fn after(self, first: Self) -> Self {
        let (a, b) = (self, first);
        Self {
            w: a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
            x: a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            y: a.w * b.y + a.y * b.w + a.z * b.x - a.x * b.z,
            z: a.w * b.z + a.z * b.w + a.x * b.y - a.y * b.x,
        }
    }

    /// Returns a vector turned by this rotation.
    #[must_use]
    pub fn turn(self, vector: Vector) -> Vector {
        let Vector { x, y, z } = vector;
        let turned = self.after(Self { x, y, z, w: 0.0 }).after(self.inverse());
        Vector { x: turned.x, y: turned.y, z: turned.z }
    }

    /// Returns the axis of the rotation times its angle, rad, up to half a turn.
    #[must_use]
    pub fn rotation_vector(self) -> Vector {
        let sine = (self.x * self.x + self.y * self.y + self.z * self.z).sqrt();
        let half = if self.w < 0.0 { (-sine).atan2(-self.w) } else { sine.atan2(self.w) };
        // Both vanish together; half an angle is its sine then.
        let scale = if sine > 0.0 { 2.0 * half / sine } else { 0.0 };
        Vector { x: scale * self.x, y: scale * self.y, z: scale * self.z }
    }
}

impl From<[f64; 4]> for Quaternion {
    /// From the components in the order w, x, y, z.
    fn from([w, x, y, z]: [f64; 4]) -> Self {
        Self { x, y, z, w }
    }
}

impl Pose {
    /// Returns the pose of a robot that is level, its body `height` m above the floor.
    #[must_use]
    pub fn planar(pose: PlanarPose, height: f64) -> Self {
        Self {
            position: Vector { x: pose.x, y: pose.y, z: height },
            orientation: Quaternion::about_z(pose.heading),
        }
    }

    /// Returns the pose seen from above. The heading is the direction of the body's x axis.
    #[must_use]
    pub fn on_the_floor(&self) -> PlanarPose {
        let Vector { x, y, .. } = self.position;
        PlanarPose { x, y, heading: wrap(self.orientation.heading()) }
    }

    /// Returns how far the body's z axis is from up, rad.
    #[must_use]
    pub fn tilt(&self) -> f64 {
        let Quaternion { x, y, .. } = self.orientation;
        (1.0 - 2.0 * (x * x + y * y)).clamp(-1.0, 1.0).acos()
    }

    /// Returns why this is no pose of a robot on the floor, with a remedy. A tracker in the plane states no height.
    #[must_use]
    pub fn floating(&self, is_planar: bool) -> Option<String> {
        let tilt = self.tilt();
        if tilt > MOST_TILT {
            return Some(format!(
                "the pose is tilted by {:.0} degrees: put the robot on its feet, or give the tracked body its axes, z up",
                tilt.to_degrees()
            ));
        }
        let height = self.position.z;
        let stands = HEIGHTS.contains(&height) || (is_planar && height == 0.0);
        (!stands).then(|| {
            format!(
                "the pose is {height:.3} m high, and on the floor the markers are {} to {} m high: set --up as in \
                 Motive, and its ground plane",
                HEIGHTS.start(),
                HEIGHTS.end()
            )
        })
    }

    /// Returns whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let (position, orientation) = (self.position.coordinates(), self.orientation.components());
        position.iter().chain(&orientation).all(|number| number.is_finite())
    }

    /// Returns whether every number is finite, the place within 1000 m, and the quaternion a rotation.
    #[must_use]
    pub(crate) fn is_sound(&self) -> bool {
        let norm: f64 = self.orientation.components().iter().map(|q| q * q).sum();
        // Motive sends single precision; a body it does not see has the zero quaternion.
        let is_near = self.position.coordinates().iter().all(|it| it.abs() <= FARTHEST);
        self.is_finite() && is_near && (norm - 1.0).abs() < 1e-2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotation_vector_is_axis_times_angle_whatever_the_sign_of_the_quaternion() {
        for angle in [-3.0, -0.2, 0.0, 1e-9, 0.4, 3.0] {
            let Quaternion { x, y, z, w } = Quaternion::about_z(angle);
            for q in [Quaternion { x, y, z, w }, Quaternion { x: -x, y: -y, z: -z, w: -w }] {
                let Vector { x, y, z } = q.rotation_vector();
                assert!(x == 0.0 && y == 0.0 && (z - angle).abs() < 1e-12, "{angle}: {z}");
            }
        }
    }

    #[test]
    fn rotations_follow_each_other_about_fixed_axes() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let nose_down = Quaternion { x: 0.0, y: half, z: 0.0, w: half };
        let left = Quaternion::about_z(std::f64::consts::FRAC_PI_2);
        let forward = Vector { x: 1.0, y: 0.0, z: 0.0 };
        // Forward turns down and stays there; forward turns left and stays there.
        for (both, expected) in [
            (left.after(nose_down), [0.0, 0.0, -1.0]),
            (nose_down.after(left), [0.0, 1.0, 0.0]),
            (left.after(left.inverse()), [1.0, 0.0, 0.0]),
        ] {
            let found = both.turn(forward).coordinates();
            let error = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(error < 1e-12, "{found:?}");
        }
    }

    #[test]
    fn a_flat_pose_keeps_its_heading() {
        for heading in [-3.0, -1.0, 0.0, 0.5, 3.1] {
            let pose = PlanarPose { x: 1.0, y: -2.0, heading };
            let back = Pose::planar(pose, 0.05).on_the_floor();
            assert!((back.heading - heading).abs() < 1e-12 && back.x == 1.0 && back.y == -2.0);
        }
    }

    #[test]
    fn a_quaternion_that_is_not_a_rotation_is_not_sound() {
        let lost = Pose { position: Vector::default(), orientation: Quaternion::default() };
        assert!(!lost.is_sound() && Pose::planar(PlanarPose::default(), 0.0).is_sound());
    }
}
