//! How fast a robot can go on in each direction, and how long it takes to face so that it can.
//!
//! At one heading a robot goes on by modes whose turns cancel. The mean velocities that it reaches so are the mixtures of
//! two modes that turn in opposite directions, and what lies between such mixtures: their convex hull. Its edge in a
//! direction is the fastest pace there. On a slope it depends on the heading: a robot may climb better sideways.

use std::f64::consts::TAU;

use super::motion::{Motion, REST};
use crate::pose::geometry::wrap;

/// Headings and directions of the table.
const SECTORS: usize = 24;
/// Swing of the heading between the modes of a mixture, rad.
const SWING: f64 = 0.4;
/// Time lost by a change of mode within one sense of rotation, and between both, s: a reversal passes through rest.
const SAME_SENSE: f64 = 0.1;
const BOTH_SENSES: f64 = 0.3;
/// Modes that turn slower than this do not swing, rad/s.
const STRAIGHT: f64 = 0.02;
/// Slowest pace that is reckoned with, m/s.
const SLOWEST: f64 = 0.01;
/// Slowest turn that is reckoned with, rad/s.
const SLOWEST_TURN: f64 = 0.1;
/// Way for which it pays to turn first, m.
const WAY: f64 = 0.2;

/// The paces of a robot; see the module's documentation.
#[derive(Debug, Clone, PartialEq)]
pub struct Pace {
    /// By course: the fastest, m/s.
    best: [f64; SECTORS],
    /// By heading and course: seconds lost by not facing as for the fastest.
    loss: [[f64; SECTORS]; SECTORS],
}

fn angle(sector: usize) -> f64 {
    sector as f64 * TAU / SECTORS as f64
}

/// Returns the two nearest sectors and the share of the second.
fn between(angle: f64) -> (usize, usize, f64) {
    let place = angle.rem_euclid(TAU) * SECTORS as f64 / TAU;
    let first = place as usize % SECTORS;
    (first, (first + 1) % SECTORS, place.fract())
}

impl Pace {
    /// Works the paces out from the motions of all modes, rest first.
    #[must_use]
    pub fn new(motions: &[Motion]) -> Self {
        let fastest: [[f64; SECTORS]; SECTORS] =
            std::array::from_fn(|heading| fastest(&mixtures(motions, angle(heading))));
        let turn = motions.iter().map(|m| m.twist.yaw.abs()).fold(SLOWEST_TURN, f64::max);
        let mut loss = [[0.0; SECTORS]; SECTORS];
        let mut best = [SLOWEST; SECTORS];
        for course in 0..SECTORS {
            let seconds = |heading: usize| WAY / fastest[heading][course].max(SLOWEST);
            let wait: [f64; SECTORS] = std::array::from_fn(|heading| {
                let turned = |other: usize| wrap(angle(other) - angle(heading)).abs() / turn;
                let times = (0..SECTORS).map(|other| turned(other) + seconds(other));
                times.fold(f64::INFINITY, f64::min)
            });
            let least = wait.iter().copied().fold(f64::INFINITY, f64::min);
            for heading in 0..SECTORS {
                loss[heading][course] = wait[heading] - least;
                best[course] = best[course].max(fastest[heading][course]);
            }
        }
        Self { best, loss }
    }

    /// Returns the fastest pace along a course (rad), m/s.
    #[must_use]
    pub fn best(&self, course: f64) -> f64 {
        let (a, b, share) = between(course);
        self.best[a] + share * (self.best[b] - self.best[a])
    }

    /// Returns the seconds that a robot with this heading loses on this course (rad).
    #[must_use]
    pub fn loss(&self, heading: f64, course: f64) -> f64 {
        let (a, b, share) = between(course);
        let (h, i, part) = between(heading);
        let at = |heading: usize| {
            let row = &self.loss[heading];
            row[a] + share * (row[b] - row[a])
        };
        at(h) + part * (at(i) - at(h))
    }
}

/// Returns the mean velocities (world, m/s) of all mixtures of two modes whose turns cancel at this heading.
fn mixtures(motions: &[Motion], heading: f64) -> Vec<[f64; 2]> {
    let (sin, cos) = heading.sin_cos();
    let modes: Vec<_> = motions[REST + 1..]
        .iter()
        .map(|motion| {
            let twist = motion.at(heading);
            let x = cos * twist.forward - sin * twist.lateral;
            let y = sin * twist.forward + cos * twist.lateral;
            ([x, y], twist.yaw, motion.frequency)
        })
        .collect();
    let mut points = vec![[0.0; 2]];
    for (left, turn, f) in modes.iter().filter(|(_, yaw, _)| *yaw >= 0.0) {
        for (right, back, g) in modes.iter().filter(|(_, yaw, _)| *yaw < 0.0) {
            let share = -back / (turn - back);
            let lost = if f * g > 0.0 { SAME_SENSE } else { BOTH_SENSES };
            let swing = SWING * (1.0 / turn.max(STRAIGHT) - 1.0 / back);
            let kept = swing / (swing + 2.0 * lost);
            points.push([0, 1].map(|i| kept * (share * left[i] + (1.0 - share) * right[i])));
        }
    }
    points
}

