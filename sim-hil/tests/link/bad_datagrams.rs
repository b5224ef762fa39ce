//! Datagrams that are short, long, random, replayed, reordered, of another key or another version:
//! dropped and counted, never a panic, never a movement.

use std::net::SocketAddr;
use std::time::Duration;

use flix_protocol::frame::{MAGIC, MAXIMUM_DATAGRAM};
use flix_protocol::message::{Dropped, Order, State};
use flix_protocol::session::{Key, OperatorSession, Status};
use rand::{Rng, RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::bench::Bench;

fn stranger() -> SocketAddr {
    SocketAddr::from(([192, 0, 2, 66], 666))
}

/// What is counted while `attack` goes on, and whether anything moved by itself.
fn counted<T>(bench: &mut Bench, attack: impl FnOnce(&mut Bench) -> T) -> Dropped {
    let before = bench.quality().dropped;
    let state = bench.state();
    attack(bench);
    bench.tick();
    assert_eq!(bench.state(), state, "an attack changed the robot's state");
    let after = bench.quality().dropped;
    Dropped {
        malformed: after.malformed - before.malformed,
        version: after.version - before.version,
        forged: after.forged - before.forged,
        replayed: after.replayed - before.replayed,
        stale: after.stale - before.stale,
        session: after.session - before.session,
        busy: after.busy - before.busy,
        unprovisioned: after.unprovisioned - before.unprovisioned,
    }
}

#[test]
fn datagrams_of_any_length_are_dropped_and_counted() {
    let mut bench = Bench::connected();
    let dropped = counted(&mut bench, |bench| {
        for length in 0..2_000 {
            bench.robot.receive(stranger(), &vec![0xa5; length]);
        }
    });
    assert_eq!(dropped, Dropped { malformed: 2_000, ..Dropped::default() });
}

#[test]
fn random_datagrams_never_move_the_robot() {
    let mut bench = Bench::armed();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
    let operator = bench.operator.address;
    for round in 0..20_000_u32 {
        let mut datagram = vec![0; random.random_range(0..=MAXIMUM_DATAGRAM + 20)];
        random.fill_bytes(&mut datagram);
        if datagram.len() > 4 && round % 4 != 0 {
            datagram[..3].copy_from_slice(&MAGIC);
            datagram[3] = random.random_range(0..8);
        }
        let from = if round % 2 == 0 { stranger() } else { operator };
        bench.robot.receive(from, &datagram);
        if round % 100 == 0 {
            bench.order(Order::Arm(bench.permit()));
        }
        if round % 10 == 0 {
            bench.tick();
        }
    }
    assert_eq!((bench.state(), bench.speed() < 0.5), (State::Armed, true));
}

#[test]
fn an_order_that_is_replayed_or_was_overtaken_is_dropped() {
    let mut bench = Bench::armed();
    let (now, address) = (bench.now(), bench.operator.address);
    let [replayed, overtaken] =
        [20.0, 35.0].map(|frequency| bench.operator.seal(now, bench.walk(frequency, 0.0)));
    bench.robot.receive(address, &replayed);
    bench.hold(bench.walk(0.0, 0.0), Duration::from_secs(1));
    let dropped = counted(&mut bench, |bench| {
        for _ in 0..100 {
            bench.robot.receive(address, &replayed);
        }
        bench.robot.receive(address, &overtaken);
    });
    assert_eq!(dropped, Dropped { replayed: 100, stale: 1, ..Dropped::default() });
}

#[test]
fn a_damaged_order_is_dropped_whichever_bit_is_wrong() {
    let mut bench = Bench::armed();
    let (now, address) = (bench.now(), bench.operator.address);
    let order = bench.operator.seal(now, bench.walk(35.0, 0.0));
    for bit in 0..order.len() * 8 {
        let mut damaged = order.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        bench.robot.receive(address, &damaged);
        bench.tick();
        assert_eq!(bench.state(), State::Armed, "bit {bit}");
    }
    bench.robot.receive(address, &order);
    bench.wait(Duration::from_millis(5));
    assert_eq!(bench.state(), State::Running, "undamaged");
}

#[test]
fn another_key_does_not_even_begin_a_session() {
    let mut bench = Bench::new();
    let mut intruder = OperatorSession::new(Key::new([8; 32]), [9; 32], bench.now());
    for _ in 0..10_000 {
        if let Some(hello) = intruder.poll(bench.now()) {
            bench.robot.receive(stranger(), &hello);
        }
        bench.listen_with(stranger(), |now, frame| drop(intruder.receive(now, frame)));
        bench.robot.tick().unwrap();
    }
    assert_ne!(intruder.status(bench.now()), Status::Connected);
    let dropped = bench.robot.link_quality().dropped;
    assert!(dropped.forged > 0, "{dropped:?}");
}

#[test]
fn another_version_is_counted_as_such() {
    let mut bench = Bench::connected();
    let now = bench.now();
    let mut hello = OperatorSession::new(Key::new([7; 32]), [9; 32], now).poll(now).unwrap();
    hello[4] ^= 1;
    let dropped = counted(&mut bench, |bench| bench.robot.receive(stranger(), &hello));
    assert_eq!(dropped, Dropped { version: 1, ..Dropped::default() });
}
