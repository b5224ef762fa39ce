//! The matrix of figures that the robot promises: f and theta held on a fixed and on a yielding base, and steps.
//!
//! Each base and frequency is one run of a robot from power-up: it is connected to, aligns, arms and
//! is then led through all directions, by the real client over a quiet Wi-Fi network. Figures are the plant's truth.

use flix_host::link::RobotLink;
use std::time::Duration;

use serde_json::json;

use crate::experiment::metrics::{Band, HoldMeter, StepMeter};
use crate::rig::bench::{BASES, Base, BenchError, DIRECTIONS, FREQUENCIES, Subject, setpoint};
use crate::rig::operation::Operation;
use crate::study::{Column, Limit, Measurement, Row, keeps};

/// f, averaged over each turn: largest root mean square error, Hz.
pub const FREQUENCY_LIMIT_HZ: f64 = 0.05;
/// theta at every tick: largest root mean square error, degrees.
pub const DIRECTION_LIMIT_DEG: f64 = 1.0;
/// Line of force: largest error, degrees.
pub const FORCE_LIMIT_DEG: f64 = 1.0;
/// Force across the line: largest share of that along it.
pub const ACROSS_LIMIT: f64 = 0.02;
/// When a step counts as settled.
pub const STEP_BAND: Band = Band { frequency_hz: 0.2, direction_deg: 3.0 };
/// Longest time to settle, s.
pub const SETTLE_LIMIT_S: f64 = 0.5;

/// Time for a new setpoint before it is measured: twice what a step may take.
const SETTLING: Duration = Duration::from_secs(1);
/// Time for which a setpoint is measured: 20 turns at 10 Hz.
const MEASURING: Duration = Duration::from_secs(2);
/// Time for which a step is watched.
const WATCHING: Duration = Duration::from_millis(1500);

/// One held setpoint.
#[derive(Debug, Clone)]
pub struct HoldResult {
    /// What the shaker stood on.
    pub base: Base,
    /// Commanded f, Hz.
    pub f_hz: f64,
    /// Commanded theta, degrees.
    pub theta_deg: f64,
    /// See [`FREQUENCY_LIMIT_HZ`].
    pub f_rms_hz: f64,
    /// See [`DIRECTION_LIMIT_DEG`].
    pub theta_rms_deg: f64,
    /// See [`FORCE_LIMIT_DEG`].
    pub force_error_deg: f64,
    /// See [`ACROSS_LIMIT`].
    pub across_axis: f64,
}

impl HoldResult {
    /// Returns the columns of its row, with their limits.
    fn columns() -> Vec<Column> {
        vec![
            Column::text("base"),
            Column::number("f_hz"),
            Column::number("theta_deg"),
            Column::number("f_rms_hz").limited(Limit::AtMost(FREQUENCY_LIMIT_HZ)),
            Column::number("theta_rms_deg").limited(Limit::AtMost(DIRECTION_LIMIT_DEG)),
            Column::number("force_error_deg").limited(Limit::Within(FORCE_LIMIT_DEG)),
            Column::number("across_axis").limited(Limit::AtMost(ACROSS_LIMIT)),
        ]
    }

    /// Returns the figures, the last values of its row.
    fn figures(&self) -> Row {
        [self.f_rms_hz, self.theta_rms_deg, self.force_error_deg, self.across_axis]
            .map(Into::into)
            .to_vec()
    }

    /// Returns whether all figures are within their limits.
    #[must_use]
    pub fn passes(&self) -> bool {
        let columns = Self::columns();
        let figures = self.figures();
        keeps(&columns[columns.len() - figures.len()..], &figures)
    }
}

/// One step.
#[derive(Debug, Clone)]
pub struct StepResult {
    /// What was done.
    pub name: String,
    /// From the operator's command until f and theta were near for good; none when they never were.
    pub settle_s: Option<f64>,
    /// Largest phase current of both motors.
    pub peak_current_a: f64,
    /// The robot's own setting.
    pub current_limit_a: f64,
}

impl StepResult {
    /// Returns whether it settled in time and within the current limit.
    #[must_use]
    pub fn passes(&self) -> bool {
        self.settle_s.is_some_and(|settled| settled <= SETTLE_LIMIT_S)
            && self.peak_current_a <= self.current_limit_a
    }
}

/// A change of setpoint.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    /// For reports.
    pub name: &'static str,
    /// From (f, theta), Hz and degrees.
    pub from: (f64, f64),
    /// To (f, theta), Hz and degrees.
    pub to: (f64, f64),
}

impl Step {
    fn name_on(self, base: Base) -> String {
        format!("{}, {base} base", self.name)
    }
}

