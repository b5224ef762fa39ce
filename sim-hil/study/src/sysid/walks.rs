//! Walks on the floor: what all values together come to, and the check of the whole.
//!
//! A row is one walk. How well a walk is met that nothing was fitted to says how far the model can be trusted: each third
//! of the pairs (f, theta) is held out in turn, and walked by the robot that the other two thirds identify. So the same
//! pairs are judged held out and fitted: some are at the edge between two gaits, and one third may have more of them than
//! another. Walks are chaotic, so that only an ensemble over starts and headings is compared.

use std::path::Path;

use flix_host::nav::Twist;
use serde::Serialize;

use super::ensemble::Ensemble;
use super::fit::Posterior;
use super::table::{Column, Table};
use super::unknowns::{Unknown, apply};
use crate::measured::{MeasuredError, SPEEDS};
use crate::modes::LEVER;
use flix_sim::experiment::walk::ideal_motion;
use flix_sim::model::RobotModel;

/// What the file is made of.
pub const TABLE: Table<5> = Table { name: "walks", columns: SPEEDS, fewest: 3 };

/// What a walk may be say besides: its heading at the start, which the floor does not care for, and how long it was.
pub const OPTIONAL: [Column; 3] = [
    Column::new("seconds", 0.5, 600.0),
    Column::new("heading_deg", -360.0, 360.0),
    Column::new("seed", 0.0, 1e15),
];

/// Length of a walk whose row does not say it, s.
const SECONDS: f64 = 8.0;
/// Step of the simulation, s.
const STEP: f64 = 2.5e-4;
/// Robots drawn.
const MEMBERS: usize = 24;
/// Walks of the identified robot for each pair.
const CHECKS: u64 = 4;
/// Parts that are held out in turn.
const PARTS: usize = 3;

/// One pair (f, theta).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Pair {
    /// Hz.
    pub f_hz: f64,
    /// Degrees.
    pub theta_deg: f64,
    /// Mean of the measured walks: forward and lateral in m/s, yaw in rad/s.
    pub measured: [f64; 3],
    /// Mean of the identified robot's.
    pub simulated: [f64; 3],
    /// Mean of the walks of the robot that is identified without this pair.
    pub held_out: [f64; 3],
    #[serde(skip)]
    seconds: f64,
}

impl Pair {
    const fn new((f_hz, theta_deg): (f64, f64), seconds: f64) -> Self {
        let none = [0.0; 3];
        Self { f_hz, theta_deg, measured: none, simulated: none, held_out: none, seconds }
    }

    const fn pair(&self) -> (f64, f64) {
        (self.f_hz, self.theta_deg)
    }

    /// Returns the mean of a robot's walks.
    fn walked(&self, model: &RobotModel, seed: u64) -> [f64; 3] {
        let walks: Vec<[f64; 3]> = (0..CHECKS)
            .filter_map(|walk| {
                let seed = seed ^ ((walk + 1) << 40);
                ideal_motion(model, self.pair(), self.seconds, STEP, seed).map(components)
            })
            .collect();
        core::array::from_fn(|i| walks.iter().map(|w| w[i]).sum::<f64>() / walks.len() as f64)
    }
}

/// Returns the motion in the order of the file's columns.
const fn components(motion: Twist) -> [f64; 3] {
    [motion.forward, motion.lateral, motion.yaw]
}

/// All walks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Walks {
    /// Pairs in the order of the file.
    pub pairs: Vec<Pair>,
}

impl Walks {
    /// Reads the file, if it is there.
    ///
    /// # Errors
    /// When it is refused.
    pub fn read(folder: &Path) -> Result<Option<Self>, MeasuredError> {
        let Some(lines) = TABLE.read_with(folder, &OPTIONAL)? else { return Ok(None) };
        let mut pairs: Vec<(Pair, f64)> = Vec::new();
        for (_, row) in &lines.rows {
            let (f_hz, theta_deg) = (row[0], row[1]);
            let known = pairs.iter().position(|(p, _)| (p.f_hz, p.theta_deg) == (f_hz, theta_deg));
            let index = known.unwrap_or(pairs.len());
            if known.is_none() {
                pairs.push((Pair::new((f_hz, theta_deg), 0.0), 0.0));
            }
            let (pair, count) = &mut pairs[index];
            for (sum, value) in pair.measured.iter_mut().zip(&row[2..5]) {
                *sum += value;
            }
            pair.seconds += if lines.given[5] { row[5] } else { SECONDS };
            *count += 1.0;
        }
        let mean = |(mut pair, count): (Pair, f64)| {
            pair.measured.iter_mut().for_each(|sum| *sum /= count);
            pair.seconds /= count;
            pair
        };
        Ok(Some(Self { pairs: pairs.into_iter().map(mean).collect() }))
    }

    /// Plans the nine pairs of the paper's modes.
    #[must_use]
    pub fn planned() -> Self {
        let pair =
            |(_, f, theta): (&str, f32, f32)| Pair::new((f64::from(f), f64::from(theta)), 2.0);
        Self { pairs: flix_host::nav::PAPER_PAIRS.into_iter().map(pair).collect() }
    }

    /// Takes what this robot would do for what was measured.
    pub fn expect(&mut self, model: &RobotModel, seed: u64) {
        for pair in &mut self.pairs {
            pair.measured = pair.walked(model, seed);
        }
    }

    /// Returns what is known after all walks and how far they are from what was expected; and writes down how the robot
    /// that is then known walks each pair, and the one that is known without that third of the pairs.
    pub fn condition(
        &mut self,
        prior: &Posterior,
        (base, unknowns): (&RobotModel, &[Unknown]),
        seed: u64,
    ) -> (Posterior, f64) {
        let ensemble = Ensemble::draw(prior, (base, unknowns), MEMBERS, seed, |model, seed| {
            let each = self.pairs.iter().zip(0..).map(|(pair, i)| {
                ideal_motion(model, pair.pair(), pair.seconds, STEP, seed ^ (i << 32))
                    .map(components)
            });
            Some(each.collect::<Option<Vec<_>>>()?.concat())
        });
        let without = |part: Option<usize>| {
            let readings = self.pairs.iter().enumerate().flat_map(|(i, pair)| {
                pair.measured.map(|it| (part != Some(i % PARTS)).then_some(it))
            });
            ensemble.update(&readings.collect::<Vec<_>>())
        };
        let all = without(None);
        let parts: [Posterior; PARTS] = core::array::from_fn(|part| without(Some(part)).0);
        let model = |of: &Posterior| apply(base, unknowns, &of.mean.as_slice()[..unknowns.len()]);
        for (i, pair) in self.pairs.iter_mut().enumerate() {
            pair.simulated = pair.walked(&model(&all.0), seed);
            let other = &parts[i % PARTS];
            let same = other.mean == all.0.mean;
            pair.held_out = if same { pair.simulated } else { pair.walked(&model(other), seed) };
        }
        all
    }

    /// Returns the sum of the square errors (equation 3) of all pairs, (m/s)^2, as they are fitted and as they are held out.
    #[must_use]
    pub(crate) fn square_errors(&self) -> [f64; 2] {
        let of = |which: fn(&Pair) -> [f64; 3]| -> f64 {
            let error = |pair: &Pair| {
                let off: [f64; 3] = core::array::from_fn(|i| which(pair)[i] - pair.measured[i]);
                (off[0].powi(2) + off[1].powi(2) + (LEVER * off[2]).powi(2)) / 3.0
            };
            self.pairs.iter().map(error).sum()
        };
        [of(|pair| pair.simulated), of(|pair| pair.held_out)]
    }
}
