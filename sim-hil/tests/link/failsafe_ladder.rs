//! 100 ms without a valid command: warned; 250 ms: both rotors ramp down together; 1 s: disarmed.
//! Nothing one tick before, everything one tick after.

use std::time::Duration;

use flix_protocol::failsafe::{COMMAND_DEADLINE, LINK_LATE, LINK_LOST};
use flix_protocol::message::{Command, Event, Outcome, Refusal, State};

use super::bench::{Bench, TICK, setpoint};

/// A robot that shakes, heard of for the last time so long before its last tick.
fn silent_for(silence: Duration) -> Bench {
    let mut bench = Bench::shaking();
    bench.say(Command::Setpoint(setpoint(20.0, 0.0)));
    // The tick at the moment of the command, and all after it.
    bench.wait(silence + TICK);
    bench
}

#[test]
fn the_operator_is_warned_after_100_ms_and_not_before() {
    let late = |silence| silent_for(silence).robot.report().link_late;
    let before = late(LINK_LATE - TICK);
    assert_eq!([before, late(LINK_LATE)], [false, true]);
}

#[test]
fn the_rotors_ramp_down_after_250_ms_and_not_before() {
    let before = silent_for(COMMAND_DEADLINE - TICK).state();
    assert_eq!([before, silent_for(COMMAND_DEADLINE).state()], [State::Running, State::Stopping]);
}

#[test]
fn a_robot_that_aligns_its_motors_lets_go_after_250_ms_and_not_before() {
    let aligning_for = |silence| {
        let mut bench = Bench::connected();
        bench.hold(Command::Ping(0), Duration::from_millis(600));
        bench.say(Command::Arm);
        bench.wait(silence + TICK);
        bench
    };
    let before = aligning_for(COMMAND_DEADLINE - TICK).state();
    let mut after = aligning_for(COMMAND_DEADLINE);
    assert_eq!([before, after.state()], [State::Aligning, State::Disarmed]);
    after.wait(Duration::from_millis(300));
    assert!(after.speed() < 0.5, "{} Hz", after.speed());
}

#[test]
fn the_robot_is_disarmed_after_a_second_and_not_before() {
    let disarmed = |silence| {
        let bench = silent_for(silence);
        // At rest already, so letting go takes one tick.
        matches!(bench.state(), State::Disarmed | State::Stopping)
    };
    let before = disarmed(LINK_LOST - TICK);
    assert_eq!([before, disarmed(LINK_LOST)], [false, true]);
}

#[test]
fn both_rotors_are_at_rest_600_ms_after_the_last_command() {
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

#[test]
fn commands_that_come_back_while_the_rotors_ramp_down_are_obeyed_again() {
    let mut bench = silent_for(COMMAND_DEADLINE + Duration::from_millis(50));
    bench.hold(Command::Setpoint(setpoint(15.0, 0.0)), Duration::from_millis(800));
    let frequency = bench.robot.truth().frequency();
    assert!((frequency - 15.0).abs() < 0.5, "{frequency} Hz");
}

/// Whoever sees the rotors stand may reach for the robot: only a person starts them again.
#[test]
fn rotors_that_came_to_rest_by_silence_turn_again_only_when_a_person_asks_for_it() {
    for silence in (400..1_000).step_by(31) {
        let mut bench = silent_for(Duration::from_millis(silence));
        let mut has_rested = false;
        let mut refused = false;
        for _ in 0..100 {
            bench.operator.replies.clear();
            bench.hold(Command::Setpoint(setpoint(15.0, 0.0)), Duration::from_millis(10));
            has_rested |= bench.state() == State::Armed;
            refused |= bench
                .operator
                .replies
                .iter()
                .any(|reply| reply.outcome == Outcome::Refused(Refusal::Rested));
            let speed = bench.speed();
            assert!(!has_rested || speed < 0.5, "{speed} Hz again after {silence} ms");
        }
        assert_eq!(has_rested, refused, "{silence} ms");
        if !has_rested {
            // A dip: the rotors were still ramping down.
            assert!(silence < 600, "{silence} ms");
            continue;
        }
        assert_eq!(bench.state(), State::Armed, "{silence} ms");
        // A key that was pressed before anybody could see that they rest.
        bench.operator.intent += 1;
        bench.hold(Command::Setpoint(setpoint(15.0, 0.0)), Duration::from_millis(300));
        assert!(bench.speed() < 0.5, "{silence} ms");
        bench.operator.intent += 1;
        bench.operator.halts = bench.operator.telemetry.last().unwrap().halts;
        bench.hold(Command::Setpoint(setpoint(15.0, 0.0)), Duration::from_millis(800));
        let frequency = bench.robot.truth().frequency();
        assert!((frequency - 15.0).abs() < 0.5, "{frequency} Hz after {silence} ms");
    }
}

#[test]
fn pings_do_not_keep_a_robot_shaking() {
    let mut bench = Bench::shaking();
    bench.hold(Command::Ping(0), Duration::from_millis(700));
    assert!(bench.speed() < 0.5, "{} Hz", bench.speed());
}

#[test]
fn pings_do_not_start_a_robot_that_ramped_down() {
    let mut bench = Bench::shaking();
    bench.hold(Command::Ping(0), Duration::from_secs(3));
    assert!(bench.speed() < 0.5, "{} Hz", bench.speed());
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
