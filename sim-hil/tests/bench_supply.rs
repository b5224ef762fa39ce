//! On a bench supply, which takes nothing back, a board that does not measure its bus never lifts it, however the
//! rotors come to rest from full speed; theta is held meanwhile.

use core::time::Duration;

use flix_host::link::RobotLink;
use flix_protocol::message::Faults;
use flix_sim::model::RobotModel;
use flix_sim::reliability::commission::CURRENT_LIMIT_A;
use flix_sim::reliability::commissioned_accuracy::draw;
use flix_sim::reliability::unknown_motors::{Watched, measured_by_hand, unknown_motors};
use flix_sim::rig::bench::{BASES, Base, BenchError, Subject, setpoint};
use flix_sim::rig::hardware_fault::{HardwareFault, Injected};
use flix_sim::rig::operation::Operation;
use flix_sim::rig::simulated::Truth;

/// Largest bus voltage, as a share of what the supply is set to.
const LARGEST_RISE: f64 = 1.05;
/// Largest bus voltage over that of the supply while the supply is too weak for f, whatever the moment of the command.
const LARGEST_RISE_AT_CEILING: f64 = 1.08;
/// Time between two moments at which f is commanded.
const START_INTERVAL: Duration = Duration::from_micros(7_300);
/// Largest error of theta while f falls, degrees: what a step may end with.
const LARGEST_DIRECTION_ERROR_DEG: f64 = 3.0;
/// Commanded before the end, degrees.
const DIRECTION_DEG: f64 = 20.0;
/// Steepest ramp for which this is promised, Hz/s: a new robot's.
const STEEPEST: f64 = 200.0;
/// Above this theta is judged, Hz.
const JUDGED_HZ: f64 = 2.0;
/// Time to come up to speed, and to come to rest at the slowest ramp.
const SETTLING: Duration = Duration::from_secs(4);

/// What ends a run at full speed.
#[derive(Debug, Clone, Copy, PartialEq)]
enum End {
    Rest,
    Reversal,
    Stop,
    Disarm,
    Fault,
    Jam,
    LostLink,
}

const ENDS: [End; 7] =
    [End::Rest, End::Reversal, End::Stop, End::Disarm, End::Fault, End::Jam, End::LostLink];

/// A robot on a stand.
#[derive(Debug, Clone, Copy)]
struct Setup {
    measures_current: bool,
    measures_bus: bool,
    /// Else on a bench supply.
    on_battery: bool,
    /// Hz/s.
    ramp: f64,
    seed: u64,
}

impl Setup {
    const ON_BENCH_SUPPLY: Self = Self {
        measures_current: true,
        measures_bus: false,
        on_battery: false,
        ramp: STEEPEST,
        seed: 1,
    };

    fn shaking(self) -> Result<Operation, BenchError> {
        let mut model = RobotModel::named("W")?;
        let electrical = &mut model.electrical;
        electrical.pack.takes_charge = self.on_battery;
        electrical.sense.current = self.measures_current;
        if !self.measures_bus {
            electrical.sense.bus_uv_per_count = 0;
        }
        electrical.settings.insert("frequency_ramp".to_owned(), self.ramp);
        let subject = Subject { model: Some(model), seed: self.seed };
        let mut operation = subject.on(Base::Fixed)?;
        operation.arm()?;
        operation.want(setpoint(35.0, DIRECTION_DEG)?);
        operation.run(SETTLING, |_| {})?;
        assert!(operation.robot.truth().frequency() > 34.9, "{self:?}");
        Ok(operation)
    }
}

/// What the end of a run showed.
#[derive(Debug)]
struct Seen {
    /// Highest bus voltage over what the supply is set to.
    rise: f64,
    direction_error_deg: f64,
    /// What the supply gave, J.
    given: f64,
}

