//! 100 ms without an order: warned; 250 ms: both rotors ramp down together; 1 s: disarmed.
//! Nothing one tick before, everything one tick after.

use std::time::Duration;

use flix_protocol::failsafe::{COMMAND_DEADLINE, LINK_LATE, LINK_LOST};
use flix_protocol::message::{Command, Event, Halt, Order, State};

use super::bench::{Bench, TICK};

/// Gives an order for the last time, and lets so long pass up to the robot's last tick.
fn last(mut bench: Bench, order: Order, silence: Duration) -> Bench {
    bench.order(order);
    // The tick at the moment of the order, and all after it.
    bench.wait(silence + TICK);
    bench
}

/// A robot that shakes, heard of for the last time so long before its last tick.
fn silent_for(silence: Duration) -> Bench {
    let bench = Bench::shaking();
    let walk = bench.walk(20.0, 0.0);
    last(bench, walk, silence)
}

#[test]
fn each_step_of_silence_comes_at_its_tick_and_not_before() {
    let shaking = |silence| {
        let report = silent_for(silence).robot.report();
        (report.state, report.link_late)
    };
    assert_eq!(shaking(LINK_LATE - TICK), (State::Running, false));
    assert_eq!(shaking(LINK_LATE), (State::Running, true));
    assert_eq!(shaking(COMMAND_DEADLINE - TICK), (State::Running, true));
    assert_eq!(shaking(COMMAND_DEADLINE), (State::Stopping, true));
    assert_eq!(shaking(LINK_LOST - TICK).0, State::Armed);
    // The rotors are at rest already, so letting go takes one tick.
    assert_ne!(shaking(LINK_LOST).0, State::Armed);
}

#[test]
fn aligning_motors_are_let_go_after_250_ms_and_not_before() {
    let aligning_for = |silence| {
        let mut bench = Bench::connected();
        bench.hold(Order::Off, Duration::from_millis(600));
        let arm = Order::Arm(bench.permit());
        last(bench, arm, silence)
    };
    let before = aligning_for(COMMAND_DEADLINE - TICK).state();
    let mut after = aligning_for(COMMAND_DEADLINE);
    assert_eq!([before, after.state()], [State::Aligning, State::Disarmed]);
    after.wait(Duration::from_millis(300));
    assert!(after.speed() < 0.5, "{} Hz", after.speed());
}

#[test]
fn both_rotors_are_at_rest_600_ms_after_the_last_order() {
    let speed = silent_for(Duration::from_millis(600)).speed();
    assert!(speed < 0.5, "{speed} Hz");
}

#[test]
fn theta_is_held_while_the_rotors_ramp_down() {
    let mut bench = silent_for(COMMAND_DEADLINE);
    let mut largest_error = 0.0_f64;
    while bench.state() == State::Stopping && bench.speed() > 1.0 {
        bench.tick();
        let theta = bench.robot.truth().direction.to_degrees();
        let half_turns = (theta / 180.0).round() * 180.0;
        largest_error = largest_error.max((theta - half_turns).abs());
    }
    assert!(largest_error < 5.0, "{largest_error} degrees");
}

/// An order that comes back while the rotors ramp down is obeyed again. Whoever sees them stand may reach for the robot: only a
/// person who knows that they stand starts them again.
#[test]
fn rotors_that_came_to_rest_by_silence_wait_for_a_new_wish() {
    for silence in (260..1_000).step_by(31) {
        let mut bench = Bench::shaking();
        let walk = bench.walk(15.0, 0.0);
        bench.order(walk);
        bench.wait(Duration::from_millis(silence));
        let mut has_rested = false;
        for _ in 0..100 {
            bench.hold(walk, Duration::from_millis(10));
            has_rested |= bench.state() == State::Armed;
            let speed = bench.speed();
            assert!(!has_rested || speed < 0.5, "{speed} Hz again after {silence} ms");
        }
        assert_eq!(has_rested, bench.shown().halt == Halt::Rested, "{silence} ms");
        // Rotors that did not rest were still ramping down.
        assert!(has_rested || silence < 600, "{silence} ms");
        if has_rested {
            assert_eq!(bench.state(), State::Armed, "{silence} ms");
            bench.hold(bench.walk(15.0, 0.0), Duration::from_millis(800));
        }
        let frequency = bench.robot.truth().frequency();
        assert!((frequency - 15.0).abs() < 0.5, "{frequency} Hz after {silence} ms");
    }
}

#[test]
fn requests_are_no_signs_of_life() {
    let mut bench = Bench::shaking();
    let ping = |bench: &mut Bench| drop(bench.say(Command::Ping(0)));
    bench.repeat(Duration::from_millis(700), ping);
    assert!(bench.speed() < 0.5, "{} Hz", bench.speed());
    bench.repeat(Duration::from_secs(2), |bench| {
        ping(bench);
        assert!(bench.speed() < 0.5, "{} Hz", bench.speed());
    });
    assert_eq!((bench.state(), bench.shown().halt), (State::Disarmed, Halt::LinkLost));
}

#[test]
fn each_step_is_told_once_and_in_order() {
    let mut bench = silent_for(LINK_LOST);
    bench.wait(Duration::from_millis(10));
    let mut events = bench.events();
    events.retain(|event| {
        matches!(event, Event::LinkLate | Event::CommandDeadline | Event::LinkLost)
    });
    assert_eq!(events, [Event::LinkLate, Event::CommandDeadline, Event::LinkLost]);
}
