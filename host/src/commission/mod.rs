//! Commissioning: measures the motors of a robot that knows nothing of them, over its link, and finds the settings that they
//! need.
//!
//! ```text
//! standing field   what is wired wrongly, by its name                                              wiring
//! standing field   R, L, dead time, delay of the bridges; sign and balance of the amplifiers      circuit
//! turning field    pole pairs, direction, which encoder sees it, flux linkage roughly             turning_field
//! jumping field    whether a shown ampere speeds a rotor up about as much as it should            swing
//! alignment        electrical angles and eccentricity of the encoders                             the robot's own
//! slow, then fast  flux linkage and latency of the encoders                                       running
//! ramps            what a shown ampere is worth, by the inertia of the rotors                     running
//! ```
//!
//! Every step is bounded by the robot itself: nothing of a motor is assumed until it was measured. Known are the inertia of
//! the rotors, by their mass, and the bus voltage.

pub mod circuit;
mod finding;
mod least_squares;
mod robot_under_test;
pub mod running;
mod step;
pub mod swing;
mod trials;
pub mod turning_field;
pub mod voltage_latency;
pub mod voltage_mode;
pub mod wiring;

use std::f64::consts::TAU;

use flix_protocol::message::{Fault, Faults, Setpoint};

use self::circuit::{Circuit, Phases, is_winding};
pub use self::finding::{Finding, Phase, motor_name};
use self::robot_under_test::{RobotUnderTest, slopes};
use self::running::BackEmf;
use self::step::CURRENT_LIMIT;
pub use self::step::{CommissionError, Step};
use self::trials::First;
use self::turning_field::Rotor;
use self::wiring::Stood;
use crate::link::RobotLink;

/// What somebody knows of the robot who measured it by hand.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Known {
    /// Inertia of one rotor, kg m^2; else the setting `rotor_inertia` holds.
    pub rotor_inertia: Option<f64>,
    /// Voltage of the battery while the robot rests, V: corrects the divider, or stands for it where there is none.
    pub battery: Option<f64>,
}

/// What was measured of one motor.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Motor {
    /// Terminal to star point, ohm.
    pub resistance: f64,
    /// Terminal to star point, H.
    pub inductance: f64,
    /// Peak phase back-EMF per electrical rad/s, Wb.
    pub flux_linkage: f64,
    /// True current over what the amplifiers of phases A and B show.
    pub current_gains: [f64; 2],
    /// Whether the amplifiers count down for current into the motor.
    pub current_inverted: bool,
    /// What dead time takes of a phase that carries much, V.
    pub dead_voltage: f64,
    /// The rotor as it followed a turning field.
    pub rotor: Rotor,
}

/// What was measured, and is in force until power-off.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Commissioned {
    /// Top, bottom.
    pub motors: [Motor; 2],
    /// Pole pairs of both.
    pub pole_pairs: u32,
    /// How much older a fresh encoder reading is than it says, s.
    pub encoder_latency: f64,
    /// From a tick's current sample to the middle of the interval in which its duties act, s.
    pub actuation_delay: f64,
    /// Settings that it changed: name, value before, value now.
    pub changes: Vec<(String, f32, f32)>,
}

