//! An order or a change that is refused changes nothing, and its operator is told why.

use std::time::Duration;

use flix_protocol::message::{
    Command, Name, Order, Outcome, ParameterCommand, Refusal, Setpoint, State, Withheld,
};

use super::bench::Bench;

/// A setpoint as a faulty program would send it: the types refuse to make one.
fn impossible(bench: &Bench, frequency: f32, direction: f32) -> Order {
    let bytes = postcard::to_allocvec(&(frequency, direction)).unwrap();
    Order::Shake(bench.permit(), postcard::from_bytes::<Setpoint>(&bytes).unwrap())
}

#[test]
fn a_setpoint_out_of_range_is_withheld_and_changes_nothing() {
    let mut bench = Bench::shaking();
    for (frequency, direction) in [(35.1, 0.0), (-35.1, 0.0), (30.0, -90.5)] {
        let wild = impossible(&bench, frequency, direction);
        for _ in 0..10 {
            bench.hold(bench.walk(20.0, 0.0), Duration::from_millis(20));
            assert_eq!(bench.see(wild).withheld, Some(Withheld::Range), "{frequency} {direction}");
            assert_eq!(bench.shown().setpoint, super::bench::setpoint(20.0, 0.0));
        }
        let f = bench.robot.truth().frequency();
        assert!((f - 20.0).abs() < 0.5, "{f} Hz after {frequency} Hz {direction} degrees");
    }
}

#[test]
fn a_setpoint_out_of_range_is_no_sign_of_life() {
    let mut bench = Bench::shaking();
    bench.hold(impossible(&bench, 36.0, 0.0), Duration::from_millis(300));
    assert_eq!(bench.state(), State::Stopping);
}

#[test]
fn numbers_that_are_none_are_refused_with_the_range() {
    let mut bench = Bench::connected();
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let refusal = Refusal::out_of_range("over_speed", 10.0, 200.0);
        let name = Name::try_from("over_speed").unwrap();
        let set = Command::Parameter(ParameterCommand::Set(name, value));
        assert_eq!(bench.say(set), Outcome::Refused(refusal), "{value}");
    }
}

#[test]
fn a_robot_that_is_not_armed_says_so() {
    let mut bench = Bench::connected();
    let shown = bench.see(bench.walk(20.0, 0.0));
    assert_eq!((shown.withheld, shown.state), (Some(Withheld::State), State::Disarmed));
}
