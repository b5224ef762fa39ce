//! What one datagram costs the robot's end: what a flood has to pay for.
//!
//! Time on the machine that runs it; divide 1 s by a time for the datagrams a second that one core
//! answers.

use std::hint::black_box;
use std::net::SocketAddr;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use flix_protocol::message::{Command, Outcome, Reply, ToOperator, ToRobot};
use flix_protocol::session::{Key, OperatorSession, RobotReceived, RobotSession};
use flix_protocol::units::Instant;

fn answer(received: RobotReceived) -> Vec<u8> {
    match received {
        RobotReceived::Answer(frame) | RobotReceived::Connected(frame) => frame.to_vec(),
        other => panic!("the handshake goes on: {other:?}"),
    }
}

fn handshake(criterion: &mut Criterion) {
    let now = Instant::from_micros(1_000);
    let address: SocketAddr = ([192, 168, 4, 2], 4000).into();
    let key = || Key::new([1; 32]);
    let mut robot = RobotSession::new(Some(key()), [11; 32]);
    let mut operator = OperatorSession::new(key(), [22; 32], now);
    let hello = operator.poll(now).expect("Hello is due").to_vec();
    let challenge = answer(robot.receive(now, address, &hello));
    operator.receive(now, &challenge);
    let confirm = operator.poll(now).expect("Confirm is due").to_vec();

    let mut forged_hello = hello.clone();
    forged_hello[20] ^= 1;
    let mut forged_confirm = confirm.clone();
    forged_confirm[20] ^= 1;

    let mut group = criterion.benchmark_group("robot receives");
    group.throughput(Throughput::Elements(1));
    for (name, datagram) in [
        ("noise", &[0xA5; 64][..]),
        ("a forged Hello", &forged_hello),
        ("a good Hello", &hello),
        ("a forged Confirm", &forged_confirm),
    ] {
        group.bench_function(name, |bencher| {
            bencher.iter(|| robot.receive(now, black_box(address), black_box(datagram)));
        });
    }
    group.bench_function("a good Confirm", |bencher| {
        // Its cookie is good once, so each gets a robot that has just given it.
        let fresh = || RobotSession::new(Some(key()), [11; 32]);
        bencher.iter_batched_ref(
            fresh,
            |robot| robot.receive(now, black_box(address), black_box(&confirm)),
            criterion::BatchSize::SmallInput,
        );
    });

    let accept = answer(robot.receive(now, address, &confirm));
    operator.receive(now, &accept);
    let mut forged = operator.send(now, &ToRobot::request(1, Command::Ping(1))).expect("connected");
    forged[16] ^= 1;
    group.bench_function("a forged command", |bencher| {
        bencher.iter(|| robot.receive(now, address, black_box(&forged)));
    });
    group.bench_function("a good command, with its reply", |bencher| {
        bencher.iter(|| {
            let ping = ToRobot::request(1, Command::Ping(1));
            let frame = operator.send(now, &ping).expect("connected");
            let received = robot.receive(now, address, &frame);
            let reply = ToOperator::Reply(Reply { request: 1, outcome: Outcome::Pong(1) });
            (received, robot.send(now, &reply))
        });
    });
    group.finish();
}

criterion_group!(benches, handshake);
criterion_main!(benches);
