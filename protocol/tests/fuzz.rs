//! Targets for a fuzzer, which are plain tests too.
//!
//! `cargo test` tries each with random input for a second. Under a coverage-guided fuzzer (needs
//! `cargo install cargo-bolero` and a nightly compiler):
//!
//! ```text
//! cargo bolero test -p flix-protocol robot_survives_any_datagrams -T 10min
//! ```

use core::time::Duration;

use crate::ends::{Ends, OPERATOR, SECOND_OPERATOR, STOP, key, ping, telemetry};
use bolero::{check, generator::*};
use flix_protocol::frame::Datagram;
use flix_protocol::message::{ToOperator, ToRobot, unreadable};
use flix_protocol::provision::{Answer, FrameReader, Request};
use flix_protocol::session::{OperatorReceived, RobotReceived, Status};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// What can be read can be written, and is then read as the same.
fn reads_as_it_writes<T: Serialize + DeserializeOwned + PartialEq + core::fmt::Debug>(
    bytes: &[u8],
) {
    if let Ok(message) = postcard::from_bytes::<T>(bytes) {
        let mut buffer = [0; 1024];
        let written = postcard::to_slice(&message, &mut buffer).expect("a message is short");
        // Through text: a NaN in a reply is not equal to itself.
        let again = postcard::from_bytes::<T>(written).expect("what was written can be read");
        assert_eq!(format!("{again:?}"), format!("{message:?}"));
    }
}

#[test]
fn decoders_survive_any_bytes() {
    check!().for_each(|bytes: &[u8]| {
        let _ = Datagram::parse(bytes);
        let _ = unreadable(bytes);
        reads_as_it_writes::<ToRobot>(bytes);
        reads_as_it_writes::<ToOperator>(bytes);
    });
}

#[test]
fn serial_readers_survive_any_bytes() {
    check!().for_each(|bytes: &[u8]| {
        let (mut robot, mut operator) = (FrameReader::new(), FrameReader::new());
        for &byte in bytes {
            let _ = robot.push::<Request>(byte);
            let _ = operator.push::<Answer>(byte);
        }
    });
}

/// What happens next to a session.
#[derive(Debug, Clone, TypeGenerator)]
enum Step {
    /// Any bytes come in.
    Noise(Vec<u8>),
    /// A datagram of this kind with any content comes in.
    Forged { kind: u8, content: Vec<u8> },
    /// A datagram that was sent before comes in again, with some bytes changed.
    Again { which: u8, place: u16, flip: u8, from_second: bool },
    /// The other end says something.
    Genuine(u8),
    /// The other end says what the types do not allow.
    Unchecked(Vec<u8>),
    /// Time passes.
    Wait(u16),
    /// The operator begins anew.
    Connect,
}

/// Plays steps against both ends, and looks after each that nobody was fooled.
fn play(steps: &[Step]) {
    let mut ends = Ends::connected();
    let mut sent: Vec<Vec<u8>> = Vec::new();
    for (number, step) in (0_u32..).zip(steps) {
        let (datagram, is_authentic, from) = match step {
            Step::Noise(bytes) => (bytes.clone(), false, OPERATOR),
            Step::Forged { kind, content } => {
                ([b"flx".as_slice(), &[kind % 8], content].concat(), false, OPERATOR)
            }
            Step::Again { which, place, flip, from_second } => {
                let Some(mut datagram) = sent.get(usize::from(*which) % sent.len().max(1)).cloned()
                else {
                    continue;
                };
                let place = usize::from(*place) % datagram.len();
                datagram[place] ^= flip;
                (datagram, false, if *from_second { SECOND_OPERATOR } else { OPERATOR })
            }
            Step::Genuine(kind) => {
                let message = if kind % 3 == 0 { STOP } else { ping(number) };
                let frame = ends.operator.send(ends.now, &message);
                let Ok(frame) = frame else { continue };
                if let Ok((_, frame)) = ends.robot.send(ends.now, &telemetry(u64::from(number))) {
                    sent.push(frame.to_vec());
                }
                (frame.to_vec(), true, OPERATOR)
            }
            Step::Unchecked(plain) => {
                let Ok(frame) = ends.operator.send_bytes(plain) else { continue };
                (frame.to_vec(), true, OPERATOR)
            }
            Step::Wait(milliseconds) => {
                ends.wait(Duration::from_millis((*milliseconds).into()));
                continue;
            }
            Step::Connect => {
                ends.operator.connect(ends.now);
                assert_eq!(ends.run(), Status::Connected, "the holder can always come back");
                continue;
            }
        };
        let before = ends.robot.quality(ends.now).dropped.total();
        let received = ends.robot.receive(ends.now, from, &datagram);
        let is_dropped = matches!(received, RobotReceived::Dropped(..));
        let counted = ends.robot.quality(ends.now).dropped.total() - before;
        assert_eq!(counted, u64::from(is_dropped), "every dropped datagram is counted");
        let acts = matches!(
            received,
            RobotReceived::Message(_)
                | RobotReceived::Late { .. }
                | RobotReceived::Connected(_)
                | RobotReceived::Left
                | RobotReceived::Stop(..)
                | RobotReceived::Unreadable(_)
        );
        assert!(is_authentic || !acts, "{received:?}");
        let received = ends.operator.receive(ends.now, &datagram);
        assert!(!matches!(received, OperatorReceived::Left | OperatorReceived::Connected));
        if is_authentic {
            sent.push(datagram);
        }
    }
}

#[test]
fn robot_survives_any_datagrams() {
    check!().with_type::<Vec<Step>>().for_each(|steps| play(steps));
}

/// The whole of a handshake under attack: any bytes between any two of its datagrams.
#[test]
fn a_handshake_survives_any_datagrams() {
    check!().with_type::<[Vec<u8>; 8]>().for_each(|noise| {
        let mut ends = Ends::new(Some(key(1)), key(1));
        let mut noise = noise.iter();
        let mut disturb = |ends: &mut Ends| {
            if let Some(bytes) = noise.next() {
                for kind in 0..11 {
                    let datagram = [b"flx".as_slice(), &[kind], bytes].concat();
                    ends.operator_hears(&datagram);
                    ends.robot_hears(&datagram);
                    ends.robot.receive(ends.now, SECOND_OPERATOR, &datagram);
                }
            }
        };
        while let Some(at) = ends.operator.poll_at() {
            ends.now = ends.now.max(at);
            while let Some(frame) = ends.operator.poll(ends.now) {
                disturb(&mut ends);
                let answer = crate::ends::answer(ends.robot_hears(&frame), frame.len());
                disturb(&mut ends);
                if let Some(answer) = answer {
                    ends.operator_hears(&answer);
                }
            }
        }
        assert_eq!(ends.operator.status(ends.now), Status::Connected);
    });
}
