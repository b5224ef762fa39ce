//! The whole robot under its own software and under the ideal drive: it stays on its feet, and all energy is accounted
//! for.

use core::time::Duration;

use flix_protocol::session::Key;
use flix_sim::experiment::walk::{DEFAULT_STEP, Shaking, Walk, WalkDrive, walk};
use flix_sim::model::RobotModel;
use flix_sim::plant::{Mechanics, Plant};
use flix_sim::rig::bench::{DIRECTIONS, setpoint};
use flix_sim::rig::channel::ChannelParameters;
use flix_sim::rig::operation::Operation;
use flix_sim::rig::robot::{RobotParameters, SimulatedRobot};
use rayon::prelude::*;

#[test]
fn what_the_battery_gives_goes_into_copper_friction_legs_and_floor_within_a_hundredth() {
    let plant = Plant::new(&RobotModel::named("W").unwrap()).unwrap();
    let robot = SimulatedRobot::new(RobotParameters::new(Key::new([7; 32]), 5), plant);
    let mut operation = Operation::new(robot, ChannelParameters::QUIET_WIFI);
    operation.arm().unwrap();
    let books = |operation: &Operation<Plant>| {
        let plant = operation.robot.mechanics();
        (operation.robot.electronics().ledger(plant.rotor_angle()), plant.energy())
    };
    let (electrical, mechanical) = books(&operation);
    operation.hold(setpoint(-30.0, 30.0).unwrap());
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

#[test]
fn at_full_speed_in_every_direction_it_stays_on_its_feet() {
    // Standing, the plate is 57 mm high; on its side or through the floor its middle is below.
    const LOWEST: f64 = 0.035;
    // Higher than it can hop: 35 Hz lift the feet by a few millimetres.
    const HIGHEST: f64 = 0.10;
    let model = RobotModel::named("W").unwrap();
    let runs: Vec<(f64, f64, u64)> = [-35.0, 35.0]
        .into_iter()
        .flat_map(|f| DIRECTIONS.map(|theta| (f, theta)))
        .flat_map(|(f, theta)| (1..=16).map(move |seed| (f, theta, seed)))
        .collect();
    runs.into_par_iter().for_each(|(f, theta, seed)| {
        let what = Walk {
            shaking: Shaking::new(f, theta).unwrap(),
            seconds: 8.0,
            drive: WalkDrive::Ideal,
            step: DEFAULT_STEP,
            heading: None,
        };
        let mut heights = (f64::INFINITY, f64::NEG_INFINITY);
        let walked = walk(&model, &what, seed, |plant| {
            let height = plant.body().position[2];
            heights = (heights.0.min(height), heights.1.max(height));
        })
        .unwrap();
        assert!(
            heights.0 > LOWEST && heights.1 < HIGHEST && walked.yaw_rad_s.is_finite(),
            "{f} Hz, {theta} degrees, seed {seed}: plate between {heights:?} m"
        );
    });
}
