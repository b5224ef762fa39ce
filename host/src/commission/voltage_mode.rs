//! Commissioning of a robot that measures no phase currents: what was entered bounds them, and how late the encoders are is found.

use std::f64::consts::TAU;
use std::time::Duration;

use flix_protocol::message::{Bridges, Command, Mark, Outcome};

use super::robot_under_test::{Done, RobotUnderTest};
use super::voltage_latency::{self, Entered, Turned};
use super::{
    CAREFUL, CommissionError, EMF_SHARE, FASTEST_HZ, FIRST_LATENCY, Finding, Known,
    LONGEST_LATENCY, QUICK, RAMP_CURRENT, RAMP_SLOPES, SLOW_ELECTRICAL_HZ, Step, alignment_current,
    braked_from, motor_name, position_bandwidth, with_either_loop,
};
use crate::link::RobotLink;

/// Fastest electrical frequency, Hz: beyond it a turned voltage swings the rotors.
const FASTEST_ELECTRICAL_HZ: f64 = 80.0;
/// Steepest ramp, Hz/s, and captures over which a mean is taken.
const STEEPEST: f64 = 40.0;
const CAPTURES: usize = 3;
/// Furthest that a voltage is turned, rad.
const LARGEST_TURN: f64 = 0.3;
/// Nothing but these bounds the current, A: what the loops ask for, of which 0.85 may flow against the magnets while f falls, what
/// the turned voltage drives beside it, and what a latency drives that is as far from the one believed first as encoders have it.
/// They are 1.9 A together.
const HELD_CURRENT: f64 = 1.3;
const TURNED_CURRENT: f64 = 0.4;
const MISTAKEN_CURRENT: f64 = 0.35;
/// Most that voltages may be off a motor as it was entered, as a share of its back-EMF at the fastest.
const LARGEST_MISFIT: f64 = 0.1;
/// By how much both encoders' latencies, of one kind, may differ, s.
const LARGEST_DIFFERENCE: f64 = 0.4e-3;

/// What was found, and is in force until power-off.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Latency {
    /// How much older a fresh encoder reading is than it says, s.
    pub encoder_latency: f64,
    /// Settings that were entered and that this rests on.
    pub rests_on: Vec<String>,
    /// Settings that it changed: name, value before, value now.
    pub changes: Vec<(String, f32, f32)>,
}

/// Steps that it goes through.
pub const STEPS: [Step; 4] = [Step::Wiring, Step::Aligning, Step::Slow, Step::Fast];

/// Returns what a robot answers of its board's bridges.
///
/// # Errors
/// When it does not answer.
pub fn bridges<S: RobotLink>(robot: &mut S) -> Result<Bridges, CommissionError<S::Error>> {
    match robot.ask(Command::Bridges)? {
        Outcome::Bridges(bridges) => Ok(bridges),
        _ => Err(CommissionError::OtherAnswer),
    }
}

/// Finds how late the encoders are of a robot at rest, disarmed, without faults, whose board measures no phase currents. Pole pairs,
/// resistance, inductance and flux linkage must have been entered, each to 5 %. The voltage is turned by at most 17 degrees against
/// the magnets, and by less where that would drive more than 0.4 A.
///
/// What it finds is in force until power-off, and stored when the settings are saved. On an error the robot is disarmed and has the
/// settings of before, as far as it still answers.
///
/// # Errors
/// When a value was not entered, the robot refuses, a step ends in a fault, or a motor is another than was entered.
pub fn find_latency<S: RobotLink>(
    robot: &mut S,
    known: &Known,
    step: impl FnMut(Step),
) -> Result<Latency, CommissionError<S::Error>> {
    let bridges = bridges(robot)?;
    let mut under_test = RobotUnderTest::new(robot);
    let found = find(&mut under_test, &bridges, known, step);
    under_test.conclude(found).map(|found| Latency { changes: under_test.changes(), ..found })
}

