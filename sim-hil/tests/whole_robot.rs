//! The whole robot under its own software: all energy is accounted for.

use core::time::Duration;

use flix_host::link::RobotLink;
use flix_protocol::session::Key;
use flix_sim::model::RobotModel;
use flix_sim::plant::{Mechanics, Plant};
use flix_sim::rig::bench::setpoint;
use flix_sim::rig::lossy_network::ChannelParameters;
use flix_sim::rig::operation::Operation;
use flix_sim::rig::simulated::{RobotParameters, SimulatedRobot};

#[test]
fn what_the_battery_gives_goes_into_copper_friction_legs_and_floor_within_a_hundredth() {
    let plant = Plant::new(&RobotModel::named("W").unwrap()).unwrap();
    let robot = SimulatedRobot::new(RobotParameters::new(Key::new([7; 32]), 5), plant);
    let mut operation = Operation::new(robot, ChannelParameters::QUIET_WIFI);
    operation.arm().unwrap();
    let books = |operation: &Operation| {
        let plant = operation.robot.mechanics();
        (operation.robot.electronics().ledger(plant.rotor_angle()), plant.energy())
    };
    let (electrical, mechanical) = books(&operation);
    operation.want(setpoint(-30.0, 30.0).unwrap());
    operation.run(Duration::from_secs(3), |_| {}).unwrap();
    let (electrical_end, mechanical_end) = books(&operation);

    let drawn = electrical_end.battery - electrical.battery;
    let lost_electrically = electrical_end.imbalance() - electrical.imbalance();
    // Both sides of the shaft count the same work.
    let handed_over = electrical_end.mechanical - electrical.mechanical;
    let taken = mechanical_end.motor_work - mechanical.motor_work;
    let lost_mechanically = mechanical_end.balance(&mechanical);
    assert!(drawn > 3.0 && taken > 1.0, "{electrical_end:?} {mechanical_end:?}");
    for missing in [lost_electrically, handed_over - taken, lost_mechanically] {
        assert!(missing.abs() < 0.003 * drawn, "{missing} of {drawn} J");
    }
}
