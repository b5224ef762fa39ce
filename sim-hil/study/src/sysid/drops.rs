//! The robot dropped onto its feet: stiffness and damping of the floor.
//!
//! The file is the height of the body's middle over the floor from the release on, a drop after another. What counts is
//! how far it sinks and springs back after the feet have touched.

use super::ensemble::Ensemble;
use super::fit::Posterior;
use super::table::{Column, Table};
use super::unknowns::Unknown;
use flix_sim::model::{GRAVITY, RobotModel};
use flix_sim::plant::{Mechanics, Plant};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

/// What the file is made of.
pub const TABLE: Table<4> = Table {
    name: "drops",
    columns: [
        Column::new("drop", 1.0, 1e4),
        Column::new("height_mm", 2.0, 100.0),
        Column::new("t_s", 0.0, 10.0),
        Column::new("z_mm", -100.0, 1000.0),
    ],
    fewest: 30,
};

/// Height of the soles over the floor at the release in the usual drop, mm, and how often it is repeated.
pub const USUAL: (f64, usize) = (flix_host::experiment::drops::HEIGHT, 5);

/// Width of the intervals over which heights are averaged, s, and how many there are from the touch on.
const INTERVAL: f64 = 4e-3;
const INTERVALS: usize = 25;
/// Robots drawn.
const MEMBERS: usize = 64;
/// Step of the simulation, s.
pub const STEP: f64 = 1e-4;

/// Drops from one height.
#[derive(Debug, Clone)]
pub struct Drops {
    height_mm: f64,
    /// Mean height in each interval, less that at the release, mm.
    measured: Vec<f64>,
    /// Standard deviation of each mean from the noise of the cameras, mm.
    noise: f64,
}

impl Drops {
    /// Takes the rows of a file: the drops from the height that most samples are of.
    ///
    /// # Errors
    /// With what is missing, as a sentence.
    pub fn new(rows: &[[f64; 4]]) -> Result<Self, String> {
        let count = |height: f64| rows.iter().filter(|row| row[1] == height).count();
        let most = rows.iter().map(|row| row[1]).max_by_key(|height| count(*height));
        let height_mm = most.ok_or("no rows of numbers")?;
        let (mut sums, mut left) = (vec![(0.0, 0.0); INTERVALS], Vec::new());
        let end = touch(height_mm) + INTERVAL * INTERVALS as f64;
        for drop in rows.chunk_by(|a, b| a[0] == b[0]).filter(|drop| drop[0][1] == height_mm) {
            let samples: Vec<(f64, f64)> = drop.iter().map(|row| (row[2], row[3])).collect();
            for (sum, mean) in sums.iter_mut().zip(means(&samples, height_mm)) {
                let (mean, count) = mean.ok_or_else(|| {
                    format!(
                        "drop {} lacks samples: record each from its release (t_s = 0) to {end:.2} s, at {} Hz or faster",
                        drop[0][0],
                        2.0 / INTERVAL
                    )
                })?;
                *sum = (sum.0 + mean, sum.1 + count);
            }
            // What the fall leaves over before the soles touch is the cameras' noise.
            let falling = samples.iter().take_while(|(t, _)| *t < 0.9 * touch(height_mm));
            let over: Vec<f64> = falling.map(|(t, z)| z + 500.0 * GRAVITY * t * t).collect();
            let middle = over.iter().sum::<f64>() / over.len().max(1) as f64;
            left.extend(over.iter().map(|z| (z - middle).powi(2)));
        }
        let drops = rows.chunk_by(|a, b| a[0] == b[0]).filter(|d| d[0][1] == height_mm).count();
        let square = left.iter().sum::<f64>() / left.len().max(1) as f64;
        Ok(Self {
            height_mm,
            measured: sums.iter().map(|(sum, _)| sum / drops as f64).collect(),
            noise: (square / sums[0].1).sqrt(),
        })
    }

    /// Plans drops that nobody has made yet.
    #[must_use]
    pub fn planned() -> Self {
        Self { height_mm: USUAL.0, measured: vec![0.0; INTERVALS], noise: 0.05 }
    }

    /// Takes what this robot would do for what was measured.
    pub fn expect(&mut self, model: &RobotModel, seed: u64) {
        if let Some(heights) = self.simulate(model, seed) {
            self.measured = heights;
        }
    }

    /// Returns the measured course: time since the touch (s) and height since the release (mm).
    #[must_use]
    pub fn course(&self) -> Vec<(f64, f64)> {
        let time = |index: usize| (index as f64 + 0.5) * INTERVAL;
        self.measured.iter().enumerate().map(|(index, z)| (time(index), *z)).collect()
    }

    /// Simulates the same course for a robot.
    #[must_use]
    pub fn simulate(&self, model: &RobotModel, seed: u64) -> Option<Vec<f64>> {
        let seconds = touch(self.height_mm) + INTERVAL * INTERVALS as f64;
        let samples = fall(model, self.height_mm, seed, STEP, (seconds, 5))?;
        let each = means(&samples, self.height_mm);
        each.into_iter().map(|mean| mean.map(|(mean, ..)| mean)).collect()
    }

    /// Returns what is known after the drops, and how far they are from what was expected.
    #[must_use]
    pub fn condition(
        &self,
        prior: &Posterior,
        robot: (&RobotModel, &[Unknown]),
        seed: u64,
    ) -> (Posterior, f64) {
        let ensemble = Ensemble::draw(prior, robot, MEMBERS, seed, |model, seed| {
            let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
            let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
            let noisy = |z: f64| z + self.noise * normal();
            Some(self.simulate(model, seed)?.into_iter().map(noisy).collect())
        });
        ensemble.update(&self.measured.iter().copied().map(Some).collect::<Vec<_>>())
    }
}

/// When the soles touch, s after the release.
fn touch(height_mm: f64) -> f64 {
    (2e-3 * height_mm / GRAVITY).sqrt()
}

/// Drops a robot: time since the release (s) and height of the body's middle (mm), one sample every so many steps.
#[must_use]
pub fn fall(
    model: &RobotModel,
    height_mm: f64,
    seed: u64,
    step: f64,
    (seconds, every): (f64, usize),
) -> Option<Vec<(f64, f64)>> {
    let mut plant = Plant::new(model).ok()?;
    plant.disturb(seed, false);
    plant.displace([0.0, 0.0, 1e-3 * height_mm], 0.0);
    let mut samples = vec![(0.0, 1e3 * plant.body().position[2])];
    for index in 1..=(seconds / step).ceil() as usize {
        plant.step([0.0; 2], step).ok()?;
        if index % every == 0 {
            samples.push((plant.time(), 1e3 * plant.body().position[2]));
        }
    }
    Some(samples)
}

/// Mean and number of the samples in each interval from the touch on, less the height at the release; none where there
/// are less than two.
fn means(samples: &[(f64, f64)], height_mm: f64) -> Vec<Option<(f64, f64)>> {
    // Until here the fall is less than what cameras see.
    let start: Vec<f64> = samples.iter().take_while(|(t, _)| *t < INTERVAL).map(|s| s.1).collect();
    let start = start.iter().sum::<f64>() / start.len().max(1) as f64;
    let interval = |index: usize| {
        let from = touch(height_mm) + index as f64 * INTERVAL;
        let inside = samples.iter().filter(|(t, _)| (from..from + INTERVAL).contains(t));
        let heights: Vec<f64> = inside.map(|(_, z)| z - start).collect();
        let count = heights.len() as f64;
        (heights.len() > 1).then(|| (heights.iter().sum::<f64>() / count, count))
    };
    (0..INTERVALS).map(interval).collect()
}