fn end(setup: Setup, end: End) -> Result<Seen, BenchError> {
    let mut operation = setup.shaking()?;
    let now = operation.now();
    let (set, given) = {
        let supply = operation.robot.electronics().battery();
        (supply.open_circuit_voltage(), supply.delivered())
    };
    let mut seen = Seen { rise: 0.0, direction_error_deg: 0.0, given: 0.0 };
    let mut target = 0.0;
    match end {
        End::Rest => operation.want(setpoint(target, DIRECTION_DEG)?),
        End::Reversal => {
            target = -35.0;
            operation.want(setpoint(target, DIRECTION_DEG)?);
        }
        End::Stop => operation.client().stop(now),
        End::Disarm => operation.client().disarm(now),
        End::Fault | End::Jam => {
            let fault = match end {
                End::Fault => HardwareFault::EncoderLost(0),
                _ => HardwareFault::Jammed(0, 1.0),
            };
            operation.robot.disturb(Injected::new(fault, now, now + SETTLING, 1));
        }
        End::LostLink => operation.operators[0].is_gone = true,
    }
    operation.run(SETTLING, |truth| {
        seen.rise = seen.rise.max(truth.bus_voltage / set);
        if truth.frequency().abs() > JUDGED_HZ {
            let error = (truth.direction.to_degrees() - DIRECTION_DEG).rem_euclid(180.0);
            seen.direction_error_deg = seen.direction_error_deg.max(error.min(180.0 - error));
        }
    })?;
    seen.given = operation.robot.electronics().battery().delivered() - given;
    let reached = operation.robot.truth().frequency();
    assert!((reached - target).abs() < 0.3, "{setup:?}, {end:?}: {reached} Hz");
    Ok(seen)
}

#[test]
fn no_way_to_come_to_rest_lifts_the_bus_of_a_bench_supply() {
    for measures_current in [true, false] {
        for (ramp, seed) in [(20.0, 1), (STEEPEST, 2), (STEEPEST, 3)] {
            let setup = Setup { measures_current, ramp, seed, ..Setup::ON_BENCH_SUPPLY };
            for what in ENDS {
                let seen = end(setup, what).unwrap();
                assert!(seen.rise < LARGEST_RISE, "{setup:?}, {what:?}: {seen:?}");
            }
        }
    }
}

#[test]
fn theta_is_held_while_f_falls_unless_a_fault_brakes() {
    for (measures_current, ramp) in
        [(true, STEEPEST), (false, STEEPEST), (true, 20.0), (false, 20.0)]
    {
        let setup = Setup { measures_current, ramp, ..Setup::ON_BENCH_SUPPLY };
        for what in ENDS.into_iter().filter(|it| !matches!(it, End::Fault | End::Jam)) {
            let seen = end(setup, what).unwrap();
            assert!(
                seen.direction_error_deg < LARGEST_DIRECTION_ERROR_DEG,
                "{setup:?}, {what:?}: {seen:?}"
            );
        }
    }
}

/// f, Hz; theta, degrees; for so long, s.
type Step = (f64, f64, f64);

/// Returns a step at the usual theta.
const fn at(f: f64, seconds: f64) -> Step {
    (f, DIRECTION_DEG, seconds)
}

/// What [`shaken`] saw.
#[derive(Debug)]
struct Shaken {
    /// Highest bus voltage over what the supply is set to.
    rise: f64,
    faults: Faults,
    /// Largest current of a phase, A.
    current: f64,
}

impl Shaken {
    fn is_well(&self) -> bool {
        self.rise < LARGEST_RISE && self.faults == Faults::NONE && self.current < CURRENT_LIMIT_A
    }
}

