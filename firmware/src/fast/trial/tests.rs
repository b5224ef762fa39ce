//! What a trial promises, on the bench.

use super::*;
use crate::fast::control::bench::Bench;
use crate::fast::exchange::Wanted;
use flix_protocol::message::State;

const HALVE: Trial =
    Trial { motors: [true; 2], current_ma: 700, angle: 0, pattern: Pattern::Halve(20), ticks: 800 };

/// A bench whose motors are of this resistance (ohm) and inductance (H), at a trial.
fn at_trial(resistance: f64, inductance: f64, trial: Trial) -> Bench {
    let mut bench = Bench::new(None);
    for motor in &mut bench.motors {
        (motor.resistance, motor.inductance) = (resistance, inductance);
    }
    bench.run(0.05);
    bench.peak_current = 0.0;
    bench.asked.trial = Some(trial);
    bench.want(Wanted::Try);
    bench.until(State::Aligning);
    bench
}

/// Runs to the first tick of the captured pattern.
fn to_pattern(bench: &mut Bench) {
    let came = (0..60_000).any(|_| {
        bench.tick();
        bench.control.sample(&[], 0).is_pattern
    });
    assert!(came, "no pattern: {}", bench.control.report().faults);
}

/// Voltage along phase A of a motor's bridge, V.
fn voltage(bench: &Bench, motor: usize) -> f64 {
    let Bridge::Duty(duties) = bench.last.bridges[motor] else { return 0.0 };
    let [a, b, c] = duties.map(|duty| bench.bus * f64::from(duty.raw()) / 65_536.0);
    (2.0 * a - b - c) / 3.0
}

#[test]
fn any_motor_carries_its_reference_or_bears_two_watts_and_no_more() {
    for (resistance, inductance) in [(0.6, 0.8e-3), (2.5, 1e-3), (9.0, 5e-3)] {
        let mut bench = at_trial(resistance, inductance, HALVE);
        to_pattern(&mut bench);
        // Where the voltage is whole.
        bench.run(0.003_5);
        let current = bench.motors[0].phases()[0];
        let bearable = (2.0_f64 / 1.5 / resistance).sqrt();
        let expected = bearable.min(0.7);
        assert!((current / expected - 1.0).abs() < 0.15, "{resistance} ohm: {current} A");
        assert!(bench.peak_current < 1.4, "{resistance} ohm: {} A", bench.peak_current);
        bench.until(State::Disarmed);
        bench.run(0.6);
        assert!(bench.control.report().faults.is_empty());
        assert_eq!(bench.last.bridges, [Bridge::Off; 2]);
    }
}

#[test]
fn the_voltage_of_the_pattern_is_whole_and_half_in_turn() {
    let mut bench = at_trial(2.5, 1e-3, HALVE);
    to_pattern(&mut bench);
    let voltages: std::vec::Vec<f64> = (0..80)
        .map(|_| {
            bench.tick();
            voltage(&bench, 0)
        })
        .collect();
    let whole = voltages.iter().copied().fold(0.0, f64::max);
    let halves = voltages.iter().filter(|it| (*it / whole - 0.5).abs() < 0.002).count();
    let wholes = voltages.iter().filter(|it| (*it / whole - 1.0).abs() < 0.002).count();
    assert_eq!((halves, wholes), (40, 40), "{voltages:?}");
}

#[test]
fn a_turning_field_takes_its_rotor_along_and_leaves_the_other_alone() {
    for (driven, speed) in [(0, 66), (1, -66)] {
        let pattern = Pattern::Turn(speed);
        let motors = [driven == 0, driven == 1];
        let trial = Trial { motors, pattern, ticks: 3_000, current_ma: 800, angle: 0 };
        let mut bench = at_trial(2.5, 1e-3, trial);
        to_pattern(&mut bench);
        let before = [0, 1].map(|motor| bench.motors[motor].angle);
        bench.run(0.3);
        let turned = [0, 1].map(|motor| (bench.motors[motor].angle - before[motor]).abs());
        // 66 of 2^16 turn a tick, 7 pole pairs.
        let expected = 66.0 / 65_536.0 * 3_000.0 / 7.0 * core::f64::consts::TAU;
        assert!((turned[driven] / expected - 1.0).abs() < 0.05, "{turned:?}");
        assert!(turned[1 - driven] < 0.01, "{turned:?}");
        assert_eq!(bench.last.bridges[1 - driven], Bridge::BRAKE);
    }
}