/// Electrical frequency at which the encoder's latency is looked at first, Hz: one that is 1.3 ms off turns the field by 19
/// degrees there.
const SLOW_ELECTRICAL_HZ: f64 = 40.0;
/// Fastest shaking frequency of commissioning, Hz.
const FASTEST_HZ: f64 = 20.0;
/// Share of the bus that the back-EMF may take at the fastest.
const EMF_SHARE: f64 = 0.35;
/// Ramps go from this share of the fastest to that.
const RAMP_SHARES: [f64; 2] = [0.2, 1.0];
/// Believed first: the middle of what encoders have, s.
const FIRST_LATENCY: f64 = 1.2e-3;
/// Longest latency that the robot corrects, s.
const LONGEST_LATENCY: f64 = 3e-3;
/// Bandwidths of trackers and position loops while the latency is not known, and those of a new robot, Hz.
const CAREFUL: [f64; 2] = [60.0, 10.0];
/// That of position loops, Hz, where the resistance leaves no voltage for the current that loops may ask for at the fastest: what is
/// cut of their swinging would blur what is measured.
const CALM: f64 = 6.0;
/// Standard deviation of a rotor's speed, as a share of it, from which on the angle that swings with it makes the back-EMF look a
/// hundredth smaller. Rotors of a robot on its legs swing by up to 0.02.
const LARGEST_SWING: f64 = 0.03;
/// Where magnets are farther from where the alignment found them, electrical rad, they or the encoder have slipped: the current that
/// speeds a rotor up seems a two-hundredth larger then. Of robots that are right it is 0.02.
const LARGEST_SLIP: f64 = 0.1;
/// Phase voltage that a bridge gives, as a share of the bus.
const PHASE_SHARE: f64 = 0.577;
const QUICK: [f64; 2] = [125.0, 20.0];
/// How far a position loop may turn in its own time before it sees what it did, rad, and how late that is beside the latency of
/// the encoder, s: readings, and the tracker's own lag.
const LOOP_ADVANCE: f64 = 0.45;
const LOOP_AGE: f64 = 2.5e-3;
/// Current that speeds up the rotors when the amplifiers' scale is measured, A.
const RAMP_CURRENT: f64 = 0.3;
/// Torque that turns the rotors while aligning, N m, several times friction and cogging of motors of this size; and the
/// least and most current for it, A.
const ALIGNMENT_TORQUE: f64 = 25e-3;
const ALIGNMENT_CURRENTS: (f64, f64) = (0.3, 1.2);
/// Most current that a rotor swings by, A.
const SWING_CURRENT: f64 = 0.9;
/// Current that rotors which are still turning may drive through shorted windings, A.
const BRAKING_CURRENT: f64 = 1.0;
/// The fault of position loops that do not suit their motors.
const UNLOCKED: Faults = Faults::NONE.with(Fault::PhaseLockLost);
/// How often motors are made to run while orders stay away in the middle of it.
const MOST_RUNS: u32 = 3;
/// Gentlest and steepest ramps, Hz/s.
const RAMP_SLOPES: (f64, f64) = (10.0, 300.0);

/// Commissions a robot at rest, disarmed, without faults. `step` is called with each step as it begins. What it finds is in force
/// until power-off, and stored when the settings are saved. On an error the robot is disarmed and has the settings of
/// before, as far as it still answers.
///
/// # Errors
/// When the robot refuses, a step ends in a fault, or a motor does not behave like one.
pub fn commission<S: RobotLink>(
    robot: &mut S,
    known: &Known,
    step: impl FnMut(Step),
) -> Result<Commissioned, CommissionError<S::Error>> {
    let mut under_test = RobotUnderTest::new(robot);
    let found = measure(&mut under_test, known, step);
    under_test.conclude(found).map(|found| Commissioned { changes: under_test.changes(), ..found })
}

