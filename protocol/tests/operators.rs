//! Several operators of one robot, each with a key of its own.

use crate::ends::{Ends, OPERATOR, SECOND_OPERATOR, answer, connect, key, ping, telemetry};
use flix_protocol::frame::{Frame, KEY_ID_LENGTH};
use flix_protocol::message::{DropReason, OperatorName};
use flix_protocol::session::{
    ConnectError, MAXIMUM_OPERATORS, Operator, OperatorReceived, OperatorSession, Operators,
    RobotReceived, RobotSession, SESSION_EXPIRY, SESSION_LIFE, Status, StopSession,
};

const NAMES: [&str; MAXIMUM_OPERATORS] =
    ["anna", "bob", "carla", "dora", "emil", "fritz", "gina", "hugo"];
/// Place of the key's identifier in a Hello.
const HELLO_KEY_ID: usize = 31;

fn name(number: usize) -> OperatorName {
    NAMES[number].parse().unwrap()
}

/// Operator number 0 has key 1, and so on.
fn operators(numbers: impl IntoIterator<Item = usize>) -> Operators {
    let mut operators = Operators::default();
    for number in numbers {
        let key = key(number as u8 + 1);
        operators.add(Operator::new(name(number), &key)).unwrap();
    }
    operators
}

/// A robot of eight operators, and operator number `holder`.
fn ends(holder: usize) -> Ends {
    let mut ends = Ends::new(None, key(holder as u8 + 1));
    ends.robot = RobotSession::new(operators(0..MAXIMUM_OPERATORS), [11; 32]);
    ends
}

fn connected(holder: usize) -> Ends {
    let mut ends = ends(holder);
    assert_eq!(ends.run(), Status::Connected);
    ends
}

fn arm(ends: &mut Ends) -> RobotReceived {
    let frame = ends.operator.send(ends.now, &ping(1)).unwrap();
    ends.robot_hears(&frame)
}

#[test]
fn each_of_eight_operators_drives_under_its_name() {
    for number in 0..MAXIMUM_OPERATORS {
        let mut ends = connected(number);
        assert_eq!(ends.robot.operator(ends.now), Some(name(number)));
        assert!(matches!(arm(&mut ends), RobotReceived::Message(_)));
        let frame: Frame = ends.robot.send(ends.now, &telemetry(1)).unwrap().1;
        assert!(matches!(ends.operator_hears(&frame), OperatorReceived::Message(_)));
        ends.wait(SESSION_EXPIRY);
        assert_eq!(ends.robot.operator(ends.now), None);
    }
}

#[test]
fn a_key_is_good_under_its_own_identifier_alone() {
    let mut ends = ends(0);
    let hello = ends.operator.poll(ends.now).unwrap();
    let own = key(1).id();
    assert_eq!(hello[HELLO_KEY_ID..HELLO_KEY_ID + KEY_ID_LENGTH], own);
    for id in (2..=9).map(|number| key(number).id()).chain([[0; KEY_ID_LENGTH]]) {
        let mut forged = hello.clone();
        forged[HELLO_KEY_ID..HELLO_KEY_ID + KEY_ID_LENGTH].copy_from_slice(&id);
        let received = ends.robot_hears(&forged);
        assert!(matches!(received, RobotReceived::Dropped(DropReason::Forged, _)), "{received:?}");
    }
    assert!(matches!(ends.robot_hears(&hello), RobotReceived::Answer(_)));
}

#[test]
fn a_key_that_is_none_of_the_robots_is_refused_as_the_wrong_key() {
    let mut ends = ends(0);
    let mut stranger = OperatorSession::new(key(9), [23; 32], ends.now);
    let (_, status) = connect(ends.now, &mut stranger, &mut ends.robot, OPERATOR);
    assert_eq!(status, Status::Failed(ConnectError::WrongKey));
}

#[test]
fn a_revoked_operators_session_ends_at_once_and_its_key_opens_nothing() {
    let mut ends = connected(3);
    assert!(!ends.robot.set_operators(operators([0, 1, 2, 4])));
    assert_eq!(ends.robot.operator(ends.now), None);
    assert_eq!(arm(&mut ends), RobotReceived::Dropped(DropReason::Session, None));
    ends.operator.connect(ends.now);
    assert_eq!(ends.run(), Status::Failed(ConnectError::WrongKey));
    let mut stop = StopSession::new(&key(4), [44; 32], ends.now);
    let hello = stop.poll(ends.now).unwrap();
    let received = ends.robot_hears(&hello);
    assert!(matches!(received, RobotReceived::Dropped(DropReason::Forged, _)));
}

