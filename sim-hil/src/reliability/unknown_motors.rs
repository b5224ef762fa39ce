//! A robot whose motors nobody knows, and its owner.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use flix_firmware::settings::Settings;
use flix_host::commission::{CommissionError, Commissioned, Known, commission, motor_name};
use flix_host::link::{Client, RobotLink};
use flix_protocol::message::{Command, Outcome, ParameterCommand, Refusal, Setpoint};
use flix_protocol::units::Instant;
use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::model::{RobotModel, Shaker};
use crate::plant::electronics::Electronics;
use crate::rig::bench::{Base, BenchError, Subject};
use crate::rig::operation::{Operation, OperationError};
use crate::rig::simulated::Disturbance;
use crate::rig::wiring_fault::Miswired;

/// How well a voltmeter reads, as a share.
const VOLTMETER_ERROR: f64 = 0.005;

/// How much longer than asked a host pauses, at most.
const LATEST: Duration = Duration::from_millis(20);

/// By how much values measured by hand are off, as a share.
pub const BY_HAND: f64 = 0.03;
/// By how much their latency is, us.
pub const LATE_BY_HAND_US: f64 = 50.0;

/// Draws a robot with unknown motors, encoders and amplifiers, the same for the same seed.
///
/// R 0.1 to 10 ohm, L 20 uH to 5 mH, flux linkage 0.5 to 10 mWb, 4 to 14 pole pairs, latency of the encoders 0 to 2.5 ms, gain
/// errors to 20 %, with and without a battery divider.
///
#[must_use]
pub fn unknown_motors(seed: u64) -> RobotModel {
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

/// Returns what its owner knows of the robot of this seed: its rotors' inertia, and the battery by a voltmeter.
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

/// Returns resistance, inductance and flux linkage of both motors as they are, each as its setting.
pub fn motor_values(watched: &Watched) -> impl Iterator<Item = (String, f64)> {
    let electronics = watched.operation.robot.electronics();
    [0, 1].into_iter().flat_map(move |motor| {
        let truth = electronics.motor(motor).parameters();
        [
            ("phase_resistance", truth.resistance),
            ("phase_inductance", 1e3 * truth.inductance),
            ("flux_linkage", 1e3 * truth.flux_linkage),
        ]
        .map(|(name, value)| (format!("{}_{name}", motor_name(motor)), value))
    })
}

/// Returns the settings that somebody enters who has measured the motors of this robot by hand, and the battery where the board does
/// not, and knows the rotors' inertia and how late the encoders are.
#[must_use]
pub fn measured_by_hand(watched: &Watched, model: &RobotModel, seed: u64) -> BTreeMap<String, f64> {
    let mut source = Xoshiro256PlusPlus::seed_from_u64(seed.rotate_left(32));
    let mut error = || 2.0 * source.random::<f64>() - 1.0;
    let mut settings = BTreeMap::new();
    for (name, value) in motor_values(watched) {
        settings.insert(name, value * (1.0 + BY_HAND * error()));
    }
    let late = model.electrical.encoder.late_us + LATE_BY_HAND_US * error();
    settings.insert("encoder_latency".to_owned(), late.max(0.0));
    settings.insert("rotor_inertia".to_owned(), 1e7 * rotor_inertia(&model.shaker));
    settings.insert("pole_pairs".to_owned(), model.electrical.motor.pole_pairs.into());
    if model.electrical.sense.bus_uv_per_count == 0 {
        let battery = watched.operation.robot.truth().bus_voltage;
        settings.insert("nominal_voltage".to_owned(), battery * (1.0 + VOLTMETER_ERROR * error()));
    }
    settings
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

/// A simulated robot, the largest current that any of its phases ever carried, and a host whose pauses last longer than asked.
pub struct Watched {
    /// The robot and its operator.
    pub operation: Operation,
    /// From power-up on.
    pub largest_current: Ammeter,
    /// Of the host.
    late: Xoshiro256PlusPlus,
}

impl Watched {
    /// Powers it up on the fixed bench, and lets it connect and its link prove steady.
    ///
    /// # Errors
    /// When it cannot be built or connected to.
    pub fn power_up(model: RobotModel, seed: u64) -> Result<Self, BenchError> {
        Self::power_up_with(model, seed, None)
    }

    /// Powers up, as [`Watched::power_up`] does, one that is wired wrongly.
    ///
    /// # Errors
    /// When it cannot be built or connected to.
    pub fn power_up_with(
        model: RobotModel,
        seed: u64,
        miswired: Option<Miswired>,
    ) -> Result<Self, BenchError> {
        let subject = Subject { model: Some(model), seed };
        let mut operation = subject.on(Base::Fixed)?;
        if let Some(miswired) = miswired {
            operation.robot.disturb(miswired);
        }
        Self::of(operation, seed)
    }

    /// Lets a robot that was just powered up, wherever it stands, connect and its link prove steady.
    ///
    /// # Errors
    /// When it cannot be connected to.
    pub fn of(operation: Operation, seed: u64) -> Result<Self, BenchError> {
        let late = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut watched = Self { operation, largest_current: Ammeter::default(), late };
        watched.operation.robot.disturb(watched.largest_current.clone());
        watched.wait_until_connected()?;
        // As a new robot: nobody knows its motors.
        watched.request(Command::Parameter(ParameterCommand::Reset))?;
        watched.pause(Duration::from_millis(300))?;
        Ok(watched)
    }

    /// Loses this share of all datagrams from now on, in either direction.
    pub fn lose(&mut self, share: f64) {
        for operator in &mut self.operation.operators {
            for channel in [&mut operator.to_robot, &mut operator.to_operator] {
                channel.parameters.loss = share;
            }
        }
    }

    /// Returns how often motors that were driven came to rest because no order counted, modulo 256.
    #[must_use]
    pub fn lapses(&self) -> u8 {
        let events = &self.operation.robot.report().events;
        events.command_deadline.wrapping_add(events.command_age)
    }

    /// Returns all its settings, and how they are known.
    #[must_use]
    pub fn settings(&self) -> Settings {
        *self.operation.robot.software().slow.settings()
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

    /// Enters settings as a person does, who then lowers the bandwidth of the position loops where the robot asks for it. Returns
    /// all that was entered.
    ///
    /// # Errors
    /// When the robot does not answer.
    pub fn enter(
        &mut self,
        mut settings: BTreeMap<String, f64>,
    ) -> Result<BTreeMap<String, f64>, OperationError> {
        for (name, value) in &settings {
            self.set(name.as_str(), *value as f32)?;
        }
        if let Outcome::Refused(Refusal::UnstablePosition {
            position_bandwidth_instead: instead,
            ..
        }) = self.request(Command::Parameter(ParameterCommand::Check))?
        {
            let name = "position_bandwidth";
            self.set(name, instead)?;
            settings.insert(name.to_owned(), instead.into());
        }
        Ok(settings)
    }
}

impl RobotLink for Watched {
    type Error = OperationError;

    fn operate(&mut self) -> (&mut Client, Instant) {
        self.operation.operate()
    }

    fn wait(&mut self, longest: Duration) -> Result<(), OperationError> {
        self.operation.wait(longest)
    }

    fn pause(&mut self, duration: Duration) -> Result<(), OperationError> {
        let late = LATEST.mul_f64(self.late.random());
        Ok(self.operation.run(duration + late, |_| {})?)
    }

    /// Its owner is a person.
    fn hold(&mut self, setpoint: Setpoint) {
        self.want(setpoint);
    }
}
