//! Switches, sensors and magnets that fail while the robot runs: named, and no motor is cooked.

use core::time::Duration;

use flix_host::link::RobotLink;
use flix_protocol::message::Fault;
use flix_sim::model::RobotModel;
use flix_sim::plant::electronics::inverter::{Leg, Rail};
use flix_sim::rig::bench::{Base, Subject, setpoint};
use flix_sim::rig::hardware_fault::{HardwareFault, Injected};
use flix_sim::rig::operation::Operation;

/// Most that a phase may carry before a fault is named, and after it with the motors of the bench, A.
const MOST_A: f64 = 2.2;
/// The limit of the driver, and a little more, A.
const OVER_A: f64 = 2.6;
/// For ever.
const STAYS: Duration = Duration::from_secs(3_600);

/// What was seen of a robot in which something failed.
#[derive(Debug)]
struct Seen {
    /// The fault, and how long after the failure.
    fault: Option<(Fault, Duration)>,
    /// Largest phase current until the fault, and after it, A.
    largest_a: [f64; 2],
    theta_off_deg: f64,
    /// For how long a phase carried more than [`OVER_A`].
    over: Duration,
    /// Copper heat of both motors over the last 0.2 s, W, and what the battery gave from 20 ms after the failure on, J.
    heat_w: f64,
    drawn_j: f64,
}

/// Returns a robot that holds f, Hz, and theta, 20 degrees, with motors of this resistance (ohm) that it knows.
fn holding(senses_current: bool, ohm: f64, f: f64, seed: u64) -> Operation {
    let model = RobotModel::named(Base::Fixed.model()).unwrap();
    holding_of(model, senses_current, ohm, f, seed)
}

/// The same of this model.
fn holding_of(
    mut model: RobotModel,
    senses_current: bool,
    ohm: f64,
    f: f64,
    seed: u64,
) -> Operation {
    let electrical = &mut model.electrical;
    electrical.sense.current = senses_current;
    electrical.motor.phase_inductance_mh *= ohm / electrical.motor.phase_resistance_ohm;
    electrical.motor.phase_resistance_ohm = ohm;
    for motor in ["top", "bottom"] {
        let settings = &mut electrical.settings;
        settings.insert(format!("{motor}_phase_resistance"), ohm);
        settings.insert(format!("{motor}_phase_inductance"), electrical.motor.phase_inductance_mh);
    }
    let mut operation = Subject { model: Some(model), seed }.on(Base::Fixed).unwrap();
    operation.arm().unwrap();
    operation.want(setpoint(f, 20.0).unwrap());
    operation.run(Duration::from_secs(1), |_| {}).unwrap();
    operation
}

/// Looks on for so long after a failure.
fn failing(operation: &mut Operation, fault: HardwareFault, watched: Duration) -> Seen {
    let begin = operation.now();
    operation.robot.disturb(Injected::new(fault, begin, begin + STAYS, 1));
    let mut seen = Seen {
        fault: None,
        largest_a: [0.0; 2],
        theta_off_deg: 0.0,
        over: Duration::ZERO,
        heat_w: 0.0,
        drawn_j: 0.0,
    };
    let last = Duration::from_millis(200);
    while operation.now() < begin + watched {
        let before = operation.now();
        let ledger = operation.robot.electronics().ledger([0.0; 2]);
        if before == begin + Duration::from_millis(20) {
            seen.drawn_j -= ledger.battery;
        }
        if before + last == begin + watched {
            seen.heat_w -= ledger.copper;
        }
        operation.tick().unwrap();
        let truth = operation.robot.truth();
        if truth.largest_current() > OVER_A {
            seen.over += operation.now().since(before);
        }
        if let (None, Some(fault)) = (seen.fault, operation.robot.report().first_fault) {
            seen.fault = Some((fault, operation.now().since(begin)));
        }
        let largest = &mut seen.largest_a[usize::from(seen.fault.is_some())];
        *largest = largest.max(truth.largest_current());
        let off = (truth.direction.to_degrees() - 20.0 + 90.0).rem_euclid(180.0) - 90.0;
        seen.theta_off_deg = seen.theta_off_deg.max(off.abs());
    }
    let ledger = operation.robot.electronics().ledger([0.0; 2]);
    seen.drawn_j += ledger.battery;
    seen.heat_w = (seen.heat_w + ledger.copper) / last.as_secs_f64();
    seen
}

