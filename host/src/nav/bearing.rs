//! Angle from the course that is commanded to the one that is seen.
//!
//! A tracked body whose forward axis is not the robot's is seen to walk at a constant angle to its commands, and otherwise as
//! commanded. A robot that is not like its mode table walks at another angle, speed and rate of turn in each mode.

use super::moved::{ARM, Moved, size};

/// Commanded way over which sums fade to a third, m.
const MEMORY: f64 = 0.4;
/// Least commanded way that determines the angle, m.
const LEAST: f64 = 0.15;
/// Largest change of the commanded motion from one slot to the next, as a share of it: a change of mode is larger.
const STEADY: f64 = 0.4;
/// Largest share of the squared motion that a turn by the angle leaves unexplained. Turned axes leave 0.01 to 0.07, robots with
/// load, legs and friction other than in their mode table most often 0.1 to 0.7.
const UNEXPLAINED: f64 = 0.07;
/// Least angle that is reported, degrees: worn robots and slopes of 3 degrees make up to 16.
const REPORTED: f64 = 17.0;

/// Sums over motions that were seen, `s`, and commanded, `c`, whose ways are complex numbers.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Bearing {
    /// Real and imaginary part of `s` times the conjugate of `c`, m^2.
    along: f64,
    across: f64,
    /// Product of the turns of both, and squares of the motions, m^2.
    turns: f64,
    squares: f64,
    /// Commanded way, m.
    way: f64,
}

impl Bearing {
    /// Takes motions of one slot, and the motion that was commanded in the slot before.
    pub(super) fn add(&mut self, seen: Moved, commanded: Moved, before: Moved) {
        let change = std::array::from_fn(|axis| commanded[axis] - before[axis]);
        if size(change) > STEADY * size(commanded) {
            return;
        }
        let ([east, north, turn], [to_east, to_north, to_turn]) = (seen, commanded);
        let way = to_east.hypot(to_north);
        let kept = (-way / MEMORY).exp();
        for (sum, more) in [
            (&mut self.along, east * to_east + north * to_north),
            (&mut self.across, north * to_east - east * to_north),
            (&mut self.turns, ARM * ARM * turn * to_turn),
            (&mut self.squares, size(seen).powi(2) + size(commanded).powi(2)),
            (&mut self.way, way),
        ] {
            *sum = kept * *sum + more;
        }
    }

    /// Returns by how many degrees the tracked body points to the left of the robot: as far as the seen course lies to the right of
    /// the commanded one. `None` where it is less than can be told, or does not explain how the robot moves.
    pub(super) fn turned(&self) -> Option<f64> {
        let degrees = -self.across.atan2(self.along).to_degrees();
        let explained = 2.0 * (self.along.hypot(self.across) + self.turns);
        let is_sure = self.way >= LEAST && explained >= (1.0 - UNEXPLAINED) * self.squares;
        (is_sure && degrees.abs() >= REPORTED).then_some(degrees)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What 20 slots of a walk ahead that turns show: seen at this angle to the left, degrees, with ways and turns of these sizes.
    fn turned(degrees: f64, way: f64, turn: f64) -> Option<f64> {
        let mut bearing = Bearing::default();
        for slot in 0..20 {
            let course = 0.1 * f64::from(slot);
            let (seen, commanded) = (course + degrees.to_radians(), [course.cos(), course.sin()]);
            let seen = [way * seen.cos(), way * seen.sin(), 0.1 * turn];
            let commanded = [0.02 * commanded[0], 0.02 * commanded[1], 0.1];
            bearing.add(seen, commanded, commanded);
        }
        bearing.turned()
    }

    #[test]
    fn an_angle_alone_is_told_from_17_degrees_on() {
        for degrees in [20.0, -20.0, 90.0, -150.0] {
            let found = turned(degrees, 0.02, 1.0).unwrap();
            assert!((found + degrees).abs() < 1e-9, "{found}");
        }
        assert_eq!(turned(16.0, 0.02, 1.0), None);
    }

    #[test]
    fn a_robot_whose_speed_or_turn_differs_too_is_not_judged() {
        assert_eq!(turned(30.0, 0.01, 1.0), None);
        assert_eq!(turned(30.0, 0.02, -1.0), None);
    }
}
