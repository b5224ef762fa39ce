//! What is believed of the robot at hand, from [`Experience`] and from how it has walked so far.
//!
//! Everything that the experience leaves open is one vector of unknowns: the slope along the floor's x and y, the factors
//! that all pairs share, and what each pair has of its own. Before the first step it has mean zero and the spreads of the
//! experience. A measured motion is nearly linear in it, so that each stretch of walking corrects all of it at once (an
//! extended Kalman filter of constants): who slides in one mode slides in the others.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::experience::{Experience, Walks, numbers};
use super::motion::{Motion, REST};
use crate::pose::geometry::Twist;

/// Unknowns of the slope, at the beginning of the vector.
const SLOPE: usize = 2;
/// Where the unknowns begin that last for a while only: what no pair and no slope explains, m/s, m/s, rad/s.
const PASSING: usize = SLOPE;
/// Where the factors begin.
const FACTORS: usize = PASSING + 3;
/// Spread of what passes, and the time in which it does, s.
const PASSING_SPREAD: Twist = Twist { forward: 0.015, lateral: 0.015, yaw: 0.15 };
const PASSING_TIME: f64 = 3.0;
/// Spread of a stretch in which the gait changes all the time, besides the noise.
const CHANGE_SPREAD: Twist = Twist { forward: 0.02, lateral: 0.02, yaw: 0.2 };
/// Growth of the variance of what a pair has of its own, as a share of the experience's a second: walks wander.
const WANDER: f64 = 0.01;
/// Share by which the variance of every motion grows while nothing is known of the slope: three times the spread. Who slides in
/// one mode slides in all, so that mistakes do not cancel: robots on 5 degrees walked off by 0.17 m before they knew.
const SLIDES: f64 = 8.0;
/// How many times the experience's spread a slope is from which on that share falls as slowly as what is not known of the slope;
/// on a level floor it falls as the square.
const STEEP: f64 = 2.0;

