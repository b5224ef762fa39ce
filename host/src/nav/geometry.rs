//! Poses in the plane: ENU world frame, heading counter-clockwise from x (REP 103).

use std::f64::consts::{PI, TAU};

/// Where a robot stands and which way it faces, seen from above.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PlanarPose {
    /// East, m.
    pub x: f64,
    /// North, m.
    pub y: f64,
    /// Counter-clockwise from x, rad; any size, [`wrap`] brings it to one turn.
    pub heading: f64,
}

/// Speeds of a body in its own frame FLU.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Twist {
    /// Along the body's x, m/s.
    pub forward: f64,
    /// Along the body's y (left), m/s.
    pub lateral: f64,
    /// About z, to the left, rad/s.
    pub yaw: f64,
}

/// The same angle in (-pi, pi]. Not finite stays not finite.
#[must_use]
pub fn wrap(angle: f64) -> f64 {
    let turned = (angle + PI).rem_euclid(TAU) - PI;
    if turned <= -PI { PI } else { turned }
}

impl PlanarPose {
    /// Whether every part is a number.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.heading.is_finite()
    }

    /// Distance to a point, m.
    #[must_use]
    pub fn distance_to(&self, (x, y): (f64, f64)) -> f64 {
        (x - self.x).hypot(y - self.y)
    }

    /// The pose after moving with a constant `twist` for `seconds` (midpoint rule: exact to third
    /// order in the angle turned).
    #[must_use]
    pub fn moved(&self, twist: Twist, seconds: f64) -> Self {
        let turn = twist.yaw * seconds;
        let (sin, cos) = (self.heading + turn / 2.0).sin_cos();
        Self {
            x: self.x + (cos * twist.forward - sin * twist.lateral) * seconds,
            y: self.y + (sin * twist.forward + cos * twist.lateral) * seconds,
            heading: self.heading + turn,
        }
    }

    /// This pose seen from `base`, in the frame of `base`.
    #[must_use]
    pub fn seen_from(&self, base: &Self) -> Self {
        let (sin, cos) = base.heading.sin_cos();
        let (dx, dy) = (self.x - base.x, self.y - base.y);
        Self {
            x: cos * dx + sin * dy,
            y: -sin * dx + cos * dy,
            heading: wrap(self.heading - base.heading),
        }
    }
}

impl Twist {
    /// Standing still.
    pub const REST: Self = Self { forward: 0.0, lateral: 0.0, yaw: 0.0 };

    /// This twist times a factor.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            forward: self.forward * factor,
            lateral: self.lateral * factor,
            yaw: self.yaw * factor,
        }
    }

    /// The sum of two twists.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            forward: self.forward + other.forward,
            lateral: self.lateral + other.lateral,
            yaw: self.yaw + other.yaw,
        }
    }

    /// Speed over the floor, m/s.
    #[must_use]
    pub fn speed(self) -> f64 {
        self.forward.hypot(self.lateral)
    }

    /// Direction of travel against the heading, rad to the left.
    #[must_use]
    pub fn course(self) -> f64 {
        self.lateral.atan2(self.forward)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrapping_keeps_half_a_turn_positive() {
        assert_eq!((wrap(PI), wrap(-PI)), (PI, PI));
    }

    #[test]
    fn a_quarter_turn_on_a_circle_ends_where_geometry_says() {
        let twist = Twist { forward: 1.0, lateral: 0.0, yaw: 1.0 };
        let end =
            (0..1000).fold(PlanarPose::default(), |pose, _| pose.moved(twist, PI / 2.0 / 1000.0));
        assert!((end.x - 1.0).abs() < 1e-5 && (end.y - 1.0).abs() < 1e-5, "{end:?}");
    }

    #[test]
    fn left_of_a_robot_that_faces_north_is_west() {
        let north = PlanarPose { x: 0.0, y: 0.0, heading: PI / 2.0 };
        let end = north.moved(Twist { forward: 0.0, lateral: 1.0, yaw: 0.0 }, 1.0);
        assert!((end.x + 1.0).abs() < 1e-12 && end.y.abs() < 1e-12);
    }
}
