//! Positions, poses and speeds in the plane.
//!
//! World frame ENU: x east, y north, metres; headings counter-clockwise from x, radians (REP 103).
//! Speeds are in the body frame FLU: forward and left in m/s, yaw to the left in rad/s.

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::str::FromStr;

use crate::system::number::in_unit;

/// A point on the floor, m.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Position {
    /// East, m.
    pub x: f64,
    /// North, m.
    pub y: f64,
}

/// Position and heading of a robot, seen from above.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PlanarPose {
    /// East, m.
    pub x: f64,
    /// North, m.
    pub y: f64,
    /// Counter-clockwise from x, rad, of any size; [`wrap`] reduces it to one turn.
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

/// Returns the same angle in (-pi, pi]. An angle that is not finite stays so.
#[must_use]
pub fn wrap(angle: f64) -> f64 {
    let turned = (angle + PI).rem_euclid(TAU) - PI;
    if turned <= -PI { PI } else { turned }
}

impl Position {
    /// The origin of the world frame.
    pub const ORIGIN: Self = Self::new(0.0, 0.0);

    /// Makes a position from east and north, m.
    #[must_use]
    pub const fn new(x: f64, y: f64) -> Self {
        Self { x, y }
    }

    /// Returns whether both coordinates are finite.
    #[must_use]
    pub fn is_finite(self) -> bool {
        self.x.is_finite() && self.y.is_finite()
    }

    /// Returns the distance to another position, m.
    #[must_use]
    pub fn distance_to(self, other: Self) -> f64 {
        (other.x - self.x).hypot(other.y - self.y)
    }

    /// Returns the square of the distance to another position, m^2.
    #[must_use]
    pub fn squared_distance_to(self, other: Self) -> f64 {
        (self.x - other.x).powi(2) + (self.y - other.y).powi(2)
    }

    /// Returns the position `share` (0 to 1) of the way to another one.
    #[must_use]
    pub fn towards(self, other: Self, share: f64) -> Self {
        Self::new(self.x + (other.x - self.x) * share, self.y + (other.y - self.y) * share)
    }

    /// Returns the direction to another position, rad counter-clockwise from x.
    #[must_use]
    pub fn bearing_to(self, other: Self) -> f64 {
        (other.y - self.y).atan2(other.x - self.x)
    }
}

/// Farthest coordinate that is taken from people, m: beyond, a number is a slip.
pub(crate) const FARTHEST: f64 = 1000.0;

/// Reads a coordinate in metres, or with its unit behind it.
fn coordinate(text: &str) -> Option<f64> {
    in_unit(text, "m").ok().filter(|number| number.abs() <= FARTHEST)
}

/// A text was refused as a position.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("\"{0}\" is not a position: write x,y in metres within {FARTHEST}, such as 0.5,-0.2")]
pub struct NotAPosition(String);

impl FromStr for Position {
    type Err = NotAPosition;

    /// Reads `x,y` in metres.
    fn from_str(text: &str) -> Result<Self, NotAPosition> {
        text.split_once(',')
            .and_then(|(x, y)| Some(Self::new(coordinate(x)?, coordinate(y)?)))
            .ok_or_else(|| NotAPosition(text.to_owned()))
    }
}

/// A rectangle along the axes of the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Area {
    /// South-west corner.
    pub low: Position,
    /// North-east corner.
    pub high: Position,
}

impl Area {
    /// Returns the smallest area that contains these positions.
    pub fn around(positions: impl IntoIterator<Item = Position>) -> Self {
        let everywhere = Position::new(f64::INFINITY, f64::INFINITY);
        let nothing = Self { low: everywhere, high: Position::new(-everywhere.x, -everywhere.y) };
        positions.into_iter().fold(nothing, |Self { low, high }, p| Self {
            low: Position::new(low.x.min(p.x), low.y.min(p.y)),
            high: Position::new(high.x.max(p.x), high.y.max(p.y)),
        })
    }

