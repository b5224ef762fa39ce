//! What an operator asks travels through protocol and session to the robot's software and back.

use flix_protocol::message::{Command, Outcome};
use flix_protocol::session::Key;
use flix_sim::model::RobotModel;
use flix_sim::model::SIMULATED_BOARD;
use flix_sim::plant::Plant;
use flix_sim::rig::channel::ChannelParameters;
use flix_sim::rig::operation::Operation;
use flix_sim::rig::robot::{RobotParameters, SimulatedRobot};

fn operation(network: ChannelParameters) -> Operation<Plant> {
    let model = RobotModel::named("bench-fixed").expect("a shipped model");
    let mechanics = Plant::new(&model).expect("a shipped model");
    let robot = SimulatedRobot::new(RobotParameters::new(Key::new([7; 32]), 1), mechanics);
    Operation::new(robot, network)
}

#[test]
fn the_robot_says_who_it_is() {
    let mut operation = operation(ChannelParameters::PERFECT);
    operation.connect().unwrap();
    let Outcome::Identity(identity) = operation.ask(Command::Identify).unwrap() else {
        panic!("another answer");
    };
    assert_eq!(
        (identity.name.as_str(), identity.board.as_str()),
        ("simulated", SIMULATED_BOARD.name)
    );
}

#[test]
fn a_session_stands_through_heavy_loss_and_jitter() {
    let mut operation = operation(ChannelParameters {
        loss: 0.3,
        jitter: std::time::Duration::from_millis(100),
        ..ChannelParameters::QUIET_WIFI
    });
    operation.connect().unwrap();
    assert_eq!(operation.ask(Command::Ping(5)).unwrap(), Outcome::Pong(5));
}
