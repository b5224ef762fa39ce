//! The promises of the batch.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

use flix_batch::{Batch, Precision, StateError};
use flix_plant::model::{RobotModel, random};
use flix_plant::plant::{BodyState, Drive, Mechanics, Part, Plant, Wrench};

const STEP: f64 = 1e-4;

/// Robots of several kinds that start and are shaken each in its own way.
fn crowd(robots: usize) -> Vec<(RobotModel, u64, [f64; 2])> {
    let shipped = ["A", "W", "calibrated"].map(|name| RobotModel::named(name).unwrap());
    (0..robots)
        .map(|i| {
            let model = if i % 4 == 3 { random(i as u64) } else { shipped[i % 4].clone() };
            (model, i as u64, [15.0 + 4.0 * i as f64, -1.5 + 0.4 * i as f64])
        })
        .collect()
}

fn batch(crowd: &[(RobotModel, u64, [f64; 2])], precision: Precision) -> Batch {
    let models = crowd.iter().map(|(model, ..)| model.clone()).collect();
    let mut batch = Batch::new(models, precision).unwrap();
    for (robot, (_, seed, [f, theta])) in crowd.iter().enumerate() {
        batch.change(robot, |plant| plant.disturb(*seed, false)).unwrap();
        batch.set_drive(robot, *f, *theta);
    }
    batch
}

#[test]
fn a_robot_of_a_long_batch_has_the_bits_of_a_plant_alone() {
    let crowd = crowd(11);
    let mut together = batch(&crowd, Precision::Double);
    together.run(600, STEP);
    for (robot, (model, seed, [frequency_hz, theta_rad])) in crowd.iter().enumerate() {
        let mut alone = Plant::new(model).unwrap();
        alone.disturb(*seed, false);
        alone.set_drive(Drive::Ideal { frequency_hz: *frequency_hz, theta_rad: *theta_rad });
        for _ in 0..600 {
            alone.step([0.0; 2], STEP).unwrap();
        }
        assert_eq!(together.body(robot), alone.body(), "robot {robot}");
        let plant = together.plant(robot).unwrap();
        assert_eq!((plant.energy(), plant.legs()), (alone.energy(), alone.legs()), "robot {robot}");
    }
}

/// Bodies of these robots after a while, in this precision.
fn bodies(crowd: &[(RobotModel, u64, [f64; 2])], precision: Precision) -> Vec<BodyState> {
    let mut batch = batch(crowd, precision);
    batch.run(300, STEP);
    (0..crowd.len()).map(|robot| batch.body(robot)).collect()
}

#[test]
fn a_robots_bits_do_not_depend_on_its_neighbours() {
    for precision in [Precision::Single, Precision::Double] {
        let mut crowd = crowd(19);
        let mut there = bodies(&crowd, precision);
        crowd.reverse();
        crowd.truncate(12);
        there.reverse();
        there.truncate(12);
        assert_eq!(bodies(&crowd, precision), there, "{precision:?}");
    }
}

#[test]
fn a_robots_bits_do_not_depend_on_the_length_of_vectors() {
    let (crowd, plants): (Vec<_>, Vec<_>) = crowd(9)
        .into_iter()
        .map(|(model, seed, [frequency_hz, theta_rad])| {
            let mut plant = Plant::new(&model).unwrap();
            plant.disturb(seed, false);
            plant.set_drive(Drive::Ideal { frequency_hz, theta_rad });
            (model, plant)
        })
        .unzip();
    let plants: Vec<_> = plants.iter().collect();
    for precision in [Precision::Single, Precision::Double] {
        let run = |mut batch: Batch| {
            batch.run(300, STEP);
            (0..batch.len()).map(|robot| batch.body(robot)).collect::<Vec<_>>()
        };
        let short = Batch::in_blocks(crowd.clone(), &plants, precision, false).unwrap();
        let usual = Batch::of(crowd.clone(), &plants, precision).unwrap();
        assert_eq!(run(short), run(usual), "{precision:?}");
    }
}

