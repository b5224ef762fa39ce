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
use serde_json::json;

use crate::model::RobotModel;
use crate::rig::bench::{BASES, BenchError, Subject, setpoint};
use crate::rig::operation::OperationError;
use crate::study::{Column, Limit, Measurement, Value};

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
#[derive(Debug, Clone, PartialEq)]
pub enum Verdict {
    /// The robot refused to arm, in these words.
    Refused(String),
    /// It rested with this heat, W.
    Rested(f64),
    /// A fault came up, in these words.
    Faulted(String),
}

impl Verdict {
    /// Returns whether a set of this margin is quiet, or says why not.
    #[must_use]
    pub fn passes(&self, margin: f32) -> bool {
        match self {
            Self::Refused(_) => margin < LEAST_MARGIN,
            Self::Rested(heat) => *heat < HEAT_LIMIT_W,
            Self::Faulted(_) => true,
        }
    }
}

/// The latency of the encoders, a setting that is drawn apart.
const LATENCY: &str = "encoder_latency";

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
    set.insert(LATENCY.to_owned(), latency);
    set
}

/// Returns the robot that has a set, its encoders as late as it says.
///
/// # Errors
/// When the model is damaged.
fn robot(set: &Set) -> Result<RobotModel, BenchError> {
    let mut model = RobotModel::named("bench-fixed")?;
    model.electrical.encoder.late_us = set.get(LATENCY).copied().unwrap_or(0.0);
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

/// A set and its lesser margin.
#[derive(Debug)]
pub struct Judged {
    seed: u64,
    set: Set,
    margin: f32,
}

/// Draws and judges so many sets; returns the runs of those nearest the border.
///
/// # Errors
/// When a value is refused by itself.
pub fn shivers(
    drawn: usize,
    nearest: usize,
    first_seed: u64,
) -> Result<Measurement<Judged>, BenchError> {
    let judge = |index: usize| {
        let seed = first_seed.wrapping_add(index as u64);
        let set = draw(seed);
        margin(&set).map(|margin| Judged { seed, set, margin })
    };
    let mut judged: Vec<Judged> =
        (0..drawn).into_par_iter().map(judge).collect::<Result<_, _>>()?;
    let accepted = judged.iter().filter(|it| it.margin >= LEAST_MARGIN).count();
    let from_border = |judged: &Judged| (judged.margin - LEAST_MARGIN).abs();
    judged.sort_by(|one, other| from_border(one).total_cmp(&from_border(other)));
    judged.truncate(nearest);
    let names = || DRAWN.iter().map(|(name, ..)| *name).chain([LATENCY]);
    let found = [
        Column::text("verdict"),
        Column::number("heat_w").limited(Limit::AtMost(HEAT_LIMIT_W)).or_missing(),
        Column::text("said"),
        Column::promise("pass"),
    ];
    let study = Measurement::new(
        "shiver",
        json!({ "drawn": drawn, "nearest": nearest, "first_seed": first_seed }),
        names().chain(["margin"]).map(Column::number).chain(found).collect(),
        move |Judged { set, margin, .. }, _| {
            let values = names().map(|name| Value::from(set.get(name).copied()));
            values.chain([f64::from(*margin).into()]).collect()
        },
        |Judged { seed, set, margin }| {
            let verdict = run(set, *seed)?;
            let pass = verdict.passes(*margin);
            let (name, heat, said) = match verdict {
                Verdict::Refused(said) => ("refused", None, said),
                Verdict::Rested(heat) => ("rested", Some(heat), String::new()),
                Verdict::Faulted(said) => ("faulted", None, said),
            };
            Ok::<_, BenchError>(vec![vec![name.into(), heat.into(), said.into(), pass.into()]])
        },
    );
    let facts = json!({ "drawn": drawn, "accepted": accepted });
    Ok(study.runs(judged, 1).listed("run", &["verdict"]).with_facts(facts))
}
