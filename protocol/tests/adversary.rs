//! Somebody on the network who sees everything, sends anything, and does not have the key.

use crate::ends::{Ends, OPERATOR, answer, key, ping, telemetry, walk};
use flix_protocol::frame::MAXIMUM_DATAGRAM;
use flix_protocol::message::DropReason;
use flix_protocol::session::{OperatorReceived, OperatorSession, RobotReceived, RobotSession};
use flix_protocol::units::Instant;
use proptest::prelude::*;

/// Everything that crosses the network from the first Hello to the first telemetry.
struct Recording {
    to_robot: Vec<Vec<u8>>,
    to_operator: Vec<Vec<u8>>,
}

fn record(ends: &mut Ends) -> Recording {
    let mut recording = Recording { to_robot: Vec::new(), to_operator: Vec::new() };
    while let Some(frame) = ends.operator.poll(ends.now) {
        let answer = answer(ends.robot_hears(&frame), frame.len()).unwrap();
        ends.operator_hears(&answer);
        recording.to_robot.push(frame.to_vec());
        recording.to_operator.push(answer);
    }
    let frame = ends.operator.send(ends.now, &walk(35.0, 0.0)).unwrap();
    recording.to_robot.push(frame.to_vec());
    let (_, frame) = ends.robot.send(ends.now, &telemetry(1)).unwrap();
    recording.to_operator.push(frame.to_vec());
    recording
}

/// A robot or an operator did something that only the holder of the key may ask for.
fn robot_was_fooled(received: &RobotReceived) -> bool {
    !matches!(received, RobotReceived::Dropped(..))
}

#[test]
fn every_flipped_bit_of_every_datagram_to_the_robot_is_dropped() {
    for kind in 0..3 {
        // The robot stands where this datagram is the next to come.
        let mut ends = Ends::new(Some(key(1)), key(1));
        let recording = record(&mut ends);
        let mut robot = RobotSession::new(Some(key(1)), [11; 32]);
        for datagram in &recording.to_robot[..kind] {
            robot.receive(ends.now, OPERATOR, datagram);
        }
        let genuine = &recording.to_robot[kind];
        for bit in 0..genuine.len() * 8 {
            let mut tampered = genuine.clone();
            tampered[bit / 8] ^= 1 << (bit % 8);
            let received = robot.receive(ends.now, OPERATOR, &tampered);
            assert!(!robot_was_fooled(&received), "datagram {kind}, bit {bit}: {received:?}");
        }
        let received = robot.receive(ends.now, OPERATOR, genuine);
        assert!(robot_was_fooled(&received), "the genuine one still counts: {received:?}");
    }
}

#[test]
fn every_flipped_bit_of_every_datagram_to_the_operator_is_dropped() {
    for kind in 0..3 {
        let mut ends = Ends::new(Some(key(1)), key(1));
        let mut operator = OperatorSession::new(key(1), [22; 32], ends.now);
        let recording = record(&mut ends);
        let _ = operator.poll(ends.now);
        for datagram in &recording.to_operator[..kind] {
            operator.receive(ends.now, datagram);
        }
        let genuine = &recording.to_operator[kind];
        for bit in 0..genuine.len() * 8 {
            let mut tampered = genuine.clone();
            tampered[bit / 8] ^= 1 << (bit % 8);
            let received = operator.receive(ends.now, &tampered);
            let dropped = matches!(received, OperatorReceived::Dropped(_));
            assert!(dropped, "datagram {kind}, bit {bit}: {received:?}");
        }
        let received = operator.receive(ends.now, genuine);
        assert!(!matches!(received, OperatorReceived::Dropped(_)), "{received:?}");
    }
}

#[test]
fn every_truncation_and_extension_is_dropped() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let recording = record(&mut ends);
    for (kind, genuine) in recording.to_robot.iter().enumerate() {
        let mut robot = RobotSession::new(Some(key(1)), [11; 32]);
        for datagram in &recording.to_robot[..kind] {
            robot.receive(ends.now, OPERATOR, datagram);
        }
        for length in (0..genuine.len()).chain(genuine.len() + 1..MAXIMUM_DATAGRAM + 20) {
            let mut changed = genuine.clone();
            changed.resize(length, 0);
            let received = robot.receive(ends.now, OPERATOR, &changed);
            assert!(!robot_was_fooled(&received), "datagram {kind}, {length} bytes: {received:?}");
        }
    }
}

#[test]
fn a_recording_played_again_does_nothing() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let recording = record(&mut ends);
    let last = recording.to_robot.last().unwrap();
    assert_eq!(ends.robot_hears(last), RobotReceived::Message(walk(35.0, 0.0)));
    let peer = ends.robot.peer(ends.now);
    for _ in 0..3 {
        for datagram in &recording.to_robot {
            let received = ends.robot_hears(datagram);
            // A repeated Hello or Confirm is answered as a lost answer would be.
            let harmless =
                matches!(received, RobotReceived::Answer(_) | RobotReceived::Dropped(..));
            assert!(harmless, "{received:?}");
        }
    }
    assert_eq!(ends.robot.peer(ends.now), peer);
    let fresh = ends.operator.send(ends.now, &ping(2)).unwrap();
    assert_eq!(ends.robot_hears(&fresh), RobotReceived::Message(ping(2)));
}