/// The steps that are measured, on both bases.
pub const STEPS: [Step; 3] = [
    Step { name: "10 to 35 Hz", from: (10.0, 0.0), to: (35.0, 0.0) },
    Step { name: "+30 to -30 Hz", from: (30.0, 0.0), to: (-30.0, 0.0) },
    Step { name: "theta 0 to 90 degrees at 30 Hz", from: (30.0, 0.0), to: (30.0, 90.0) },
];

/// Returns every held setpoint of a robot, in one run for each base and frequency.
#[must_use]
pub fn holds(subject: &Subject) -> Measurement<(Base, f64)> {
    let robot = subject.clone();
    Measurement::new(
        "accuracy-hold",
        json!({ "model": subject.model, "seed": subject.seed }),
        HoldResult::columns(),
        |(base, f): &(Base, f64), row| {
            vec![base.to_string().into(), (*f).into(), DIRECTIONS[row].into()]
        },
        move |(base, f)| {
            let held = hold_all_directions(&robot, *base, *f)?;
            Ok::<_, BenchError>(held.iter().map(HoldResult::figures).collect())
        },
    )
    .runs(BASES.into_iter().flat_map(|base| FREQUENCIES.map(|f| (base, f))), DIRECTIONS.len())
    .listed("hold", &["base", "f_hz"])
}

/// Returns every step of a robot, each a run.
#[must_use]
pub fn steps(subject: &Subject) -> Measurement<(Base, Step)> {
    let robot = subject.clone();
    Measurement::new(
        "accuracy-steps",
        json!({ "model": subject.model, "seed": subject.seed }),
        vec![
            Column::text("name"),
            Column::number("settle_s").limited(Limit::AtMost(SETTLE_LIMIT_S)),
            Column::number("peak_current_a"),
            Column::number("current_limit_a"),
            Column::promise("pass"),
        ],
        |(base, step): &(Base, Step), _| vec![step.name_on(*base).into()],
        move |(base, step)| {
            let it = measure_step(&robot, *base, *step)?;
            let (peak, limit) = (it.peak_current_a.into(), it.current_limit_a.into());
            Ok::<_, BenchError>(vec![vec![it.settle_s.into(), peak, limit, it.passes().into()]])
        },
    )
    .runs(BASES.into_iter().flat_map(|base| STEPS.map(|step| (base, step))), 1)
    .listed("steps", &[])
}

/// Holds this frequency through all directions, in one run.
///
/// # Errors
/// When the robot cannot be brought to run.
pub fn hold_all_directions(
    subject: &Subject,
    base: Base,
    frequency: f64,
) -> Result<Vec<HoldResult>, BenchError> {
    hold_directions(&mut subject.on(base)?, base, frequency)
}

/// As [`hold_all_directions`], by this operator.
pub(super) fn hold_directions(
    operation: &mut Operation,
    base: Base,
    frequency: f64,
) -> Result<Vec<HoldResult>, BenchError> {
    operation.arm()?;
    DIRECTIONS
        .into_iter()
        .map(|direction| {
            let setpoint = setpoint(frequency, direction)?;
            operation.want(setpoint);
            operation.run(SETTLING, |_| {})?;
            let mut meter = HoldMeter::new(setpoint);
            operation.run(MEASURING, |truth| meter.watch(truth))?;
            let figures = meter.figures();
            Ok(HoldResult {
                base,
                f_hz: frequency,
                theta_deg: direction,
                f_rms_hz: figures.frequency_rms_hz,
                theta_rms_deg: figures.direction_rms_deg,
                force_error_deg: figures.force_error_deg,
                across_axis: figures.across_axis,
            })
        })
        .collect()
}

/// Measures one step, in one run.
///
/// # Errors
/// When the robot cannot be brought to run.
pub fn measure_step(subject: &Subject, base: Base, step: Step) -> Result<StepResult, BenchError> {
    step_of(&mut subject.on(base)?, base, step)
}

/// As [`measure_step`], by this operator.
pub(super) fn step_of(
    operation: &mut Operation,
    base: Base,
    step: Step,
) -> Result<StepResult, BenchError> {
    let current_limit_a =
        operation.wait_until_connected().and_then(|()| operation.setting("current_limit"))?;
    operation.arm()?;
    operation.want(setpoint(step.from.0, step.from.1)?);
    operation.run(SETTLING, |_| {})?;
    let target = setpoint(step.to.0, step.to.1)?;
    let mut meter = StepMeter::new(target, STEP_BAND);
    operation.want(target);
    operation.run(WATCHING, |truth| meter.watch(truth))?;
    Ok(StepResult {
        name: step.name_on(base),
        settle_s: meter.settled_after(),
        peak_current_a: meter.peak_current(),
        current_limit_a,
    })
}
