//! Commissioning of robots whose motors nobody knows: how well it finds them, and what it costs them.
//!
//! Unknown motors are of one size and wound differently, as gimbal motors are: turns of the winding change R and L with
//! their square and the flux linkage in proportion, about the assumed motor's.

use flix_host::commission::voltage_mode::find_latency;
use flix_host::commission::{CommissionError, Commissioned, Known};
use rayon::prelude::*;
use serde::Serialize;

use super::unknown_motors::{Watched, known, measured_by_hand, unknown_motors};
use super::wiring::{Wiring, search};
use crate::model::RobotModel;
use crate::plant::electronics::motor::MotorParameters;
use crate::rig::bench::BenchError;

/// Largest relative error of resistance, inductance and flux linkage.
pub const VALUE_LIMIT: f64 = 0.03;
/// Largest error of the encoder's latency, us.
pub const LATENCY_LIMIT_US: f64 = 50.0;
/// Largest phase current, A.
pub const CURRENT_LIMIT_A: f64 = 2.0;
/// How one robot was commissioned.
#[derive(Debug, Clone, Serialize)]
pub struct Trialled {
    /// Its seed.
    pub seed: u64,
    /// What was drawn.
    pub drawn: Drawn,
    /// What was found is off by this much; nothing where something went wrong.
    pub errors: Option<Errors>,
    /// What went wrong.
    pub failure: Option<String>,
    /// Largest phase current from power-up on, A.
    pub largest_current_a: f64,
    /// How often its motors came to rest because no order counted.
    pub lapses: u8,
    /// How long it took, s.
    pub seconds: f64,
}

/// A robot as it was drawn; its two motors differ from it by up to 5 % either way.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Drawn {
    /// ohm.
    pub resistance: f64,
    /// mH.
    pub inductance: f64,
    /// mWb.
    pub flux: f64,
    /// Of both motors.
    pub pole_pairs: u32,
    /// us.
    pub latency_us: f64,
    /// Whether the board measures its battery.
    pub divider: bool,
}

impl Drawn {
    fn of(model: &RobotModel) -> Self {
        let electrical = &model.electrical;
        Self {
            resistance: electrical.motor.phase_resistance_ohm,
            inductance: electrical.motor.phase_inductance_mh,
            flux: electrical.motor.flux_linkage_mwb,
            pole_pairs: electrical.motor.pole_pairs,
            latency_us: electrical.encoder.late_us,
            divider: electrical.sense.bus_uv_per_count != 0,
        }
    }
}

/// Largest errors of both motors.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Errors {
    /// Relative.
    pub resistance: f64,
    /// Relative.
    pub inductance: f64,
    /// Relative.
    pub flux: f64,
    /// Of the encoders' mean, us.
    pub latency_us: f64,
    /// Whether pole pairs and the amplifiers' sign are right.
    pub exact: bool,
}

impl Errors {
    fn of(found: &Commissioned, truth: &[MotorParameters; 2], late_us: f64) -> Self {
        let worst = |of: &dyn Fn(usize) -> f64| of(0).abs().max(of(1).abs());
        let motors = &found.motors;
        Self {
            resistance: worst(&|it| motors[it].resistance / truth[it].resistance - 1.0),
            inductance: worst(&|it| motors[it].inductance / truth[it].inductance - 1.0),
            flux: worst(&|it| motors[it].flux_linkage / truth[it].flux_linkage - 1.0),
            latency_us: (1e6 * found.encoder_latency - late_us).abs(),
            exact: truth.iter().all(|it| it.pole_pairs == found.pole_pairs),
        }
    }

    fn worse(self, other: Self) -> Self {
        Self {
            resistance: self.resistance.max(other.resistance),
            inductance: self.inductance.max(other.inductance),
            flux: self.flux.max(other.flux),
            latency_us: self.latency_us.max(other.latency_us),
            exact: self.exact && other.exact,
        }
    }

