//! Any bytes, for whatever decodes them.

use core::net::SocketAddr;

use flix_host::link::RobotLink;
use flix_protocol::frame::{Datagram, MAXIMUM_MESSAGE};
use flix_protocol::message::{ToOperator, ToRobot, unreadable};
use flix_protocol::provision::{Answer, FrameReader, Request};
use flix_protocol::session::{Key, OperatorSession};
use flix_protocol::units::Instant;
use rand::RngExt;

use super::attacker::{Attacker, LONGEST};
use super::forgery::NETWORK;
use super::kind::Kind;
use crate::rig::bench::{Base, bench_knowing};
use crate::rig::operation::Operation;

/// Feeds so many bytes to decoders and to a live robot; returns how many. Panics where they do.
pub(super) fn fuzz(seed: u64, bytes: u64) -> u64 {
    let Ok(mut operation) = bench_knowing(Base::Fixed, seed, None, NETWORK) else { return 0 };
    let _ = operation.wait_until_connected();
    let mut fuzzer = Fuzzer::new(seed, &operation);
    let mut fed = 0;
    while fed < bytes {
        let input = fuzzer.input((bytes - fed).min(LONGEST as u64) as usize);
        fed += input.len() as u64;
        fuzzer.feed(&mut operation, &input);
        // A tick for every few, so that what was obeyed is acted on.
        if fuzzer.attacker.below(16) == 0 {
            let attacker = &mut fuzzer.attacker;
            let overhear = |towards, datagram: &[u8]| attacker.keep(towards, datagram);
            if operation.tick_overheard(overhear).is_err() {
                break;
            }
            while operation.client().update().is_some() {}
        }
    }
    fed
}

struct Fuzzer {
    attacker: Attacker,
    /// Somebody with the key, who sends what no type allows.
    insider: OperatorSession,
    address: SocketAddr,
    readers: (FrameReader, FrameReader),
}

impl Fuzzer {
    fn new(seed: u64, operation: &Operation) -> Self {
        let now = operation.now();
        Self {
            attacker: Attacker::new(seed, Vec::new(), Vec::new()),
            insider: OperatorSession::new(Key::new([0x5a; 32]), [9; 32], now),
            address: operation.operators[0].address,
            readers: (FrameReader::new(), FrameReader::new()),
        }
    }

    /// At least one byte, and no more than `most`.
    fn input(&mut self, most: usize) -> Vec<u8> {
        let kind = [Kind::Noise, Kind::Headed, Kind::Flipped, Kind::Spliced, Kind::Forged]
            [self.attacker.below(5)];
        let mut input = self.attacker.datagram(kind, Instant::START);
        input.truncate(most);
        if input.is_empty() { vec![0] } else { input }
    }

    fn feed(&mut self, operation: &mut Operation, input: &[u8]) {
        let now = operation.now();
        let _ = Datagram::parse(input);
        let _ = unreadable(input);
        let _ = postcard::from_bytes::<ToRobot>(input);
        let _ = postcard::from_bytes::<ToOperator>(input);
        for &byte in input {
            let _ = self.readers.0.push::<Request>(byte);
            let _ = self.readers.1.push::<Answer>(byte);
        }
        operation.client().receive(now, input);
        operation.robot.receive(self.address, input);
        self.misuse_the_key(operation, now, input);
    }

    /// Takes the session now and then, as its holder may at any time, and says these bytes in it.
    fn misuse_the_key(&mut self, operation: &mut Operation, now: Instant, input: &[u8]) {
        if self.attacker.random.random::<f64>() < 0.001 {
            self.insider.connect(now);
        }
        while let Some(frame) = self.insider.poll(now) {
            operation.robot.receive(self.address, &frame);
            let mut answer = flix_protocol::frame::Frame::new();
            while operation.robot.transmit(&mut answer).is_some() {
                let _ = self.insider.receive(now, &answer);
            }
        }
        let plain = &input[..input.len().min(MAXIMUM_MESSAGE)];
        if let Ok(frame) = self.insider.send_bytes(plain) {
            operation.robot.receive(self.address, &frame);
        }
    }
}
