//! What commissioning finds in many robots, and when something changes meanwhile.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use flix_firmware::settings::Settings;
use flix_host::commission::{CommissionError, Finding, Known, Step, commission};
use flix_protocol::units::Instant;
use flix_sim::model::{RobotModel, SIMULATED_BOARD};
use flix_sim::plant::Plant;
use flix_sim::plant::electronics::Electronics;
use flix_sim::reliability::commission::{CURRENT_LIMIT_A, motors, voltage_mode, wiring_faults};
use flix_sim::reliability::unknown_motors::{Watched, rotor_inertia, unknown_motors};
use flix_sim::rig::bench::bench_key;
use flix_sim::rig::hardware_fault::{HardwareFault, Injected};
use flix_sim::rig::lossy_network::ChannelParameters;
use flix_sim::rig::operation::{Operation, OperationError};
use flix_sim::rig::simulated::{Disturbance, RobotParameters, SimulatedRobot};
use flix_sim::rig::wiring_fault::{Miswired, WiringFault};
use flix_sim::study::compute;

#[test]
fn robots_of_unknown_motors_find_their_own_values_and_name_what_is_wired_wrongly() {
    let seeds = [2, 3, 4];
    for study in [motors(&seeds, 0.01), voltage_mode(&seeds, 0.01), wiring_faults(&seeds)] {
        let table = compute(&study);
        assert!(table.pass(), "{table:?}");
    }
}

/// Requests that orders overtake, and captures whose beginning is heard of late, ended these three.
#[test]
fn robots_find_their_values_where_a_third_of_all_datagrams_is_lost() {
    let table = compute(&motors(&[7, 31, 77], 0.3));
    assert!(table.pass(), "{table:?}");
}

/// Lets the top rotor rub for some time after its test says that the ramps begin.
struct Rub {
    ramps: Arc<AtomicBool>,
    held: f64,
    after: Duration,
    length: Duration,
    begun: Option<Injected>,
}

impl Disturbance for Rub {
    fn electronics(&mut self, now: Instant, electronics: &mut Electronics) {
        if self.begun.is_none() && self.ramps.load(Ordering::Relaxed) {
            let from = now + self.after;
            let jammed = HardwareFault::Jammed(0, self.held);
            self.begun = Some(Injected::new(jammed, from, from + self.length, 1));
        }
        if let Some(begun) = &mut self.begun {
            begun.electronics(now, electronics);
        }
    }
}

/// What the ramps take is friction and inertia: friction that changes among them would be taken for inertia.
#[test]
fn a_rotor_that_begins_to_rub_while_it_is_measured_is_named_and_the_settings_stay_as_they_were() {
    let mut model = unknown_motors(9_201);
    for (measures_bus, held, after, seconds) in [
        (false, 0.004, 24_100, 200),
        (false, 0.004, 12_200, 1),
        (false, 0.004, 24_100, 15),
        (false, 0.002, 3_100, 47),
        (true, 0.004, 3_100, 200),
        (true, 0.004, 6_100, 200),
        (true, 0.004, 8_100, 1),
    ] {
        model.electrical.sense.bus_uv_per_count = if measures_bus { 4_464 } else { 0 };
        let mut robot = Watched::power_up(model.clone(), 9_201).unwrap();
        let battery = Some(robot.operation.robot.electronics().battery().open_circuit_voltage());
        let ramps = Arc::new(AtomicBool::new(false));
        let (after, length) = (Duration::from_millis(after), Duration::from_secs(seconds));
        let begun = None;
        robot.operation.robot.disturb(Rub {
            ramps: Arc::clone(&ramps),
            held,
            after,
            length,
            begun,
        });
        let before = robot.settings();
        let known = Known { rotor_inertia: Some(rotor_inertia(&model.shaker)), battery };
        let found = commission(&mut robot, &known, |step| {
            ramps.fetch_or(step == Step::Ramps, Ordering::Relaxed);
        });
        let Err(CommissionError::Found(finding)) = found else { panic!("{found:?}") };
        assert!(matches!(finding, Finding::Uneven { motor: 0, .. }), "{finding:?}");
        let after = robot.settings();
        let kept =
            |it: &Settings| (it.marks, it.phase_resistance, it.frequency_ramp, it.current_limit);
        assert_eq!(kept(&after), kept(&before));
    }
}

