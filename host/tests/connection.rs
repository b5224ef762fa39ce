//! What an operator's program asks of a robot in real time, and how that ends.

use std::net::UdpSocket;

use flix_host::link::udp::{Connection, stop};
use flix_host::link::{LinkError, RobotLink, Wish};
use flix_host::system::interrupt::Interrupt;
use flix_protocol::message::{Fault, Halt, OperatorName, State, Telemetry};
use flix_protocol::session::Key;

use crate::support::{FakeRobot, ServedRobot, key};

/// Serves a robot, and connects to it.
fn connect(change: impl FnOnce(&mut FakeRobot)) -> (ServedRobot, Connection) {
    let mut robot = FakeRobot::new(Some(key()));
    change(&mut robot);
    let served = ServedRobot::steady(robot);
    let mut connection = Connection::open(served.address, key(), Interrupt::never()).unwrap();
    connection.wait_until_connected().unwrap();
    (served, connection)
}

#[test]
fn a_robot_whose_commands_stayed_away_while_it_aligned_its_motors_is_armed_again() {
    let (served, mut connection) = connect(|robot| robot.lapses = Some(Halt::LetGo));
    connection.arm().unwrap();
    assert_eq!(served.robot().state, State::Armed);
    assert_eq!(served.robot().lapses, None);
}

#[test]
fn a_robot_that_disarms_by_itself_while_it_aligns_its_motors_is_not_armed_again() {
    let (served, mut connection) = connect(|robot| robot.lapses = Some(Halt::LinkLost));
    let ended = connection.arm();
    assert_eq!(ended, Err(LinkError::Lapsed));
    assert_eq!(served.robot().state, State::Disarmed);
}

#[test]
fn who_knows_of_a_stop_waits_until_it_can_be_cleared() {
    let (served, mut connection) =
        connect(|robot| (robot.stopped, robot.ramps_down_for) = (true, 3));
    connection.clear(std::time::Instant::now()).unwrap();
    let robot = served.robot();
    assert_eq!((robot.stopped, robot.ramps_down_for), (false, 0));
    drop(robot);
}

#[test]
fn a_stop_that_comes_while_another_cannot_be_cleared_yet_is_not_cleared() {
    let (served, mut connection) =
        connect(|robot| (robot.stopped, robot.ramps_down_for) = (true, 20));
    let stopped = std::thread::scope(|scope| {
        scope.spawn(|| {
            while served.robot().ramps_down_for > 15 {
                std::thread::yield_now();
            }
            served.robot().stop_from_outside();
        });
        connection.clear(std::time::Instant::now())
    });
    assert_eq!(stopped, Err(LinkError::StoppedBy(OperatorName::OWNER)));
    assert!(served.robot().stopped);
}

/// What becomes of a robot with this trouble when its operator clears it, and something else comes at once.
fn cleared(
    trouble: fn(&mut FakeRobot),
    comes: fn(&mut FakeRobot),
) -> (ServedRobot, Result<Telemetry, LinkError>) {
    let (served, mut connection) = connect(|robot| {
        trouble(robot);
        robot.after_clearing = Some(comes);
    });
    let ended = connection.clear(std::time::Instant::now());
    (served, ended)
}

#[test]
fn who_clears_clears_no_fault_and_no_stop_that_came_since() {
    let stop: fn(&mut FakeRobot) = |robot| robot.stopped = true;
    let stall: fn(&mut FakeRobot) = |robot| robot.fail(Fault::Stall);
    let (served, ended) = cleared(stop, stall);
    assert!(matches!(ended, Err(LinkError::Faulted { .. })), "{ended:?}");
    assert!(!served.robot().faults.is_empty());
    let (served, ended) = cleared(stall, stall);
    assert!(matches!(ended, Err(LinkError::Faulted { .. })), "the same again: {ended:?}");
    assert!(!served.robot().faults.is_empty());
    let (served, ended) = cleared(stall, FakeRobot::stop_from_outside);
    assert!(matches!(ended, Err(LinkError::StoppedBy(_))), "{ended:?}");
    assert!(served.robot().stopped);
}

#[test]
fn who_is_interrupted_while_arming_insists_leaves_the_robot_stopped() {
    let (served, mut connection) = connect(|robot| robot.is_unproven = true);
    let patience = std::time::Duration::from_secs(20);
    while connection.telemetry().is_none() {
        connection.pause(std::time::Duration::from_millis(20)).unwrap();
    }
    let (client, now) = connection.operate();
    client.insist_on(now, Wish::Arm, patience).unwrap();
    connection.pause(std::time::Duration::from_millis(200)).unwrap();
    drop(connection);
    served.robot().is_unproven = false;
    std::thread::sleep(std::time::Duration::from_millis(500));
    let robot = served.robot();
    assert_eq!((robot.state, robot.stopped), (State::Disarmed, true));
    drop(robot);
}

#[test]
fn who_clears_a_stop_is_told_of_the_fault_that_came_meanwhile() {
    let (served, mut connection) = connect(|robot| {
        (robot.stopped, robot.ramps_down_for) = (true, 20);
    });
    let ended = std::thread::scope(|scope| {
        scope.spawn(|| {
            while served.robot().ramps_down_for > 15 {
                std::thread::yield_now();
            }
            served.robot().fail(Fault::Stall);
        });
        connection.clear(std::time::Instant::now())
    });
    assert!(matches!(ended, Err(LinkError::Faulted { .. })), "{ended:?}");
}

#[test]
fn a_stop_at_the_last_of_several_addresses_names_the_key_that_it_was_proved_by() {
    // The first two are of somebody who says nothing.
    let mute = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
    let served = ServedRobot::steady(FakeRobot::new(Some(key())));
    let mut more = vec![served.address, mute[1].local_addr().unwrap()];
    let (own, others) = (key(), [8, 9].map(|it| Key::new([it; 32])));
    let keys = [&others[0], &own, &others[1]];
    let first = mute[0].local_addr().unwrap();
    let by = stop(first, &keys, &Interrupt::never(), || more.pop());
    assert_eq!(by.map_err(|error| error.to_string()), Ok(1));
    assert!(served.robot().stopped);
}
