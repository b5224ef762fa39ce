//! Arming is explicit, and only after 500 ms of a healthy link.

use std::time::Duration;

use flix_protocol::failsafe::{LINK_LATE, PROVING_TIME};
use flix_protocol::message::{Command, Outcome, Refusal, State};

use super::bench::{Bench, TICK, setpoint};

/// Says a ping every 20 ms from now on, for exactly so long; the last tick is not the last ping.
fn prove(bench: &mut Bench, duration: Duration) {
    bench.hold(Command::Ping(0), duration);
}

#[test]
fn a_link_proven_for_one_tick_less_does_not_arm() {
    let mut bench = Bench::connected();
    prove(&mut bench, PROVING_TIME - TICK);
    assert_eq!(bench.say(Command::Arm), Outcome::Refused(Refusal::LinkUnproven));
}

#[test]
fn arming_in_the_moment_of_connecting_is_refused_for_the_link_alone() {
    let mut bench = Bench::connected();
    assert_eq!(bench.say(Command::Arm), Outcome::Refused(Refusal::LinkUnproven));
}

#[test]
fn an_idle_robot_is_cleared_in_the_moment_of_connecting() {
    let mut bench = Bench::connected();
    assert_eq!(bench.say(Command::Clear), Outcome::Done);
}

#[test]
fn a_link_proven_for_500_ms_arms() {
    let mut bench = Bench::connected();
    prove(&mut bench, PROVING_TIME);
    assert_eq!(bench.say(Command::Arm), Outcome::Done);
}

#[test]
fn a_silence_of_one_tick_less_than_100_ms_is_forgiven() {
    let mut bench = Bench::connected();
    prove(&mut bench, PROVING_TIME / 2);
    bench.say(Command::Ping(1));
    bench.wait(LINK_LATE - TICK);
    prove(&mut bench, PROVING_TIME / 2);
    assert_eq!(bench.say(Command::Arm), Outcome::Done);
}

#[test]
fn a_silence_of_100_ms_starts_the_proof_over() {
    let mut bench = Bench::connected();
    prove(&mut bench, PROVING_TIME / 2);
    bench.say(Command::Ping(1));
    bench.wait(LINK_LATE);
    prove(&mut bench, PROVING_TIME / 2);
    assert_eq!(bench.say(Command::Arm), Outcome::Refused(Refusal::LinkUnproven));
}

#[test]
fn a_setpoint_alone_never_arms() {
    let mut bench = Bench::connected();
    bench.hold(Command::Setpoint(setpoint(20.0, 0.0)), Duration::from_secs(2));
    assert_eq!((bench.state(), bench.speed()), (State::Disarmed, 0.0));
}

#[test]
fn an_armed_robot_rests_until_it_is_told_to_shake() {
    let mut bench = Bench::armed();
    bench.hold(Command::Ping(0), Duration::from_secs(1));
    assert_eq!(bench.state(), State::Armed);
}

#[test]
fn a_lost_link_is_not_armed_again_by_commands_that_come_back() {
    let mut bench = Bench::shaking();
    bench.wait(Duration::from_millis(1_500));
    bench.hold(Command::Setpoint(setpoint(20.0, 0.0)), Duration::from_secs(1));
    assert_eq!(bench.state(), State::Disarmed);
}

#[test]
fn a_robot_that_is_armed_again_forgets_what_it_was_told_before() {
    let mut bench = Bench::shaking();
    bench.say(Command::Disarm);
    bench.hold(Command::Ping(0), Duration::from_secs(1));
    bench.arm();
    bench.hold(Command::Ping(0), Duration::from_millis(300));
    assert_eq!(bench.state(), State::Armed);
}