/// It moves, and what a rotor takes with it: values are then less exact, but nothing is wrong.
#[test]
fn a_robot_that_stands_on_its_legs_is_commissioned_too() {
    let model = RobotModel::named("W").unwrap();
    for seed in 1..=6 {
        let parameters = RobotParameters::of(&model.electrical, bench_key(), seed).unwrap();
        let robot = SimulatedRobot::new(parameters, Plant::new(&model).unwrap());
        let operation = Operation::new(robot, ChannelParameters::QUIET_WIFI);
        let mut robot = Watched::of(operation, seed).unwrap();
        let inertia = Some(rotor_inertia(&model.shaker));
        let found =
            commission(&mut robot, &Known { rotor_inertia: inertia, battery: None }, |_| {});
        let found = found.unwrap();
        for (motor, found) in found.motors.iter().enumerate() {
            let has = robot.operation.robot.electronics().motor(motor).parameters();
            let off = |found: f64, is: f64| (found / is - 1.0).abs();
            assert!(off(found.resistance, has.resistance) < 0.06, "{seed}: {found:?}");
            assert!(off(found.flux_linkage, has.flux_linkage) < 0.02, "{seed}: {found:?}");
        }
    }
}

/// Commissions a robot whose amplifiers show another current than flows. Returns what is found, and the largest current, A.
fn with_wrong_shunts(
    seed: u64,
    fault: WiringFault,
) -> (Result<(), CommissionError<OperationError>>, f64) {
    let model = unknown_motors(seed);
    let rotor_inertia = Some(rotor_inertia(&model.shaker));
    let miswired = Miswired::new(fault, SIMULATED_BOARD.current_sense, seed);
    let mut robot = Watched::power_up_with(model, seed, Some(miswired)).unwrap();
    let battery = Some(robot.operation.robot.truth().bus_voltage);
    let found = robot.commission(&Known { rotor_inertia, battery });
    (found.map(drop), robot.largest_current.get())
}

/// What amplifiers show of the current.
const TOO_LITTLE: [f64; 5] = [0.05, 0.1, 0.2, 0.35, 0.5];

#[test]
fn amplifiers_that_show_a_twentieth_to_half_of_the_current_let_no_more_than_2_a_flow() {
    // The rotor of 320019 swings back while the first current is held, and doubled it.
    let drawn = (1..=10).zip(TOO_LITTLE.into_iter().cycle());
    for (seed, share) in drawn.chain([(320_019, 0.05)]) {
        let (found, largest) = with_wrong_shunts(seed, WiringFault::OtherBoard(share));
        let Err(CommissionError::Found(finding)) = found else { panic!("{seed} {share}") };
        let is_named = matches!(finding, Finding::CurrentScale { .. } | Finding::FaintCurrents);
        assert!(is_named, "seed {seed}, {share}: {finding}");
        assert!(largest < CURRENT_LIMIT_A, "seed {seed}, {share}: {largest} A");
    }
}

#[test]
fn amplifiers_of_one_motor_that_show_too_little_are_named_as_that_motors() {
    for (seed, share) in (1..=10).zip(TOO_LITTLE.into_iter().cycle()) {
        let motor = seed as usize % 2;
        let (found, largest) = with_wrong_shunts(seed, WiringFault::AmplifiersGain(motor, share));
        let Err(CommissionError::Found(finding)) = found else { panic!("{seed} {share}") };
        let named = match finding {
            Finding::AmplifiersScale { motor, .. } | Finding::NotConnected(motor) => Some(motor),
            _ => None,
        };
        assert_eq!(named, Some(motor), "seed {seed}, {share}: {finding}");
        assert!(largest < CURRENT_LIMIT_A, "seed {seed}, {share}: {largest} A");
    }
}
