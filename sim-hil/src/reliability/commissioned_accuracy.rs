//! Robots that chance draws about the assumed one, commissioned: whether each then keeps the promises of [`accuracy`],
//! or says why not.
//!
//! [`accuracy`]: super::accuracy

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use flix_host::link::Update;
use flix_protocol::message::{Event, Fault};
use flix_protocol::units::Instant;
use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::json;

use super::accuracy::{HoldResult, STEPS, Step, StepResult, hold_directions, step_of};
pub use super::commission::CURRENT_LIMIT_A;
use super::unknown_motors::{Ammeter, Watched, bench_model, known, measured_by_hand};
pub use super::unknown_motors::{BY_HAND, LATE_BY_HAND_US};
use crate::model::RobotModel;
use crate::plant::electronics::Electronics;
use crate::rig::bench::{BASES, Base, BenchError, FREQUENCIES, Subject};
use crate::rig::simulated::Disturbance;
use crate::study::{Column, Measurement, Row, Table, Value};

/// theta of a robot whose f is limited: largest root mean square error, degrees.
pub const LIMITED_DIRECTION_DEG: f64 = 3.0;
/// Within which a robot says what is wrong.
const SAYING: Duration = Duration::from_millis(500);

/// Draws a robot about the assumed one, the same for the same seed, with or without current sense; half of the boards have no
/// battery divider.
#[must_use]
pub fn draw(seed: u64, measures_current: bool) -> RobotModel {
    let mut source = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut share = || source.random::<f64>();
    let mut model = bench_model();
    // Evenly in its logarithm.
    let mut times = |low: f64, high: f64| low * (high / low).powf(share());
    let electrical = &mut model.electrical;
    let motor = &mut electrical.motor;
    motor.phase_resistance_ohm *= times(0.3, 3.0);
    motor.phase_inductance_mh *= times(0.3, 3.0);
    motor.flux_linkage_mwb *= times(0.7, 1.4);
    motor.cogging_torque_mn_m *= times(0.5, 2.0);
    motor.coulomb_friction_mn_m *= times(0.5, 2.0);
    motor.viscous_friction_un_m_s_rad *= times(0.5, 2.0);
    model.shaker.mass_g *= times(0.8, 1.25);
    model.body.total_mass_g *= times(0.8, 1.25);
    electrical.pack.cell_resistance_mohm *= times(0.5, 3.0);
    electrical.sense.current_offset_counts *= times(0.3, 3.0);
    electrical.encoder.eccentricity_deg[0] *= times(0.3, 1.5);
    electrical.encoder.late_us = 900.0 * share();
    let charge = 0.1 + 0.9 * share();
    (electrical.pack.charge_at_least, electrical.pack.charge_at_most) = (charge, charge);
    electrical.sense.current = measures_current;
    if share() < 0.5 {
        electrical.sense.bus_uv_per_count = 0;
    }
    model
}

/// What a robot did of what it promises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kept {
    /// Every promise.
    Held,
    /// Voltage or current held f back, it said so, and held theta within [`LIMITED_DIRECTION_DEG`].
    Limited,
    /// It came to rest with a fault that names what was wrong.
    Named,
    /// It came to rest with a fault that names something else, or could not be commissioned.
    Misnamed,
    /// A promise was broken, and it said nothing.
    Silent,
}

/// One run of a robot.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Run {
    /// What the shaker stood on.
    #[serde(deserialize_with = "base")]
    pub base: Base,
    /// What was asked.
    pub asked: String,
    /// f that was asked, or the larger one of a step, without its sign, Hz.
    pub asked_hz: f64,
    /// Least f that was held instead, Hz; none of a step.
    pub reached_hz: Option<f64>,
    /// See [`Kept`].
    pub kept: Kept,
    /// What was out of its limits, and what the robot said.
    pub why: String,
}

/// Reads the name of a base.
fn base<'de, D: Deserializer<'de>>(source: D) -> Result<Base, D::Error> {
    let name = String::deserialize(source)?;
    let base = BASES.into_iter().find(|base| base.to_string() == name);
    base.ok_or_else(|| serde::de::Error::custom(format!("no base is called {name}")))
}

/// One robot.
#[derive(Debug, Clone, Serialize)]
pub struct Robot {
    /// Its seed.
    pub seed: u64,
    /// The worst of its runs.
    pub kept: Kept,
    /// Runs that broke a promise.
    pub broken: Vec<Run>,
    /// Largest phase current from the first power-up on, commissioning included, A.
    pub largest_current_a: f64,
}

