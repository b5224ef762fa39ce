//! What the fast half promises, on the bench.

use crate::control::bench::{Bench, HARDWARE, parameters};
use crate::hardware::Bridge;
use flix_protocol::message::{Fault, State};

const FREE: Option<f64> = Some(0.35);
const PAIRS: [(f32, f32); 6] =
    [(10.0, 0.0), (20.0, 30.0), (30.0, -60.0), (-30.0, 90.0), (35.0, 0.0), (-35.0, 45.0)];

fn armed(base: Option<f64>) -> Bench {
    let mut bench = Bench::new(base);
    bench.arm();
    bench
}

fn running(base: Option<f64>, frequency: f32, direction: f32) -> Bench {
    let mut bench = armed(base);
    bench.command(frequency, direction);
    bench.run(0.7);
    assert_eq!(bench.state(), State::Running);
    bench
}

#[test]
fn holds_frequency_and_direction_on_a_fixed_base() {
    let mut bench = armed(None);
    for (frequency, direction) in PAIRS {
        bench.command(frequency, direction);
        bench.run(0.5);
        let held = bench.hold(frequency.into(), direction.into(), 0.5);
        assert!(held.frequency < 0.01 && held.direction < 0.15, "{frequency} {direction} {held:?}");
    }
}

#[test]
fn holds_frequency_and_direction_on_a_base_that_drives_back() {
    let mut bench = armed(FREE);
    for (frequency, direction) in PAIRS {
        bench.command(frequency, direction);
        bench.run(0.5);
        let held = bench.hold(frequency.into(), direction.into(), 0.5);
        assert!(held.frequency < 0.01 && held.direction < 0.15, "{frequency} {direction} {held:?}");
    }
}

#[test]
fn alignment_finds_offset_phase_order_and_eccentricity() {
    let mut bench = Bench::new(FREE);
    bench.motors[1].reversed = true;
    bench.arm();
    let report = bench.control.report();
    assert_eq!(report.alignments, 1);
    for (motor, found) in bench.motors.iter().zip(report.alignment) {
        assert_eq!(found.reversed, motor.reversed);
        let radians = |turn: i32| f64::from(turn) / 4_294_967_296.0 * std::f64::consts::TAU;
        let offset = radians(found.electrical_offset as i32) - motor.offset;
        assert!(offset.abs() < 0.03, "electrical offset is off by {offset} rad");
        let [(first, phase), _] = motor.eccentricity;
        // amplitude sin(angle + phase) = cosine cos(angle) + sine sin(angle)
        let [cosine, sine, ..] = found.eccentricity.map(radians);
        assert!((cosine - first * phase.sin()).abs() < 0.001, "{cosine}");
        assert!((sine - first * phase.cos()).abs() < 0.001, "{sine}");
    }
}

#[test]
fn works_with_swapped_wires_on_one_motor() {
    let mut bench = Bench::new(FREE);
    bench.motors[0].reversed = true;
    bench.arm();
    bench.command(30.0, 30.0);
    bench.run(0.5);
    let held = bench.hold(30.0, 30.0, 0.5);
    assert!(held.frequency < 0.01 && held.direction < 0.15, "{held:?}");
}

#[test]
fn reverses_within_half_a_second_below_the_current_limit() {
    let mut bench = running(FREE, 30.0, 20.0);
    bench.command(-30.0, 20.0);
    bench.run(0.5);
    assert!((bench.frequency() + 30.0).abs() < 0.2, "{}", bench.frequency());
    assert!(bench.direction_error(20.0).abs() < 3.0);
    assert!(bench.peak_current < 2.0, "{}", bench.peak_current);
}

#[test]
fn turns_theta_the_short_way_through_ninety_degrees_without_losing_f() {
    let mut bench = running(FREE, 30.0, 80.0);
    bench.command(30.0, -80.0);
    for _ in 0..5_000 {
        bench.tick();
        // The long way would pass forward.
        assert!(bench.direction_error(90.0).abs() < 15.0);
        assert!((bench.frequency() - 30.0).abs() < 0.5, "{}", bench.frequency());
    }
    assert!(bench.direction_error(-80.0).abs() < 0.5);
}

#[test]
fn works_in_voltage_mode_without_a_current_sense() {
    let hardware = crate::hardware::Hardware { current_sense: None, ..HARDWARE };
    let mut bench = Bench::with(FREE, parameters(|_| {}), hardware);
    bench.arm();
    bench.command(30.0, -30.0);
    bench.run(0.5);
    let held = bench.hold(30.0, -30.0, 0.5);
    assert!(held.frequency < 0.01 && held.direction < 0.15, "{held:?}");
}

#[test]
fn predicts_where_the_encoder_is_slower_than_the_loop() {
    let mut bench = Bench::new(FREE);
    bench.encoder_every = 3;
    bench.arm();
    bench.command(30.0, 30.0);
    bench.run(0.5);
    let held = bench.hold(30.0, 30.0, 0.5);
    assert!(held.frequency < 0.02 && held.direction < 0.2, "{held:?}");
}

#[test]
fn stop_brings_the_rotors_to_rest_together_and_is_latched() {
    let mut bench = running(FREE, 35.0, 30.0);
    bench.order.stop += 1;
    for _ in 0..3_500 {
        bench.tick();
        if bench.frequency().abs() > 3.0 {
            assert!(bench.direction_error(30.0).abs() < 3.0, "phase-locked on the way down");
        }
    }
    assert_eq!(bench.state(), State::Disarmed);
    assert!(bench.fastest() < 0.5);
    bench.order.arm += 1;
    bench.run(0.1);
    assert_eq!(bench.state(), State::Disarmed, "the stop is latched");
}

#[test]
fn a_lost_encoder_brakes_both_rotors_to_rest() {
    let mut bench = running(FREE, 35.0, 30.0);
    bench.motors[0].encoder_alive = false;
    bench.run(0.5);
    assert_eq!(bench.control.report().first_fault, Some(Fault::EncoderLost));
    assert!(bench.fastest() < 0.5, "{}", bench.fastest());
    assert!(bench.peak_current < 2.0, "{}", bench.peak_current);
    bench.run(1.5);
    assert_eq!(bench.last.bridges, [Bridge::Off; 2]);
}

#[test]
fn a_dead_encoder_is_named_and_nothing_spins() {
    let mut bench = Bench::new(FREE);
    bench.motors[1].encoder_alive = false;
    bench.run(0.05);
    bench.order.arm += 1;
    bench.until(State::Faulted);
    assert_eq!(bench.control.report().first_fault, Some(Fault::EncoderLost));
}
