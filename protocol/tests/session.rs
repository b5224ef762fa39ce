//! Two ends on a virtual network in virtual time.

mod ends;

use core::time::Duration;

use ends::{Ends, OPERATOR, command, key, telemetry};
use flix_protocol::message::Command;
use flix_protocol::session::{ConnectError, OperatorReceived, RobotReceived, Status};
use flix_protocol::units::Instant;

#[test]
fn the_right_key_connects_and_both_ends_are_heard() {
    let mut ends = Ends::connected();
    let frame = ends.operator.send(ends.now, &command(7, Command::Arm)).unwrap();
    assert_eq!(ends.to_robot(&frame), RobotReceived::Command(command(7, Command::Arm)));
    let (peer, frame) = ends.robot.send(ends.now, &telemetry(5)).unwrap();
    assert_eq!(peer, OPERATOR);
    assert_eq!(ends.operator.receive(ends.now, &frame), OperatorReceived::Message(telemetry(5)));
    assert_eq!(ends.robot.quality(ends.now).dropped.total(), 0);
}

#[test]
fn a_wrong_key_is_refused_with_that_sentence() {
    let mut ends = Ends::new(Some(key(1)), key(2));
    assert_eq!(ends.run(), Status::Failed(ConnectError::WrongKey));
    assert!(ends.now < Instant::START + Duration::from_secs(1), "without long waiting");
}

#[test]
fn a_robot_without_a_key_refuses_everybody() {
    let mut ends = Ends::new(None, key(1));
    assert_eq!(ends.run(), Status::Failed(ConnectError::Unprovisioned));
}