fn measure<S: RobotLink>(
    under_test: &mut RobotUnderTest<'_, S>,
    known: &Known,
    mut step: impl FnMut(Step),
) -> Result<Commissioned, CommissionError<S::Error>> {
    step(Step::Wiring);
    under_test.begin()?;
    if let Some(inertia) = known.rotor_inertia {
        under_test.set("rotor_inertia", 1e7 * inertia)?;
    }
    let inertia = under_test.setting("rotor_inertia")? * 1e-7;
    if let Some(battery) = known.battery {
        under_test.take_battery(battery)?;
    }
    under_test.set_each("aligned", [0.0; 2])?;
    under_test.set_each("current_gain_a", [1.0; 2])?;
    under_test.set_each("current_gain_b", [1.0; 2])?;

    under_test.look()?.check().map_err(CommissionError::Found)?;
    // Little current at first: amplifiers that show too little of it let more flow.
    let mut first = [under_test.first(0, inertia)?, under_test.first(1, inertia)?];
    let shown = first_scales(first);
    let wiring = under_test.wiring(shown)?;
    match (judge(&wiring, shown), faint(first)) {
        (Ok(()), None) => {}
        (Err(found), Some(_)) if !wiring::compares(found) => {
            return Err(CommissionError::Found(found));
        }
        (_, Some(found)) | (Err(found), None) => return Err(CommissionError::Found(found)),
    }
    for (motor, first) in first.iter_mut().enumerate().filter(|(_, it)| !it.shows) {
        // It shows by now, or just about.
        *first = under_test.first(motor, inertia)?;
        if !first.shows {
            return Err(CommissionError::Found(Finding::NotConnected(motor)));
        }
    }
    check_first(first).map_err(CommissionError::Found)?;
    let shown = first_scales(first);
    let uneven = wiring.each_ref().map(wiring::uneven);

    step(Step::Phases);
    let field = trials::standing_ma(shown);
    let (mut standing, bridges) = under_test.stand(Step::Phases, [true; 2], field)?;
    let (again, _) = under_test.stand(Step::Phases, [true; 2], field)?;
    standing.iter_mut().zip(again).for_each(|(standing, again)| standing.extend(again));
    let winding = |motor: usize, scale: f64| {
        let found = circuit::measure(&standing[motor], &bridges, scale);
        check_winding(motor, found.map(|it| it.of_uneven(uneven[motor])))
    };
    let mut windings = [winding(0, 1.0)?, winding(1, 1.0)?];
    // One bridge delays like the other.
    let delay = (windings[0].circuit.delay + windings[1].circuit.delay) / 2.0;

    step(Step::Turning(0));
    let top = under_test.turn(0, &windings[0], &bridges, shown[0])?;
    step(Step::Turning(1));
    let turned = [top, under_test.turn(1, &windings[1], &bridges, shown[1])?];
    let rotors = turned.map(|(rotor, _)| rotor);
    let [pole_pairs, of_bottom] = rotors.map(|rotor| rotor.pole_pairs());
    if pole_pairs != of_bottom {
        let finding = Finding::OtherPolePairs { top: pole_pairs, bottom: of_bottom };
        return Err(CommissionError::Found(finding));
    }
    let pairs = f64::from(pole_pairs);
    let flux = rotors.map(|rotor| rotor.flux_linkage);
    let mut swings = [None; 2];
    for motor in [0, 1] {
        let most = SWING_CURRENT * shown[motor];
        let current = alignment_current(pairs * flux[motor]).min(most).max(turned[motor].1);
        let swing = under_test.swing(motor, &windings[motor], current)?;
        // One that friction holds says nothing.
        swings[motor] = swing::scale(&swing, &rotors[motor], inertia);
    }
    let resistances = windings.map(|it| it.circuit.resistance);
    let scales = of_one_kind(swings, resistances);
    check_scales(&SCALES, scales, resistances).map_err(CommissionError::Found)?;
    // As the amplifiers show it that show least.
    let limit = CURRENT_LIMIT * scales[0].min(scales[1]).min(1.0);

    step(Step::Aligning);
    let actuation_delay = delay + circuit::TICK / 2.0;
    under_test.set("pole_pairs", pairs)?;
    under_test.set_each("phase_resistance", resistances)?;
    under_test.set_each("phase_inductance", windings.map(|it| 1e3 * it.circuit.inductance))?;
    under_test.set_each("current_gain_b", windings.map(|it| 1.0 / it.balance))?;
    under_test.set("actuation_delay", 1e6 * actuation_delay)?;
    under_test.set("tracker_bandwidth", CAREFUL[0])?;
    let bus = standing[0].bus.min(standing[1].bus);
    let weaker = 1.5 * pairs * flux[0].min(flux[1]);
    let ramp = (weaker * RAMP_CURRENT / inertia / TAU).clamp(RAMP_SLOPES.0, RAMP_SLOPES.1);
    let aligning = alignment_current(pairs * flux[0].min(flux[1])).min(limit);
    under_test.bound(ramp, aligning, limit)?;
    let runs = Runs {
        circuits: windings.map(|it| it.circuit),
        pairs,
        flux,
        bus,
        inertia,
        ramp,
        measures_bus: bridges.measures_bus,
    };
    let resistive = resistances[0].max(resistances[1]) * limit;
    let Ran { flux, latency, slopes } =
        with_either_loop(under_test, resistive, bus, |under_test, bandwidth| {
            runs.run(under_test, bandwidth, &mut step)
        })?;
    let scales = [0, 1].map(|motor| slopes[motor] * 1.5 * pairs * flux[motor] / inertia);
    check_scales(&SCALES, scales, resistances).map_err(CommissionError::Found)?;
    for motor in [0, 1] {
        windings[motor] = winding(motor, scales[motor])?;
    }
    let motors = [0, 1].map(|motor| {
        let Phases { circuit, inverted, balance, .. } = windings[motor];
        Motor {
            resistance: circuit.resistance,
            inductance: circuit.inductance,
            flux_linkage: flux[motor],
            current_gains: [1.0 / scales[motor], 1.0 / (scales[motor] * balance)],
            current_inverted: inverted,
            dead_voltage: circuit.dead_voltage,
            rotor: rotors[motor],
        }
    });
    under_test.set_each("phase_resistance", motors.map(|it| it.resistance))?;
    under_test.set_each("phase_inductance", motors.map(|it| 1e3 * it.inductance))?;
    under_test.set_each("current_gain_a", motors.map(|it| it.current_gains[0]))?;
    under_test.set_each("current_gain_b", motors.map(|it| it.current_gains[1]))?;
    under_test.set("tracker_bandwidth", QUICK[0])?;
    under_test.set_position_bandwidth(position_bandwidth(latency))?;
    under_test.unbound()?;
    let changes = Vec::new();
    Ok(Commissioned { motors, pole_pairs, encoder_latency: latency, actuation_delay, changes })
}