#[test]
fn another_drive_takes_over_at_the_phase_of_the_last() {
    let crowd = crowd(3);
    let (mut short, mut long) =
        (batch(&crowd, Precision::Single), batch(&crowd, Precision::Double));
    let mut alone = long.plant(1).unwrap();
    for [frequency_hz, theta_rad] in [[30.0, 0.0], [-22.0, 1.2], [17.0, -0.4]] {
        for batch in [&mut short, &mut long] {
            batch.set_drive(1, frequency_hz, theta_rad);
            batch.run(77, STEP);
        }
        alone.set_drive(Drive::Ideal { frequency_hz, theta_rad });
        for _ in 0..77 {
            alone.step([0.0; 2], STEP).unwrap();
        }
    }
    assert_eq!(long.body(1), alone.body());
    let angles = short.plant(1).unwrap().rotor_angle();
    for (short, exact) in angles.into_iter().zip(alone.rotor_angle()) {
        assert!((short - exact).sin().abs() < 1e-5, "{short} {exact}");
    }
}

#[test]
fn a_run_in_pieces_that_somebody_looks_at_has_the_bits_of_one() {
    let crowd = crowd(5);
    for precision in [Precision::Single, Precision::Double] {
        let walk = |pieces: &[usize]| {
            let mut batch = batch(&crowd, precision);
            for (f, theta) in [(30.0, 0.0), (-30.0, 0.9), (24.0, -1.3)] {
                batch.set_drive(1, f, theta);
                for steps in pieces {
                    batch.run(*steps, STEP);
                    let looked = batch.plant(1).unwrap();
                    assert_eq!(looked.body(), batch.body(1));
                }
            }
            let seen = (0..crowd.len()).map(|i| (batch.body(i), batch.motor_work(i)));
            (seen.collect::<Vec<_>>(), batch.time())
        };
        let whole = walk(&[700]);
        assert_eq!(walk(&[1, 3, 149, 547]), whole, "{precision:?}");
        assert_eq!(walk(&[350; 2]), whole, "{precision:?}");
    }
}

#[test]
fn a_robot_placed_late_walks_as_one_placed_at_the_start() {
    let crowd = crowd(4);
    for precision in [Precision::Single, Precision::Double] {
        let mut batch = batch(&crowd, precision);
        let fresh = batch.plant(2).unwrap();
        let walk = |batch: &mut Batch| {
            batch.set_drive(2, -25.0, 0.3);
            batch.run(333, STEP);
            batch.body(2)
        };
        let first = walk(&mut batch);
        batch.place(2, crowd[2].0.clone(), &fresh).unwrap();
        assert_eq!(walk(&mut batch), first, "{precision:?}");
    }
}

#[test]
fn short_numbers_follow_a_change_of_f_and_theta_as_long_ones() {
    let crowd = crowd(3);
    let [short, long] = [Precision::Single, Precision::Double].map(|precision| {
        let mut batch = batch(&crowd, precision);
        for (f, theta) in [(30.0, 0.0), (-30.0, 0.9), (24.0, -1.3)] {
            batch.set_drive(0, f, theta);
            batch.run(1500, STEP);
        }
        (batch.plant(0).unwrap(), batch.motor_work(0))
    });
    for (short, long) in short.0.rotor_angle().into_iter().zip(long.0.rotor_angle()) {
        assert!((short - long).sin().abs() < 1e-4, "{short} {long}");
    }
    assert!((short.1 / long.1 - 1.0).abs() < 0.05, "{} {}", short.1, long.1);
}

