//! One operator at a time, and nobody inherits a running robot.

use std::time::Duration;

use flix_protocol::frame::Frame;
use flix_protocol::message::{Command, Event, OperatorName, State};
use flix_protocol::session::{self, HOLDER_SILENCE, Key};

use super::bench::{Bench, Operator, TICK, key, setpoint};

/// Lets a stranger try to connect for so long while the first operator holds his setpoint. Returns
/// whether the stranger got in.
fn intrude(bench: &mut Bench, duration: Duration) -> bool {
    let mut stranger = Operator::new(key(), 2, bench.now());
    let end = bench.now() + duration;
    let mut frame = Frame::new();
    while bench.now() < end && !stranger.is_connected {
        bench.say(Command::Setpoint(setpoint(20.0, 0.0)));
        for _ in 0..200 {
            let now = bench.now();
            if let Some(hello) = stranger.session.poll(now) {
                bench.robot.receive(stranger.address, &hello);
            }
            while let Some(to) = bench.robot.transmit(&mut frame) {
                if to == stranger.address {
                    let _ = stranger.session.receive(now, &frame);
                }
            }
            bench.tick();
        }
    }
    stranger.session.status(bench.now()) == flix_protocol::session::Status::Connected
}

#[test]
fn a_second_operator_is_refused_while_the_first_is_heard() {
    assert!(!intrude(&mut Bench::shaking(), Duration::from_secs(2)));
}

#[test]
fn a_second_operator_does_not_disturb_the_first() {
    let mut bench = Bench::shaking();
    intrude(&mut bench, Duration::from_secs(1));
    assert_eq!(bench.state(), State::Running);
}

#[test]
fn a_refused_operator_is_counted() {
    let mut bench = Bench::shaking();
    intrude(&mut bench, Duration::from_secs(1));
    assert!(bench.quality().dropped.busy > 0);
}

/// When a second operator gets in who tries all the time, after the first falls silent.
fn takeover(bench: &mut Bench) -> Duration {
    let silent_since = bench.now();
    bench.operator = Operator::new(key(), 2, bench.now());
    bench.connect();
    bench.now().since(silent_since)
}

#[test]
fn a_second_operator_gets_in_once_the_first_is_silent_for_a_second() {
    let mut bench = Bench::shaking();
    bench.say(Command::Setpoint(setpoint(20.0, 0.0)));
    let after = takeover(&mut bench);
    // The second repeats its hello every 100 ms.
    let latest = HOLDER_SILENCE + Duration::from_millis(150);
    assert!((HOLDER_SILENCE..latest).contains(&after), "{after:?}");
}

#[test]
fn who_takes_over_finds_the_robot_disarmed() {
    let mut bench = Bench::shaking();
    takeover(&mut bench);
    bench.hold(Command::Setpoint(setpoint(20.0, 0.0)), Duration::from_millis(500));
    assert_eq!((bench.state(), bench.speed() < 0.5), (State::Disarmed, true));
}

#[test]
fn an_operator_who_starts_over_finds_the_robot_disarmed() {
    let mut bench = Bench::shaking();
    // Another program on the same address and port: it need not wait.
    bench.operator = Operator::new(key(), 1, bench.now());
    bench.connect();
    bench.hold(Command::Setpoint(setpoint(20.0, 0.0)), Duration::from_millis(700));
    assert_eq!((bench.state(), bench.speed() < 0.5), (State::Disarmed, true));
}

#[test]
fn a_robot_whose_operator_says_goodbye_ramps_down_at_once() {
    let mut bench = Bench::shaking();
    let goodbye = bench.operator.session.goodbye().unwrap();
    bench.robot.receive(bench.operator.address, &goodbye);
    bench.wait(TICK);
    assert_eq!(bench.state(), State::Stopping);
}

#[test]
fn commands_of_a_session_that_is_over_are_dropped() {
    let mut bench = Bench::shaking();
    let now = bench.now();
    let late = bench.operator.seal(now, Command::Arm);
    let address = bench.operator.address;
    takeover(&mut bench);
    bench.robot.receive(address, &late);
    assert_eq!(bench.quality().dropped.session, 1);
}

#[test]
fn a_new_operator_is_told_that_he_took_over() {
    let mut bench = Bench::connected();
    bench.wait(Duration::from_millis(5));
    assert!(bench.events().contains(&Event::OperatorConnected(OperatorName::OWNER)));
}

#[test]
fn a_robot_whose_operator_is_revoked_ramps_down_at_once() {
    let mut bench = Bench::shaking();
    let bob = session::Operator::new("bob".parse().unwrap(), &Key::new([9; 32]));
    bench.robot.change_operators(bob);
    bench.wait(TICK);
    assert_eq!((bench.state(), bench.robot.driver()), (State::Stopping, None));
}
