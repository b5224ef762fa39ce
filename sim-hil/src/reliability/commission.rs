//! Commissioning of robots whose motors nobody knows: how well it finds them, and what it costs them.
//!
//! A stranger's motors are of one size and wound differently, as gimbal motors are: turns of the winding change R and L with
//! their square and the flux linkage in proportion, about the assumed motor's.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use flix_host::commission::{
    CommissionError, Commissioned, Known, Subject as Commissionable, commission,
};
use flix_protocol::message::{
    Command, Outcome, ParameterCommand, Refusal, Setpoint, State, Telemetry,
};
use flix_protocol::units::Instant;
use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use serde::Serialize;

use super::wiring::{Wiring, search};
use crate::model::{RobotModel, Shaker};
use crate::plant::Plant;
use crate::plant::electronics::Electronics;
use crate::plant::electronics::motor::MotorParameters;
use crate::rig::bench::{Base, BenchError, Subject};
use crate::rig::operation::{Operation, OperationError, PATIENCE};
use crate::rig::robot::Disturbance;
use crate::rig::wiring_fault::Miswired;

/// Largest relative error of resistance, inductance and flux linkage.
pub const VALUE_LIMIT: f64 = 0.03;
/// Largest error of the encoder's latency, us.
pub const LATENCY_LIMIT_US: f64 = 50.0;
/// Largest phase current, A.
pub const CURRENT_LIMIT_A: f64 = 2.0;
/// How well a voltmeter reads, as a share.
const VOLTMETER_ERROR: f64 = 0.005;

/// Draws a robot with unknown motors, encoders and amplifiers, the same for the same seed.
///
/// R 0.1 to 10 ohm, L 20 uH to 5 mH, flux linkage 0.5 to 10 mWb, 4 to 14 pole pairs, latency of the encoders 0 to 2.5 ms, gain
/// errors to 20 %, with and without a battery divider.
///
#[must_use]
pub fn stranger(seed: u64) -> RobotModel {
    let mut source = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut share = || source.random::<f64>();
    let mut model = bench_model();
    let electrical = &mut model.electrical;
    let motor = &mut electrical.motor;
    let assumed = *motor;
    // Within `factor` either way, evenly in its logarithm.
    let mut about = |factor: f64| factor.powf(2.0 * share() - 1.0);
    // Wound for 0.1 to 10 ohm.
    let resistance = about(10.0);
    let turns = (resistance / assumed.phase_resistance_ohm).sqrt();
    motor.phase_resistance_ohm = resistance;
    motor.phase_inductance_mh =
        (assumed.phase_inductance_mh * turns * turns * about(2.0)).clamp(0.02, 5.0);
    motor.flux_linkage_mwb = (assumed.flux_linkage_mwb * turns * about(1.5)).clamp(0.5, 10.0);
    motor.cogging_torque_mn_m *= about(1.5);
    motor.coulomb_friction_mn_m *= about(1.5);
    motor.pole_pairs = 4 + (11.0 * share()) as u32;
    motor.cogging_periods = 12 * motor.pole_pairs;
    electrical.encoder.late_us = 2_500.0 * share();
    electrical.sense.current_gain_error = 0.2;
    if share() < 0.5 {
        electrical.sense.bus_uv_per_count = 0;
    }
    model
}

/// Returns the shipped bench.
pub(super) fn bench_model() -> RobotModel {
    match RobotModel::named(Base::Fixed.model()) {
        Ok(model) => model,
        Err(error) => unreachable!("the shipped bench is damaged: {error}"),
    }
}

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
    /// Longest time, s.
    pub longest_s: f64,
    /// The same robots without current sense that refused to be measured; all must.
    pub refused_without_current_sense: usize,
    /// The same robots with each wiring fault.
    pub wiring_faults: Wiring,
    /// One after the other.
    pub each: Vec<Trialled>,
    /// Whether all are within the limits.
    pub pass: bool,
}

/// Commissions so many strangers from this seed on. `done` is called after each.
///
/// # Errors
/// When a robot cannot be built.
pub fn measure(
    robots: usize,
    first_seed: u64,
    done: impl Fn() + Sync,
) -> Result<Commissioning, BenchError> {
    let seeds: Vec<u64> = (0..robots as u64).map(|count| first_seed.wrapping_add(count)).collect();
    let each = seeds
        .par_iter()
        .map(|seed| {
            let trialled = try_stranger(*seed)?;
            let refused = is_refused_without_sense(*seed)?;
            let searched = search(*seed)?;
            done();
            Ok((trialled, refused, searched))
        })
        .collect::<Result<Vec<_>, BenchError>>()?;
    let refused_without_current_sense = each.iter().filter(|it| it.1).count();
    let (each, searched): (Vec<Trialled>, Vec<_>) = each.into_iter().map(|it| (it.0, it.2)).unzip();
    let wiring_faults = Wiring::of(searched.into_iter().flatten().collect());
    let ended = each.iter().filter_map(|it| it.errors);
    let largest = |of: fn(&Trialled) -> f64| each.iter().map(of).fold(0.0, f64::max);
    let found = each.iter().filter(|it| it.passes()).count();
    Ok(Commissioning {
        robots,
        found,
        worst: ended.reduce(Errors::worse).unwrap_or_default(),
        largest_current_a: largest(|it| it.largest_current_a).max(wiring_faults.largest_current_a),
        longest_s: largest(|it| it.seconds),
        refused_without_current_sense,
        pass: found == robots
            && refused_without_current_sense == robots
            && wiring_faults.named == wiring_faults.tried
            && wiring_faults.largest_current_a <= CURRENT_LIMIT_A,
        wiring_faults,
        each,
    })
}

