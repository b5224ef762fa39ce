//! One operator at a time, and nobody inherits a running robot.

use std::time::Duration;

use flix_protocol::message::{Event, OperatorName, Order, State};
use flix_protocol::session::{self, HOLDER_SILENCE, Key, Status};

use super::bench::{Bench, Operator, TICK, key};

#[test]
fn a_second_operator_is_refused_and_counted_and_disturbs_nobody() {
    let mut bench = Bench::shaking();
    let mut stranger = Operator::new(key(), 2, bench.now());
    let (walk, end) = (bench.walk(20.0, 0.0), bench.now() + Duration::from_secs(2));
    while bench.now() < end {
        if let Some(hello) = stranger.session.poll(bench.now()) {
            bench.robot.receive(stranger.address, &hello);
        }
        bench.listen_with(stranger.address, |now, frame| stranger.receive(now, frame));
        bench.hold(walk, Duration::from_millis(2));
    }
    assert_ne!(stranger.session.status(bench.now()), Status::Connected);
    let f = bench.robot.truth().frequency();
    assert!((f - 20.0).abs() < 0.5 && bench.quality().dropped.busy > 0, "{f} Hz");
}

/// A second operator takes over as soon as he can; how long that takes.
fn take_over(bench: &mut Bench, number: u8) -> Duration {
    let since = bench.now();
    bench.operator = Operator::new(key(), number, since);
    bench.connect();
    bench.now().since(since)
}

#[test]
fn a_second_operator_gets_in_after_a_second_of_silence() {
    let mut bench = Bench::shaking();
    bench.order(bench.walk(20.0, 0.0));
    let after = take_over(&mut bench, 2);
    // The second repeats its hello every 100 ms.
    let latest = HOLDER_SILENCE + Duration::from_millis(150);
    assert!((HOLDER_SILENCE..latest).contains(&after), "{after:?}");
}

/// Number 2 comes from another address. Number 1 is another program at the same address and port, which need not wait.
#[test]
fn nobody_inherits_a_running_robot_or_earlier_orders() {
    for number in [1, 2] {
        let mut bench = Bench::shaking();
        let (now, address, permit) = (bench.now(), bench.operator.address, bench.permit());
        let late = bench.operator.seal(now, Order::Arm(permit));
        let old = [bench.walk(20.0, 0.0), Order::Arm(permit)];
        take_over(&mut bench, number);
        let connected = Event::OperatorConnected(OperatorName::OWNER);
        assert!(bench.events().contains(&connected), "{:?}", bench.events());
        assert_ne!(bench.permit(), permit);
        bench.robot.receive(address, &late);
        assert_eq!(bench.quality().dropped.session, 1);
        for order in [bench.walk(20.0, 0.0), old[0], old[1]] {
            bench.hold(order, Duration::from_millis(700));
            assert_eq!((bench.state(), bench.speed() < 0.5), (State::Disarmed, true), "{order:?}");
        }
    }
}

#[test]
fn a_robot_whose_operator_leaves_or_is_revoked_ramps_down_at_once() {
    for leaves in [true, false] {
        let mut bench = Bench::shaking();
        if leaves {
            let goodbye = bench.operator.session.goodbye().unwrap();
            bench.robot.receive(bench.operator.address, &goodbye);
        } else {
            let bob = session::Operator::new("bob".parse().unwrap(), &Key::new([9; 32]));
            bench.robot.change_operators(bob);
        }
        bench.wait(TICK);
        assert_eq!((bench.state(), bench.robot.driver()), (State::Stopping, None));
    }
}