/// Shakes a robot without a battery divider, with motors of this flux linkage (mWb), resistance (ohm) and inductance (mH), on a
/// nearly empty supply that takes nothing back, at each f and theta for so long.
fn shaken(
    measures_current: bool,
    (flux, resistance, inductance): (f64, f64, f64),
    settings: &[(&str, f64)],
    course: &[Step],
) -> Shaken {
    let mut model = RobotModel::named("W").unwrap();
    let electrical = &mut model.electrical;
    electrical.pack.takes_charge = false;
    [electrical.pack.charge_at_least, electrical.pack.charge_at_most] = [0.1; 2];
    electrical.sense.current = measures_current;
    electrical.sense.bus_uv_per_count = 0;
    electrical.motor.flux_linkage_mwb = flux;
    electrical.motor.phase_resistance_ohm = resistance;
    electrical.motor.phase_inductance_mh = inductance;
    let watched = Watched::power_up(model.clone(), 1).unwrap();
    let entered = settings.iter().map(|(name, value)| ((*name).to_owned(), *value));
    let by_hand = measured_by_hand(&watched, &model, 1);
    model.electrical.settings.extend(by_hand.into_iter().chain(entered));
    let mut operation = Subject { model: Some(model), seed: 1 }.on(Base::Fixed).unwrap();
    operation.arm().unwrap();
    let set = operation.robot.electronics().battery().open_circuit_voltage();
    let (mut highest, mut current) = (0.0_f64, 0.0_f64);
    for (f, direction, seconds) in course {
        operation.want(setpoint(*f, *direction).unwrap());
        let look = |truth: &Truth| {
            highest = highest.max(truth.bus_voltage);
            current = current.max(truth.largest_current());
        };
        operation.run(Duration::from_secs_f64(*seconds), look).unwrap();
    }
    Shaken { rise: highest / set, faults: operation.robot.report().faults, current }
}

#[test]
fn a_reversal_of_motors_that_do_not_reach_what_is_asked_lifts_no_supply() {
    for measures_current in [true, false] {
        for motor in [(5.0, 5.0, 1.0), (6.0, 4.0, 1.0), (5.0, 2.5, 1.0)] {
            let seen = shaken(measures_current, motor, &[], &[at(35.0, 3.0), at(-35.0, 2.0)]);
            assert!(seen.is_well(), "{motor:?}: {seen:?}");
        }
    }
}

#[test]
fn f_beyond_the_ceiling_that_is_raised_again_while_it_falls_lifts_no_supply() {
    for measures_current in [true, false] {
        for (low, seconds) in [(10.0, 0.06), (0.0, 0.1), (-35.0, 0.1), (20.0, 0.04)] {
            let course = [at(35.0, 3.0), at(low, seconds), at(35.0, 0.5)];
            let seen = shaken(measures_current, (4.2, 5.0, 1.0), &[], &course);
            assert!(seen.is_well(), "{low} Hz: {seen:?}");
        }
    }
}

#[test]
fn the_current_that_burns_ends_as_softly_as_it_begins() {
    // What an inductance holds goes back, too: 3 mH lifted the supply by up to 28 %.
    let lowered = [at(35.0, 1.5), at(28.0, 0.5), at(27.0, 0.3), at(8.0, 0.05), at(35.0, 0.5)];
    let strong = [at(10.0, 0.3), at(35.0, 1.0)];
    for measures_current in [true, false] {
        for motor in [(3.0, 0.9, 3.0), (3.0, 2.5, 3.0), (3.0, 0.9, 1.0), (4.4, 0.9, 2.0)] {
            for (ramp, course) in
                [(20.0, &lowered[..]), (39.0, &strong), (STEEPEST, &lowered), (STEEPEST, &strong)]
            {
                let seen = shaken(measures_current, motor, &[("frequency_ramp", ramp)], course);
                assert!(seen.is_well(), "{motor:?} {ramp} {course:?}: {seen:?}");
            }
        }
    }
}

#[test]
fn a_reversal_from_the_ceiling_lifts_no_supply_whatever_its_ramp() {
    for (ramp, motor) in [(39.0, (4.2, 5.0, 1.0)), (39.0, (4.6, 2.5, 1.0)), (30.0, (4.6, 2.5, 1.0))]
    {
        for back in [&[at(-35.0, 3.0)][..], &[at(-35.0, 0.4), at(35.0, 1.0)]] {
            let course = [&[at(35.0, 4.0)], back].concat();
            let seen = shaken(true, motor, &[("frequency_ramp", ramp)], &course);
            assert!(seen.is_well(), "{ramp} {back:?}: {seen:?}");
        }
    }
}

