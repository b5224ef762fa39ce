//! The paper's walking modes and a reversal, one after the other on a sliding body: figures of each, and what is drawn of it.

use core::f64::consts::TAU;
use std::time::Duration;

use flix_host::link::RobotLink as _;
use flix_host::teleop::paper_modes::PaperMode;
use flix_protocol::message::Setpoint;

use crate::experiment::metrics::{Hold, HoldMeter, StepMeter, line_error};
use crate::reliability::accuracy::{
    ACROSS_LIMIT, DIRECTION_LIMIT_DEG, FORCE_LIMIT_DEG, FREQUENCY_LIMIT_HZ, SETTLE_LIMIT_S,
    STEP_BAND,
};
use crate::rig::bench::{Base, BenchError, bench, setpoint};
use crate::rig::simulated::Truth;

/// Returns the scenes by name, with their pairs in Hz and degrees: the paper's modes (Table IV), then the last one with its
/// frequency reversed.
pub fn scenes() -> impl ExactSizeIterator<Item = (&'static str, (f64, f64))> {
    let (f, theta) = PaperMode::StrafeRight.pair();
    let mut scenes = PaperMode::ALL.map(|mode| (mode.name(), mode.pair())).to_vec();
    scenes.push(("reversal", (-f, theta)));
    scenes.into_iter()
}

/// Time from a command until its scene is measured.
const SETTLING: Duration = Duration::from_millis(700);
/// Time for which a scene is measured.
const MEASURING: Duration = Duration::from_millis(800);

/// What became of a scene.
#[derive(Debug)]
pub struct Scene {
    /// What it is called.
    pub name: &'static str,
    /// What was commanded.
    pub setpoint: Setpoint,
    /// When, s.
    pub began_s: f64,
    /// Time until f and theta were within the band of steps, s, if they were.
    pub settled_s: Option<f64>,
    /// How well they were held after that.
    pub figures: Hold,
    /// Largest phase current, A.
    pub peak_current: f64,
}

impl Scene {
    /// Returns whether everything is within its limit; `current_limit` in A.
    #[must_use]
    pub fn passes(&self, current_limit: f64) -> bool {
        self.settled_s.is_some_and(|settled| settled <= SETTLE_LIMIT_S)
            && self.figures.frequency_rms_hz <= FREQUENCY_LIMIT_HZ
            && self.figures.direction_rms_deg <= DIRECTION_LIMIT_DEG
            && self.figures.force_error_deg.abs() <= FORCE_LIMIT_DEG
            && self.figures.across_axis <= ACROSS_LIMIT
            && self.peak_current <= current_limit
    }
}

/// What was seen of a robot that was shaken through all scenes.
#[derive(Debug)]
pub struct Demonstration {
    /// The scenes, in their order.
    pub scenes: Vec<Scene>,
    /// What is drawn, one for each [`ROW`].
    pub rows: Vec<Row>,
    /// The robot's current limit, A.
    pub current_limit: f64,
}

impl Demonstration {
    /// Shakes the robot of this seed through all scenes; `shown` is called when it is armed and after each.
    ///
    /// # Errors
    /// When the robot could not be brought to run.
    pub fn of(seed: u64, shown: &dyn Fn()) -> Result<Self, BenchError> {
        let mut operation = bench(Base::Free, seed)?;
        operation.wait_until_connected()?;
        let current_limit = operation.setting("current_limit")?;
        operation.arm()?;
        shown();
        let mut recorder = Recorder::default();
        let scenes = scenes().map(|(name, (frequency, direction))| {
            let setpoint = setpoint(frequency, direction)?;
            let began_s = operation.now().as_micros() as f64 * 1e-6;
            let mut step = StepMeter::new(setpoint, STEP_BAND);
            let mut hold = HoldMeter::new(setpoint);
            operation.want(setpoint);
            operation.run(SETTLING, |truth| {
                step.watch(truth);
                recorder.watch(truth, setpoint);
            })?;
            operation.run(MEASURING, |truth| {
                step.watch(truth);
                hold.watch(truth);
                recorder.watch(truth, setpoint);
            })?;
            shown();
            Ok(Scene {
                name,
                setpoint,
                began_s,
                settled_s: step.settled_after(),
                figures: hold.figures(),
                peak_current: step.peak_current(),
            })
        });
        let scenes = scenes.collect::<Result<_, BenchError>>()?;
        Ok(Self { scenes, rows: recorder.rows, current_limit })
    }