/// Runs with the position loop, of this bandwidth in Hz, that suits motors of this resistive voltage on this bus, V; where the phase
/// lock is lost or the rotors swing, again with the other one. A run that broke off is done again.
fn with_either_loop<S: RobotLink, T>(
    under_test: &mut RobotUnderTest<'_, S>,
    resistive: f64,
    bus: f64,
    mut run: impl FnMut(&mut RobotUnderTest<'_, S>, f64) -> Result<T, CommissionError<S::Error>>,
) -> Result<T, CommissionError<S::Error>> {
    let is_free = resistive < (PHASE_SHARE - EMF_SHARE) * bus;
    let [first, second] = if is_free { [CAREFUL[1], CALM] } else { [CALM, CAREFUL[1]] };
    let mut run = |under_test: &mut RobotUnderTest<'_, S>, bandwidth: f64| {
        under_test.until_held(MOST_RUNS, |it| run(it, bandwidth))
    };
    match run(under_test, first) {
        // Which loop keeps the lock, friction and cogging decide, too.
        Err(CommissionError::Faulted { step, faults }) if faults == UNLOCKED => {
            under_test.robot.hold(Setpoint::REST);
            under_test.clear(step, UNLOCKED)?;
            run(under_test, second)
        }
        Err(CommissionError::Found(Finding::Swings { .. })) => run(under_test, second),
        ran => ran,
    }
}

/// Runs of both motors by what was measured of them at rest.
struct Runs {
    circuits: [Circuit; 2],
    pairs: f64,
    /// Flux linkage, roughly, Wb.
    flux: [f64; 2],
    /// Bus voltage, V, and whether it is measured.
    bus: f64,
    measures_bus: bool,
    /// Of each rotor, kg m^2.
    inertia: f64,
    /// How fast f changes, Hz/s.
    ramp: f64,
}

/// What was measured of motors that ran.
struct Ran {
    /// Wb.
    flux: [f64; 2],
    /// Of the encoders, s.
    latency: f64,
    /// Current for each acceleration, A s^2/rad.
    slopes: [f64; 2],
}

