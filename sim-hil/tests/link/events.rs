//! Events are numbered, bounded, and their loss is seen.

use std::time::Duration;

use flix_firmware::link::EVENTS;
use flix_protocol::message::{Command, Event};

use super::bench::{Bench, setpoint};

fn numbers(bench: &Bench) -> Vec<u32> {
    bench.operator.events.iter().map(|report| report.number).collect()
}

#[test]
fn the_first_event_is_that_the_robot_started() {
    let mut bench = Bench::connected();
    bench.wait(Duration::from_millis(5));
    assert_eq!(bench.events()[0], Event::Started);
}

#[test]
fn events_that_all_arrive_count_up_without_a_gap() {
    let mut bench = Bench::shaking();
    bench.say(Command::Stop);
    bench.hold(Command::Ping(0), Duration::from_secs(1));
    let numbers = numbers(&bench);
    assert_eq!(numbers, (0..u32::try_from(numbers.len()).unwrap()).collect::<Vec<_>>());
}

#[test]
fn an_operator_who_was_not_there_sees_how_much_he_missed() {
    let mut bench = Bench::connected();
    bench.wait(Duration::from_millis(5));
    bench.operator.events.clear();
    // Each stop that is cleared makes two events; nobody gets them.
    for _ in 0..EVENTS {
        bench.hold_deaf(Command::Stop);
        bench.hold_deaf(Command::Clear);
    }
    bench.wait(Duration::from_millis(5));
    let reported = numbers(&bench);
    assert_eq!(reported.len(), EVENTS);
    assert!(reported[0] > 3, "the oldest are gone: {reported:?}");
}

#[test]
fn telemetry_comes_as_often_as_it_is_set() {
    let mut bench = Bench::armed();
    bench.operator.telemetry.clear();
    bench.hold(Command::Setpoint(setpoint(10.0, 0.0)), Duration::from_secs(1));
    let reported = bench.operator.telemetry.len();
    assert!((49..=51).contains(&reported), "{reported}");
}
