//! Whether any settings that the robot arms with let a rotor shiver at rest, by the plant.
//!
//! Sets of bandwidths, delays, limits and ramps are drawn; the motors are as their settings say. The robot's own stability
//! margin ([`Margins`]) judges each. Those nearest its border, on either side, run on the bench: aligned, driven at 5 Hz, then
//! at rest for five seconds, in which the motors' heat is measured. A set passes when the robot refuses to arm with it, when
//! both motors together stay below [`HEAT_LIMIT_W`], or when a fault names what is wrong.

use std::collections::BTreeMap;
use std::time::Duration;

use flix_firmware::fast::margin::{LEAST_MARGIN, Margins};
use flix_firmware::settings::Settings;
use flix_host::link::{LinkError, RobotLink};
use flix_protocol::message::{Refusal, Setpoint};
use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use serde::Serialize;

use crate::model::RobotModel;
use crate::rig::bench::{BASES, BenchError, Subject, setpoint};
use crate::rig::operation::OperationError;

/// Most heat of both motors at rest, W: a fiftieth of what cooks one.
pub const HEAT_LIMIT_W: f64 = 0.5;
/// It is driven at this before, Hz.
const DRIVEN_HZ: f64 = 5.0;
/// For so long.
const DRIVEN: Duration = Duration::from_secs(2);
/// Slow ramps end within this.
const RAMP: Duration = Duration::from_millis(1_500);
/// Rest that is looked at.
const REST: Duration = Duration::from_secs(5);
/// What is drawn: setting, least and most, evenly in its logarithm.
const DRAWN: [(&str, f64, f64); 7] = [
    ("position_bandwidth", 1.0, 60.0),
    ("tracker_bandwidth", 10.0, 500.0),
    ("current_bandwidth", 50.0, 1_500.0),
    ("actuation_delay", 1.0, 500.0),
    ("current_limit", 0.8, 2.6),
    ("frequency_ramp", 5.0, 1_000.0),
    ("direction_ramp", 10.0, 10_000.0),
];
/// Half of the encoders are late, by up to this, us.
const LATEST_US: f64 = 3_000.0;

/// A set of settings, by name; the rest are defaults.
pub type Set = BTreeMap<String, f64>;

/// What became of a set on the bench.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The robot refused to arm, in these words.
    Refused(String),
    /// It rested with this heat, W.
    Rested(f64),
    /// A fault came up, in these words.
    Faulted(String),
}

/// A set that was judged, and run where it is near the border.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judged {
    /// The set.
    pub set: Set,
    /// Its lesser margin.
    pub margin: f32,
    /// What became of it.
    pub verdict: Verdict,
}

impl Judged {
    /// Returns whether it is quiet, or says why not.
    #[must_use]
    pub fn passes(&self) -> bool {
        match &self.verdict {
            Verdict::Refused(_) => self.margin < LEAST_MARGIN,
            Verdict::Rested(heat) => *heat < HEAT_LIMIT_W,
            Verdict::Faulted(_) => true,
        }
    }
}

/// All that was found.
#[derive(Debug, Clone, Serialize)]
pub struct Shivers {
    /// Whether every set that was run passes.
    pub pass: bool,
    /// Sets drawn.
    pub drawn: usize,
    /// Of them, those that the robot arms with.
    pub accepted: usize,
    /// Those that were run.
    pub run: Vec<Judged>,
}

/// Draws a set, the same for the same seed.
#[must_use]
pub fn draw(seed: u64) -> Set {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut set: Set = DRAWN
        .iter()
        .map(|(name, least, most)| {
            let share = random.random::<f64>();
            ((*name).to_owned(), least * (most / least).powf(share))
        })
        .collect();
    let late = random.random::<bool>();
    let latency = if late { LATEST_US * random.random::<f64>() } else { 0.0 };
    set.insert("encoder_latency".to_owned(), latency);
    set
}

/// Returns the robot that has a set, its encoders as late as it says.
///
/// # Errors
/// When the model is damaged.
fn robot(set: &Set) -> Result<RobotModel, BenchError> {
    let mut model = RobotModel::named("bench-fixed")?;
    model.electrical.encoder.late_us = set.get("encoder_latency").copied().unwrap_or(0.0);
    model.electrical.settings.extend(set.clone());
    Ok(model)
}

/// Returns the lesser margin of a set.
///
/// # Errors
/// When a value is refused by itself.
pub fn margin(set: &Set) -> Result<f32, BenchError> {
    let settings = robot(set)?.electrical.stored_settings()?.unwrap_or(Settings::DEFAULT);
    let Margins { position, current } = Margins::of(&settings, true);
    Ok(current.map_or(position, |current| current.min(position)))
}

/// Runs a set on the bench.
///
/// # Errors
/// When the robot does something else than refuse, rest, or have a fault.
pub fn run(set: &Set, seed: u64) -> Result<Verdict, BenchError> {
    let base = BASES[(seed % 2) as usize];
    let model = robot(set)?;
    let resistance = model.electrical.motor.phase_resistance_ohm;
    let mut operation = Subject { model: Some(model), seed }.on(base)?;
    match operation.arm() {
        Ok(()) => {}
        Err(OperationError::Link(LinkError::Refused(
            refusal @ (Refusal::UnstablePosition { .. } | Refusal::UnstableCurrent { .. }),
        ))) => return Ok(Verdict::Refused(refusal.to_string())),
        Err(OperationError::Link(LinkError::Faulted { all, .. })) => {
            return Ok(Verdict::Faulted(all.to_string()));
        }
        Err(error) => return Err(error.into()),
    }
    operation.want(setpoint(DRIVEN_HZ, 0.0)?);
    operation.run(DRIVEN, |_| {})?;
    operation.want(Setpoint::REST);
    operation.run(RAMP, |_| {})?;
    let (mut heat, mut ticks) = (0.0, 0.0);
    operation.run(REST, |truth| {
        let squares = truth.phase_currents.as_flattened().iter().map(|it| it * it);
        heat += resistance * squares.sum::<f64>();
        ticks += 1.0;
    })?;
    let faults = operation.robot.report().faults;
    if !faults.is_empty() {
        return Ok(Verdict::Faulted(faults.to_string()));
    }
    Ok(Verdict::Rested(heat / ticks))
}

/// Draws and judges so many sets, and runs those nearest the border. `done` is called after each run.
///
/// # Errors
/// When a robot does something else than refuse, rest, or have a fault.
pub fn measure(
    sets: usize,
    nearest: usize,
    first_seed: u64,
    done: impl Fn() + Sync,
) -> Result<Shivers, BenchError> {
    let seeds = (0..sets as u64).map(|index| first_seed.wrapping_add(index));
    let judged: Result<Vec<_>, BenchError> = seeds
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|seed| {
            let set = draw(seed);
            margin(&set).map(|margin| (seed, set, margin))
        })
        .collect();
    let mut judged = judged?;
    let accepted = judged.iter().filter(|(.., margin)| *margin >= LEAST_MARGIN).count();
    let from_border = |margin: f32| (margin - LEAST_MARGIN).abs();
    judged.sort_by(|(.., one), (.., other)| from_border(*one).total_cmp(&from_border(*other)));
    judged.truncate(nearest);
    let run: Result<Vec<Judged>, BenchError> = judged
        .into_par_iter()
        .map(|(seed, set, margin)| {
            let verdict = run(&set, seed)?;
            done();
            Ok(Judged { set, margin, verdict })
        })
        .collect();
    let run = run?;
    Ok(Shivers { pass: run.iter().all(Judged::passes), drawn: sets, accepted, run })
}