impl Runs {
    /// Aligns, runs slowly, fast and by ramps with position loops of this bandwidth, Hz, and disarms.
    fn run<S: RobotLink>(
        &self,
        under_test: &mut RobotUnderTest<'_, S>,
        bandwidth: f64,
        step: &mut impl FnMut(Step),
    ) -> Result<Ran, CommissionError<S::Error>> {
        let Self { circuits, pairs, bus, ramp, .. } = *self;
        let (mut flux, mut latency) = (self.flux, FIRST_LATENCY);
        let resistances = circuits.map(|it| it.resistance);
        under_test.set("position_bandwidth", bandwidth)?;
        under_test.set("encoder_latency", 1e6 * latency)?;
        under_test.set_each("flux_linkage", flux.map(|it| 1e3 * it))?;
        under_test.arm(Step::Aligning)?;

        let fastest = flux.map(|flux| EMF_SHARE * bus / (TAU * pairs * flux));
        let fastest = FASTEST_HZ.min(fastest[0]).min(fastest[1]);
        let slow = (SLOW_ELECTRICAL_HZ / pairs).min(fastest);
        for (speed, frequency) in [(Step::Slow, slow), (Step::Fast, fastest)] {
            step(speed);
            let mut back_emfs = [[BackEmf::default(); 2]; 2];
            for (way, frequency) in [frequency, -frequency].into_iter().enumerate() {
                for (motor, steady) in
                    under_test.steady(speed, frequency, ramp)?.into_iter().enumerate()
                {
                    let swing = steady.swing;
                    if speed == Step::Fast && swing > LARGEST_SWING * frequency.abs() {
                        under_test
                            .disarm(speed, braked_from(&resistances, &flux, pairs).min(fastest))?;
                        let finding = Finding::Swings { motor, swing, frequency };
                        return Err(CommissionError::Found(finding));
                    }
                    back_emfs[motor][way] = BackEmf::of(&steady, &circuits[motor], pairs);
                }
            }
            let off = back_emfs.map(|both| running::latency(&both).unwrap_or(0.0));
            latency = (latency + (off[0] + off[1]) / 2.0).clamp(0.0, LONGEST_LATENCY);
            flux = back_emfs.map(|[one, other]| (one.flux_linkage + other.flux_linkage) / 2.0);
            under_test.disarm(speed, braked_from(&resistances, &flux, pairs).min(fastest))?;
            under_test.set("encoder_latency", 1e6 * latency)?;
            under_test.set_each("flux_linkage", flux.map(|it| 1e3 * it))?;
            under_test.arm(speed)?;
        }

        step(Step::Ramps);
        let ends = RAMP_SHARES.map(|share| share * fastest);
        let per_hertz = TAU * self.inertia / (1.5 * pairs * flux[0].max(flux[1]));
        let changes = under_test.ramps(ends, ramp, per_hertz, self.measures_bus)?;
        let last = under_test.steady(Step::Ramps, fastest, ramp)?;
        under_test.disarm(Step::Ramps, braked_from(&resistances, &flux, pairs).min(fastest))?;
        // Orders stay away while this computes: a second on a slow or busy computer.
        let slopes = slopes(&changes, ramp).map_err(CommissionError::Found)?;
        for (motor, steady) in last.iter().enumerate() {
            // The latency is right by now.
            let BackEmf { ahead, .. } = BackEmf::of(steady, &circuits[motor], pairs);
            if ahead.abs() > LARGEST_SLIP {
                let degrees = (ahead / pairs).to_degrees();
                return Err(CommissionError::Found(Finding::MagnetSlips { motor, degrees }));
            }
        }
        Ok(Ran { flux, latency, slopes })
    }
}

/// Returns the current that turns a motor of these pole pairs times flux linkage (Wb) safely, A.
fn alignment_current(linked: f64) -> f64 {
    (ALIGNMENT_TORQUE / (1.5 * linked)).clamp(ALIGNMENT_CURRENTS.0, ALIGNMENT_CURRENTS.1)
}

/// Returns the f, Hz, at which motors that are shorted by their bridges drive [`BRAKING_CURRENT`] through themselves.
fn braked_from(resistances: &[f64; 2], flux: &[f64; 2], pairs: f64) -> f64 {
    let [top, bottom] =
        [0, 1].map(|it| BRAKING_CURRENT * resistances[it] / (TAU * pairs * flux[it]));
    top.min(bottom)
}