/// Returns the robots of a table of [`robots`] that did not fail: those with current sense, then those without.
#[must_use]
pub fn found(table: &Table) -> [Vec<Robot>; BOARDS.len()] {
    let (succeeded, _) = table.succeeded();
    BOARDS.map(|board| {
        let rows = succeeded.rows.values().filter(|row| row[0].as_text() == Some(board));
        rows.filter_map(robot).collect()
    })
}

/// Reads the row of a robot.
fn robot(row: &Row) -> Option<Robot> {
    let [_, seed, kept, largest_current, broken, ..] = row.as_slice() else { return None };
    Some(Robot {
        seed: seed.whole()?,
        kept: serde_json::from_value(kept.as_text()?.into()).ok()?,
        broken: serde_json::from_str(broken.as_text()?).ok()?,
        largest_current_a: largest_current.number()?,
    })
}

/// Names of boards with current sense and without.
const BOARDS: [&str; 2] = ["sense", "voltage"];

/// Returns so many robots from this seed on, each with current sense (commissioned) and without (measured by hand).
#[must_use]
pub fn robots(robots: usize, first_seed: u64) -> Measurement<(&'static str, u64)> {
    let seeds = move || (0..robots as u64).map(move |count| first_seed.wrapping_add(count));
    Measurement::new(
        "accuracy-robots",
        json!({ "robots": robots, "first_seed": first_seed }),
        vec![
            Column::text("board"),
            Column::whole("seed"),
            Column::text("kept"),
            Column::number("largest_current_a"),
            // The runs that broke a promise, as JSON.
            Column::text("broken"),
        ],
        |(board, seed): &(&str, u64), _| vec![(*board).into(), (*seed).into()],
        |(board, seed)| {
            let it = try_robot(*seed, *board == BOARDS[0])?;
            let broken = json!(it.broken).to_string();
            let row = vec![Value::word(&it.kept), it.largest_current_a.into(), broken.into()];
            Ok::<_, BenchError>(vec![row])
        },
    )
    .runs(BOARDS.into_iter().flat_map(move |board| seeds().map(move |seed| (board, seed))), 1)
}

/// Commissions one robot and asks for everything that it promises.
///
/// # Errors
/// When it cannot be built.
pub fn try_robot(seed: u64, measures_current: bool) -> Result<Robot, BenchError> {
    let mut model = draw(seed, measures_current);
    let mut watched = Watched::power_up(model.clone(), seed)?;
    let ammeter = watched.largest_current.clone();
    let mut broken = Vec::new();
    let settings = if measures_current {
        let known = known(&model.shaker, seed, &watched);
        let now = |(name, _, now): (String, f32, f32)| (name, f64::from(now));
        watched.commission(&known).map(|found| found.changes.into_iter().map(now).collect())
    } else {
        Ok(watched.enter(measured_by_hand(&watched, &model, seed))?)
    };
    match settings {
        Ok(settings) => {
            model.electrical.settings.extend::<BTreeMap<_, _>>(settings);
            let subject = Subject { model: Some(model), seed };
            for base in BASES {
                for asked in Asked::all() {
                    broken.extend(try_run(&subject, &ammeter, base, asked)?);
                }
            }
        }
        Err(error) => broken.push(Run {
            base: Base::Fixed,
            asked: "commissioning".to_owned(),
            asked_hz: 0.0,
            reached_hz: None,
            kept: Kept::Misnamed,
            why: error.to_string(),
        }),
    }
    let kept = broken.iter().map(|it| it.kept).max().unwrap_or(Kept::Held);
    Ok(Robot { seed, kept, broken, largest_current_a: ammeter.get() })
}

/// What is asked of a robot in one run.
#[derive(Debug, Clone, Copy)]
enum Asked {
    /// This f, Hz, through all directions.
    Hold(f64),
    /// A step.
    Step(Step),
}

impl Asked {
    /// Returns the largest f of it, Hz.
    fn frequency(self) -> f64 {
        match self {
            Self::Hold(frequency) => frequency.abs(),
            Self::Step(Step { from, to, .. }) => from.0.abs().max(to.0.abs()),
        }
    }

    fn all() -> impl Iterator<Item = Self> {
        FREQUENCIES.map(Self::Hold).into_iter().chain(STEPS.map(Self::Step))
    }
}