    /// Returns whether every scene is within its limits.
    #[must_use]
    pub fn passes(&self) -> bool {
        self.scenes.iter().all(|scene| scene.passes(self.current_limit))
    }

    /// Returns the points of something that each row has, over time in s.
    pub fn points(&self, of: impl Fn(&Row) -> f64) -> Vec<(f64, f64)> {
        self.rows.iter().map(|row| (row.time, of(row))).collect()
    }

    /// Returns the mean over a turn of the current that makes torque, A.
    #[must_use]
    pub fn torque_currents(&self, motor: usize) -> Vec<(f64, f64)> {
        self.rows
            .windows(ROWS_OF_A_TURN)
            .map(|rows| {
                let sum: f64 = rows.iter().map(|row| row.torque_current[motor]).sum();
                (rows[ROWS_OF_A_TURN / 2].time, sum / ROWS_OF_A_TURN as f64)
            })
            .collect()
    }

    /// Returns the principal axis of the force over a turn, degrees to the right of forward, near the command.
    #[must_use]
    pub fn lines_of_force(&self) -> Vec<(f64, f64)> {
        self.rows
            .windows(ROWS_OF_A_TURN)
            .map(|rows| {
                let sum = |part: usize| rows.iter().map(|row| row.force[part]).sum::<f64>();
                let axis = 0.5 * (2.0 * sum(1)).atan2(sum(0) - sum(2));
                let middle = rows[ROWS_OF_A_TURN / 2];
                (middle.time, near(axis, middle.commanded.1))
            })
            .collect()
    }
}

/// Returns a direction of a line (rad), in degrees within a quarter turn of the commanded one.
#[must_use]
pub fn near(direction: f64, commanded_deg: f64) -> f64 {
    commanded_deg + line_error(direction, commanded_deg.to_radians()).to_degrees()
}

/// Gathers what is drawn: one [`Row`] for each [`ROW`].
#[derive(Default)]
struct Recorder {
    rows: Vec<Row>,
    gathering: Gathering,
}

/// Time that a drawn point stands for.
pub const ROW: Duration = Duration::from_millis(5);
/// Rows in a turn at 30 Hz: over it the force is one line, and the yielding body's ripple averages out.
const ROWS_OF_A_TURN: usize = 7;

/// Means and extremes over [`ROW`].
#[derive(Debug, Clone, Copy, Default)]
pub struct Row {
    /// Time since power-up, s.
    pub time: f64,
    /// Commanded f (Hz) and theta (degrees).
    pub commanded: (f64, f64),
    /// f, Hz.
    pub frequency: f64,
    /// Direction at the end, rad.
    pub direction: f64,
    /// Mean current that makes torque, A, top and bottom.
    pub torque_current: [f64; 2],
    /// Largest phase current, A.
    pub largest_current: [f64; 2],
    /// Sums of squares and products of the force: forward, mixed, right.
    force: [f64; 3],
}

#[derive(Default)]
struct Gathering {
    row: Row,
    ticks: u32,
    phase: Option<(f64, f64)>,
}

impl Recorder {
    fn watch(&mut self, truth: &Truth, setpoint: Setpoint) {
        let time = truth.time.as_micros() as f64 * 1e-6;
        let gathering = &mut self.gathering;
        let (began, phase) = *gathering.phase.get_or_insert((time, truth.phase));
        let row = &mut gathering.row;
        gathering.ticks += 1;
        for motor in 0..2 {
            row.torque_current[motor] += truth.rotor_frame_currents[motor][1];
            let largest = truth.phase_currents[motor].iter().fold(0.0, |m: f64, i| m.max(i.abs()));
            row.largest_current[motor] = row.largest_current[motor].max(largest);
        }
        let [forward, left, _] = truth.shaker_force;
        row.force[0] += forward * forward;
        row.force[1] -= forward * left;
        row.force[2] += left * left;
        if time - began < ROW.as_secs_f64() {
            return;
        }
        row.time = time;
        row.commanded =
            (f64::from(setpoint.frequency().get()), f64::from(setpoint.direction().get()));
        row.frequency = (truth.phase - phase) / (time - began) / TAU;
        row.direction = truth.direction;
        row.torque_current = row.torque_current.map(|sum| sum / f64::from(gathering.ticks));
        self.rows.push(*row);
        self.gathering = Gathering { phase: Some((time, truth.phase)), ..Gathering::default() };
    }
}
