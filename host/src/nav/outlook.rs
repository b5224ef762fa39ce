//! What the way ahead costs from each place beside it and each heading.
//!
//! A robot may stand where every mode carries it the wrong way, and be free again once it has turned. A search of a few
//! seconds does not see that far; this does. The next metre of the path is a grid of places along it, errors beside it and
//! headings. From each of them one step of each mode leads to another, whose cost is known from the step before: value
//! iteration (R. Bellman, Dynamic Programming, 1957), with a discount so that it converges. It goes on with every decision,
//! as belief and robot move on.

use std::f64::consts::TAU;

use super::motion::{Motion, REST};
use super::path::Path;
use super::weights::Weights;
use crate::pose::geometry::wrap;

/// Distance between two places along the path, m, their number, and how many of them lie behind the robot.
const PLACE: f64 = 0.05;
const PLACES: usize = 24;
const BEHIND: i64 = 4;
/// Headings of the table.
const HEADINGS: usize = 24;
/// Errors of the table: finer near the path.
const ERRORS: usize = 17;
const MIDDLE: f64 = 8.0;
const FINEST: f64 = 0.03;
const GROWTH: f64 = 0.375;
/// Largest error of the table of errors, m, and its step.
const WIDEST: f64 = 2.0;
const FINE: f64 = 0.0005;
/// Turn that is worth as much as a way of one metre when modes are compared, rad.
const TURN: f64 = 10.0;
/// Directions in which modes are compared.
const DIRECTIONS: usize = 64;
/// Costs of a place.
const LAYER: usize = HEADINGS * ERRORS;
/// Time of a step, and how much of it is left once the rotors have changed, s.
const STEP: f64 = 0.6;
const WALKED: f64 = 0.45;
/// Time after which costs count for a third, s.
const HORIZON: f64 = 12.0;
/// Share of the risk of a mode that lasts: who walks in it learns.
const LASTING: f64 = 0.3;
/// Rounds of a thought: few, since nobody waits for more. The costs settle in some 60.
const ROUNDS: usize = 2;

/// The costs ahead; see the module's documentation.
#[derive(Debug, Clone)]
pub struct Outlook {
    /// Number of the first place, counted from the start of the path; none before the first thought.
    first: Option<i64>,
    /// By place, heading and error.
    costs: Vec<f32>,
    weights: Weights,
    /// By error, in steps of [`FINE`].
    table: Vec<Beside>,
}

/// An error: where it lies in the grid, and what it costs a second.
#[derive(Debug, Clone, Copy)]
struct Beside {
    index: usize,
    share: f32,
    rate: f32,
    /// What it costs to be beyond the grid: for a horizon.
    beyond: f32,
}

/// One step of a mode from a heading.
struct Step {
    /// World, m.
    x: f64,
    y: f64,
    /// Turn, rad.
    yaw: f64,
    /// Of the mode, m/s.
    spread: f64,
    /// The heading after it: index and share of the next.
    heading: usize,
    share: f32,
}

fn error_at(index: usize) -> f64 {
    FINEST * (GROWTH * (index as f64 - MIDDLE)).sinh()
}

/// Returns an angle's place among the headings: index and share of the next.
fn heading_of(heading: f64) -> (usize, f32) {
    let place = heading.rem_euclid(TAU) * HEADINGS as f64 / TAU;
    (place as usize % HEADINGS, place.fract() as f32)
}

impl Outlook {
    /// Makes an outlook that knows nothing yet.
    #[must_use]
    pub fn new(weights: Weights) -> Self {
        let edge = weights.robust(error_at(0));
        let table = (0..=(2.0 * WIDEST / FINE) as usize).map(|i| {
            let error = i as f64 * FINE - WIDEST;
            let place = MIDDLE + (error / FINEST).asinh() / GROWTH;
            let place = place.clamp(0.0, (ERRORS - 1) as f64 - 1e-6);
            let rate = weights.robust(error);
            Beside {
                index: place as usize,
                share: place.fract() as f32,
                rate: rate as f32,
                beyond: (HORIZON * (rate - edge).max(0.0)) as f32,
            }
        });
        let table = table.collect();
        Self { first: None, costs: vec![0.0; PLACES * LAYER], weights, table }
    }

    /// Returns the nearest error of the table.
    fn beside(&self, error: f64) -> Beside {
        let place = ((error + WIDEST) / FINE + 0.5) as usize;
        self.table[place.min(self.table.len() - 1)]
    }