#[test]
fn a_slow_reversal_of_motors_at_their_limits_is_no_lost_lock() {
    for measures_current in [true, false] {
        let ramp = [("frequency_ramp", 5.0)];
        let course = [at(35.0, 12.0), at(-35.0, 12.0)];
        let seen = shaken(measures_current, (4.2, 5.0, 1.0), &ramp, &course);
        assert!(seen.is_well(), "{seen:?}");
    }
}

#[test]
fn what_burns_while_f_falls_stays_below_the_current_limit() {
    // One in ten robots drawn, and windings of 0.12 to 0.24 ohm, passed it by up to 2.3 times.
    let drawn = [7_300_186, 7_500_003, 7_500_004].map(|seed| (seed, 30.0, draw(seed, true)));
    let strangers = [7_600_019, 7_600_028].map(|seed| (seed, 20.0, unknown_motors(seed)));
    for (seed, f, mut model) in drawn.into_iter().chain(strangers) {
        model.electrical.sense.bus_uv_per_count = 0;
        // Of amplifiers as commissioning leaves them.
        model.electrical.sense.current_gain_error = 0.02;
        let mut watched = Watched::power_up(model.clone(), seed).unwrap();
        watched.enter(measured_by_hand(&watched, &model, seed)).unwrap();
        watched.operation.arm().unwrap();
        for f in [f, -f, 0.5 * f] {
            watched.operation.want(setpoint(f, 0.0).unwrap());
            watched.operation.run(Duration::from_secs(1), |_| {}).unwrap();
        }
        let report = watched.operation.robot.report();
        assert_eq!(report.faults, Faults::NONE, "{seed}");
        let largest = watched.largest_current.get();
        assert!(largest < CURRENT_LIMIT_A, "{seed}: {largest} A");
    }
}

#[test]
fn a_battery_on_a_board_that_measures_its_bus_takes_back_what_the_rotors_give() {
    let setup = Setup { measures_bus: true, on_battery: true, ..Setup::ON_BENCH_SUPPLY };
    let seen = end(setup, End::Rest).unwrap();
    assert!(seen.given < -0.1, "{seen:?}");
}

#[test]
fn f_at_the_limit_of_a_weak_supply_does_not_hunt_nor_lift_it() {
    // A tenth of a volt too little for 35 Hz, or as much to spare. At the ceiling a free body of seed 960049 lifts the bus by 1.6 to
    // 6.9 %, depending on the moment of the command.
    for (seed, measures_current, starts) in
        [(960_113, true, 1), (960_113, false, 1), (960_049, true, 10), (940_038, true, 1)]
    {
        let mut model = draw(seed, measures_current);
        model.electrical.sense.bus_uv_per_count = 0;
        model.electrical.pack.takes_charge = false;
        let watched = Watched::power_up(model.clone(), seed).unwrap();
        model.electrical.settings.extend(measured_by_hand(&watched, &model, seed));
        for base in BASES {
            let mut rises = Vec::new();
            for start in 0..starts {
                let subject = Subject { model: Some(model.clone()), seed };
                let mut operation = subject.on(base).unwrap();
                operation.arm().unwrap();
                operation.run(START_INTERVAL * start, |_| {}).unwrap();
                operation.want(setpoint(35.0, 0.0).unwrap());
                operation.run(Duration::from_secs(2), |_| {}).unwrap();
                let set = operation.robot.electronics().battery().open_circuit_voltage();
                let (mut highest, mut sum, mut count) = (0.0_f64, 0.0, 0.0);
                let look = |truth: &Truth| {
                    highest = highest.max(truth.bus_voltage);
                    sum += truth.frequency();
                    count += 1.0;
                };
                operation.run(Duration::from_secs(4), look).unwrap();
                let (rise, f) = (highest / set, sum / count);
                assert!(
                    rise < LARGEST_RISE_AT_CEILING && f > 33.9,
                    "{seed}, {base}: {rise}, {f} Hz"
                );
                rises.push(rise);
            }
            let mean = rises.iter().sum::<f64>() / rises.len() as f64;
            assert!(mean < LARGEST_RISE, "{seed}, {base}: {rises:?}");
        }
    }
}
