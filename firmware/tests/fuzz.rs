//! Targets for a fuzzer, which are plain tests too: any datagrams to a whole robot.
//!
//! `cargo test` tries each with random input for a second. Under a coverage-guided fuzzer (needs
//! `cargo install cargo-bolero` and a nightly compiler):
//!
//! ```text
//! cargo bolero test -p flix-firmware robot_receive_survives_any_datagrams -T 10min
//! ```

use core::net::SocketAddr;

use crate::no_store::NoStore;
use crate::still::AT_REST;
use bolero::{TypeGenerator, check};
use flix_firmware::board::DENGFOC_V3_01;
use flix_firmware::hardware::{Actuation, Bridge};
use flix_firmware::robot::Robot;
use flix_protocol::frame::Frame;
use flix_protocol::message::{Command, State, ToRobot};
use flix_protocol::session::{Key, OperatorSession, Status};
use flix_protocol::units::Instant;

/// A robot and an operator who holds its session.
struct Ends {
    robot: Robot<NoStore>,
    operator: OperatorSession,
    address: SocketAddr,
    now: Instant,
    /// What the bridges did last.
    last: Actuation,
    sent: Vec<Vec<u8>>,
}

impl Ends {
    fn connected() -> Self {
        let now = Instant::from_micros(1_000);
        let key = || Key::new([1; 32]);
        let hardware = DENGFOC_V3_01.hardware;
        let mut ends = Self {
            robot: Robot::new(hardware, "fuzzed", Some(key()), [11; 32], NoStore),
            operator: OperatorSession::new(key(), [22; 32], now),
            address: ([192, 168, 4, 2], 4_000).into(),
            now,
            last: Actuation::OFF,
            sent: Vec::new(),
        };
        while ends.operator.status(ends.now) == Status::Connecting {
            if let Some(frame) = ends.operator.poll(ends.now) {
                ends.hear(&frame);
            }
            ends.tick(1);
        }
        ends
    }

    /// The robot takes a datagram, and the operator what the robot answers.
    fn hear(&mut self, datagram: &[u8]) {
        self.robot.slow.receive(self.now, self.address, datagram);
        let mut frame = Frame::new();
        while self.robot.slow.transmit(self.now, &mut frame).is_some() {
            let _ = self.operator.receive(self.now, &frame);
        }
    }

    fn tick(&mut self, ticks: u16) {
        for _ in 0..ticks {
            self.now = Instant::from_micros(self.now.as_micros() + 100);
            self.last = self.robot.tick(self.now, &AT_REST);
        }
    }

    fn say(&mut self, plain: &[u8]) {
        if let Ok(frame) = self.operator.send_bytes(plain) {
            self.sent.push(frame.to_vec());
            self.hear(&frame);
        }
    }
}

/// What somebody without the key can do, and time.
#[derive(Debug, Clone, TypeGenerator)]
enum Strange {
    /// Any bytes come in.
    Noise(Vec<u8>),
    /// Any bytes behind a good head.
    Headed(u8, Vec<u8>),
    /// What was said before comes again, with one byte changed or none.
    Again { which: u8, place: u16, flip: u8 },
    /// Time passes.
    Wait(u8),
}

impl Strange {
    fn happen(&self, ends: &mut Ends) {
        match self {
            Self::Noise(bytes) => ends.hear(bytes),
            Self::Headed(kind, bytes) => {
                ends.hear(&[b"flx".as_slice(), &[kind % 8], bytes].concat());
            }
            Self::Again { which, place, flip } => {
                let which = usize::from(*which) % ends.sent.len().max(1);
                let Some(mut datagram) = ends.sent.get(which).cloned() else { return };
                let place = usize::from(*place) % datagram.len();
                datagram[place] ^= flip;
                ends.hear(&datagram);
            }
            Self::Wait(ticks) => ends.tick((*ticks).into()),
        }
    }
}

/// What somebody with the key can say, too.
#[derive(Debug, Clone, TypeGenerator)]
enum Step {
    Strange(Strange),
    /// Any bytes, well sealed.
    Sealed(Vec<u8>),
    /// A command of this number with any bytes behind it, well sealed.
    Command(u8, Vec<u8>),
}

#[test]
fn robot_receive_survives_any_datagrams() {
    check!().with_type::<Vec<Step>>().for_each(|steps| {
        let mut ends = Ends::connected();
        for step in steps {
            match step {
                Step::Strange(strange) => strange.happen(&mut ends),
                Step::Sealed(plain) => ends.say(plain),
                Step::Command(number, bytes) => {
                    ends.say(&[&[1, number % 10], bytes.as_slice()].concat());
                }
            }
            ends.tick(1);
        }
    });
}

#[test]
fn strangers_never_drive_a_bridge() {
    check!().with_type::<Vec<Strange>>().for_each(|steps| {
        let mut ends = Ends::connected();
        // Something to repeat: the operator asks, and arms too early.
        for (request, command) in [(1, Command::Identify), (2, Command::Arm), (3, Command::Ping(0))]
        {
            let message = ToRobot { request, intent: 0, halts: 0, command };
            let frame = ends.operator.send(ends.now, &message).unwrap();
            ends.sent.push(frame.to_vec());
            ends.hear(&frame);
        }
        for step in steps {
            step.happen(&mut ends);
            let at_ease = ends
                .last
                .bridges
                .iter()
                .all(|bridge| matches!(bridge, Bridge::Off) || *bridge == Bridge::BRAKE);
            assert!(at_ease && ends.robot.report().state == State::Disarmed);
        }
    });
}
