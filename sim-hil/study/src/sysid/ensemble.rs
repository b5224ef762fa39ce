//! What an experiment on the floor says about a robot, without derivatives: contact has none that help.
//!
//! Robots are drawn from what is known, each does the experiment in its own disturbed start with its own noise, and
//! each unknown is regressed on what was seen: the ensemble's Kalman update. Readings are taken together into principal
//! components. A correlation counts only if chance would give one such among all that are looked at in one case of
//! twenty: a small ensemble finds others everywhere, and would narrow intervals for nothing.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::fit::Posterior;
use super::unknowns::{Unknown, apply};
use flix_sim::model::RobotModel;

/// Components below this share of the largest are rounding.
const NOTHING: f64 = 1e-9;
/// Chance of taking one correlation for real that is none.
const CHANCE: f64 = 0.05;
/// What was measured counts as no further from the ensemble's middle than this many standard deviations.
const FARTHEST: f64 = 3.0;

/// Robots drawn from what is known, and what each was seen to do.
pub struct Ensemble<'a> {
    prior: &'a Posterior,
    drawn: Vec<(DVector<f64>, Vec<f64>)>,
}

impl<'a> Ensemble<'a> {
    /// Draws `members` robots and lets each do the experiment. `simulate` gets a model and a seed; what cannot be simulated
    /// is left out.
    pub fn draw(
        prior: &'a Posterior,
        (base, unknowns): (&RobotModel, &[Unknown]),
        members: usize,
        seed: u64,
        mut simulate: impl FnMut(&RobotModel, u64) -> Option<Vec<f64>>,
    ) -> Self {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let count = unknowns.len();
        let own = prior.covariance.view((0, 0), (count, count)).into_owned();
        let mut drawn = Vec::with_capacity(members);
        if let Some(factor) = own.cholesky() {
            for member in 0..members as u64 {
                let normal = DVector::from_fn(count, |_, _| StandardNormal.sample(&mut random));
                let point = prior.mean.rows(0, count) + factor.l() * normal;
                let model = apply(base, unknowns, point.as_slice());
                let own_seed = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (member + 1);
                if let Some(seen) = simulate(&model, own_seed) {
                    drawn.push((point, seen));
                }
            }
        }
        Self { prior, drawn }
    }

    /// Returns what is known once these readings were measured, and how far they are from the ensemble, in standard
    /// deviations of its components (root mean square; about 1 where the experiment fits). Readings that are `None` are not
    /// looked at.
    pub fn update(&self, measured: &[Option<f64>]) -> (Posterior, f64) {
        let prior = self.prior;
        let Some(components) = Components::of(&self.drawn, measured) else {
            return (prior.clone(), f64::NAN);
        };
        let count = self.drawn[0].0.len();
        let mut next = prior.clone();
        let tests = (components.scores.ncols() * count) as f64;
        let least = least_correlation(CHANCE / tests, self.drawn.len());
        let mut shrunk = DVector::from_element(next.mean.len(), 1.0);
        for unknown in 0..count {
            let values = self.drawn.iter().map(|(point, _)| point[unknown]);
            let values = DVector::from_iterator(self.drawn.len(), values);
            let (shift, share) = components.regress(&values, least);
            next.mean[unknown] += shift * prior.deviation(unknown);
            shrunk[unknown] = share.sqrt();
        }
        let scale = DMatrix::from_diagonal(&shrunk);
        next.covariance = &scale * &next.covariance * &scale;
        (next, components.distance())
    }
}

/// Smallest correlation of so many pairs that chance gives with less than this probability.
fn least_correlation(probability: f64, pairs: usize) -> f64 {
    // Fisher: atanh r is normal with the variance 1/(n - 3); the tail of a normal by its asymptote.
    let mut z: f64 = 3.0;
    for _ in 0..50 {
        let tail = 2.0 / (z * core::f64::consts::TAU.sqrt());
        z = (2.0 * (tail / probability).ln()).max(1.0).sqrt();
    }
    (z / (pairs.max(4) as f64 - 3.0).sqrt()).tanh()
}

/// Readings of an ensemble, as uncorrelated components of unit variance.
struct Components {
    /// A row for each member.
    scores: DMatrix<f64>,
    measured: DVector<f64>,
}