fn find<S: RobotLink>(
    under_test: &mut RobotUnderTest<'_, S>,
    bridges: &Bridges,
    known: &Known,
    mut step: impl FnMut(Step),
) -> Result<Latency, CommissionError<S::Error>> {
    step(Step::Wiring);
    under_test.begin()?;
    let mut rests_on = Vec::new();
    let pairs = entered(under_test, "pole_pairs", &mut rests_on)?;
    let motors = [
        entered_motor(under_test, 0, &mut rests_on)?,
        entered_motor(under_test, 1, &mut rests_on)?,
    ];
    // Zero is the board's own.
    if under_test.setting("actuation_delay")? > 0.0 {
        rests_on.push("actuation_delay".to_owned());
    }
    if let Some(inertia) = known.rotor_inertia {
        under_test.set("rotor_inertia", 1e7 * inertia)?;
    }
    let inertia = under_test.setting("rotor_inertia")? * 1e-7;
    if let Some(battery) = known.battery {
        under_test.take_battery(battery)?;
    }
    let bus = under_test.bus()?;

    step(Step::Aligning);
    let weaker = pairs * motors[0].flux_linkage.min(motors[1].flux_linkage);
    let ramp = (1.5 * weaker * RAMP_CURRENT / inertia / TAU).clamp(RAMP_SLOPES.0, STEEPEST);
    under_test.set("tracker_bandwidth", CAREFUL[0])?;
    under_test.bound(ramp, alignment_current(weaker), HELD_CURRENT)?;
    let resistive = motors[0].resistance.max(motors[1].resistance) * HELD_CURRENT;
    let runs = Runs { motors, pairs, bus, bridges, ramp };
    let encoder_latency = with_either_loop(under_test, resistive, bus, |under_test, bandwidth| {
        runs.run(under_test, bandwidth, &mut step)
    })?;
    under_test.set("tracker_bandwidth", QUICK[0])?;
    under_test.set_position_bandwidth(position_bandwidth(encoder_latency))?;
    under_test.unbound()?;
    under_test.set_back("alignment_current")?;
    Ok(Latency { encoder_latency, rests_on, changes: Vec::new() })
}

/// Returns a value that somebody entered or measured, and notes its name.
fn entered<S: RobotLink>(
    under_test: &mut RobotUnderTest<'_, S>,
    name: &str,
    names: &mut Vec<String>,
) -> Done<f64, S> {
    let (value, mark) = under_test.marked(name)?;
    names.push(name.to_owned());
    match mark {
        Some(Mark::Assumed) => Err(CommissionError::Assumed { name: name.to_owned() }),
        _ => Ok(value),
    }
}

fn entered_motor<S: RobotLink>(
    under_test: &mut RobotUnderTest<'_, S>,
    motor: usize,
    names: &mut Vec<String>,
) -> Done<Entered, S> {
    let mut of = |name: &str| entered(under_test, &format!("{}_{name}", motor_name(motor)), names);
    Ok(Entered {
        resistance: of("phase_resistance")?,
        inductance: 1e-3 * of("phase_inductance")?,
        flux_linkage: 1e-3 * of("flux_linkage")?,
    })
}

/// Runs of both motors as they were entered.
struct Runs<'a> {
    motors: [Entered; 2],
    pairs: f64,
    /// V.
    bus: f64,
    bridges: &'a Bridges,
    /// Hz/s.
    ramp: f64,
}