    /// Works out some more of the table, for a robot that has come this far (arc length, m). `progress`: its weight; `usual`: speed
    /// that is reckoned with along a course.
    pub fn consider(
        &mut self,
        path: &Path,
        arc_length: f64,
        motions: &[Motion],
        progress: f64,
        usual: impl Fn(f64) -> f64,
    ) {
        self.weights.progress = progress;
        let first = (arc_length / PLACE).floor() as i64 - BEHIND;
        self.move_on(first);
        let steps: Vec<Vec<Step>> = (0..HEADINGS).map(|heading| steps(motions, heading)).collect();
        let tangents: Vec<f64> =
            (0..=PLACES).map(|p| path.at((first + p as i64) as f64 * PLACE).heading).collect();
        for _ in 0..ROUNDS {
            for place in (0..PLACES).rev() {
                let bend = wrap(tangents[place + 1] - tangents[place]) / PLACE;
                let usual = usual(tangents[place]);
                for (heading, steps) in steps.iter().enumerate() {
                    let best = self.best(place, tangents[place], bend, usual, steps);
                    let row = (place * HEADINGS + heading) * ERRORS;
                    self.costs[row..row + ERRORS].copy_from_slice(&best);
                }
            }
        }
    }

    /// Returns the least cost at each error of a place, by these steps.
    fn best(
        &self,
        place: usize,
        tangent: f64,
        bend: f64,
        usual: f64,
        steps: &[Step],
    ) -> [f32; ERRORS] {
        let discount = (-STEP / HORIZON).exp() as f32;
        let (sin, cos) = tangent.sin_cos();
        let errors: [f64; ERRORS] = std::array::from_fn(error_at);
        let stretch = errors.map(|error| 1.0 / (1.0 - bend * error).clamp(0.5, 2.0));
        let now = errors.map(|error| self.beside(error).rate);
        let mut best = [f32::INFINITY; ERRORS];
        for step in steps {
            let along = step.x * cos + step.y * sin;
            let across = step.y * cos - step.x * sin;
            let risk = LASTING * self.weights.risk(step.spread);
            for (e, best) in best.iter_mut().enumerate() {
                let ahead = along * stretch[e];
                let after = self.beside(errors[e] + across);
                let reward = self.weights.progress * (ahead / (STEP * usual)).clamp(-2.0, 2.0);
                let cost = STEP as f32 * (0.5 * (now[e] + after.rate) - (reward - risk) as f32);
                let to = place as f64 + ahead / PLACE;
                *best = best.min(cost + discount * self.look(to, step.heading, step.share, after));
            }
        }
        best
    }

    /// Makes this place the first.
    fn move_on(&mut self, first: i64) {
        let on = self.first.map_or(i64::MAX, |before| first.saturating_sub(before));
        self.first = Some(first);
        let moved = on.unsigned_abs() as usize;
        // Elsewhere on the path all is new: what was thought is as good a beginning as any.
        if moved >= PLACES {
            return;
        }
        // New places cost as the nearest that is known.
        if on > 0 {
            self.costs.copy_within(moved * LAYER.., 0);
            for place in PLACES - moved..PLACES {
                self.costs.copy_within((place - 1) * LAYER..place * LAYER, place * LAYER);
            }
        } else {
            self.costs.copy_within(..(PLACES - moved) * LAYER, moved * LAYER);
            for place in (0..moved).rev() {
                self.costs.copy_within((place + 1) * LAYER..(place + 2) * LAYER, place * LAYER);
            }
        }
    }

    /// Returns a cost between those of the grid.
    fn look(&self, place: f64, heading: usize, share: f32, beside: Beside) -> f32 {
        let place = place.clamp(0.0, (PLACES - 1) as f64 - 1e-6);
        let (p, ps) = (place as usize, (place - place.floor()) as f32);
        let next = (heading + 1) % HEADINGS;
        let at = |p: usize, h: usize| {
            let row = (p * HEADINGS + h) * ERRORS + beside.index;
            self.costs[row] + beside.share * (self.costs[row + 1] - self.costs[row])
        };
        let of = |p: usize| at(p, heading) + share * (at(p, next) - at(p, heading));
        beside.beyond + of(p) + ps * (of(p + 1) - of(p))
    }

    /// Returns the cost of the way ahead from here, s.
    #[must_use]
    pub fn cost(&self, arc_length: f64, error: f64, heading: f64) -> f64 {
        let place = arc_length / PLACE - self.first.unwrap_or(0) as f64;
        let (heading, share) = heading_of(heading);
        f64::from(self.look(place, heading, share, self.beside(error)))
    }
}

