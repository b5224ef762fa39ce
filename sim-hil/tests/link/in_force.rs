//! Settings that were changed are in force when a motor is driven, and none spoils its commutation.

use std::time::Duration;

use flix_firmware::settings::Settings;
use flix_protocol::message::{Command, Name, Order, Outcome, ParameterCommand, Refusal, State};
use flix_sim::rig::simulated::Flash;

use super::bench::Bench;

/// Phase current that is never to be exceeded, A.
const LIMIT: f64 = 0.9;

fn set(bench: &mut Bench, name: &str, value: f64) {
    let name = Name::try_from(name).unwrap();
    let outcome = bench.say(Command::Parameter(ParameterCommand::Set(name, value as f32)));
    assert!(matches!(outcome, Outcome::Parameter(_)), "{outcome:?}");
}

/// An aligned robot of this seed, disarmed, its link proven.
fn aligned(seed: u64) -> Bench {
    let mut bench = Bench::of_seed(seed, Flash::with(&Settings::DEFAULT.entered()));
    bench.connect();
    bench.arm();
    disarm(&mut bench);
    bench
}

fn disarm(bench: &mut Bench) {
    while bench.shown().state != State::Disarmed {
        bench.see(Order::Off);
    }
    bench.hold(Order::Off, Duration::from_millis(700));
}

/// Runs up to 30 Hz, and returns the largest phase current, A.
fn largest_current(bench: &mut Bench) -> f64 {
    let mut largest = 0.0_f64;
    let walk = bench.walk(30.0, 0.0);
    for _ in 0..30 {
        bench.order(walk);
        for _ in 0..200 {
            bench.tick();
            largest = largest.max(bench.robot.truth().largest_current());
        }
    }
    largest
}

#[test]
fn a_limit_set_after_a_zero_and_just_before_arming_holds() {
    for seed in 1..=5 {
        let mut bench = aligned(seed);
        for pause_ms in [0, 2, 5, 9, 14].map(|pause| pause + seed) {
            set(&mut bench, "current_limit", 2.0);
            bench.hold(Order::Off, Duration::from_millis(100));
            set(&mut bench, "top_encoder_zero", 3.0 * pause_ms as f64);
            bench.wait(Duration::from_millis(pause_ms));
            set(&mut bench, "current_limit", LIMIT);
            bench.arm_at_once();
            let largest = largest_current(&mut bench);
            assert!(largest < LIMIT, "seed {seed}, {pause_ms} ms: {largest} A");
            disarm(&mut bench);
        }
    }
}

#[test]
fn a_limit_set_while_a_rotor_still_turns_holds() {
    for seed in [1, 2] {
        let mut bench = aligned(seed);
        bench.arm_at_once();
        bench.hold(bench.walk(20.0, 0.0), Duration::from_millis(600));
        while bench.state() != State::Disarmed {
            bench.hold(Order::Stop, Duration::from_millis(1));
        }
        set(&mut bench, "bottom_encoder_clockwise", 1.0);
        set(&mut bench, "bottom_encoder_clockwise", 0.0);
        set(&mut bench, "current_limit", LIMIT);
        assert!(!bench.see(Order::Clear(bench.permit())).stopped);
        bench.arm_at_once();
        let largest = largest_current(&mut bench);
        assert!(largest < LIMIT, "seed {seed}: {largest} A");
    }
}

#[test]
fn nothing_is_set_once_arming_was_asked_for() {
    let mut bench = aligned(1);
    bench.order(Order::Arm(bench.permit()));
    let name = Name::try_from("current_limit").unwrap();
    let late = bench.say(Command::Parameter(ParameterCommand::Set(name, LIMIT as f32)));
    assert_eq!(late, Outcome::Refused(Refusal::State(State::Aligning)));
}

/// Mean heat of both motors, W, and f by the plant, Hz, at 35 Hz.
fn at_35_hz(bench: &mut Bench) -> (f64, f64) {
    let walk = bench.walk(35.0, 0.0);
    bench.hold(walk, Duration::from_millis(800));
    let (mut heat, mut f, mut ticks) = (0.0, 0.0, 0.0);
    for _ in 0..20 {
        bench.order(walk);
        for _ in 0..200 {
            bench.tick();
            let truth = bench.robot.truth();
            let squares = truth.phase_currents.as_flattened().iter().map(|it| it * it);
            heat += f64::from(Settings::DEFAULT.phase_resistance[0]) * squares.sum::<f64>();
            f += truth.frequency();
            ticks += 1.0;
        }
    }
    (heat / ticks, f / ticks)
}

#[test]
fn zeros_and_directions_entered_after_alignment_keep_the_commutation() {
    for seed in [1, 2, 3] {
        let mut bench = aligned(seed);
        bench.arm_at_once();
        let (before, _) = at_35_hz(&mut bench);
        disarm(&mut bench);
        for changes in [
            &[("top_encoder_zero", -5.0)][..],
            &[("top_encoder_zero", 120.0), ("bottom_encoder_zero", 7.0)],
            &[("top_encoder_clockwise", 1.0), ("bottom_encoder_clockwise", 1.0)],
            &[("top_encoder_clockwise", 0.0), ("bottom_encoder_clockwise", 0.0)],
        ] {
            for (name, value) in changes {
                set(&mut bench, name, *value);
            }
            bench.arm_at_once();
            let (after, f) = at_35_hz(&mut bench);
            assert!(after < 1.05 * before + 0.01, "{changes:?}: {before} W, then {after} W");
            assert!((f.abs() - 35.0).abs() < 0.05, "{changes:?}: {f} Hz");
            disarm(&mut bench);
        }
    }
}

#[test]
fn other_pole_pairs_are_aligned_with_before_anything_runs() {
    let mut bench = aligned(1);
    set(&mut bench, "pole_pairs", 5.0);
    let arm = Order::Arm(bench.permit());
    while bench.state() == State::Disarmed || bench.state() == State::Aligning {
        bench.hold(arm, Duration::from_millis(20));
    }
    // Those of the motors are 7: alignment sees it.
    assert_eq!(bench.state(), State::Faulted);
}