#[test]
fn a_robot_that_diverges_is_named_with_its_time_and_the_others_walk_on() {
    let crowd = crowd(5);
    for precision in [Precision::Single, Precision::Double] {
        let healthy = bodies(&crowd, precision);
        let mut batch = batch(&crowd, precision);
        let spun = batch.motor_work(3);
        batch.set_push(3, Wrench { force: [1e9, 0.0, 0.0], torque: [0.0; 3] });
        batch.run(300, STEP);
        let diverged = batch.diverged(3).unwrap();
        assert_eq!((diverged.time, diverged.part), (STEP, Part::Body));
        let (body, start) = (batch.body(3), Plant::new(&crowd[3].0).unwrap().body());
        let far = |at: [f64; 3], from: [f64; 3]| (0..3).any(|i| (at[i] - from[i]).abs() > 0.01);
        assert!(!far(body.position, start.position) && !far(body.velocity, [0.0; 3]), "{body:?}");
        assert_eq!(batch.motor_work(3), spun);
        for robot in [0, 1, 2, 4] {
            assert_eq!((batch.body(robot), batch.diverged(robot)), (healthy[robot], None));
        }
    }
}

#[test]
fn a_robot_that_is_replaced_starts_anew() {
    let crowd = crowd(4);
    let mut batch = batch(&crowd, Precision::Single);
    let fresh = batch.plant(2).unwrap();
    batch.run(200, STEP);
    let first = batch.body(2);
    batch.place(2, crowd[2].0.clone(), &fresh).unwrap();
    assert_eq!(batch.body(2), fresh.body());
    batch.run(200, STEP);
    assert_eq!(batch.body(2), first);
}

#[test]
fn a_model_that_cannot_walk_is_refused() {
    let bench = RobotModel::named("bench-planar").unwrap();
    let error = Batch::new(vec![bench], Precision::Single).unwrap_err();
    assert!(error.to_string().contains("bench-planar has no legs"), "{error}");
}

#[test]
fn a_batch_that_was_kept_goes_on_with_the_same_bits() {
    for precision in [Precision::Single, Precision::Double] {
        let mut one = batch(&crowd(19), precision);
        one.change(4, |plant| {
            plant.set_push(Wrench { force: [1e9, 0.0, 0.0], torque: [0.0; 3] });
        })
        .unwrap();
        one.run(137, STEP);
        (0..19).step_by(2).for_each(|robot| one.set_drive(robot, -20.0, 1.0));
        one.run(23, 2.0 * STEP);
        let mut other = Batch::restored(&one.state()).unwrap();
        let seen = |batch: &Batch, robot| {
            (batch.body(robot), batch.motor_work(robot), batch.diverged(robot), batch.time())
        };
        for steps in [0, 1, 400, 2000] {
            for batch in [&mut one, &mut other] {
                batch.run(steps, STEP);
                batch.set_drive(3, steps as f64 / 100.0, 0.1);
            }
            for robot in 0..19 {
                assert_eq!(seen(&one, robot), seen(&other, robot), "robot {robot}");
                assert_eq!(one.model(robot), other.model(robot));
            }
        }
    }
}

#[test]
fn bytes_that_were_changed_are_no_batch() {
    let state = batch(&crowd(3), Precision::Single).state();
    for at in (0..state.len()).step_by(97) {
        let mut changed = state.clone();
        changed[at] ^= 0x10;
        assert!(matches!(Batch::restored(&changed), Err(StateError::Damaged)), "byte {at}");
        assert!(matches!(Batch::restored(&state[..at]), Err(StateError::Damaged)), "{at} bytes");
    }
}

#[test]
fn rotors_that_are_spun_up_and_braked_give_back_no_more_than_they_took() {
    for precision in [Precision::Single, Precision::Double] {
        let mut batch = Batch::new(vec![RobotModel::named("W").unwrap()], precision).unwrap();
        batch.set_drive(0, 35.0, 0.0);
        let taken = batch.motor_work(0);
        batch.run(1, STEP);
        batch.set_drive(0, 0.0, 0.0);
        batch.run(6_000, STEP);
        let kept = batch.motor_work(0);
        assert!(0.0 < kept && kept < 0.3 * taken, "{precision:?}: {kept} J of {taken} J");
    }
}
