//! Arming is explicit, and only after 500 ms of a healthy link.

use std::time::Duration;

use flix_protocol::failsafe::{LINK_LATE, PROVING_TIME};
use flix_protocol::message::{Halt, Order, State, Withheld};

use super::bench::{Bench, KEEP_ALIVE, TICK};

#[test]
fn arming_wants_half_a_second_of_orders_without_a_gap() {
    // How long orders come, the gap after the last of them, and for how long they come then.
    for (before, gap, after, is_proven) in [
        (Duration::ZERO, Duration::ZERO, Duration::ZERO, false),
        (PROVING_TIME - TICK, Duration::ZERO, Duration::ZERO, false),
        (PROVING_TIME, Duration::ZERO, Duration::ZERO, true),
        (PROVING_TIME / 2, LINK_LATE - TICK, PROVING_TIME / 2, true),
        (PROVING_TIME / 2, LINK_LATE, PROVING_TIME / 2, false),
    ] {
        let mut bench = Bench::connected();
        bench.hold(Order::Off, before);
        if gap > Duration::ZERO {
            bench.order(Order::Off);
            bench.wait(gap);
            bench.hold(Order::Off, after);
        }
        bench.order(Order::Arm(bench.permit()));
        bench.wait(KEEP_ALIVE);
        let told = (!is_proven).then_some(Withheld::LinkUnproven);
        let state = if is_proven { State::Aligning } else { State::Disarmed };
        let case = format!("{before:?} {gap:?} {after:?}");
        assert_eq!((bench.state(), bench.telemetry().withheld), (state, told), "{case}");
    }
}

#[test]
fn a_robot_that_lost_its_link_is_armed_only_by_a_new_wish() {
    let mut bench = Bench::shaking();
    let walk = bench.walk(20.0, 0.0);
    let arm = Order::Arm(bench.permit());
    bench.wait(Duration::from_millis(1_500));
    for old in [walk, arm] {
        bench.hold(old, Duration::from_secs(1));
        let shown = bench.shown();
        assert_eq!((bench.state(), shown.halt), (State::Disarmed, Halt::LinkLost));
        assert_eq!((shown.withheld, bench.speed() < 0.5), (Some(Withheld::Permit), true));
    }
    bench.arm_at_once();
}