/// Returns how far the convex hull of these points and the origin reaches in each direction.
fn fastest(points: &[[f64; 2]]) -> [f64; SECTORS] {
    let hull = hull(points.to_vec());
    std::array::from_fn(|sector| {
        let (sin, cos) = angle(sector).sin_cos();
        let seen = |p: &[f64; 2]| [cos * p[0] + sin * p[1], cos * p[1] - sin * p[0]];
        let edges = hull.iter().zip(hull.iter().cycle().skip(1));
        edges.fold(0.0, |far, (from, to)| {
            let ([a, across], [b, beyond]) = (seen(from), seen(to));
            // An edge that leads from one side of the direction to the other cuts it.
            if across * beyond > 0.0 || across == beyond {
                return f64::max(far, if across == 0.0 { a.max(b) } else { far });
            }
            f64::max(far, a + (b - a) * across / (across - beyond))
        })
    })
}

/// Returns the corners of the convex hull in order (A. M. Andrew's monotone chain).
fn hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let left = |a: &[f64; 2], b: &[f64; 2], c: &[f64; 2]| {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0
    };
    let chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for point in points {
            while chain.len() > 1 && !left(&chain[chain.len() - 2], &chain[chain.len() - 1], &point)
            {
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut corners = chain(&mut points.iter().copied());
    corners.extend(chain(&mut points.iter().rev().copied()));
    corners
}

#[cfg(test)]
mod tests {
    use core::f64::consts::PI;

    use super::*;
    use crate::pose::geometry::Twist;

    const STILL: Twist = Twist::REST;

    fn motion(frequency: f64, forward: f64, lateral: f64, yaw: f64) -> Motion {
        let twist = Twist { forward, lateral, yaw };
        Motion { frequency, direction: 0.0, twist, slide: [STILL; 2], spread: 0.0 }
    }

    /// Walks ahead at 0.1 m/s in two slow turns that cancel, and strafes at 0.02 m/s either way.
    fn walker() -> Vec<Motion> {
        let rest = motion(0.0, 0.0, 0.0, 0.0);
        let strafes =
            [0.02, -0.02].map(|left| [motion(30.0, 0.0, left, 0.1), motion(30.0, 0.0, left, -0.1)]);
        let ahead = [motion(30.0, 0.1, 0.0, 0.1), motion(30.0, 0.1, 0.0, -0.1)];
        std::iter::once(rest).chain(ahead).chain(strafes.into_iter().flatten()).collect()
    }

    #[test]
    fn the_pace_is_that_of_the_fastest_mixture_whose_turns_cancel() {
        let pace = Pace::new(&walker());
        for course in [0.0, 1.0, 3.0, -2.0] {
            let best = pace.best(course);
            assert!((0.09..=0.1).contains(&best), "{course}: {best}");
        }
        let turning = Pace::new(&walker()[..2]);
        assert_eq!(turning.best(0.0), SLOWEST, "a robot that only turns left goes nowhere");
    }

    #[test]
    fn facing_away_costs_the_turn_or_the_slower_walk() {
        let mut motions = walker();
        motions.push(motion(30.0, 0.0, 0.0, 2.0));
        let pace = Pace::new(&motions);
        assert!(pace.loss(0.5, 0.5) < 0.05);
        let back = pace.loss(PI, 0.0);
        assert!((back - PI / 2.0).abs() < 0.1, "half a turn at 2 rad/s: {back}");
        assert!(pace.loss(0.5, 0.0) < pace.loss(1.0, 0.0));
    }

    #[test]
    fn on_a_slope_downhill_is_fast_and_uphill_slow() {
        let mut motions = walker();
        // Falls towards x.
        for motion in &mut motions[1..] {
            motion.slide = [
                Twist { forward: 0.05, lateral: 0.0, yaw: 0.0 },
                Twist { forward: 0.0, lateral: -0.05, yaw: 0.0 },
            ];
        }
        let pace = Pace::new(&motions);
        assert!((pace.best(0.0) - 0.15).abs() < 0.01, "{}", pace.best(0.0));
        assert!((pace.best(PI) - 0.05).abs() < 0.01, "{}", pace.best(PI));
    }
}
