//! The robot hung on soft cords and shaken: mass, stiffness and, by the phases, damping.
//!
//! The file is what motion capture saw, a test after another: the phase of the rotors, the body's pose, and the feet if
//! they have markers; in axes of the body at rest. Of each signal the component that goes with the phase is compared
//! (amplitude and phase). What the cameras may do wrong: their scale, their delay, and the axes of the markers.

use std::path::Path;

use nalgebra::Vector3;

use super::fit::{Experiment, GAIN, Sensor};
use super::table::{Column, Table};
use super::unknowns::Kind;
use crate::measured::MeasuredError;
use flix_sim::experiment::probe::{CHANNELS, Component, ProbeError, Swing, lock_in, swing};
use flix_sim::model::RobotModel;
use flix_sim::rig::bench::setpoint;

/// What the file is made of.
pub const TABLE: Table<11> = Table {
    name: "air",
    columns: [
        Column::new("test", 1.0, 1e4),
        Column::new("f_hz", -35.0, 35.0),
        Column::new("theta_deg", -90.0, 90.0),
        Column::new("t_s", -1e6, 1e6),
        Column::new("phase_deg", -1e9, 1e9),
        PLACE[0],
        PLACE[1],
        PLACE[2],
        Column::new("rx_deg", -HUNG, HUNG),
        Column::new("ry_deg", -HUNG, HUNG),
        Column::new("rz_deg", -HUNG, HUNG),
    ],
    fewest: 20,
};

/// A robot that turns further than this, degrees, does not hang quietly.
const HUNG: f64 = 30.0;
/// Where a marker is.
const PLACE: [Column; 3] = [
    Column::new("x_mm", -1e4, 1e4),
    Column::new("y_mm", -1e4, 1e4),
    Column::new("z_mm", -1e4, 1e4),
];

/// Markers on the feet, if there are any.
pub const FEET: [Column; 12] = [
    Column::new("fl_x_mm", -1e4, 1e4),
    Column::new("fl_y_mm", -1e4, 1e4),
    Column::new("fl_z_mm", -1e4, 1e4),
    Column::new("fr_x_mm", -1e4, 1e4),
    Column::new("fr_y_mm", -1e4, 1e4),
    Column::new("fr_z_mm", -1e4, 1e4),
    Column::new("rl_x_mm", -1e4, 1e4),
    Column::new("rl_y_mm", -1e4, 1e4),
    Column::new("rl_z_mm", -1e4, 1e4),
    Column::new("rr_x_mm", -1e4, 1e4),
    Column::new("rr_y_mm", -1e4, 1e4),
    Column::new("rr_z_mm", -1e4, 1e4),
];

/// Usual tests: f in Hz and theta in degrees.
pub const USUAL: [(f64, f64); 6] = flix_host::experiment::air::SHAKES;

/// Step of the simulation, s: its error is below a thousandth of any amplitude.
const STEP: f64 = 2e-4;
/// Time after which a start from straight legs is forgotten, s.
const RUN_IN: f64 = 0.2;
/// Periods that are simulated after it.
const PERIODS: f64 = 3.0;
/// Step for derivatives, s.
const COARSE_STEP: f64 = 5e-4;
/// Time between two samples, s.
const INTERVAL: f64 = 1e-3;
/// Delay of the cameras, s, and misalignment of their axes, rad.
const DELAY: f64 = 1e-3;
const AXES: f64 = 0.01;
/// Noise of a component before anything is fitted: position (m) and rotation (rad).
const NOISE: [f64; 2] = [1e-5, 1e-4];
/// Below this shake, Hz, the body's slow swing on its cords is no longer small.
const SLOWEST: f64 = 5.0;

/// Shakes in the air.
#[derive(Debug, Clone)]
pub struct Air {
    /// f in Hz, theta in degrees.
    tests: Vec<(f64, f64)>,
    channels: usize,
    /// Cosine and sine of each channel of each test.
    measured: Vec<f64>,
}

impl Air {
    /// Plans tests that nobody has made yet.
    #[must_use]
    pub fn planned(tests: &[(f64, f64)]) -> Self {
        let measured = vec![0.0; 2 * CHANNELS * tests.len()];
        Self { tests: tests.to_vec(), channels: CHANNELS, measured }
    }

    /// Reads the file, if it is there.
    ///
    /// # Errors
    /// When it is refused, when some of the feet's columns are missing, or a test does not determine its component.
    pub fn read(folder: &Path) -> Result<Option<Self>, MeasuredError> {
        let Some(lines) = TABLE.read_with(folder, &FEET)? else { return Ok(None) };
        let path = folder.join("air.csv");
        let place = |line: u64, column, reason: &str| MeasuredError::Place {
            path: path.clone(),
            line,
            column,
            reason: reason.to_owned(),
        };
        let feet = lines.given[TABLE.columns.len()..].iter().filter(|given| **given).count();
        if feet % FEET.len() != 0 {
            return Err(place(
                1,
                1,
                "some columns of the feet are missing: give all twelve or none",
            ));
        }
        let channels = if feet == 0 { 6 } else { CHANNELS };
        let mut air = Self { tests: vec![], channels, measured: vec![] };
        for test in lines.rows.chunk_by(|(_, a), (_, b)| a[0] == b[0]) {
            let (line, first) = &test[0];
            let (f, theta) = (first[1], first[2]);
            if let Some((line, _)) = test.iter().find(|(_, row)| (row[1], row[2]) != (f, theta)) {
                return Err(place(
                    *line,
                    2,
                    "f_hz and theta_deg of a test are the same in all its rows",
                ));
            }
            if f.abs() < SLOWEST {
                return Err(place(
                    *line,
                    2,
                    "f_hz is 5 Hz or more either way: slower, the cords show",
                ));
            }
            let column =
                |index: usize| test.iter().map(|(_, row)| row[index]).collect::<Vec<f64>>();
            let phases: Vec<f64> = column(4).into_iter().map(f64::to_radians).collect();
            let unit = |channel| if (3..6).contains(&channel) { 1f64.to_radians() } else { 1e-3 };
            let signals: Vec<Vec<f64>> = (0..channels)
                .map(|i| column(5 + i).into_iter().map(|value| unit(i) * value).collect())
                .collect();
            if let Some(seen) = aliased(&phases) {
                let advice = format!(
                    "aliasing: f is a multiple of a part of the cameras' rate, so that they see {seen} phases of each turn alone: take \
                     another rate (250 Hz is plenty) or another f"
                );
                return Err(place(*line, 4, &advice));
            }
            let found = lock_in(&column(3), &phases, &signals).ok_or_else(|| {
                place(*line, 4, "this test has too few samples, or its phase_deg does not turn")
            })?;
            air.tests.push((f, theta));
            air.measured.extend(found.iter().flat_map(|c| [c.cos, c.sin]));
        }
        Ok(Some(air))
    }
}

