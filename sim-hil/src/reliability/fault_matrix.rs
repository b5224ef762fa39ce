//! Every fault in every mode at every time: what the robot does.
//!
//! Each cell is a run of its own: a robot that knows its alignment is connected to over a quiet Wi-Fi network, armed
//! and commanded to shake, and then something goes wrong and stays so, unless said. It is then in order when both rotors
//! come to rest for good within [`REST_LIMIT_S`] of the moment at which the robot could know, or when f and theta are
//! held within the limits of [`crate::reliability::accuracy`]; each [`Case`] says which. Figures are the plant's truth.

use std::sync::OnceLock;
use std::time::Duration;

use flix_host::link::RobotLink;
use flix_host::teleop::paper_modes::PaperMode;
use flix_protocol::message::{Fault, State};
use flix_protocol::units::Instant;
use rand::{Rng, RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::Serialize;
use serde_json::json;

use crate::experiment::metrics::{HoldMeter, line_error};
use crate::reliability::accuracy::{DIRECTION_LIMIT_DEG, FREQUENCY_LIMIT_HZ};
use crate::reliability::fault_cases::{CASES, Case, Cause, Promise, WIFI};
use crate::rig::bench::{BASES, Base, BenchError, bench_of_board, learnt, setpoint};
use crate::rig::hardware_fault::{HardwareFault, Injected};
use crate::rig::lossy_network::ChannelParameters;
use crate::rig::operation::Operation;
use crate::rig::simulated::SimulatedRobot;
use crate::study::{Column, Measurement, Row, Value};

/// Longest time from when the cause can be known until both rotors are at rest, s.
pub const REST_LIMIT_S: f64 = 0.6;
/// Farthest that theta may run away while the rotors ramp down under control, degrees.
pub(crate) const PHASE_LIMIT_DEG: f64 = 5.0;
/// Rotors slower than this are at rest, Hz.
pub const REST_HZ: f64 = 0.5;
/// Rotors slower than this have no direction to speak of, Hz.
const TELLING_HZ: f64 = 2.0;

/// Time for which f settles before something goes wrong, or after.
const SETTLING: Duration = Duration::from_secs(1);
/// Time for which the robot is watched after the onset.
const WATCHING: Duration = Duration::from_millis(2_500);
/// Chance moves the onset by up to one turn of the rotors and one command.
const DITHER: Duration = Duration::from_millis(50);

/// When something goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Onset {
    /// While f rises from rest.
    Starting,
    /// While f and theta are held.
    Holding,
    /// While f is on its way from one sign to the other.
    Reversing,
}

/// All of them.
pub(crate) const ONSETS: [Onset; 3] = [Onset::Starting, Onset::Holding, Onset::Reversing];

/// Longest time between a command and the onset in its ramp.
const INTO_THE_RAMP: Duration = Duration::from_millis(80);

/// What the robot did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// Held f and theta.
    Held,
    /// Came to rest.
    Rested,
    /// Neither.
    Neither,
}

/// Returns the rows of the matrix that are `wanted`, of the robot of this seed.
#[must_use]
pub fn matrix(seed: u64, wanted: impl Fn(&Case) -> bool) -> Measurement<Place> {
    let cases: Vec<&'static Case> = CASES.iter().filter(|case| wanted(case)).collect();
    let names: Vec<&str> = cases.iter().map(|case| case.name).collect();
    let modes = || PaperMode::ALL.map(PaperMode::pair);
    let places = cases.iter().flat_map(|case| {
        let of_base = move |base| {
            let of_mode = move |mode| ONSETS.map(|onset| Place { case, base, mode, onset, seed });
            modes().into_iter().flat_map(of_mode)
        };
        BASES.into_iter().flat_map(of_base)
    });
    // What the robots of both bases know of their alignment, or why not.
    let flashes: [OnceLock<Result<Option<Vec<u8>>, String>>; BASES.len()] = Default::default();
    Measurement::new(
        "faults",
        json!({ "seed": seed, "faults": names }),
        vec![
            Column::text("fault"),
            Column::text("base"),
            Column::number("f_hz"),
            Column::number("theta_deg"),
            Column::text("onset"),
            Column::text("promise"),
            Column::text("outcome"),
            // From when the cause could be known until both rotors were at rest for good.
            Column::number("safe_s"),
            // Of both motors from the onset on.
            Column::number("largest_current_a"),
            // How far theta ran away while the rotors came to rest.
            Column::number("phase_error_deg"),
            // Over each turn, once settled.
            Column::number("f_rms_hz"),
            // At every tick, once settled.
            Column::number("theta_rms_deg"),
            // Where the supervisor stood at the end.
            Column::text("state"),
            Column::text("first_fault"),
            Column::promise("pass"),
        ],
        |Place { case, base, mode: (f, theta), onset, .. }, _| {
            let place = [case.name.into(), Value::word(base), (*f).into(), (*theta).into()];
            place.into_iter().chain([Value::word(onset), Value::word(&case.promise)]).collect()
        },
        move |place| {
            let [fixed, free] = &flashes;
            let flash = if place.base == BASES[0] { fixed } else { free };
            let learnt = || learnt(place.base, seed).map_err(|error| error.to_string());
            let row = place.run(flash.get_or_init(learnt).clone()?);
            row.map(|row| vec![row]).map_err(|error| error.to_string())
        },
    )
    .runs(places, 1)
    .listed("cells", &["fault"])
    .with_facts(json!({ "seed": seed }))
}

/// Where in the matrix.
#[derive(Debug)]
pub struct Place {
    case: &'static Case,
    base: Base,
    mode: (f64, f64),
    onset: Onset,
    seed: u64,
}