#[test]
fn a_bus_that_is_misread_is_named_before_a_phase_carries_more_than_walks() {
    for (seed, senses_current) in (1..).zip([true, false]) {
        for fault in
            [HardwareFault::BusReads(0.0), HardwareFault::BusReads(0.5), HardwareFault::BusFloats]
        {
            for ohm in [2.5, 0.3] {
                for f in [10.0, -30.0] {
                    let mut operation = holding(senses_current, ohm, f, seed);
                    let seen = failing(&mut operation, fault, Duration::from_millis(600));
                    let case = format!("{fault:?} {senses_current} {ohm} ohm {f} Hz: {seen:?}");
                    let (named, after) = seen.fault.expect(&case);
                    assert_eq!(named, Fault::BusSense, "{case}");
                    assert!(after < Duration::from_millis(100), "{case}");
                    assert!(seen.largest_a[0] < MOST_A, "{case}");
                    // A motor of less resistance brakes with more.
                    assert!(ohm < 1.0 || seen.largest_a[1] < MOST_A, "{case}");
                }
            }
        }
    }
}

#[test]
fn one_reading_of_the_bus_changes_nothing() {
    for (seed, senses_current) in (1..).zip([true, false]) {
        for share in [0.0, 0.5, 1.2] {
            for ohm in [2.5, 0.3] {
                let mut operation = holding(senses_current, ohm, 30.0, seed);
                let fault = HardwareFault::BusOutliers(share);
                let seen = failing(&mut operation, fault, Duration::from_millis(600));
                let case = format!("{share} {senses_current} {ohm} ohm: {seen:?}");
                assert!(seen.fault.is_none() && seen.theta_off_deg < 1.0, "{case}");
                assert!(seen.largest_a[0] < 0.6, "{case}");
            }
        }
    }
}

#[test]
fn an_upper_switch_that_is_short_takes_nothing_from_the_battery_and_the_rotors_are_at_rest_soon() {
    for (seed, ohm) in (1..).zip([2.5, 0.3]) {
        for f in [0.0, 10.0, -30.0, 35.0] {
            for (motor, phase) in [(0, 0), (1, 1), (0, 2)] {
                let mut operation = holding(true, ohm, f, seed);
                let fault = HardwareFault::Leg(motor, phase, Leg::Shorted(Rail::High));
                let seen = failing(&mut operation, fault, Duration::from_millis(600));
                let case = format!("{motor} {phase} {ohm} ohm {f} Hz: {seen:?}");
                let (named, after) = seen.fault.expect(&case);
                assert!(matches!(named, Fault::OverCurrent | Fault::CurrentSense), "{case}");
                assert!(after < Duration::from_millis(50), "{case}");
                assert!(seen.drawn_j < 1.0 && seen.heat_w < 0.1, "{case}");
                assert!(ohm < 1.0 || seen.over < Duration::from_millis(10), "{case}");
                assert!(operation.robot.truth().is_slower_than(0.5), "{case}");
            }
        }
    }
}

#[test]
fn a_bridge_that_cannot_coast_stays_on_the_rail_of_the_switch_that_is_short_until_it_is_armed_anew()
{
    let mut model = RobotModel::named(Base::Fixed.model()).unwrap();
    model.electrical.inverter.can_coast = false;
    for (f, leg) in [(10.0, Leg::Shorted(Rail::High)), (-30.0, Leg::Stuck(Rail::High))] {
        let mut operation = holding_of(model.clone(), true, 2.5, f, 1);
        let fault = HardwareFault::Leg(0, 1, leg);
        let seen = failing(&mut operation, fault, Duration::from_millis(1_500));
        assert!(seen.drawn_j < 1.0 && seen.heat_w < 0.1, "{f} Hz {leg:?}: {seen:?}");
        assert!(operation.robot.truth().is_slower_than(0.5), "{f} Hz {leg:?}");
    }
}