/// Phases of each turn by which a component cannot be told from its second harmonic, or its cosine from its sine.
const FEW_PHASES: usize = 4;
/// Pictures whose phases are as much alike, from 0 to 1, are pictures of the same phases.
const ALIKE: f64 = 0.95;

/// Returns how many phases, rad, the pictures show, where these are too few.
fn aliased(phases: &[f64]) -> Option<usize> {
    let turns = phases.last()? - phases.first()?;
    let alike = |count: &usize| {
        let sum = phases.iter().fold([0.0, 0.0], |[x, y], phase| {
            let (sin, cos) = (*count as f64 * phase).sin_cos();
            [x + cos, y + sin]
        });
        sum[0].hypot(sum[1]) > ALIKE * phases.len() as f64
    };
    // One that does not turn is refused as that.
    (1..=FEW_PHASES).find(alike).filter(|_| turns.abs() > core::f64::consts::TAU)
}

impl Air {
    fn components(&self, model: &RobotModel, step: f64) -> Result<Vec<f64>, ProbeError> {
        let every = (INTERVAL / step).round() as usize;
        let mut all = Vec::with_capacity(self.measured.len());
        for (f, theta) in &self.tests {
            let seen = shaken(model, (*f, *theta), step, PERIODS / f.abs(), every)?;
            let found = lock_in(&seen.times, &seen.phases, &seen.signals[..self.channels]);
            let still = vec![Component { cos: 0.0, sin: 0.0, rest: 0.0 }; self.channels];
            all.extend(found.unwrap_or(still).iter().flat_map(|c| [c.cos, c.sin]));
        }
        Ok(all)
    }
}

/// Simulates one test.
///
/// # Errors
/// When the model is refused or diverges.
pub fn shaken(
    model: &RobotModel,
    (f, theta): (f64, f64),
    step: f64,
    seconds: f64,
    every: usize,
) -> Result<Swing, ProbeError> {
    swing(model, setpoint(f, theta)?, step, (RUN_IN, seconds), every)
}

impl Experiment for Air {
    fn name(&self) -> &'static str {
        TABLE.name
    }

    fn shows(&self, kind: Kind) -> bool {
        matches!(kind, Kind::Mass | Kind::Stiffness | Kind::Damping)
    }

    fn simulate(&self, model: &RobotModel) -> Result<Vec<f64>, ProbeError> {
        self.components(model, STEP)
    }

    fn sketch(&self, model: &RobotModel) -> Result<Vec<f64>, ProbeError> {
        self.components(model, COARSE_STEP)
    }

    fn sensors(&self) -> Vec<Sensor> {
        let sensor = |name, spread| Sensor { name, spread };
        vec![
            sensor("scale of the cameras", GAIN),
            sensor("delay of the cameras", DELAY),
            sensor("axes of the cameras x", AXES),
            sensor("axes of the cameras y", AXES),
            sensor("axes of the cameras z", AXES),
        ]
    }

    fn observe(&self, done: &[f64], sensors: &[f64]) -> Vec<f64> {
        let [gain, delay, x, y, z] = core::array::from_fn(|i| sensors[i]);
        let axes = Vector3::new(x, y, z);
        let mut seen = Vec::with_capacity(done.len());
        for (test, (f, _)) in done.chunks(2 * self.channels).zip(&self.tests) {
            let (sin, cos) = (core::f64::consts::TAU * f * delay).sin_cos();
            for (index, vector) in test.chunks(6).enumerate() {
                let scale = if index == 1 { 1.0 } else { 1.0 + gain };
                let part = |first: usize| {
                    let v = Vector3::new(vector[first], vector[first + 2], vector[first + 4]);
                    scale * (v + axes.cross(&v))
                };
                let (c, s) = (part(0), part(1));
                // What is recorded now happened a delay ago.
                for i in 0..3 {
                    seen.extend([c[i] * cos - s[i] * sin, s[i] * cos + c[i] * sin]);
                }
            }
        }
        seen
    }

    fn measured(&self) -> &[f64] {
        &self.measured
    }

    fn noise(&self) -> Vec<f64> {
        NOISE.to_vec()
    }

    fn kind_of(&self, reading: usize) -> usize {
        usize::from((6..12).contains(&(reading % (2 * self.channels))))
    }
}