    fn passes(&self) -> bool {
        self.exact
            && self.latency_us <= LATENCY_LIMIT_US
            && [self.resistance, self.inductance, self.flux].iter().all(|it| *it <= VALUE_LIMIT)
    }
}

impl Trialled {
    /// Returns whether all was found within the limits, and no phase carried too much.
    #[must_use]
    pub fn passes(&self) -> bool {
        self.largest_current_a <= CURRENT_LIMIT_A
            && self.errors.as_ref().is_some_and(Errors::passes)
    }
}

/// How many robots were commissioned, and how well.
#[derive(Debug, Clone, Serialize)]
pub struct Commissioning {
    /// How many.
    pub robots: usize,
    /// Those of which everything was found within the limits.
    pub found: usize,
    /// Largest errors of those that came to an end.
    pub worst: Errors,
    /// Largest phase current, A.
    pub largest_current_a: f64,
    /// How often motors came to rest because no order counted.
    pub lapses: u64,
    /// Longest time, s.
    pub longest_s: f64,
    /// The same robots without current sense.
    pub voltage_mode: VoltageMode,
    /// The same robots with each wiring fault.
    pub wiring_faults: Wiring,
    /// One after the other.
    pub each: Vec<Trialled>,
    /// Whether all are within the limits.
    pub pass: bool,
}

/// Commissions so many robots of unknown motors from this seed on, over a network that loses this share of the datagrams in either
/// direction beyond the ordinary, where one is named. `done` is called after each.
///
/// # Errors
/// When a robot cannot be built.
pub fn measure(
    robots: usize,
    first_seed: u64,
    loss: Option<f64>,
    done: impl Fn() + Sync,
) -> Result<Commissioning, BenchError> {
    let seeds: Vec<u64> = (0..robots as u64).map(|count| first_seed.wrapping_add(count)).collect();
    let each = seeds
        .par_iter()
        .map(|seed| {
            let trialled = commission_unknown(*seed, loss)?;
            let late = try_in_voltage_mode(*seed, loss)?;
            let searched = search(*seed)?;
            done();
            Ok((trialled, late, searched))
        })
        .collect::<Result<Vec<_>, BenchError>>()?;
    let mut late = Vec::new();
    let (each, searched): (Vec<Trialled>, Vec<_>) = each
        .into_iter()
        .map(|(trialled, one, searched)| {
            late.push(one);
            (trialled, searched)
        })
        .unzip();
    let voltage_mode = VoltageMode::of(late);
    let wiring_faults = Wiring::of(searched.into_iter().flatten().collect());
    let ended = each.iter().filter_map(|it| it.errors);
    let largest = |of: fn(&Trialled) -> f64| each.iter().map(of).fold(0.0, f64::max);
    let found = each.iter().filter(|it| it.passes()).count();
    Ok(Commissioning {
        robots,
        found,
        worst: ended.reduce(Errors::worse).unwrap_or_default(),
        largest_current_a: largest(|it| it.largest_current_a).max(wiring_faults.largest_current_a),
        lapses: each.iter().map(|it| u64::from(it.lapses)).sum(),
        longest_s: largest(|it| it.seconds),
        pass: found == robots
            && voltage_mode.found == robots
            && wiring_faults.named == wiring_faults.tried
            && wiring_faults.largest_current_a <= CURRENT_LIMIT_A,
        voltage_mode,
        wiring_faults,
        each,
    })
}

/// Commissions the robot of one seed.
///
/// # Errors
/// When it cannot be built.
pub fn commission_unknown(seed: u64, loss: Option<f64>) -> Result<Trialled, BenchError> {
    let model = unknown_motors(seed);
    let drawn = Drawn::of(&model);
    let shaker = model.shaker;
    let mut watched = Watched::power_up(model, seed)?;
    let known = known(&shaker, seed, &watched);
    loss.inspect(|share| watched.lose(*share));
    let start = watched.operation.now();
    let found = watched.commission(&known);
    let electronics = watched.operation.robot.electronics();
    let truth = [0, 1].map(|motor| *electronics.motor(motor).parameters());
    Ok(Trialled {
        seed,
        drawn,
        errors: found.as_ref().ok().map(|found| Errors::of(found, &truth, drawn.latency_us)),
        failure: found.err().map(|error| error.to_string()),
        largest_current_a: watched.largest_current.get(),
        lapses: watched.lapses(),
        seconds: watched.operation.now().since(start).as_secs_f64(),
    })
}