#[test]
fn without_a_current_that_shows_the_voltage_stays_harmless() {
    let mut bench = at_trial(0.6, 0.8e-3, HALVE);
    bench.sense_dead = Some(2060);
    let mut most: f64 = 0.0;
    for _ in 0..20_000 {
        bench.tick();
        most = most.max(voltage(&bench, 0));
    }
    assert_eq!(bench.control.report().first_fault, Some(Fault::CurrentSense));
    assert!(most < 0.18 && bench.peak_current < 0.3, "{most} V, {} A", bench.peak_current);
}

#[test]
fn a_rotor_that_swings_to_the_field_hides_the_current_for_a_while() {
    // Its back-EMF takes the voltage at which a current must show, wherever it stands.
    for turns in 1..14 {
        let mut bench = Bench::new(None);
        for motor in &mut bench.motors {
            (motor.resistance, motor.inductance, motor.flux) = (8.2, 2.5e-3, 10e-3);
            (motor.coulomb, motor.cogging) = (0.05e-3, 0.0);
            motor.angle += core::f64::consts::TAU * f64::from(turns) / 98.0;
        }
        bench.run(0.05);
        bench.asked.trial = Some(Trial { current_ma: 300, ..HALVE });
        bench.want(Wanted::Try);
        bench.until(State::Aligning);
        to_pattern(&mut bench);
    }
}

#[test]
fn a_current_that_comes_at_once_ends_the_trial() {
    let mut bench = at_trial(2.5, 1e-3, HALVE);
    to_pattern(&mut bench);
    for motor in &mut bench.motors {
        motor.resistance = 0.8;
    }
    bench.run(0.02);
    assert!(bench.control.report().faults.contains(Fault::OverCurrent));
    assert!(bench.peak_current < 2.0, "{}", bench.peak_current);
}

#[test]
fn a_zero_that_no_amplifier_has_ends_the_trial() {
    let mut bench = at_trial(2.5, 1e-3, HALVE);
    bench.sense_offset = 900;
    bench.run(0.5);
    assert_eq!(bench.control.report().first_fault, Some(Fault::CurrentSense));
    assert!(bench.peak_current < 0.01);
}

#[test]
fn a_stop_and_a_silent_operator_end_a_trial_at_any_stage() {
    for ticks in [100, 1_000, 3_000, 12_000] {
        for stop in [true, false] {
            let mut bench = at_trial(2.5, 1e-3, Trial { ticks: 10_000, ..HALVE });
            bench.run(f64::from(ticks) * 1e-4);
            assert_eq!(bench.state(), State::Aligning, "{ticks}");
            if stop {
                bench.asked.stops += 1;
            } else {
                bench.keep_alive = false;
            }
            bench.run(if stop { 0.001 } else { 1.1 });
            assert_eq!(bench.state(), State::Disarmed, "{ticks}");
            bench.run(0.6);
            assert!(bench.fastest() < 0.1 && bench.last.bridges == [Bridge::Off; 2]);
        }
    }
}

#[test]
fn a_robot_arms_after_a_trial_and_a_trial_disarms_an_armed_robot_first() {
    let mut bench = at_trial(2.5, 1e-3, HALVE);
    bench.until(State::Disarmed);
    bench.arm();
    bench.want(Wanted::Try);
    bench.until(State::Disarmed);
    bench.until(State::Aligning);
}
