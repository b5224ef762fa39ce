//! Walks on the floor: what all values together come to, and the check of the whole.
//!
//! A row is one walk. Every third pair (f, theta) is held out: nothing is fitted to it, and how well it is met says how
//! far the model can be trusted. Walks are chaotic, so that only an ensemble over starts and headings is compared.

use std::path::Path;

use flix_host::nav::Twist;
use serde::Serialize;

use super::ensemble::condition;
use super::fit::Posterior;
use super::table::{Column, Table};
use super::unknowns::Unknown;
use crate::experiment::walk::ideal_motion;
use crate::model::RobotModel;
use crate::study::measured::MeasuredError;
use crate::study::modes::LEVER;

/// What the file is made of.
pub const TABLE: Table<5> = Table {
    name: "walks",
    columns: [
        Column::new("f_hz", -35.0, 35.0),
        Column::new("theta_deg", -90.0, 90.0),
        Column::new("forward_m_s", -1.0, 1.0),
        Column::new("lateral_m_s", -1.0, 1.0),
        Column::new("yaw_rad_s", -10.0, 10.0),
    ],
    fewest: 3,
};

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
/// Every so manyth pair is held out.
const HELD_OUT: usize = 3;

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
    /// Nothing was fitted to it.
    pub held_out: bool,
    #[serde(skip)]
    seconds: f64,
}

impl Pair {
    const fn pair(&self) -> (f64, f64) {
        (self.f_hz, self.theta_deg)
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
    /// Reads the file, if it is there. `seed` chooses which third of the pairs is held out.
    ///
    /// # Errors
    /// When it is refused.
    pub fn read(folder: &Path, seed: u64) -> Result<Option<Self>, MeasuredError> {
        let Some(lines) = TABLE.read_with(folder, &OPTIONAL)? else { return Ok(None) };
        let mut pairs: Vec<(Pair, f64)> = Vec::new();
        for (_, row) in &lines.rows {
            let (f_hz, theta_deg) = (row[0], row[1]);
            let known = pairs.iter().position(|(p, _)| (p.f_hz, p.theta_deg) == (f_hz, theta_deg));
            let index = known.unwrap_or(pairs.len());
            if known.is_none() {
                let held_out = pairs.len() % HELD_OUT == (seed % HELD_OUT as u64) as usize;
                let (measured, simulated) = ([0.0; 3], [0.0; 3]);
                let seconds = 0.0;
                pairs.push((Pair { f_hz, theta_deg, measured, simulated, held_out, seconds }, 0.0));
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
        let pair = |(_, f, theta): (&str, f32, f32)| Pair {
            f_hz: f64::from(f),
            theta_deg: f64::from(theta),
            measured: [0.0; 3],
            simulated: [0.0; 3],
            held_out: false,
            seconds: 2.0,
        };
        Self { pairs: flix_host::nav::PAPER_PAIRS.into_iter().map(pair).collect() }
    }

    /// Takes what this robot would do for what was measured.
    pub fn expect(&mut self, model: &RobotModel, seed: u64) {
        self.check(model, seed);
        self.pairs.iter_mut().for_each(|pair| pair.measured = pair.simulated);
    }

    /// Returns what is known after the walks that are not held out, and how far they are from what was expected.
    #[must_use]
    pub fn condition(
        &self,
        prior: &Posterior,
        robot: (&RobotModel, &[Unknown]),
        seed: u64,
    ) -> (Posterior, f64) {
        let fitted: Vec<&Pair> = self.pairs.iter().filter(|pair| !pair.held_out).collect();
        let measured: Vec<f64> = fitted.iter().flat_map(|pair| pair.measured).collect();
        condition(prior, robot, MEMBERS, seed, &measured, |model, seed| {
            let each = fitted.iter().zip(0..).map(|(pair, i)| {
                ideal_motion(model, pair.pair(), pair.seconds, STEP, seed ^ (i << 32))
                    .map(components)
            });
            Some(each.collect::<Option<Vec<_>>>()?.concat())
        })
    }

    /// Walks the identified robot over all pairs.
    pub fn check(&mut self, model: &RobotModel, seed: u64) {
        for pair in &mut self.pairs {
            let walks: Vec<[f64; 3]> = (0..CHECKS)
                .filter_map(|walk| {
                    let seed = seed ^ ((walk + 1) << 40);
                    ideal_motion(model, pair.pair(), pair.seconds, STEP, seed).map(components)
                })
                .collect();
            let mean = |i: usize| walks.iter().map(|w| w[i]).sum::<f64>() / walks.len() as f64;
            pair.simulated = core::array::from_fn(mean);
        }
    }

    /// Returns the mean square error (equation 3) of the fitted pairs, or of those held out, (m/s)^2, and their number.
    #[must_use]
    pub fn square_error(&self, held_out: bool) -> (f64, usize) {
        let errors: Vec<f64> = self
            .pairs
            .iter()
            .filter(|pair| pair.held_out == held_out)
            .map(|pair| {
                let off: [f64; 3] = core::array::from_fn(|i| pair.simulated[i] - pair.measured[i]);
                (off[0].powi(2) + off[1].powi(2) + (LEVER * off[2]).powi(2)) / 3.0
            })
            .collect();
        (errors.iter().sum::<f64>() / errors.len().max(1) as f64, errors.len())
    }
}