impl Runs<'_> {
    /// Aligns, and runs slowly and fast with position loops of this bandwidth, Hz, the voltage turned ahead and back. Returns
    /// the latency, s.
    fn run<S: RobotLink>(
        &self,
        under_test: &mut RobotUnderTest<'_, S>,
        bandwidth: f64,
        step: &mut impl FnMut(Step),
    ) -> Result<f64, CommissionError<S::Error>> {
        let Self { motors, pairs, bus, .. } = *self;
        let mut latency = FIRST_LATENCY;
        under_test.set("position_bandwidth", bandwidth)?;
        under_test.set("encoder_latency", 1e6 * latency)?;
        under_test.set_each("aligned", [0.0; 2])?;
        under_test.arm(Step::Aligning)?;
        let mut offsets = [0.0; 2];
        let mut orders = [1.0; 2];
        for motor in [0, 1] {
            let name = motor_name(motor);
            offsets[motor] = under_test.setting(&format!("{name}_electrical_offset"))?;
            let reversed = under_test.setting(&format!("{name}_phases_reversed"))?;
            orders[motor] = if reversed == 0.0 { 1.0 } else { -1.0 };
        }
        let flux = motors.map(|it| it.flux_linkage);
        let resistances = motors.map(|it| it.resistance);
        let fastest = flux.map(|flux| EMF_SHARE * bus / (TAU * pairs * flux));
        let fastest =
            (FASTEST_ELECTRICAL_HZ / pairs).min(FASTEST_HZ).min(fastest[0]).min(fastest[1]);
        let braked_from = braked_from(&resistances, &flux, pairs).min(fastest);
        let slow = motors.iter().map(careful_electrical).fold(SLOW_ELECTRICAL_HZ, f64::min);
        let slow = (slow / pairs).min(fastest / 2.0);
        under_test.disarm(Step::Aligning, braked_from)?;

        let mut seen: [Vec<Turned>; 2] = Default::default();
        for (speed, frequency) in [(Step::Slow, slow), (Step::Fast, fastest)] {
            step(speed);
            let omega = TAU * pairs * frequency;
            let turns =
                motors.map(|it| voltage_latency::turn(&it, omega, TURNED_CURRENT, LARGEST_TURN));
            for way in [0.0, 1.0, -1.0] {
                let angles = turns.map(|turn| way * turn);
                let turned =
                    [0, 1].map(|motor| wrapped(offsets[motor] + angles[motor].to_degrees()));
                under_test.set_each("electrical_offset", turned)?;
                under_test.arm(speed)?;
                for frequency in [frequency, -frequency] {
                    // Turning round takes twice the ramp.
                    let ramping = Duration::from_secs_f64(2.0 * frequency.abs() / self.ramp);
                    for (motor, steady) in under_test
                        .long_steady(speed, frequency, ramping, CAPTURES)?
                        .into_iter()
                        .enumerate()
                    {
                        let order = orders[motor];
                        seen[motor].push(Turned {
                            angle: angles[motor],
                            latency,
                            speed: TAU * pairs * order * steady.speed,
                            current: order * steady.current,
                            voltage: [steady.voltage[0], order * steady.voltage[1]],
                        });
                    }
                }
                under_test.disarm(speed, braked_from)?;
            }
            let mut latencies = [0.0; 2];
            for motor in [0, 1] {
                let found =
                    voltage_latency::measure(&motors[motor], &seen[motor], self.bridges, bus)
                        .ok_or(CommissionError::Found(Finding::OtherMotor(motor)))?;
                if found.misfit > LARGEST_MISFIT * omega * flux[motor] {
                    return Err(CommissionError::Found(Finding::OtherMotor(motor)));
                }
                latencies[motor] = found.latency;
            }
            if speed == Step::Fast && (latencies[0] - latencies[1]).abs() > LARGEST_DIFFERENCE {
                let [top_us, bottom_us] = latencies.map(|it| 1e6 * it);
                let finding = Finding::EncodersDiffer { top_us, bottom_us };
                return Err(CommissionError::Found(finding));
            }
            latency = ((latencies[0] + latencies[1]) / 2.0).clamp(0.0, LONGEST_LATENCY);
            under_test.set("encoder_latency", 1e6 * latency)?;
        }
        under_test.set_each("electrical_offset", offsets)?;
        Ok(latency)
    }
}

/// Returns the electrical frequency, Hz, at which a latency that nobody knows drives [`MISTAKEN_CURRENT`]: it turns the back-EMF by
/// its angle, over the resistance.
fn careful_electrical(motor: &Entered) -> f64 {
    let mistake = LONGEST_LATENCY - FIRST_LATENCY;
    (MISTAKEN_CURRENT * motor.resistance / (motor.flux_linkage * mistake)).sqrt() / TAU
}

/// Returns an angle within half a turn, degrees.
fn wrapped(degrees: f64) -> f64 {
    (degrees + 180.0).rem_euclid(360.0) - 180.0
}