/// Holds the lowest bus voltage of a robot, V. It disturbs nothing; clones share the reading.
#[derive(Debug, Clone)]
struct Voltmeter(Arc<AtomicU64>);

impl Voltmeter {
    fn new() -> Self {
        Self(Arc::new(AtomicU64::new(f64::INFINITY.to_bits())))
    }

    fn get(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed))
    }
}

impl Disturbance for Voltmeter {
    fn electronics(&mut self, _now: Instant, electronics: &mut Electronics) {
        let lowest = self.get().min(electronics.battery().bus_voltage());
        self.0.store(lowest.to_bits(), Ordering::Relaxed);
    }
}

/// Returns what became of one run, unless every promise was kept.
fn try_run(
    subject: &Subject,
    ammeter: &Ammeter,
    base: Base,
    asked: Asked,
) -> Result<Option<Run>, BenchError> {
    let mut operation = subject.on(base)?;
    let (here, voltmeter) = (Ammeter::default(), Voltmeter::new());
    operation.robot.disturb(ammeter.clone());
    operation.robot.disturb(here.clone());
    operation.robot.disturb(voltmeter.clone());
    let (name, outcome) = match asked {
        Asked::Hold(frequency) => {
            let held = hold_directions(&mut operation, base, frequency);
            (format!("{frequency:+} Hz"), held.map(|held| worst_hold(&held)))
        }
        Asked::Step(step) => {
            (step.name.to_owned(), step_of(&mut operation, base, step).map(|it| bad_step(&it)))
        }
    };
    let (mut why, direction_rms_deg, short_hz) = match outcome {
        Ok(None) => return Ok(None),
        Ok(Some(why)) => why,
        Err(BenchError::Operation(error)) => (error.to_string(), 0.0, None),
        Err(error) => return Err(error),
    };
    // What went wrong last is reported a little later.
    operation.run(SAYING, |_| {})?;
    let mut is_limited = false;
    while let Some(update) = operation.client().update() {
        is_limited |= match update {
            Update::Event(report) => matches!(report.event, Event::FrequencyLimited(_)),
            Update::Telemetry(telemetry) => telemetry.frequency_limited,
            _ => false,
        };
    }
    let settings = operation.robot.software().slow.settings();
    let kept = match operation.robot.report().first_fault {
        Some(fault) => {
            why += &format!("; fault: {fault}");
            // Whether it is true.
            let is_right = match fault {
                Fault::OverCurrent => here.get() > 0.9 * f64::from(settings.current_limit),
                Fault::UnderVoltage => voltmeter.get() < 1.02 * f64::from(settings.under_voltage),
                Fault::PhaseLockLost => is_limited,
                _ => false,
            };
            if is_right { Kept::Named } else { Kept::Misnamed }
        }
        None if is_limited && direction_rms_deg <= LIMITED_DIRECTION_DEG => Kept::Limited,
        None => Kept::Silent,
    };
    let asked_hz = asked.frequency();
    let reached_hz = short_hz.map(|short: f64| asked_hz - short);
    Ok(Some(Run { base, asked: name, asked_hz, reached_hz, kept, why }))
}

/// What was wrong with a run, the largest error of theta, degrees, and that of an f that was held, Hz.
type Wrong = (String, f64, Option<f64>);

/// Returns what was wrong with holds.
fn worst_hold(held: &[HoldResult]) -> Option<Wrong> {
    let broken = || held.iter().filter(|it| !it.passes());
    let most = |of: fn(&HoldResult) -> f64| broken().map(|it| of(it).abs()).fold(0.0, f64::max);
    let (f, theta) = (most(|it| it.f_rms_hz), most(|it| it.theta_rms_deg));
    broken().next().map(|_| {
        let why = format!(
            "f {f:.3} Hz, theta {theta:.2} deg, force {:.2} deg, across {:.1} %",
            most(|it| it.force_error_deg),
            100.0 * most(|it| it.across_axis)
        );
        (why, theta, Some(f))
    })
}

/// Returns what was wrong with a step.
fn bad_step(step: &StepResult) -> Option<Wrong> {
    let settled = step.settle_s.map_or_else(|| "never".to_owned(), |s| format!("{s:.3} s"));
    let (peak, limit) = (step.peak_current_a, step.current_limit_a);
    let why = format!("settled {settled}, {peak:.3} A of {limit:.3} A");
    (!step.passes()).then_some((why, 0.0, None))
}
