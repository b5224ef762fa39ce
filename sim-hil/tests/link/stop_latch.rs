//! A stop is obeyed in every state, stays, and can be repeated.

use std::time::Duration;

use flix_protocol::frame::Frame;
use flix_protocol::message::{Command, Event, OperatorName, Outcome, Refusal, State};
use flix_protocol::session::{StopSession, StopStatus};

use super::bench::{Bench, key, setpoint};

#[test]
fn a_stopped_robot_rests_whatever_is_asked_of_it() {
    let mut bench = Bench::shaking();
    assert_eq!(bench.say(Command::Stop), Outcome::Done);
    bench.hold(Command::Setpoint(setpoint(20.0, 0.0)), Duration::from_millis(600));
    assert!(bench.speed() < 0.5, "{} Hz", bench.speed());
}

#[test]
fn a_stopped_robot_says_why_it_does_not_arm() {
    let mut bench = Bench::shaking();
    bench.say(Command::Stop);
    bench.hold(Command::Ping(0), Duration::from_secs(1));
    assert_eq!(bench.say(Command::Arm), Outcome::Refused(Refusal::Stopped));
}

#[test]
fn a_stop_is_acknowledged_as_often_as_it_is_repeated() {
    let mut bench = Bench::shaking();
    let outcomes = [(); 5].map(|()| bench.say(Command::Stop));
    assert_eq!(outcomes, [(); 5].map(|()| Outcome::Done));
}

#[test]
fn a_stop_before_arming_keeps_the_robot_from_arming() {
    let mut bench = Bench::connected();
    bench.hold(Command::Ping(0), Duration::from_millis(600));
    bench.say(Command::Stop);
    assert_eq!(bench.say(Command::Arm), Outcome::Refused(Refusal::Stopped));
}

#[test]
fn a_stop_while_aligning_lets_go() {
    let mut bench = Bench::connected();
    bench.hold(Command::Ping(0), Duration::from_millis(600));
    bench.say(Command::Arm);
    bench.hold(Command::Ping(0), Duration::from_millis(100));
    assert_eq!(bench.state(), State::Aligning);
    bench.say(Command::Stop);
    bench.wait(Duration::from_millis(5));
    assert_eq!(bench.state(), State::Disarmed);
}

#[test]
fn a_stop_that_crosses_a_clear_wins() {
    let mut bench = Bench::connected();
    bench.say(Command::Clear);
    bench.say(Command::Stop);
    bench.wait(Duration::from_millis(5));
    assert!(bench.robot.report().stopped);
}

#[test]
fn a_clear_right_behind_a_stop_is_refused_not_lost() {
    let mut bench = Bench::shaking();
    bench.say(Command::Stop);
    assert_eq!(bench.say(Command::Clear), Outcome::Refused(Refusal::State(State::Stopping)));
}

#[test]
fn a_disarm_that_crosses_an_arm_wins() {
    let mut bench = Bench::connected();
    bench.hold(Command::Ping(0), Duration::from_millis(600));
    bench.say(Command::Arm);
    bench.say(Command::Disarm);
    bench.hold(Command::Ping(0), Duration::from_millis(100));
    assert_eq!(bench.state(), State::Disarmed);
}

/// Another operator stops the robot without a session, as long as that takes.
fn stop_from_outside(bench: &mut Bench) {
    let mut stop = StopSession::new(&key(), [2; 32], bench.now());
    let address = ([192, 0, 2, 2], 40_000).into();
    let end = bench.now() + Duration::from_secs(2);
    let mut frame = Frame::new();
    while bench.now() < end && stop.status() != StopStatus::AtRest {
        if let Some(datagram) = stop.poll(bench.now()) {
            bench.robot.receive(address, &datagram);
            let now = bench.now();
            while let Some(to) = bench.robot.transmit(&mut frame) {
                if to == address {
                    stop.receive(now, &frame).unwrap();
                } else {
                    bench.operator.receive(now, &frame);
                }
            }
        }
        bench.hold(Command::Setpoint(setpoint(20.0, 0.0)), Duration::from_millis(1));
    }
    assert_eq!(stop.status(), StopStatus::AtRest);
}

#[test]
fn a_stop_from_outside_is_acknowledged_once_the_rotors_are_at_rest() {
    let mut bench = Bench::shaking();
    stop_from_outside(&mut bench);
    assert_eq!((bench.state(), bench.speed() < 0.5), (State::Disarmed, true));
}

#[test]
fn a_stop_from_outside_latches_as_one_in_the_session_and_its_operator_learns_of_it() {
    let mut bench = Bench::shaking();
    stop_from_outside(&mut bench);
    assert_eq!(bench.say(Command::Arm), Outcome::Refused(Refusal::Stopped));
    assert!(bench.events().contains(&Event::StoppedFromOutside(OperatorName::OWNER)));
    assert_eq!(bench.say(Command::Clear), Outcome::Refused(Refusal::Stopped), "who knows of it?");
    bench.operator.halts = bench.operator.telemetry.last().unwrap().halts;
    assert_eq!(bench.say(Command::Clear), Outcome::Done);
    bench.arm();
    assert_eq!(bench.state(), State::Armed);
}

#[test]
fn a_stop_outlives_the_operator_who_said_it() {
    let mut bench = Bench::shaking();
    bench.say(Command::Stop);
    bench.wait(Duration::from_secs(12));
    bench.operator = super::bench::Operator::new(super::bench::key(), 2, bench.now());
    bench.connect();
    bench.hold(Command::Ping(0), Duration::from_millis(600));
    assert_eq!(bench.say(Command::Arm), Outcome::Refused(Refusal::Stopped));
}

#[test]
fn a_cleared_robot_arms_again() {
    let mut bench = Bench::shaking();
    bench.say(Command::Stop);
    bench.hold(Command::Ping(0), Duration::from_secs(1));
    assert_eq!(bench.say(Command::Clear), Outcome::Done);
    bench.arm();
    assert_eq!(bench.state(), State::Armed);
}
