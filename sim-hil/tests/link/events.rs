//! Events are numbered, bounded, and their loss is seen.

use std::time::Duration;

use flix_firmware::link::EVENTS;
use flix_protocol::message::{Event, Order};

use super::bench::Bench;

fn numbers(bench: &Bench) -> Vec<u32> {
    bench.operator.events.iter().map(|report| report.number).collect()
}

#[test]
fn events_count_up_without_a_gap_from_the_start_of_the_robot() {
    let mut bench = Bench::shaking();
    bench.hold(Order::Stop, Duration::from_secs(1));
    let numbers = numbers(&bench);
    assert_eq!(numbers, (0..u32::try_from(numbers.len()).unwrap()).collect::<Vec<_>>());
    assert_eq!(bench.events()[0], Event::Started);
}

#[test]
fn an_operator_who_was_not_there_sees_how_much_he_missed() {
    let mut bench = Bench::connected();
    bench.wait(Duration::from_millis(5));
    bench.operator.events.clear();
    // Each stop that is cleared makes two events; nobody gets them.
    for order in [Order::Stop, Order::Clear(bench.permit())].repeat(EVENTS) {
        bench.order(order);
        for _ in 0..20 {
            bench.robot.tick().unwrap();
        }
    }
    bench.wait(Duration::from_millis(5));
    let reported = numbers(&bench);
    assert_eq!(reported.len(), EVENTS);
    assert!(reported[0] > 3, "the oldest are gone: {reported:?}");
}