#[test]
fn a_recording_played_to_a_robot_that_restarted_does_nothing() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let recording = record(&mut ends);
    let mut restarted = RobotSession::new(Some(key(1)), [99; 32]);
    for datagram in &recording.to_robot {
        let received = restarted.receive(ends.now, OPERATOR, datagram);
        assert!(matches!(received, RobotReceived::Answer(_) | RobotReceived::Dropped(..)));
    }
    assert_eq!(restarted.peer(ends.now), None);
}

#[test]
fn another_key_opens_nothing() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let recording = record(&mut ends);
    let mut robot = RobotSession::new(Some(key(2)), [11; 32]);
    let mut operator = OperatorSession::new(key(2), [22; 32], ends.now);
    let _ = operator.poll(ends.now);
    for datagram in &recording.to_robot {
        let received = robot.receive(ends.now, OPERATOR, datagram);
        assert!(!robot_was_fooled(&received), "{received:?}");
    }
    for datagram in &recording.to_operator {
        let received = operator.receive(ends.now, datagram);
        assert!(matches!(received, OperatorReceived::Dropped(_)), "{received:?}");
    }
}

/// What the robot keeps does not grow, whoever sends whatever.
#[test]
fn the_robots_state_is_of_constant_size() {
    // A key, two secrets, two nonces, one session with the times of 64 datagrams, and counters.
    assert!(size_of::<RobotSession>() <= 8192, "{} bytes", size_of::<RobotSession>());
}

#[test]
fn a_flood_of_hellos_keeps_nobody_out() {
    let mut ends = Ends::new(Some(key(1)), key(1));
    let genuine = OperatorSession::new(key(1), [7; 32], ends.now).poll(ends.now).unwrap();
    let flood = |ends: &mut Ends, seed: u64| {
        for number in 0..1000_u64 {
            let mut hello = genuine.clone();
            let noise = (seed * 1000 + number).wrapping_mul(0x9E37_79B9_7F4A_7C15).to_le_bytes();
            hello[14..22].copy_from_slice(&noise);
            let stranger = ([10, 0, noise[0], noise[1]], 4000).into();
            let received = ends.robot.receive(ends.now, stranger, &hello);
            assert!(matches!(received, RobotReceived::Dropped(DropReason::Forged, Some(_))));
        }
    };
    flood(&mut ends, 1);
    let hello = ends.operator.poll(ends.now).unwrap();
    let challenge = answer(ends.robot_hears(&hello), hello.len()).unwrap();
    flood(&mut ends, 2);
    ends.operator_hears(&challenge);
    let confirm = ends.operator.poll(ends.now).unwrap();
    assert!(matches!(ends.robot_hears(&confirm), RobotReceived::Connected(_)));
}

proptest! {
    #[test]
    fn no_datagram_without_the_key_changes_a_session(
        datagrams in prop::collection::vec(forgery(), 1..60),
    ) {
        let mut ends = Ends::connected();
        let genuine = ends.operator.send(ends.now, &walk(35.0, 0.0)).unwrap();
        let (_, telemetry) = ends.robot.send(ends.now, &telemetry(1)).unwrap();
        for forgery in datagrams {
            let datagram = forgery.apply(&genuine);
            let received = ends.robot_hears(&datagram);
            prop_assert!(matches!(received, RobotReceived::Dropped(..)), "{:?}", received);
            let received = ends.operator_hears(&datagram);
            prop_assert!(matches!(received, OperatorReceived::Dropped(_)), "{:?}", received);
        }
        let obeyed = RobotReceived::Message(walk(35.0, 0.0));
        prop_assert_eq!(ends.robot_hears(&genuine), obeyed);
        let received = ends.operator_hears(&telemetry);
        prop_assert!(matches!(received, OperatorReceived::Message(_)), "{:?}", received);
        prop_assert!(ends.robot.quality(ends.now).dropped.total() > 0);
        prop_assert_eq!(ends.robot.peer(Instant::from_micros(1_000)), Some(OPERATOR));
    }
}

#[derive(Debug, Clone)]
enum Forgery {
    /// Any bytes.
    Noise(Vec<u8>),
    /// Any bytes behind a well-formed head of this kind.
    Kind(u8, Vec<u8>),
    /// The genuine datagram under another counter.
    Counter(u64),
    /// The genuine head before another body.
    Body(Vec<u8>),
}

fn forgery() -> impl Strategy<Value = Forgery> {
    let bytes = || prop::collection::vec(any::<u8>(), 0..520);
    prop_oneof![
        bytes().prop_map(Forgery::Noise),
        (0_u8..8, bytes()).prop_map(|(kind, bytes)| Forgery::Kind(kind, bytes)),
        // Each kind in its own length.
        (select_length(), prop::collection::vec(any::<u8>(), 60))
            .prop_map(|((kind, length), bytes)| Forgery::Kind(kind, bytes[..length - 4].to_vec())),
        (1_u64..).prop_map(Forgery::Counter),
        bytes().prop_map(Forgery::Body),
    ]
}

fn select_length() -> impl Strategy<Value = (u8, usize)> {
    prop::sample::select(vec![(1, 62), (2, 36), (3, 52), (4, 24), (5, 47), (6, 40)])
}

impl Forgery {
    fn apply(self, genuine: &[u8]) -> Vec<u8> {
        match self {
            Self::Noise(bytes) => bytes,
            Self::Kind(kind, bytes) => [b"flx".as_slice(), &[kind], &bytes].concat(),
            Self::Counter(counter) => {
                [&genuine[..8], &counter.to_le_bytes(), &genuine[16..]].concat()
            }
            Self::Body(bytes) => [&genuine[..16], &bytes].concat(),
        }
    }
}
