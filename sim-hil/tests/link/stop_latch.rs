//! A stop is obeyed in every state, stays, and can be repeated.

use std::time::Duration;

use flix_protocol::message::{Event, Halt, OperatorName, Order, State, Withheld};
use flix_protocol::session::{StopSession, StopStatus};

use super::bench::{Bench, Operator, key};

#[test]
fn a_stopped_robot_rests_until_it_is_cleared() {
    let mut bench = Bench::shaking();
    let (permit, first) = (bench.permit(), bench.operator.session.sealed() + 1);
    bench.hold(Order::Stop, Duration::from_millis(500));
    let shown = bench.shown();
    assert!(shown.stopped && shown.heard >= first, "acknowledged: {shown:?}");
    assert_eq!((shown.state, shown.permit), (State::Disarmed, permit), "its operator asked for it");
    for order in [Order::Arm(permit), bench.walk(20.0, 0.0)] {
        bench.hold(order, Duration::from_millis(600));
        assert_eq!((bench.shown().withheld, bench.speed() < 0.5), (Some(Withheld::Stopped), true));
    }
    assert!(!bench.see(Order::Clear(permit)).stopped);
    bench.arm_at_once();
}

/// The newest order wins, also over one that it overtook.
#[test]
fn a_stop_or_disarm_that_crosses_its_opposite_wins() {
    for overtakes in [false, true] {
        for newer in [Order::Stop, Order::Off] {
            let mut bench = Bench::connected();
            bench.hold(Order::Off, Duration::from_millis(600));
            if newer == Order::Stop {
                bench.see(Order::Stop);
            }
            let (now, permit, address) = (bench.now(), bench.permit(), bench.operator.address);
            let older =
                if newer == Order::Stop { Order::Clear(permit) } else { Order::Arm(permit) };
            let mut frames = [older, newer].map(|order| bench.operator.seal(now, order));
            if overtakes {
                frames.reverse();
            }
            for frame in frames {
                bench.robot.receive(address, &frame);
            }
            bench.wait(Duration::from_millis(100));
            let stopped = newer == Order::Stop;
            assert_eq!((bench.state(), bench.robot.report().stopped), (State::Disarmed, stopped));
        }
    }
}

/// Another operator stops the robot without a session, while its operator goes on with an order; how long that takes.
fn stop_from_outside(bench: &mut Bench, order: Order) -> Duration {
    let begun = bench.now();
    let mut stop = StopSession::new(&key(), [2; 32], begun);
    let address = ([192, 0, 2, 2], 40_000).into();
    while stop.status() != StopStatus::AtRest {
        assert!(bench.now().since(begun) < Duration::from_secs(2), "{:?}", stop.status());
        if let Some(datagram) = stop.poll(bench.now()) {
            bench.robot.receive(address, &datagram);
            bench.listen_with(address, |now, frame| stop.receive(now, frame).unwrap());
        }
        bench.hold(order, Duration::from_millis(1));
    }
    bench.now().since(begun)
}

#[test]
fn only_an_operator_who_knows_a_stop_from_outside_clears_it() {
    let mut bench = Bench::shaking();
    let (old, walk) = (Order::Clear(bench.permit()), bench.walk(20.0, 0.0));
    let took = stop_from_outside(&mut bench, walk);
    assert!(took < Duration::from_millis(600), "{took:?}");
    assert_eq!((bench.state(), bench.speed() < 0.5), (State::Disarmed, true));
    assert!(bench.events().contains(&Event::StoppedFromOutside(OperatorName::OWNER)));
    let shown = bench.see(old);
    assert_eq!((shown.stopped, shown.halt), (true, Halt::StoppedFromOutside));
    assert_eq!(shown.withheld, Some(Withheld::Permit));
    assert!(!bench.see(Order::Clear(bench.permit())).stopped);
    bench.arm_at_once();
}

#[test]
fn a_stop_outlives_the_operator_who_said_it() {
    let mut bench = Bench::shaking();
    bench.see(Order::Stop);
    bench.wait(Duration::from_secs(12));
    bench.operator = Operator::new(key(), 2, bench.now());
    bench.connect();
    bench.hold(Order::Off, Duration::from_millis(600));
    let shown = bench.see(Order::Arm(bench.permit()));
    assert_eq!((shown.withheld, shown.state), (Some(Withheld::Stopped), State::Disarmed));
}