/// Returns the steps from a heading that are the furthest in some direction of way and turn.
fn steps(motions: &[Motion], heading: usize) -> Vec<Step> {
    let from = heading as f64 * TAU / HEADINGS as f64;
    let all = motions[REST + 1..].iter().map(|motion| {
        let middle = from + 0.5 * WALKED * motion.at(from).yaw;
        let twist = motion.at(middle).scaled(WALKED);
        let (sin, cos) = middle.sin_cos();
        let (heading, share) = heading_of(from + twist.yaw);
        Step {
            x: cos * twist.forward - sin * twist.lateral,
            y: sin * twist.forward + cos * twist.lateral,
            yaw: twist.yaw,
            spread: motion.spread,
            heading,
            share,
        }
    });
    let all: Vec<Step> = all.collect();
    let mut furthest = vec![false; all.len()];
    for k in 0..DIRECTIONS {
        // Evenly over the sphere, along a spiral.
        let z = (2.0 * k as f64 + 1.0) / DIRECTIONS as f64 - 1.0;
        let (sin, cos) = (k as f64 * 2.399_963).sin_cos();
        let flat = (1.0 - z * z).sqrt();
        let far = |step: &Step| flat * (cos * step.x + sin * step.y) + z * step.yaw / TURN;
        let best = (0..all.len()).max_by(|a, b| far(&all[*a]).total_cmp(&far(&all[*b])));
        furthest[best.unwrap_or(0)] = true;
    }
    all.into_iter().zip(furthest).filter(|(_, furthest)| *furthest).map(|(step, _)| step).collect()
}

#[cfg(test)]
mod tests {
    use core::f64::consts::{FRAC_PI_2, PI};

    use super::*;
    use crate::pose::geometry::{Position, Twist};

    fn motion(forward: f64, yaw: f64) -> Motion {
        let twist = Twist { forward, lateral: 0.0, yaw };
        Motion { frequency: 30.0, direction: 0.0, twist, slide: [Twist::REST; 2], spread: 0.0 }
    }

    /// A robot that walks ahead and turns left or right on the spot.
    fn walker() -> Vec<Motion> {
        [(0.0, 0.0), (0.1, 0.0), (0.0, 1.0), (0.0, -1.0)].map(|(v, w)| motion(v, w)).to_vec()
    }

    fn line() -> Path {
        Path::through("line", &[Position::ORIGIN, Position::new(5.0, 0.0)], false).unwrap()
    }

    fn considered(motions: &[Motion], arc_length: f64) -> Outlook {
        let mut outlook = Outlook::new(Weights::LEARNED);
        for _ in 0..60 {
            outlook.consider(&line(), arc_length, motions, 2.0, |_| 0.1);
        }
        outlook
    }

    #[test]
    fn to_stand_wrong_costs_and_to_stand_far_away_costs_more() {
        let outlook = considered(&walker(), 1.0);
        let ahead = outlook.cost(1.0, 0.0, 0.0);
        let costs = [0.5, FRAC_PI_2, PI].map(|heading| outlook.cost(1.0, 0.0, heading));
        assert!(
            ahead < costs[0] && costs[0] < costs[1] && costs[1] < costs[2],
            "{ahead} {costs:?}"
        );
        let costs = [0.03, 0.1, 0.25, 0.6, 1.5].map(|error| outlook.cost(1.0, error, 0.0));
        assert!(ahead < costs[0] && costs.is_sorted(), "{ahead} {costs:?}");
        // Left of the path it is better to face right.
        assert!(outlook.cost(1.0, 0.1, -FRAC_PI_2) < outlook.cost(1.0, 0.1, FRAC_PI_2));
    }

    #[test]
    fn turns_that_carry_the_robot_away_cost() {
        let drifting = |turns: &[usize]| {
            let mut motions = walker();
            for turn in turns {
                motions[*turn].twist.forward = 0.1;
            }
            // Beside the path and facing away from it, it has to turn.
            considered(&motions, 1.0).cost(1.0, 0.1, FRAC_PI_2)
        };
        let [none, left, both] = [&[][..], &[2], &[2, 3]].map(drifting);
        assert!((left - none).abs() < 2.0, "it turns right then: {none} {left}");
        assert!(both > none + 5.0, "{none} {both}");
    }

    #[test]
    fn it_goes_on_with_the_robot_and_settles_elsewhere() {
        let mut walked = considered(&walker(), 1.0);
        for cm in 101..150 {
            walked.consider(&line(), f64::from(cm) * 0.01, &walker(), 2.0, |_| 0.1);
        }
        let anew = considered(&walker(), 1.49);
        for (error, heading) in [(0.0, 0.0), (0.1, 1.0), (-0.05, -2.0)] {
            let [a, b] = [&walked, &anew].map(|it| it.cost(1.5, error, heading));
            assert!((a - b).abs() < 0.5, "{a} {b}");
        }
        for _ in 0..30 {
            walked.consider(&line(), 4.0, &walker(), 2.0, |_| 0.1);
        }
        let there = considered(&walker(), 4.0);
        assert!((walked.cost(4.0, 0.1, 1.0) - there.cost(4.0, 0.1, 1.0)).abs() < 0.5);
    }

    #[test]
    fn what_is_not_known_costs() {
        let mut doubtful = walker();
        for motion in &mut doubtful {
            motion.spread = 0.03;
        }
        let [known, not] = [walker(), doubtful].map(|it| considered(&it, 1.0).cost(1.0, 0.0, 0.0));
        assert!(not > known + 1.0, "{known} {not}");
    }
}
