//! Targets for a fuzzer, which are plain tests too: any datagrams to a whole robot.
//!
//! `cargo test` tries each with random input for a second. Under a coverage-guided fuzzer (needs
//! `cargo install cargo-bolero` and a nightly compiler):
//!
//! ```text
//! cargo bolero test -p flix-firmware robot_receive_survives_any_datagrams -T 10min
//! ```

use crate::ends::Ends;
use bolero::{TypeGenerator, check};
use flix_firmware::board::DENGFOC_V3_01;
use flix_firmware::hardware::Bridge;
use flix_protocol::message::{Command, Order, Permit, State, ToRobot};

/// A robot, an operator who holds its session, and all that he said.
struct Target {
    ends: Ends,
    sent: Vec<Vec<u8>>,
}

impl Target {
    fn connected() -> Self {
        let mut ends = Ends::unconnected(DENGFOC_V3_01.hardware);
        ends.connect();
        Self { ends, sent: Vec::new() }
    }

    fn tick(&mut self, ticks: u16) {
        for _ in 0..ticks {
            self.ends.cross();
            self.ends.tick(1);
            self.ends.cross();
        }
    }

    fn say(&mut self, plain: &[u8]) {
        if let Ok(frame) = self.ends.operator.send_bytes(plain) {
            self.sent.push(frame.to_vec());
            self.ends.hear(&frame);
        }
    }

    fn rests(&self) -> bool {
        let at_ease = |bridge: &Bridge| matches!(bridge, Bridge::Off) || *bridge == Bridge::BRAKE;
        let state = self.ends.exchange.newest_report().state;
        state == State::Disarmed && self.ends.actuation.bridges.iter().all(at_ease)
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
    fn happen(&self, target: &mut Target) {
        match self {
            Self::Noise(bytes) => target.ends.hear(bytes),
            Self::Headed(kind, bytes) => {
                target.ends.hear(&[b"flx".as_slice(), &[kind % 8], bytes].concat());
            }
            Self::Again { which, place, flip } => {
                let which = usize::from(*which) % target.sent.len().max(1);
                let Some(mut datagram) = target.sent.get(which).cloned() else { return };
                let place = usize::from(*place) % datagram.len();
                datagram[place] ^= flip;
                target.ends.hear(&datagram);
            }
            Self::Wait(ticks) => target.tick((*ticks).into()),
        }
    }
}

/// What somebody with the key can say, too.
#[derive(Debug, Clone, TypeGenerator)]
enum Step {
    Strange(Strange),
    /// Any bytes, well sealed.
    Sealed(Vec<u8>),
    /// An order of this kind with any bytes behind it, well sealed.
    Order(u8, Vec<u8>),
    /// A request of this kind, likewise.
    Request(u8, Vec<u8>),
}

#[test]
fn robot_receive_survives_any_datagrams() {
    check!().with_type::<Vec<Step>>().for_each(|steps| {
        let mut target = Target::connected();
        for step in steps {
            match step {
                Step::Strange(strange) => strange.happen(&mut target),
                Step::Sealed(plain) => target.say(plain),
                Step::Order(kind, bytes) => {
                    target.say(&[&[0, kind % 7], bytes.as_slice()].concat())
                }
                Step::Request(kind, bytes) => {
                    target.say(&[&[1, 1, kind % 7], bytes.as_slice()].concat());
                }
            }
            target.tick(1);
        }
    });
}

#[test]
fn strangers_never_drive_a_bridge() {
    check!().with_type::<Vec<Strange>>().for_each(|steps| {
        let mut target = Target::connected();
        // Something to repeat: the operator asks, and arms too early.
        for message in [
            ToRobot::request(1, Command::Identify),
            ToRobot::Order(Order::Arm(Permit::default())),
            ToRobot::request(3, Command::Ping(0)),
        ] {
            let frame = target.ends.seal(message);
            target.sent.push(frame.to_vec());
            target.ends.hear(&frame);
        }
        for step in steps {
            step.happen(&mut target);
            assert!(target.rests());
        }
        // The fast half reports every tenth tick.
        target.tick(10);
        assert!(target.rests());
    });
}