impl Place {
    fn run(&self, flash: Option<Vec<u8>>) -> Result<Row, BenchError> {
        let mut random = self.random();
        let (frequency, direction) = self.mode;
        let senses_current = self.case.senses_current;
        // Chance wires a robot without current sense otherwise: it aligns anew.
        let flash = flash.filter(|_| senses_current);
        let mut operation = bench_of_board(self.base, senses_current, self.seed, flash, WIFI)?;
        operation.arm()?;
        if self.onset == Onset::Reversing {
            operation.want(setpoint(-frequency, direction)?);
            operation.run(SETTLING, |_| {})?;
        }
        operation.want(setpoint(frequency, direction)?);
        let lead = if self.onset == Onset::Holding { SETTLING } else { INTO_THE_RAMP };
        operation.run(lead + DITHER.mul_f64(random.random::<f64>()), |_| {})?;

        let onset = operation.now();
        self.inject(&mut operation, onset, random.next_u64());
        let settled = onset + if self.onset == Onset::Holding { Duration::ZERO } else { SETTLING };
        let mut watch = Watch::new(setpoint(frequency, direction)?, settled);
        let end = onset + WATCHING;
        let mended = onset + self.case.lasts;
        while operation.now() < end {
            if operation.now() == mended {
                set_network(&mut operation, WIFI);
            }
            operation.tick()?;
            watch.see(&operation.robot);
        }
        Ok(self.judge(&operation.robot, &watch, onset))
    }

    /// Of its own for each cell.
    fn random(&self) -> Xoshiro256PlusPlus {
        let mut text: Vec<u8> = self.case.name.bytes().collect();
        text.extend(format!("{:?}{:?}{:?}", self.base, self.mode, self.onset).bytes());
        // FNV-1a.
        let hash = text.iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
        });
        Xoshiro256PlusPlus::seed_from_u64(hash ^ self.seed)
    }

    fn inject(&self, operation: &mut Operation, now: Instant, seed: u64) {
        match self.case.cause {
            Cause::Link(network) => set_network(operation, network),
            Cause::Clock(rate) => operation.operators[0].clock.run_at(rate, now),
            Cause::Hardware(fault) => {
                let until = now + self.case.lasts;
                operation.robot.disturb(Injected::new(fault, now, until, seed));
            }
        }
    }

    fn judge(&self, robot: &SimulatedRobot, watch: &Watch, onset: Instant) -> Row {
        let report = robot.report();
        let figures = watch.hold.figures();
        let current_limit = f64::from(robot.software().slow.settings().current_limit);
        let knowable = onset + self.case.knowable_after;
        let safe_s = watch.rested.map(|at| at.since(knowable).as_secs_f64());
        // An amplifier that lies takes its error with it into the limit.
        let is_told = !matches!(self.case.cause, Cause::Hardware(HardwareFault::CurrentOffset(..)));
        let is_held = figures.frequency_rms_hz <= FREQUENCY_LIMIT_HZ
            && figures.direction_rms_deg <= DIRECTION_LIMIT_DEG
            && (watch.largest_current <= current_limit || !is_told);
        let is_safe = safe_s.is_some_and(|seconds| seconds <= REST_LIMIT_S);
        let phase_error_deg = watch.rested.map(|_| watch.phase_error.to_degrees());
        let pass = match self.case.promise {
            Promise::Holds => is_held,
            Promise::RampsDown => {
                is_safe && phase_error_deg.is_some_and(|error| error <= PHASE_LIMIT_DEG)
            }
            Promise::Rests => is_safe,
            Promise::HoldsOrRests => is_held || is_safe,
        };
        let outcome = match () {
            () if is_held => Outcome::Held,
            () if watch.rested.is_some() => Outcome::Rested,
            () => Outcome::Neither,
        };
        let first_fault = report.first_fault.map(|fault: Fault| fault.to_string());
        vec![
            Value::word(&outcome),
            safe_s.into(),
            watch.largest_current.into(),
            phase_error_deg.into(),
            Some(figures.frequency_rms_hz).filter(|rms| rms.is_finite()).into(),
            figures.direction_rms_deg.into(),
            report.state.to_string().into(),
            first_fault.unwrap_or_default().into(),
            pass.into(),
        ]
    }
}

fn set_network(operation: &mut Operation, network: ChannelParameters) {
    for operator in &mut operation.operators {
        operator.to_robot.parameters = network;
        operator.to_operator.parameters = network;
    }
}

/// Looks at every tick from the onset on.
struct Watch {
    hold: HoldMeter,
    settled: Instant,
    /// Since when both rotors have been at rest.
    rested: Option<Instant>,
    /// theta when the robot began to come to rest, rad.
    kept: Option<f64>,
    phase_error: f64,
    largest_current: f64,
}

impl Watch {
    fn new(setpoint: flix_protocol::message::Setpoint, settled: Instant) -> Self {
        Self {
            hold: HoldMeter::new(setpoint),
            settled,
            rested: None,
            kept: None,
            phase_error: 0.0,
            largest_current: 0.0,
        }
    }

    fn see(&mut self, robot: &SimulatedRobot) {
        let truth = robot.truth();
        self.largest_current = self.largest_current.max(truth.largest_current());
        if truth.time >= self.settled {
            self.hold.watch(&truth);
        }
        let is_coming_to_rest = !matches!(robot.report().state, State::Armed | State::Running);
        if is_coming_to_rest && !truth.is_slower_than(TELLING_HZ) {
            let kept = *self.kept.get_or_insert(truth.direction);
            self.phase_error = self.phase_error.max(line_error(truth.direction, kept).abs());
        }
        if truth.is_slower_than(REST_HZ) {
            self.rested.get_or_insert(truth.time);
        } else {
            self.rested = None;
        }
    }
}