impl Components {
    fn of(drawn: &[(DVector<f64>, Vec<f64>)], measured: &[Option<f64>]) -> Option<Self> {
        let (columns, given): (Vec<usize>, Vec<f64>) =
            measured.iter().enumerate().filter_map(|(i, it)| it.map(|it| (i, it))).unzip();
        let rows = drawn.len();
        if rows < 8 || columns.is_empty() {
            return None;
        }
        let mut all = DMatrix::from_fn(rows, columns.len(), |i, j| drawn[i].1[columns[j]]);
        let mut given = DVector::from_vec(given);
        for (column, given) in given.iter_mut().enumerate() {
            let mut values = all.column_mut(column);
            let mean = values.mean();
            values.add_scalar_mut(-mean);
            let deviation = (values.norm_squared() / (rows - 1) as f64).sqrt();
            let deviation = deviation.max(f64::MIN_POSITIVE);
            values /= deviation;
            *given = (*given - mean) / deviation;
        }
        // No more components than an ensemble of this size can hold apart.
        let svd = all.svd(true, true);
        let (u, v) = (svd.u?, svd.v_t?);
        let largest = svd.singular_values.max();
        let mut order: Vec<usize> = (0..svd.singular_values.len())
            .filter(|i| svd.singular_values[*i] > NOTHING * largest)
            .collect();
        order.sort_by(|a, b| svd.singular_values[*b].total_cmp(&svd.singular_values[*a]));
        order.truncate(rows / 4);
        let unit = ((rows - 1) as f64).sqrt();
        let scores = DMatrix::from_fn(rows, order.len(), |i, k| unit * u[(i, order[k])]);
        let measured = DVector::from_fn(order.len(), |k, _| {
            unit * v.row(order[k]).transpose().dot(&given) / svd.singular_values[order[k]]
        });
        Some(Self { scores, measured })
    }

    /// How far an unknown moves, in its own standard deviations, and what is left of its variance.
    fn regress(&self, values: &DVector<f64>, least: f64) -> (f64, f64) {
        let rows = values.len() as f64;
        let centred = values.add_scalar(-values.mean());
        let deviation = (centred.norm_squared() / (rows - 1.0)).sqrt().max(f64::MIN_POSITIVE);
        let (mut shift, mut explained, mut used, mut leverage) = (0.0, 0.0, 0.0, 1.0 / rows);
        for (score, measured) in self.scores.column_iter().zip(self.measured.iter()) {
            let correlation = score.dot(&centred) / (rows - 1.0) / deviation;
            if correlation.abs() > least {
                let there = measured.clamp(-FARTHEST, FARTHEST);
                shift += correlation * there;
                explained += correlation * correlation;
                leverage += there * there / (rows - 1.0);
                used += 1.0;
            }
        }
        if used == 0.0 {
            return (0.0, 1.0);
        }
        let left = (1.0 - explained).max(0.0) * (rows - 1.0) / (rows - 1.0 - used);
        (shift, (left * (1.0 + leverage)).clamp(1e-6, 1.0))
    }

    fn distance(&self) -> f64 {
        (self.measured.norm_squared() / self.measured.len().max(1) as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sysid::unknowns::unknowns;

    /// A robot that shows one of its values, in noise, among readings that show nothing.
    fn seen(model: &RobotModel, seed: u64, noise: f64) -> Vec<f64> {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        vec![1e-3 * model.contact.stiffness_n_per_m + noise * normal(), normal(), normal()]
    }

    #[test]
    fn an_unknown_that_shows_is_found_and_all_others_stay_as_they_were() {
        let (base, unknowns) = unknowns(&RobotModel::named("W").unwrap());
        let prior = Posterior::prior(unknowns.len());
        let truth = 1e-3 * base.contact.stiffness_n_per_m * 1.1;
        let (next, distance) = Ensemble::draw(&prior, (&base, &unknowns), 64, 1, |model, seed| {
            Some(seen(model, seed, 0.05))
        })
        .update(&[Some(truth), Some(0.1), Some(-0.2)]);
        let shows = unknowns.iter().position(|u| u.name == "floor_stiffness_n_per_m").unwrap();
        let off = 1e-3 * unknowns[shows].value(next.mean[shows]) - truth;
        // Of its spread less than half is left, not a tenth as its noise would allow: correlations that chance could give in
        // an ensemble of this size do not count.
        let left = next.deviation(shows);
        assert!(off.abs() < 0.15 && left < 0.5, "{off} {left}");
        let others = (0..unknowns.len()).filter(|i| *i != shows);
        assert!(others.clone().all(|i| next.mean[i] == 0.0 && next.deviation(i) == 1.0));
        assert!(distance < 2.0);
    }

    #[test]
    fn what_was_not_measured_changes_nothing() {
        let (base, unknowns) = unknowns(&RobotModel::named("W").unwrap());
        let prior = Posterior::prior(unknowns.len());
        let ensemble = Ensemble::draw(&prior, (&base, &unknowns), 64, 1, |model, seed| {
            Some(seen(model, seed, 0.05))
        });
        let (next, _) = ensemble.update(&[None, Some(0.1), Some(-0.2)]);
        assert_eq!(next.mean, prior.mean);
    }

    #[test]
    fn a_correlation_has_to_be_larger_the_more_are_looked_at() {
        let few = least_correlation(0.05, 50);
        assert!((few - 0.28).abs() < 0.04, "{few}");
        assert!(least_correlation(0.05 / 500.0, 50) > 0.5);
    }
}