/// Returns the bandwidth of the position loops, Hz, that bears encoders of this latency.
fn position_bandwidth(latency: f64) -> f64 {
    (LOOP_ADVANCE / (TAU * (latency + LOOP_AGE))).min(QUICK[1])
}

fn check_winding<E>(motor: usize, found: Option<Phases>) -> Result<Phases, CommissionError<E>> {
    found.filter(is_winding).ok_or(CommissionError::Found(Finding::NoWinding(motor)))
}

/// What a motor may show over the current that its inertia takes: amplifiers are within 20 %, and the stated inertia nearly
/// right.
const SCALES: std::ops::Range<f64> = 0.65..1.45;

/// The same where little current was shown and friction blurs it. Less flows than is shown beyond: that endangers nothing, and
/// what it comes from shows later, as a magnet that slips.
const FIRST_SCALES: std::ops::Range<f64> = 0.5..f64::INFINITY;
/// What amplifiers that are right show over what flows.
const RIGHT: std::ops::Range<f64> = 0.8..1.2;
/// Ratio of what both motors show over what flows where the amplifiers of one kind are wrong: each may be 20 % off, and friction
/// adds.
const LARGEST_SCALE_RATIO: f64 = 1.7;
/// Motors are of one kind: where their resistances differ by more, their amplifiers do.
const ONE_KIND: std::ops::Range<f64> = 0.5..2.0;

/// Checks what the motors show over what flows, by the resistances that they show, ohm.
fn check_scales(
    range: &std::ops::Range<f64>,
    scales: [f64; 2],
    resistances: [f64; 2],
) -> Result<(), Finding> {
    let both = Finding::CurrentScale { scale: (scales[0] + scales[1]) / 2.0 };
    let motor = match scales.map(|scale| range.contains(&scale)) {
        [true, true] => return Ok(()),
        [false, false] => return Err(both),
        [top, _] => usize::from(top),
    };
    let (scale, other) = (scales[motor], scales[1 - motor]);
    let apart = (other / scale).ln();
    let resistance = (resistances[motor] / resistances[1 - motor]).ln();
    // The other one is hardly better, or off as amplifiers of one kind may be, too.
    let is_as_bad = apart.abs() < scale.ln().abs() / 2.0;
    let is_off = !RIGHT.contains(&other) && apart.abs() < LARGEST_SCALE_RATIO.ln();
    Err(if is_as_bad || is_off {
        both
    } else if resistance / apart > 0.5 {
        // The same amplifiers show more resistance, and the same inertia less current.
        Finding::AmplifiersScale { motor, scale }
    } else if scale < range.start {
        Finding::NoMass { motor, share: scale }
    } else {
        both
    })
}

/// Returns what a motor that did not turn shows over what flows, by its resistance beside that of the other one, of its kind.
fn by_other(motor: usize, scales: [Option<f64>; 2], resistances: [f64; 2]) -> Option<f64> {
    let other = 1 - motor;
    scales[other].map(|scale| scale * resistances[other] / resistances[motor])
}

/// Returns the scales of two motors of one kind. One that did not turn and has the other's resistance is not doubted.
fn of_one_kind(scales: [Option<f64>; 2], resistances: [f64; 2]) -> [f64; 2] {
    let is_alike = ONE_KIND.contains(&(resistances[0] / resistances[1]));
    [0, 1].map(|motor| {
        let by_other = || by_other(motor, scales, resistances).filter(|_| !is_alike);
        scales[motor].or_else(by_other).unwrap_or(1.0)
    })
}

fn resistances_of(first: [First; 2]) -> [f64; 2] {
    first.map(|it| it.circuit.map_or(f64::NAN, |it| it.resistance))
}

/// Checks what little current showed.
fn check_first(first: [First; 2]) -> Result<(), Finding> {
    let resistances = resistances_of(first);
    check_scales(&FIRST_SCALES, of_one_kind(first.map(|it| it.scale), resistances), resistances)
}