    /// Returns the area with a margin on all sides, m.
    #[must_use]
    pub fn widened(self, margin: f64) -> Self {
        let Self { low, high } = self;
        Self {
            low: Position::new(low.x - margin, low.y - margin),
            high: Position::new(high.x + margin, high.y + margin),
        }
    }

    /// Returns whether a position is inside.
    #[must_use]
    pub fn contains(&self, Position { x, y }: Position) -> bool {
        (self.low.x..=self.high.x).contains(&x) && (self.low.y..=self.high.y).contains(&y)
    }
}

impl fmt::Display for Area {
    /// Writes `west,south,east,north` in metres.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { low, high } = self;
        write!(f, "{:.2},{:.2},{:.2},{:.2}", low.x, low.y, high.x, high.y)
    }
}

/// A text was refused as an area.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "\"{0}\" is not an area: write west,south,east,north in metres within {FARTHEST}, such as -1,-0.7,1,0.7"
)]
pub struct NotAnArea(String);

impl FromStr for Area {
    type Err = NotAnArea;

    /// Reads `west,south,east,north` in metres.
    fn from_str(text: &str) -> Result<Self, NotAnArea> {
        let numbers: Option<Vec<f64>> = text.split(',').map(coordinate).collect();
        match numbers.as_deref() {
            Some([x0, y0, x1, y1]) if x0 < x1 && y0 < y1 => {
                Ok(Self { low: Position::new(*x0, *y0), high: Position::new(*x1, *y1) })
            }
            _ => Err(NotAnArea(text.to_owned())),
        }
    }
}

impl PlanarPose {
    /// Makes a pose from a position and a heading, rad.
    #[must_use]
    pub const fn new(Position { x, y }: Position, heading: f64) -> Self {
        Self { x, y, heading }
    }

    /// Returns the position without the heading.
    #[must_use]
    pub const fn position(&self) -> Position {
        Position::new(self.x, self.y)
    }

    /// Returns the distance to a position, m.
    #[must_use]
    pub fn distance_to(&self, other: Position) -> f64 {
        self.position().distance_to(other)
    }

    /// Returns the pose after motion with a constant `twist` for `seconds` (midpoint rule: exact to
    /// second order in the angle turned).
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

    /// Returns the world position of a point of the body, which is `x` forward and `y` left, m.
    #[must_use]
    pub fn place(&self, body: Position) -> Position {
        let (sin, cos) = self.heading.sin_cos();
        Position::new(self.x + cos * body.x - sin * body.y, self.y + sin * body.x + cos * body.y)
    }
}

impl Twist {
    /// No motion.
    pub const REST: Self = Self { forward: 0.0, lateral: 0.0, yaw: 0.0 };

    /// Returns this twist times a factor.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            forward: self.forward * factor,
            lateral: self.lateral * factor,
            yaw: self.yaw * factor,
        }
    }

    /// Returns the sum of two twists.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            forward: self.forward + other.forward,
            lateral: self.lateral + other.lateral,
            yaw: self.yaw + other.yaw,
        }
    }

    /// Returns the speed over the floor, m/s.
    #[must_use]
    pub fn speed(self) -> f64 {
        self.forward.hypot(self.lateral)
    }

    /// Returns the direction of travel relative to the heading, rad to the left.
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
    #[test]
    fn an_area_is_read_and_written_alike() {
        let area: Area = "-1,-0.7, 1,0.7".parse().unwrap();
        assert_eq!(area.to_string().parse::<Area>(), Ok(area));
    }

    #[test]
    fn what_is_not_an_area_is_refused() {
        for bad in ["", "1,2,3", "1,1,0,0", "0,0,nan,1", "a,b,c,d", "0,0,inf,1"] {
            assert!(bad.parse::<Area>().is_err(), "{bad}");
        }
    }

    #[test]
    fn what_is_not_a_position_is_refused() {
        assert_eq!("0.5, -0.2".parse(), Ok(Position::new(0.5, -0.2)));
        for bad in ["", "1", "1,2,3", "nan,0", "a,b"] {
            assert!(bad.parse::<Position>().is_err(), "{bad}");
        }
    }
}