/// Commissions one stranger.
///
/// # Errors
/// When it cannot be built.
pub fn try_stranger(seed: u64) -> Result<Trialled, BenchError> {
    let model = stranger(seed);
    let drawn = Drawn::of(&model);
    let shaker = model.shaker;
    let mut watched = Watched::power_up(model, seed)?;
    let known = known(&shaker, seed, &watched);
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
        seconds: watched.operation.now().since(start).as_secs_f64(),
    })
}

/// Returns what its owner knows of this seed's stranger: its rotors' inertia, and the battery by a voltmeter.
pub(super) fn known(shaker: &Shaker, seed: u64, watched: &Watched) -> Known {
    let mut source = Xoshiro256PlusPlus::seed_from_u64(!seed);
    let error = VOLTMETER_ERROR * (2.0 * source.random::<f64>() - 1.0);
    let battery = watched.operation.robot.truth().bus_voltage * (1.0 + error);
    Known { rotor_inertia: Some(rotor_inertia(shaker)), battery: Some(battery) }
}

/// Returns the inertia of one rotor about its shaft, kg m^2.
#[must_use]
pub const fn rotor_inertia(shaker: &Shaker) -> f64 {
    1e-9 * shaker.mass_g * shaker.arm_mm * shaker.arm_mm + 1e-7 * shaker.bell_inertia_g_cm2
}

/// Returns whether the same stranger on a board without current sense refuses to be measured and no current ever flows.
fn is_refused_without_sense(seed: u64) -> Result<bool, BenchError> {
    let mut model = stranger(seed);
    model.electrical.sense.current = false;
    let mut watched = Watched::power_up(model, seed)?;
    let found = watched.commission(&Known::default());
    let refusal = OperationError::Refused(Refusal::NoCurrentSense);
    let is_refused = matches!(found, Err(CommissionError::Robot(error)) if error == refusal);
    Ok(is_refused && watched.largest_current.get() == 0.0)
}

/// Holds the largest current that any phase of a robot carried, A. It disturbs nothing; clones share the reading.
#[derive(Debug, Clone, Default)]
pub struct Ammeter(Arc<AtomicU64>);

impl Ammeter {
    /// Returns it.
    #[must_use]
    pub fn get(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed))
    }
}

impl Disturbance for Ammeter {
    fn electronics(&mut self, _now: Instant, electronics: &mut Electronics) {
        let currents = electronics.phase_currents();
        let largest =
            currents.as_flattened().iter().fold(self.get(), |most, it| most.max(it.abs()));
        self.0.store(largest.to_bits(), Ordering::Relaxed);
    }
}

/// A simulated robot on the fixed bench, and the largest current that any of its phases ever carried.
pub struct Watched {
    /// The robot and its operator.
    pub operation: Operation<Plant>,
    /// From power-up on.
    pub largest_current: Ammeter,
}

impl Watched {
    /// Powers it up, and lets it connect and its link prove steady.
    ///
    /// # Errors
    /// When it cannot be built or connected to.
    pub fn power_up(model: RobotModel, seed: u64) -> Result<Self, BenchError> {
        Self::power_up_with(model, seed, None)
    }

    /// The same of a robot that is wired wrongly.
    ///
    /// # Errors
    /// When it cannot be built or connected to.
    pub fn power_up_with(
        model: RobotModel,
        seed: u64,
        miswired: Option<Miswired>,
    ) -> Result<Self, BenchError> {
        let subject = Subject { model: Some(model), seed };
        let largest_current = Ammeter::default();
        let mut watched = Self { operation: subject.on(Base::Fixed)?, largest_current };
        watched.operation.robot.disturb(watched.largest_current.clone());
        if let Some(miswired) = miswired {
            watched.operation.robot.disturb(miswired);
        }
        watched.operation.connect()?;
        // As a new robot: nobody knows its motors.
        watched.operation.ask(Command::Parameter(ParameterCommand::Reset))?;
        watched.pause(Duration::from_millis(300))?;
        Ok(watched)
    }

    /// Commissions it.
    ///
    /// # Errors
    /// As [`commission`].
    pub fn commission(
        &mut self,
        known: &Known,
    ) -> Result<Commissioned, CommissionError<OperationError>> {
        commission(self, known, |_| {})
    }
}

impl Commissionable for Watched {
    type Error = OperationError;

    fn ask(&mut self, command: Command) -> Result<Outcome, OperationError> {
        let end = self.operation.now() + PATIENCE;
        loop {
            match self.operation.ask(command.clone())? {
                Outcome::Refused(refusal)
                    if flix_host::link::passes(&refusal) && self.operation.now() < end =>
                {
                    self.pause(Duration::from_millis(20))?;
                }
                Outcome::Refused(refusal) => return Err(OperationError::Refused(refusal)),
                outcome => return Ok(outcome),
            }
        }
    }

    fn pause(&mut self, duration: Duration) -> Result<(), OperationError> {
        Ok(self.operation.run(duration, |_| {})?)
    }

    fn telemetry(&mut self) -> Option<Telemetry> {
        self.operation.client().telemetry().copied()
    }

    fn arm(&mut self) -> Result<(), OperationError> {
        self.operation.arm()
    }

    fn disarm(&mut self) -> Result<(), OperationError> {
        self.operation.client().release();
        self.ask(Command::Disarm)?;
        self.operation.await_state(&[State::Disarmed])
    }

    fn hold(&mut self, setpoint: Setpoint) {
        self.operation.hold(setpoint);
    }
}