/// Returns what the amplifiers of both motors show over what flows, by little current and as far as they, not the inertia of a
/// rotor, may be what is wrong, at most 1; 0 where none shows.
fn first_scales(first: [First; 2]) -> [f64; 2] {
    let finding = check_first(first).err();
    let scales = first.map(|it| it.scale);
    [0, 1].map(|motor| match (first[motor], finding) {
        (First { shows: false, .. }, _) => 0.0,
        (_, Some(Finding::NoMass { motor: it, .. })) if it == motor => 1.0,
        _ => {
            let by_other = || by_other(motor, scales, resistances_of(first));
            scales[motor].or_else(by_other).unwrap_or(1.0).min(1.0)
        }
    })
}

/// Judges the wiring by what the amplifiers show, or would if they showed a current as it is: that some lie is no fault of wires.
fn judge(wiring: &[[Stood; 3]; 2], shown: [f64; 2]) -> Result<(), Finding> {
    // What is about right may be right.
    let lies = |scale: f64| scale > 0.0 && !FIRST_SCALES.contains(&scale);
    let unscaled = [0, 1].map(|motor| {
        let scale = if lies(shown[motor]) { shown[motor] } else { 1.0 };
        wiring[motor].map(|it| it.unscaled(scale))
    });
    wiring::judge(wiring).or_else(|found| wiring::judge(&unscaled).map_err(|_| found))
}

/// Returns what is wrong where one motor shows no current, and the other none or too little: what their amplifiers show does not
/// compare phases then.
fn faint(first: [First; 2]) -> Option<Finding> {
    let scale = match first.map(|it| it.shows) {
        [false, false] => return Some(Finding::FaintCurrents),
        [true, true] => return None,
        [top, _] => first[usize::from(!top)].scale,
    };
    scale.filter(|it| *it < FIRST_SCALES.start).map(|scale| Finding::CurrentScale { scale })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wrong_is_told_from_what_both_motors_show_of_their_inertia_and_of_their_resistance() {
        let both = |scale| Err(Finding::CurrentScale { scale });
        let one = |motor, scale| Err(Finding::AmplifiersScale { motor, scale });
        let mass = |motor, share| Err(Finding::NoMass { motor, share });
        for (scales, resistances, expected) in [
            ([1.1, 0.8], [2.0, 2.5], Ok(())),
            ([0.25, 0.375], [8.0, 6.0], both(0.3125)),
            ([2.5, 2.0], [1.0, 1.2], both(2.25)),
            // Half of the current, and amplifiers 20 % off either way.
            ([0.4, 0.66], [5.0, 3.0], both(0.53)),
            ([0.1, 1.0], [20.0, 2.0], one(0, 0.1)),
            ([1.0, 3.0], [2.0, 0.7], one(1, 3.0)),
            ([1.0, 0.3], [2.0, 2.2], mass(1, 0.3)),
            ([1.0, 0.3], [2.2, 2.0], mass(1, 0.3)),
        ] {
            assert_eq!(check_scales(&SCALES, scales, resistances), expected, "{scales:?}");
        }
    }

    #[test]
    fn a_motor_that_did_not_turn_is_known_by_the_other_one_of_its_kind() {
        assert_eq!(of_one_kind([None, Some(0.1)], [0.2, 2.0]), [1.0, 0.1]);
        assert_eq!(of_one_kind([Some(1.0), None], [0.2, 2.0]), [1.0, 0.1]);
        assert_eq!(of_one_kind([Some(0.1), None], [2.0, 2.1]), [0.1, 1.0]);
        assert_eq!(of_one_kind([None, None], [2.0, 0.1]), [1.0, 1.0]);
    }

    #[test]
    fn position_loops_are_those_of_a_new_robot_unless_its_encoders_are_slow() {
        assert_eq!(position_bandwidth(0.0), QUICK[1]);
        assert_eq!(position_bandwidth(1e-3), QUICK[1]);
        assert!((13.0..16.0).contains(&position_bandwidth(2.5e-3)));
    }
}
