//! A robot obeys only what its operator means now: a network that delays orders moves it no longer than the command age and
//! the ramp down after the operator's last wish.

use std::time::Duration;

use flix_protocol::failsafe::{COMMAND_AGE, LONGEST_MOVEMENT, longest_command_age};
use flix_protocol::frame::Frame;
use flix_protocol::message::{
    Command, Event, Order, Outcome, ParameterCommand, Refusal, State, Withheld,
};

use super::bench::{Bench, TICK};

/// Keeps every deadline of silence.
const DRIP: Duration = Duration::from_millis(90);

/// A robot at full speed, and orders that its operator sealed then and that the network kept.
fn at_full_speed(kept: usize) -> (Bench, Vec<Frame>) {
    at_full_speed_of(Bench::armed(), kept)
}

fn at_full_speed_of(mut bench: Bench, kept: usize) -> (Bench, Vec<Frame>) {
    let full = bench.walk(35.0, 0.0);
    bench.hold(full, Duration::from_secs(2));
    assert!(bench.speed() > 34.0);
    let now = bench.now();
    let frames = (0..kept).map(|_| bench.operator.seal(now, full)).collect();
    (bench, frames)
}

#[test]
fn setpoints_released_one_by_one_prolong_no_movement() {
    let (bench, frames) = at_full_speed(40);
    release_one_by_one(bench, frames);
}

/// Whatever a robot arms with keeps the promise.
#[test]
fn setpoints_released_one_by_one_prolong_no_movement_at_the_longest_age_of_commands() {
    for ramp in [20.0, 110.0, 200.0, 1_000.0] {
        let mut bench = Bench::connected();
        let age = longest_command_age(ramp).as_secs_f32();
        for (name, value) in [("frequency_ramp", ramp), ("command_age", age)] {
            let set = ParameterCommand::Set(name.try_into().unwrap(), value);
            assert!(matches!(bench.say(Command::Parameter(set)), Outcome::Parameter(_)));
        }
        bench.arm();
        let (bench, frames) = at_full_speed_of(bench, 40);
        release_one_by_one(bench, frames);
    }
}

fn release_one_by_one(mut bench: Bench, frames: Vec<Frame>) {
    let (wished, address) = (bench.now(), bench.operator.address);
    for frame in frames {
        bench.robot.receive(address, &frame);
        for _ in 0..DRIP.as_micros() / TICK.as_micros() {
            bench.tick();
            let since = bench.now().since(wished);
            assert!(since < LONGEST_MOVEMENT || bench.speed() < 0.5, "moves after {since:?}");
        }
    }
}

#[test]
fn setpoints_released_in_a_burst_later_move_nothing() {
    for wait in [Duration::from_millis(500), Duration::from_secs(2), Duration::from_secs(9)] {
        let (mut bench, frames) = at_full_speed(40);
        let address = bench.operator.address;
        bench.wait(LONGEST_MOVEMENT.max(wait));
        for frame in frames {
            bench.robot.receive(address, &frame);
        }
        bench.hold_still(Duration::from_secs(1));
    }
}

#[test]
fn rotors_ramp_down_for_an_old_setpoint_that_arrived_just_now() {
    let (mut bench, frames) = at_full_speed(1);
    let (wished, address) = (bench.now(), bench.operator.address);
    while bench.now().since(wished) < COMMAND_AGE - Duration::from_millis(190) {
        bench.tick();
    }
    bench.robot.receive(address, &frames[0]);
    // 190 ms of silence only, but the order was meant 400 ms ago. It states a telemetry of the last 20 ms, and its
    // time is rounded by up to a slot.
    let before = Duration::from_millis(40);
    while bench.now().since(wished) < COMMAND_AGE - before {
        bench.tick();
    }
    let still = bench.state();
    while bench.now().since(wished) < COMMAND_AGE + 2 * TICK {
        bench.tick();
    }
    assert_eq!([still, bench.state()], [State::Running, State::Stopping]);
    bench.wait(Duration::from_millis(50));
    assert!(bench.events().contains(&Event::CommandAge));
}

#[test]
fn late_orders_and_changes_do_nothing_and_are_told_once() {
    let mut bench = Bench::connected();
    bench.hold(Order::Off, Duration::from_secs(1));
    let (now, address) = (bench.now(), bench.operator.address);
    let arm = Order::Arm(bench.permit());
    let set = ParameterCommand::Set("telemetry_rate".try_into().unwrap(), 20.0);
    let change = bench.operator.ask(now, Command::Parameter(set));
    let late = [change, bench.operator.seal(now, arm), bench.operator.seal(now, arm)];
    bench.wait(Duration::from_millis(600));
    for frame in late {
        bench.robot.receive(address, &frame);
        bench.tick();
    }
    let withheld = bench.telemetry().withheld;
    let is_late = matches!(withheld, Some(Withheld::Late { age_ms: 600..=640, limit_ms: 400 }));
    assert!(is_late, "{withheld:?}");
    let replies: Vec<_> = bench.operator.replies.iter().map(|reply| &reply.outcome).collect();
    let [Outcome::Refused(Refusal::Late { age_ms: 600..=640, limit_ms: 400 })] = replies[..] else {
        panic!("{replies:?}");
    };
    let told = |event: &&Event| matches!(event, Event::CommandsLate { .. });
    assert_eq!((bench.events().iter().filter(told).count(), bench.state()), (1, State::Disarmed));
}

#[test]
fn a_stop_and_a_disarm_count_at_any_age() {
    for (order, stopped) in [(Order::Stop, true), (Order::Off, false)] {
        let mut bench = Bench::shaking();
        let (now, address) = (bench.now(), bench.operator.address);
        let late = bench.operator.seal(now, order);
        bench.wait(Duration::from_millis(700));
        assert_eq!(bench.state(), State::Armed);
        bench.robot.receive(address, &late);
        bench.wait(Duration::from_millis(5));
        assert_eq!((bench.state(), bench.robot.report().stopped), (State::Disarmed, stopped));
    }
}
