//! What is out of range is refused with the range, and changes nothing.

use flix_protocol::message::{Command, Name, Outcome, ParameterCommand, Refusal, Setpoint, State};

use super::bench::{Bench, setpoint};

/// A setpoint as a faulty program would send it: the types refuse to make one.
fn impossible(frequency: f32, direction: f32) -> Command {
    let bytes = postcard::to_allocvec(&(frequency, direction)).unwrap();
    Command::Setpoint(postcard::from_bytes::<Setpoint>(&bytes).unwrap())
}

fn set(name: &str, value: f32) -> Command {
    Command::Parameter(ParameterCommand::Set(Name::try_from(name).unwrap(), value))
}

#[test]
fn a_frequency_beyond_35_hz_is_refused_with_the_range() {
    let mut bench = Bench::armed();
    assert_eq!(bench.say(impossible(35.1, 0.0)), Outcome::Refused(Refusal::frequency()));
}

#[test]
fn a_direction_beyond_90_degrees_is_refused_with_the_range() {
    let mut bench = Bench::armed();
    assert_eq!(bench.say(impossible(20.0, -90.5)), Outcome::Refused(Refusal::direction()));
}

#[test]
fn a_refused_setpoint_leaves_the_robot_as_it_was() {
    let mut bench = Bench::shaking();
    bench.say(Command::Setpoint(setpoint(20.0, 0.0)));
    bench.say(impossible(36.0, 45.0));
    assert_eq!(bench.telemetry().setpoint, setpoint(20.0, 0.0));
}

#[test]
fn a_refused_setpoint_is_no_sign_of_life() {
    let mut bench = Bench::shaking();
    bench.hold(impossible(36.0, 0.0), std::time::Duration::from_millis(300));
    assert_eq!(bench.state(), State::Stopping);
}

#[test]
fn numbers_that_are_none_are_refused_with_the_range() {
    let mut bench = Bench::connected();
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let refusal = Refusal::out_of_range("over_speed", 10.0, 200.0);
        assert_eq!(bench.say(set("over_speed", value)), Outcome::Refused(refusal), "{value}");
    }
}

#[test]
fn a_robot_that_is_not_armed_says_so() {
    let mut bench = Bench::connected();
    let outcome = bench.say(Command::Setpoint(setpoint(20.0, 0.0)));
    assert_eq!(outcome, Outcome::Refused(Refusal::State(State::Disarmed)));
}
