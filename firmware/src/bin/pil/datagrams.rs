//! Instructions that the robot takes for one datagram, its answer included.

use core::net::SocketAddr;

use flix_firmware::board::DENGFOC_V3_01;
use flix_firmware::hardware::NoStore;
use flix_firmware::robot::Robot;
use flix_protocol::frame::Frame;
use flix_protocol::message::{Command, Order, ToRobot};
use flix_protocol::session::{Key, OperatorReceived, OperatorSession};
use flix_protocol::units::Instant;

use crate::machine::{Stopwatch, println};
use crate::overhead;

const NOW: Instant = Instant::from_micros(1_000_000);
/// A byte of every datagram that its tag covers.
const FORGED: usize = 20;

struct Counter {
    robot: Robot<NoStore>,
    address: SocketAddr,
    overhead: u32,
}

impl Counter {
    /// Lets the robot receive a datagram, prints what that took, and returns the answer.
    fn receive(&mut self, name: &str, datagram: &[u8]) -> Frame {
        let mut answer = Frame::new();
        let stopwatch = Stopwatch::start();
        self.robot.slow.receive(NOW, self.address, core::hint::black_box(datagram));
        let _ = self.robot.slow.transmit(NOW, &mut answer);
        let spent = stopwatch.instructions().wrapping_sub(self.overhead);
        println!("datagram {spent} {name}");
        answer
    }

    /// As [`Counter::receive`], with a bit flipped.
    fn forge(&mut self, name: &str, datagram: &[u8]) {
        let mut forged = Frame::new();
        let _ = forged.extend_from_slice(datagram);
        if let Some(byte) = forged.get_mut(FORGED) {
            *byte ^= 1;
        }
        self.receive(name, &forged);
    }
}

/// Prints a line `datagram N NAME` for each kind; `None` where operator and robot do not understand each other.
pub(crate) fn count() -> Option<()> {
    let key = || Some(Key::new([1; 32]));
    let mut counter = Counter {
        robot: Robot::new(DENGFOC_V3_01.hardware, "daisy", key(), [11; 32], NoStore),
        address: ([192, 168, 4, 2], 4_000).into(),
        overhead: overhead(),
    };
    let mut operator = OperatorSession::new(key()?, [22; 32], NOW);
    counter.receive("noise", &[0xa5; 64]);
    let hello = operator.poll(NOW)?;
    counter.forge("a forged Hello", &hello);
    let challenge = counter.receive("a good Hello", &hello);
    operator.receive(NOW, &challenge);
    let confirm = operator.poll(NOW)?;
    counter.forge("a forged Confirm", &confirm);
    let accept = counter.receive("a good Confirm: a session begins", &confirm);
    let is_connected = operator.receive(NOW, &accept) == OperatorReceived::Connected;
    let mut seal = |message| operator.send(NOW, &message).ok();
    let ping = seal(ToRobot::request(1, Command::Ping(1)))?;
    counter.forge("a forged request", &ping);
    counter.receive("a good request, with its reply", &ping);
    counter.receive("a request replayed", &ping);
    let stop = seal(ToRobot::Order(Order::Stop))?;
    counter.receive("a good order: a stop", &stop);
    is_connected.then_some(())
}