/// A belief about one robot; see the module's documentation.
#[derive(Debug, Clone)]
pub struct Belief {
    experience: Arc<Experience>,
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Belief {
    /// Believes what experience says.
    #[must_use]
    pub fn new(experience: Arc<Experience>) -> Self {
        let factors = experience.factors();
        let own = experience.walks().iter().flat_map(|walks| numbers(walks.own));
        let spreads: Vec<f64> = [experience.slope; SLOPE]
            .into_iter()
            .chain(numbers(PASSING_SPREAD))
            .chain((0..factors).map(|_| 1.0))
            .chain(own)
            .collect();
        let covariance = DMatrix::from_diagonal(&DVector::from_iterator(
            spreads.len(),
            spreads.iter().map(|s| s * s),
        ));
        Self { mean: DVector::zeros(spreads.len()), covariance, experience }
    }

    /// Takes the mean motion of a stretch of `seconds` with this mean heading (rad). `shares`: how much of it was in which
    /// mode, counted as in the list of motions, rest first.
    pub fn observe(
        &mut self,
        shares: &[(usize, f64)],
        heading: f64,
        measured: Twist,
        seconds: f64,
    ) {
        let experience = Arc::clone(&self.experience);
        let walked = shares.iter().filter(|(mode, share)| *mode != REST && *share > 0.0);
        let walked: Vec<(usize, &Walks, f64)> =
            walked.map(|(mode, share)| (mode - 1, &experience.walks()[mode - 1], *share)).collect();
        if walked.is_empty() {
            return;
        }
        self.pass(seconds);
        let lean = self.lean(heading);
        for axis in 0..3 {
            let of = |twist: Twist| numbers(twist)[axis];
            let (mut expected, mut noise) = (0.0, 0.0);
            let mut row: Vec<(usize, f64)> = Vec::new();
            for (pair, walks, share) in &walked {
                expected += share * of(walks.mean);
                noise += share * of(walks.noise).powi(2);
                row.extend(self.row(*pair, walks, *share, heading, axis));
                // A product of two unknowns, about what is believed of both: in the row it counts for each.
                for (k, factor) in walks.factors.iter().enumerate() {
                    let [ahead, left] = factor.slide.map(of);
                    let slides = ahead * lean[0] + left * lean[1];
                    expected -= share * slides * self.mean[FACTORS + k];
                }
                let own = FACTORS + experience.factors() + 3 * pair + axis;
                self.covariance[(own, own)] += WANDER * seconds * of(walks.own).powi(2);
            }
            row.push((PASSING + axis, 1.0));
            // A stretch in which the gait changes tells less.
            let steady = walked.iter().map(|(_, _, share)| share * share).sum::<f64>().min(1.0);
            noise *= experience.stretch / seconds;
            noise += (1.0 - steady) * of(CHANGE_SPREAD).powi(2);
            self.correct(&row, of(measured) - expected, noise);
        }
    }

    /// Returns the spread of the translation that is expected of a pair at this heading, m/s.
    fn spread(&self, pair: usize, walks: &Walks, heading: f64) -> f64 {
        let variance = |axis: usize| {
            let row = self.row(pair, walks, 1.0, heading, axis);
            let along = |(i, w): &(usize, f64)| {
                w * row.iter().map(|(j, v)| v * self.covariance[(*i, *j)]).sum::<f64>()
            };
            row.iter().map(along).sum::<f64>()
        };
        ((1.0 + self.doubt()) * (variance(0) + variance(1))).max(0.0).sqrt()
    }

    /// Returns the share by which the variance of every motion grows for what is not known of the slope.
    fn doubt(&self) -> f64 {
        let usual = self.experience.slope.powi(2);
        let unknown = (self.covariance[(0, 0)] + self.covariance[(1, 1)]) / (SLOPE as f64 * usual);
        let steep = (self.mean[0].powi(2) + self.mean[1].powi(2)) / (STEEP.powi(2) * usual);
        SLIDES * unknown * unknown.max(steep.min(1.0))
    }

    /// Returns what the motion of a pair along an axis depends on, for so much of it, linear about what is believed.
    fn row(
        &self,
        pair: usize,
        walks: &Walks,
        share: f64,
        heading: f64,
        axis: usize,
    ) -> Vec<(usize, f64)> {
        let of = |twist: Twist| numbers(twist)[axis];
        let (sin, cos) = heading.sin_cos();
        let [ahead, left] = self.slide(walks).map(of);
        let slope = [ahead * cos - left * sin, ahead * sin + left * cos];
        let lean = self.lean(heading);
        let factors = walks.factors.iter().map(|factor| {
            let [ahead, left] = factor.slide.map(of);
            of(factor.level) + ahead * lean[0] + left * lean[1]
        });
        let own = FACTORS + self.experience.factors() + 3 * pair + axis;
        let first = slope.into_iter().enumerate();
        let factors = factors.enumerate().map(|(k, weight)| (FACTORS + k, weight));
        let all = first.chain(factors).chain([(own, 1.0)]);
        all.map(|(index, weight)| (index, share * weight)).collect()
    }

    /// Returns the slope that is believed in, forward and to the left of a robot with this heading.
    fn lean(&self, heading: f64) -> [f64; 2] {
        let (sin, cos) = heading.sin_cos();
        [self.mean[0] * cos + self.mean[1] * sin, self.mean[1] * cos - self.mean[0] * sin]
    }

    /// Returns how this robot is believed to slide in a pair.
    fn slide(&self, walks: &Walks) -> [Twist; 2] {
        let factors = walks.factors.iter().enumerate();
        factors.fold(walks.slide, |[ahead, left], (k, factor)| {
            let of = |i: usize| factor.slide[i].scaled(self.mean[FACTORS + k]);
            [ahead.plus(of(0)), left.plus(of(1))]
        })
    }

    /// Lets time pass.
    fn pass(&mut self, seconds: f64) {
        let kept = (-seconds / PASSING_TIME).exp();
        for (axis, spread) in numbers(PASSING_SPREAD).into_iter().enumerate() {
            let index = PASSING + axis;
            self.mean[index] *= kept;
            self.covariance.row_mut(index).scale_mut(kept);
            self.covariance.column_mut(index).scale_mut(kept);
            self.covariance[(index, index)] += (1.0 - kept * kept) * spread.powi(2);
        }
    }

    /// Corrects by one number: the sum of unknowns by these weights, measured with noise of this variance.
    fn correct(&mut self, row: &[(usize, f64)], measured: f64, noise: f64) {
        let mut along = DVector::zeros(self.mean.len());
        for (index, weight) in row {
            along.axpy(*weight, &self.covariance.column(*index), 1.0);
        }
        let weigh = |values: &DVector<f64>| row.iter().map(|(i, w)| w * values[*i]).sum::<f64>();
        let variance = noise + weigh(&along);
        let surprise = measured - weigh(&self.mean);
        self.mean.axpy(surprise / variance, &along, 1.0);
        self.covariance.ger(-1.0 / variance, &along, &along, 1.0);
    }

    /// Writes the expected motions of this robot into the list of motions, rest first, with their spreads at this heading
    /// (rad).
    ///
    /// # Panics
    /// If the list is not that of the experience's table.
    pub fn write_motions(&self, heading: f64, motions: &mut [Motion]) {
        let factors = self.experience.factors();
        let (x, y) = (self.mean[0], self.mean[1]);
        for (pair, walks) in self.experience.walks().iter().enumerate() {
            let own = FACTORS + factors + 3 * pair;
            let mut twist = walks.mean.plus(Twist {
                forward: self.mean[own] + self.mean[PASSING],
                lateral: self.mean[own + 1] + self.mean[PASSING + 1],
                yaw: self.mean[own + 2] + self.mean[PASSING + 2],
            });
            for (k, factor) in walks.factors.iter().enumerate() {
                twist = twist.plus(factor.level.scaled(self.mean[FACTORS + k]));
            }
            let [ahead, left] = self.slide(walks);
            let motion = &mut motions[pair + 1];
            motion.twist = twist;
            motion.slide =
                [ahead.scaled(x).plus(left.scaled(y)), ahead.scaled(y).plus(left.scaled(-x))];
            motion.spread = self.spread(pair, walks, heading);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::experience::tests::quicker_and_slower;
    use super::super::motion::motions;
    use super::*;

    const FORWARD: usize = 1;
    const LEFT: usize = 3;

    /// What is believed after `stretches` of 0.3 s in a mode, of a robot that moves so at this heading.
    fn after(stretches: u32, mode: usize, moves: impl Fn(f64, Twist) -> Twist) -> Vec<Motion> {
        let experience = Arc::new(quicker_and_slower());
        let mut motions = motions(&experience.table());
        let known = motions[mode].twist;
        let mut belief = Belief::new(experience);
        for stretch in 0..stretches {
            let heading = 0.2 * f64::from(stretch);
            belief.observe(&[(mode, 1.0)], heading, moves(heading, known), 0.3);
        }
        belief.write_motions(0.0, &mut motions);
        motions
    }

    #[test]
    fn before_the_first_step_all_is_as_experience_says() {
        let before = after(0, FORWARD, |_, known| known);
        let known = motions(&quicker_and_slower().table());
        for (before, known) in before.iter().zip(&known) {
            assert_eq!((before.twist, before.slide), (known.twist, known.slide));
        }
        // 30 % of its speed, its own 0.01 m/s along and across, and a slope of 0.03; three times as much while that is not known.
        let usual = (0.3 * known[FORWARD].twist.speed()).hypot(0.01f64.hypot(0.01));
        let spread = before[FORWARD].spread;
        let expected = 3.0 * usual.hypot(0.03f64.hypot(0.4 * 0.03));
        assert!((spread - expected).abs() < 6e-3, "{spread}");
        let walked = after(30, FORWARD, |_, known| known);
        assert!(walked[FORWARD].spread < 0.5 * spread, "{}", walked[FORWARD].spread);
    }

    #[test]
    fn a_robot_that_walks_slower_is_expected_to_turn_slower() {
        let usual = motions(&quicker_and_slower().table())[LEFT].twist.yaw;
        let slower = after(30, FORWARD, |_, known| known.scaled(0.5));
        let share = slower[LEFT].twist.yaw / usual;
        assert!((0.45..0.7).contains(&share), "{share}");
    }

    #[test]
    fn a_slope_is_found_and_expected_in_every_mode() {
        // It falls towards x: a robot that faces there is faster by 0.05 m/s.
        let found = after(60, FORWARD, |heading, known| {
            known.plus(Twist {
                forward: 0.05 * heading.cos(),
                lateral: -0.02 * heading.sin(),
                yaw: 0.0,
            })
        });
        let usual = motions(&quicker_and_slower().table())[LEFT].twist;
        let downhill = found[LEFT].at(0.0).forward - usual.forward;
        let uphill = found[LEFT].at(core::f64::consts::PI).forward - usual.forward;
        assert!(
            (downhill - 0.05).abs() < 0.015 && (uphill + 0.05).abs() < 0.015,
            "{downhill} {uphill}"
        );
    }

    #[test]
    fn motions_on_a_steep_slope_are_doubted_longer() {
        // As many stretches on the level, and where it falls by 5 degrees towards x.
        let [level, steep] = [0.0, 0.087].map(|slope| {
            let moves = |heading: f64, known: Twist| {
                known.plus(Twist { forward: slope * heading.cos(), lateral: 0.0, yaw: 0.0 })
            };
            after(8, FORWARD, moves)[LEFT].spread
        });
        assert!(steep > 1.05 * level, "{steep} {level}");
    }

    #[test]
    fn what_no_pair_explains_passes() {
        let experience = Arc::new(quicker_and_slower());
        let mut belief = Belief::new(Arc::clone(&experience));
        let mut motions = motions(&experience.table());
        let known = motions[FORWARD].twist;
        let off = known.plus(Twist { forward: 0.02, lateral: 0.0, yaw: 0.0 });
        let mut last = 0.0;
        for stretch in 0..80 {
            belief.observe(&[(FORWARD, 1.0)], 0.3, if stretch < 10 { off } else { known }, 0.3);
            belief.write_motions(0.0, &mut motions);
            last = motions[FORWARD].at(0.3).forward - known.forward;
            assert!(stretch != 9 || last > 0.012, "{last}");
        }
        assert!(last.abs() < 0.004, "{last}");
    }
}
