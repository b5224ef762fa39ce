//! CMA-ES: evolution strategy with covariance matrix adaptation, for noisy functions of some tens of variables.
//!
//! After N. Hansen, *The CMA Evolution Strategy: A Tutorial* (arXiv 1604.00772), with its default constants:
//! rank-one and rank-mu updates of the covariance, cumulative step-size adaptation. Lower is better; only the
//! order of values matters.
//!
//! The paper searches with HEBO, a Bayesian optimisation (sections II-C and II-D), which spares evaluations by a model
//! of the function. Here an evaluation takes a tenth of a second and many run at once, while such a model takes seconds for
//! each suggestion: `sim-hil/docs/studies.md` compares both on one budget of evaluations.
//!
//! The search lives in the unit cube: a coordinate outside 0 .. 1 is mirrored back ([`inside`]). Candidates of
//! a generation depend on the seed and the generation alone, so that a search can be kept as TOML after any
//! generation and goes on the same way.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

/// The state of a search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cmaes {
    /// Middle of the distribution: the best estimate when values are noisy.
    mean: Vec<f64>,
    /// Step size.
    sigma: f64,
    /// Covariance, row by row.
    covariance: Vec<f64>,
    /// Evolution path of the covariance.
    path: Vec<f64>,
    /// Evolution path of the step size.
    step_path: Vec<f64>,
    /// Generations so far.
    generation: u64,
    /// Candidates a generation.
    population: usize,
    seed: u64,
}

/// Constants of the method for a number of variables.
struct Constants {
    weights: Vec<f64>,
    /// Variance-effective number of parents.
    effective: f64,
    step_rate: f64,
    step_damping: f64,
    path_rate: f64,
    rank_one: f64,
    rank_mu: f64,
    /// Expected length of a standard normal vector.
    length: f64,
}

impl Constants {
    fn new(variables: usize, population: usize) -> Self {
        let n = variables as f64;
        let parents = population / 2;
        let raw: Vec<f64> =
            (0..parents).map(|i| (parents as f64 + 0.5).ln() - (i as f64 + 1.0).ln()).collect();
        let sum: f64 = raw.iter().sum();
        let weights: Vec<f64> = raw.iter().map(|w| w / sum).collect();
        let effective = 1.0 / weights.iter().map(|w| w * w).sum::<f64>();
        let step_rate = (effective + 2.0) / (n + effective + 5.0);
        let rank_one = 2.0 / ((n + 1.3).powi(2) + effective);
        let rank_mu =
            2.0 * (0.25 + effective + 1.0 / effective - 2.0) / ((n + 2.0).powi(2) + effective);
        Self {
            step_rate,
            step_damping: 1.0
                + 2.0 * (((effective - 1.0) / (n + 1.0)).sqrt() - 1.0).max(0.0)
                + step_rate,
            path_rate: (4.0 + effective / n) / (n + 4.0 + 2.0 * effective / n),
            rank_one,
            rank_mu: rank_mu.min(1.0 - rank_one),
            length: n.sqrt() * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n)),
            weights,
            effective,
        }
    }
}

/// Returns the usual number of candidates a generation.
#[must_use]
pub fn usual_population(variables: usize) -> usize {
    4 + (3.0 * (variables as f64).ln()).floor() as usize
}

/// Mirrors at the walls of the unit cube what is outside of it.
#[must_use]
pub fn inside(point: &[f64]) -> Vec<f64> {
    point
        .iter()
        .map(|x| {
            let x = x.rem_euclid(2.0);
            if x > 1.0 { 2.0 - x } else { x }
        })
        .collect()
}

impl Cmaes {
    /// Creates a search that begins at `start` with steps of `sigma` and tries `population` candidates a generation
    /// ([`usual_population`]; more where values are noisy or have many valleys).
    ///
    /// # Panics
    /// When `start` is empty or the population is below 4.
    #[must_use]
    pub fn new(start: &[f64], sigma: f64, seed: u64, population: usize) -> Self {
        let variables = start.len();
        assert!(variables > 0, "a search has at least one variable");
        assert!(population >= 4, "a generation has at least four candidates");
        Self {
            mean: start.to_vec(),
            sigma,
            covariance: DMatrix::<f64>::identity(variables, variables).as_slice().to_vec(),
            path: vec![0.0; variables],
            step_path: vec![0.0; variables],
            generation: 0,
            population,
            seed,
        }
    }

    /// Returns the middle of the distribution, inside the unit cube.
    #[must_use]
    pub fn mean(&self) -> Vec<f64> {
        inside(&self.mean)
    }

    /// Returns the step size, as a share of the ranges.
    #[must_use]
    pub const fn sigma(&self) -> f64 {
        self.sigma
    }

    /// Generations so far.
    #[must_use]
    pub const fn generation(&self) -> u64 {
        self.generation
    }