/// The latency of one robot's encoders, found on a board without current sense.
#[derive(Debug, Clone, Serialize)]
pub struct Late {
    /// Its seed.
    pub seed: u64,
    /// What was drawn.
    pub drawn: Drawn,
    /// Error of the latency, us; nothing where something went wrong.
    pub error_us: Option<f64>,
    /// What went wrong.
    pub failure: Option<String>,
    /// Whether it refused while values were assumed, and no current flowed.
    pub refused_assumed: bool,
    /// Largest phase current from power-up on, A.
    pub largest_current_a: f64,
    /// How long it took, s.
    pub seconds: f64,
}

impl Late {
    /// Returns whether the latency was found within the limit, no phase carried too much, and nothing moved before values were entered.
    #[must_use]
    pub fn passes(&self) -> bool {
        self.refused_assumed
            && self.largest_current_a <= CURRENT_LIMIT_A
            && self.error_us.is_some_and(|error| error <= LATENCY_LIMIT_US)
    }
}

/// Robots without current sense.
#[derive(Debug, Clone, Serialize)]
pub struct VoltageMode {
    /// Those whose latency was found within the limit.
    pub found: usize,
    /// Largest error of those that came to an end, us.
    pub worst_us: f64,
    /// Largest phase current, A.
    pub largest_current_a: f64,
    /// Longest time, s.
    pub longest_s: f64,
    /// Those that refused while values were assumed; all must.
    pub refused_assumed: usize,
    /// One after the other.
    pub each: Vec<Late>,
}

impl VoltageMode {
    fn of(each: Vec<Late>) -> Self {
        let largest = |of: fn(&Late) -> f64| each.iter().map(of).fold(0.0, f64::max);
        Self {
            found: each.iter().filter(|it| it.passes()).count(),
            worst_us: largest(|it| it.error_us.unwrap_or_default()),
            largest_current_a: largest(|it| it.largest_current_a),
            longest_s: largest(|it| it.seconds),
            refused_assumed: each.iter().filter(|it| it.refused_assumed).count(),
            each,
        }
    }
}

/// Finds the latency of the same robot on a board without current sense, its motors measured by hand.
///
/// # Errors
/// When it cannot be built.
pub(crate) fn try_in_voltage_mode(seed: u64, loss: Option<f64>) -> Result<Late, BenchError> {
    let mut model = unknown_motors(seed);
    model.electrical.sense.current = false;
    let drawn = Drawn::of(&model);
    let mut watched = Watched::power_up(model.clone(), seed)?;
    let refused = find_latency(&mut watched, &Known::default(), |_| {});
    let refused_assumed = matches!(refused, Err(CommissionError::Assumed { .. }))
        && watched.largest_current.get() == 0.0;
    let mut entered = measured_by_hand(&watched, &model, seed);
    entered.remove("encoder_latency");
    watched.enter(entered)?;
    let known = known(&model.shaker, seed, &watched);
    loss.inspect(|share| watched.lose(*share));
    let start = watched.operation.now();
    let found = find_latency(&mut watched, &known, |_| {});
    let ended = found.as_ref().ok();
    Ok(Late {
        seed,
        drawn,
        error_us: ended.map(|it| (1e6 * it.encoder_latency - drawn.latency_us).abs()),
        failure: found.err().map(|error| error.to_string()),
        refused_assumed,
        largest_current_a: watched.largest_current.get(),
        seconds: watched.operation.now().since(start).as_secs_f64(),
    })
}