#[test]
fn a_handshake_of_an_operator_that_is_revoked_meanwhile_opens_no_session() {
    let mut ends = ends(3);
    let hello = ends.operator.poll(ends.now).unwrap();
    let challenge = answer(ends.robot_hears(&hello), hello.len()).unwrap();
    ends.operator_hears(&challenge);
    let confirm = ends.operator.poll(ends.now).unwrap();
    ends.robot.set_operators(operators([0, 1, 2]));
    assert_eq!(ends.robot_hears(&confirm), RobotReceived::Dropped(DropReason::Forged, None));
}

#[test]
fn a_session_outlasts_that_others_are_added_revoked_and_renamed() {
    let mut ends = connected(1);
    assert!(ends.robot.set_operators(operators([1, 4])));
    assert!(matches!(arm(&mut ends), RobotReceived::Message(_)));
    let renamed = Operator::new("robert".parse().unwrap(), &key(2));
    assert!(ends.robot.set_operators(renamed));
    assert_eq!(ends.robot.operator(ends.now).unwrap().as_str(), "robert");
    // Its keys are renewed with its own key, which is now in another place.
    let end = ends.now + 2 * SESSION_LIFE;
    while ends.now < end {
        ends.wait(SESSION_EXPIRY / 2);
        while let Some(renewal) = ends.operator.poll(ends.now) {
            let renewed = answer(ends.robot_hears(&renewal), renewal.len()).unwrap();
            ends.operator_hears(&renewed);
        }
        ends.moment();
        ends.ping();
    }
    assert!(matches!(arm(&mut ends), RobotReceived::Message(_)));
}

#[test]
fn a_second_operator_learns_who_holds_the_robot_from_the_robot_alone() {
    let mut ends = connected(0);
    let mut second = OperatorSession::new(key(2), [23; 32], ends.now);
    let hello = second.poll(ends.now).unwrap();
    let received = ends.robot.receive(ends.now, SECOND_OPERATOR, &hello);
    assert!(matches!(received, RobotReceived::Dropped(DropReason::Busy, Some(_))));
    let held = answer(received, hello.len()).unwrap();
    for bit in 0..held.len() * 8 {
        let mut changed = held.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        let received = second.receive(ends.now, &changed);
        assert!(matches!(received, OperatorReceived::Dropped(_)), "bit {bit}");
    }
    second.receive(ends.now, &held);
    let (_, status) = connect(ends.now, &mut second, &mut ends.robot, SECOND_OPERATOR);
    // Meanwhile the first was silent for a second.
    assert_eq!(status, Status::Connected);
    let busy = ConnectError::Busy(Some(name(0))).to_string();
    assert!(busy.contains("another operator holds the robot, anna"), "{busy}");
}

#[test]
fn a_robot_that_stays_held_is_reported_with_its_holder() {
    let mut ends = connected(5);
    let mut second = OperatorSession::new(key(2), [23; 32], ends.now);
    while let Some(at) = second.poll_at() {
        ends.now = ends.now.max(at);
        ends.moment();
        ends.ping();
        if let Some(hello) = second.poll(ends.now) {
            let received = ends.robot.receive(ends.now, SECOND_OPERATOR, &hello);
            second.receive(ends.now, &answer(received, hello.len()).unwrap());
        }
    }
    assert_eq!(second.status(ends.now), Status::Failed(ConnectError::Busy(Some(name(5)))));
}

#[test]
fn another_operator_who_forges_the_holders_address_does_not_take_over() {
    let mut ends = connected(0);
    let mut second = OperatorSession::new(key(2), [23; 32], ends.now);
    let hello = second.poll(ends.now).unwrap();
    let received = ends.robot_hears(&hello);
    assert!(matches!(received, RobotReceived::Dropped(DropReason::Busy, _)), "{received:?}");
    assert!(matches!(arm(&mut ends), RobotReceived::Message(_)));
}

#[test]
fn every_operator_stops_the_robot_and_is_named() {
    for number in 0..MAXIMUM_OPERATORS {
        let mut ends = connected(0);
        let mut stop = StopSession::new(&key(number as u8 + 1), [44; 32], ends.now);
        let hello = stop.poll(ends.now).unwrap();
        let challenge = ends.robot.receive(ends.now, SECOND_OPERATOR, &hello);
        stop.receive(ends.now, &answer(challenge, hello.len()).unwrap()).unwrap();
        let demand = stop.poll(ends.now).unwrap();
        let received = ends.robot.receive(ends.now, SECOND_OPERATOR, &demand);
        let RobotReceived::Stop(stopped, by) = received else { panic!("{received:?}") };
        assert_eq!(by, name(number));
        assert_eq!(stop.receive(ends.now, &stopped), Ok(()));
        assert!(matches!(arm(&mut ends), RobotReceived::Message(_)), "the session goes on");
    }
}