    /// Axes of the distribution: directions as columns, and the standard deviation along each.
    fn axes(&self) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.mean.len();
        let eigen = SymmetricEigen::new(DMatrix::from_column_slice(n, n, &self.covariance));
        (eigen.eigenvectors, eigen.eigenvalues.map(|value| value.max(1e-20).sqrt()))
    }

    /// Points of this generation, not mirrored: the same until [`Cmaes::update`].
    #[must_use]
    pub fn ask(&self) -> Vec<Vec<f64>> {
        let n = self.mean.len();
        let (directions, deviations) = self.axes();
        let mut random = Xoshiro256PlusPlus::seed_from_u64(
            self.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(self.generation),
        );
        (0..self.population)
            .map(|_| {
                let normal: DVector<f64> =
                    DVector::from_fn(n, |_, _| StandardNormal.sample(&mut random));
                let step = &directions * normal.component_mul(&deviations);
                self.mean.iter().zip(step.iter()).map(|(m, s)| m + self.sigma * s).collect()
            })
            .collect()
    }

    /// Moves on with the values of the points of [`Cmaes::ask`], in order. What is not a number counts as the
    /// worst.
    pub fn update(&mut self, points: &[Vec<f64>], values: &[f64]) {
        let n = self.mean.len();
        let c = Constants::new(n, self.population);
        let mut order: Vec<usize> = (0..points.len().min(values.len())).collect();
        let value = |i: usize| if values[i].is_nan() { f64::INFINITY } else { values[i] };
        order.sort_by(|a, b| value(*a).total_cmp(&value(*b)));

        let old = DVector::from_column_slice(&self.mean);
        let steps: Vec<DVector<f64>> = order
            .iter()
            .take(c.weights.len())
            .map(|&i| (DVector::from_column_slice(&points[i]) - &old) / self.sigma)
            .collect();
        let mean_step = steps
            .iter()
            .zip(&c.weights)
            .fold(DVector::zeros(n), |sum, (step, weight)| sum + step * *weight);

        let (directions, deviations) = self.axes();
        let whitened =
            &directions * (directions.transpose() * &mean_step).component_div(&deviations);
        let step_path = DVector::from_column_slice(&self.step_path) * (1.0 - c.step_rate)
            + whitened * (c.step_rate * (2.0 - c.step_rate) * c.effective).sqrt();
        let age = 1.0 - (1.0 - c.step_rate).powf(2.0 * (self.generation as f64 + 1.0));
        let stalled = step_path.norm() / age.sqrt() < (1.4 + 2.0 / (n as f64 + 1.0)) * c.length;
        let pull = if stalled { 1.0 } else { 0.0 };
        let path = DVector::from_column_slice(&self.path) * (1.0 - c.path_rate)
            + &mean_step * (pull * (c.path_rate * (2.0 - c.path_rate) * c.effective).sqrt());

        let kept = 1.0 - c.rank_one - c.rank_mu
            + (1.0 - pull) * c.rank_one * c.path_rate * (2.0 - c.path_rate);
        let mut covariance = DMatrix::from_column_slice(n, n, &self.covariance) * kept
            + &path * path.transpose() * c.rank_one;
        for (step, weight) in steps.iter().zip(&c.weights) {
            covariance += step * step.transpose() * (c.rank_mu * weight);
        }
        self.mean = (old + mean_step * self.sigma).as_slice().to_vec();
        self.sigma *= ((c.step_rate / c.step_damping) * (step_path.norm() / c.length - 1.0)).exp();
        self.covariance = covariance.as_slice().to_vec();
        self.path = path.as_slice().to_vec();
        self.step_path = step_path.as_slice().to_vec();
        self.generation += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Minimises and returns the distance of the mean from `goal`.
    fn search(generations: u64, goal: &[f64], value: impl Fn(&[f64], u64) -> f64) -> f64 {
        let mut search = Cmaes::new(&vec![0.5; goal.len()], 0.2, 7, usual_population(goal.len()));
        for generation in 0..generations {
            let points = search.ask();
            let values: Vec<f64> = points.iter().map(|p| value(p, generation)).collect();
            search.update(&points, &values);
        }
        search.mean().iter().zip(goal).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    }

    #[test]
    fn finds_the_end_of_a_long_bent_valley() {
        // Rosenbrock's function, minimum where all are 1, scaled into the cube.
        let off = search(400, &[0.75; 6], |p, _| {
            let x: Vec<f64> = p.iter().map(|v| 4.0 * v - 2.0).collect();
            x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum()
        });
        assert!(off < 1e-4, "{off}");
    }

    #[test]
    fn finds_the_middle_of_an_ill_conditioned_bowl() {
        let goal = [0.2, 0.4, 0.6, 0.8];
        let off = search(300, &goal, |p, _| {
            (0..4).map(|i| 10f64.powi(2 * i as i32) * (p[i] - goal[i]).powi(2)).sum()
        });
        assert!(off < 1e-6, "{off}");
    }

    #[test]
    fn goes_on_from_a_file_with_the_same_bits() {
        let advance = |search: &mut Cmaes| {
            let points = search.ask();
            let values: Vec<f64> = points.iter().map(|p| p.iter().map(|x| x * x).sum()).collect();
            search.update(&points, &values);
        };
        let mut whole = Cmaes::new(&[0.3, 0.9, 0.1], 0.1, 1, 7);
        advance(&mut whole);
        let mut resumed: Cmaes = toml::from_str(&toml::to_string(&whole).unwrap()).unwrap();
        advance(&mut whole);
        advance(&mut resumed);
        assert_eq!(whole, resumed);
    }

    #[test]
    fn mirrors_at_the_walls() {
        let back = inside(&[-0.25, 1.5, 0.5, 2.25]);
        assert_eq!(back, [0.25, 0.5, 0.5, 0.25]);
    }
}
