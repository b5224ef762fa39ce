//! The host records the experiments of an identification from the whole simulated robot, over the link, in virtual time;
//! the study reads the files and finds what it would find in the plant itself.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

use std::path::Path;
use std::time::Duration;

use flix_host::experiment::air::{Air, AirSettings, COLUMNS};
use flix_host::experiment::drops::Drops;
use flix_host::experiment::{Sheet, drops, walks};
use flix_host::nav::{EndReason, Identification, IdentificationSettings, PlanarPose};
use flix_host::pilot::{Ending, Helm, Pilot};
use flix_protocol::message::Setpoint;
use flix_protocol::session::Key;
use flix_sim::experiment::course::{Conditions, Course};
use flix_sim::model::RobotModel;
use flix_sim::plant::Plant;
use flix_sim::rig::motion_capture::MotionCapture;
use flix_sim::rig::simulated::{RobotParameters, SimulatedRobot};
use flix_study::sysid::fit::Experiment;
use flix_study::sysid::unknowns::Kind;
use flix_study::sysid::{Data, identify, synthetic};
use flix_study::sysid::{air as study_air, drops as study_drops, walks as study_walks};

/// One way, as on a busy network; the study knows the delay of the cameras to 1 ms.
const LATENCY: Duration = Duration::from_millis(15);

fn course<H: Helm>(helm: H, model: RobotModel, heading: f64) -> Course<H> {
    let start = PlanarPose { x: 0.1, y: -0.2, heading };
    let conditions = Conditions { model, seed: 3, latency: LATENCY, loss: 0.02, start };
    Course::new(&conditions, Pilot::new(helm, Vec::new(), None)).unwrap()
}

fn until_end<H: Helm>(mut course: Course<H>) -> H {
    while course.now().as_micros() < 100_000_000 {
        if let Some(ending) = course.step().unwrap() {
            assert_eq!(ending, Ending::Finished);
            return course.into_pilot().finish(std::collections::BTreeMap::new()).0;
        }
    }
    panic!("still going");
}

fn air(shakes: &[(f32, f32)]) -> Air {
    Air::new(AirSettings {
        shakes: shakes.iter().map(|(f, theta)| Setpoint::saturating(*f, *theta)).collect(),
        time: Duration::from_secs(1),
        pose_patience: Duration::from_secs(5),
    })
}

/// Shakes a hung robot of this model and writes the file.
fn shake(model: &RobotModel, shakes: &[(f32, f32)], folder: &Path) {
    let mut course = course(air(shakes), model.clone(), 2.0);
    course.hang(0.5);
    // The pilot learns when telemetry arrived by no more than this.
    course.set_pose_period(Duration::from_micros(200));
    let shaken = until_end(course);
    let mut sheet = Sheet::open(folder, "air", &COLUMNS).unwrap();
    sheet.append("test", &shaken.rows(sheet.last())).unwrap();
}

#[test]
fn a_hung_robot_is_recorded_as_it_swings_in_the_plant() {
    let folder = tempfile::tempdir().unwrap();
    let shakes = [(28.0, 0.0), (35.0, 90.0), (-20.0, 90.0)];
    let model = RobotModel::named("W").unwrap();
    shake(&model, &shakes, folder.path());
    let read = study_air::Air::read(folder.path()).unwrap().unwrap();
    let swings = read.simulate(&model).unwrap();
    // Cosine and sine of six channels of each shake, m and rad. Position and rotation are compared with the largest of
    // each; a delay of 1 ms turns the phase at 35 Hz by 0.22 rad.
    for (test, (measured, swing)) in read.measured().chunks(12).zip(swings.chunks(12)).enumerate() {
        for (measured, swing) in measured.chunks(6).zip(swing.chunks(6)) {
            let size = swing.iter().fold(0.0, |most: f64, it| most.max(it.abs()));
            let off = measured.iter().zip(swing).map(|(a, b)| (a - b).abs());
            let off = off.fold(0.0, f64::max) / size;
            assert!(off < 0.25, "{:?}: off by {off}: {measured:?} {swing:?}", shakes[test]);
        }
    }
}

#[test]
fn what_is_recorded_in_the_air_narrows_the_damping_and_the_mass() {
    let folder = tempfile::tempdir().unwrap();
    let plan = RobotModel::named("W").unwrap();
    let robot = synthetic::hidden(&plan, 1);
    shake(&robot, &[(20.0, 0.0), (28.0, 90.0), (35.0, 0.0)], folder.path());
    let found = identify(&plan, &Data::read(folder.path()).unwrap(), 1, false, |_| {}).unwrap();
    let stage = found.stages.iter().find(|stage| stage.experiment == "air").unwrap();
    for kind in [Kind::Damping, Kind::Mass, Kind::Stiffness] {
        let index = Kind::ALL.iter().position(|it| *it == kind).unwrap();
        assert!(stage.left[index] < 0.9, "{kind:?}: {:?}", stage.left);
    }
}

#[test]
fn an_interrupted_run_keeps_the_shakes_that_are_whole() {
    let mut course = course(air(&[(20.0, 0.0), (28.0, 0.0)]), RobotModel::named("W").unwrap(), 0.0);
    course.hang(0.5);
    while course.pilot().helm().shakes().is_empty() || course.robot().1 < 27.0 {
        assert_eq!(course.step().unwrap(), None);
    }
    course.end(Ending::Interrupted);
    while course.step().unwrap().is_none() {}
    let rows = course.pilot().helm().rows(4.0);
    assert!(rows.len() == 100 && rows.iter().all(|row| row[..2] == [5.0, 20.0]), "{rows:?}");
}

#[test]
fn a_robot_that_is_shaken_on_the_floor_is_stopped_before_it_walks_far() {
    let walker = RobotModel::named("W").unwrap();
    let mut course = course(air(&[(-30.0, 30.0); 12]), walker, 0.0);
    let start = course.truth();
    let ending = loop {
        if let Some(ending) = course.step().unwrap() {
            break ending;
        }
    };
    let away = course.truth().distance_to(start.position());
    let Ending::Stopped(EndReason::Experiment(sentence)) = &ending else { panic!("{ending:?}") };
    assert!(sentence.contains("clear of the floor") && away < 0.5, "{sentence}: {away} m");
}

#[test]
fn walks_are_recorded_with_their_motion_and_read_by_the_study() {
    let folder = tempfile::tempdir().unwrap();
    let pairs = [(-30.0, 30.0), (-30.0, 90.0), (30.0, 90.0)];
    let helm = Identification::new(IdentificationSettings {
        pairs: pairs.map(|(f, theta)| (f.to_string(), Setpoint::saturating(f, theta))).into(),
        stretch: Duration::from_secs(3),
        rounds: 1,
        fence: "-2,-2,2,2".parse().unwrap(),
        pose_deadline: Duration::from_millis(100),
        pose_patience: Duration::from_secs(5),
        least_battery: None,
        known: None,
    });
    let helm = until_end(course(helm, RobotModel::named("W").unwrap(), 1.0));
    let rows = walks::rows(&helm);
    let mut sheet = Sheet::open(folder.path(), "walks", &walks::COLUMNS).unwrap();
    sheet.append("test", &rows).unwrap();
    let recorded: Vec<(f64, f64)> = rows.iter().map(|row| (row[0], row[1])).collect();
    assert_eq!(recorded, pairs.map(|(f, theta)| (f64::from(f), f64::from(theta))));
    // The second pair turns left, the third right: as the table of the model has them.
    assert!(rows[1][4] > 0.2 && rows[2][4] < -0.2, "{rows:?}");
    assert_eq!(
        Data::read(folder.path()).unwrap().given(),
        [false, false, false, false, false, true]
    );
}

#[test]
fn drops_are_cut_out_of_what_the_cameras_see_and_read_by_the_study() {
    let (folder, model) = (tempfile::tempdir().unwrap(), RobotModel::named("W").unwrap());
    let parameters = RobotParameters::of(&model.electrical, Key::new([0x5a; 32]), 1).unwrap();
    let mut robot = SimulatedRobot::new(parameters, Plant::new(&model).unwrap());
    let stands = robot.mechanics().body().position;
    let (mut cameras, mut drops) = (MotionCapture::new(1), Drops::new(20.0));
    for count in 1..=2 {
        robot.mechanics_mut().hold(stands, 0.02, 1.0);
        for _ in 0..2000 {
            (0..10).for_each(|_| robot.tick().unwrap());
            cameras.look(robot.now(), &robot);
            for sample in cameras.seen(robot.now()) {
                assert!(drops.observe(&sample).is_none_or(|verdict| verdict == Ok(())));
            }
        }
        assert_eq!(drops.count(), count);
    }
    let mut sheet = Sheet::open(folder.path(), "drops", &drops::COLUMNS).unwrap();
    sheet.append("test", &drops.rows(sheet.last())).unwrap();
    let rows = study_drops::TABLE.read(folder.path()).unwrap().unwrap();
    let rows: Vec<_> = rows.into_iter().map(|(_, row)| row).collect();
    let measured = study_drops::Drops::new(&rows).unwrap();
    // A release that is dated wrongly by 3 ms shows 2 mm at the touch.
    let simulated = measured.simulate(&model, 7).unwrap();
    for ((time, height), expected) in measured.course().into_iter().zip(simulated) {
        assert!((height - expected).abs() < 1.5, "{time} s: {height} mm, and {expected} mm");
    }
}

#[test]
fn the_host_writes_the_columns_that_the_study_reads() {
    let names = |columns: &[flix_host::experiment::Column]| -> Vec<&str> {
        columns.iter().map(|column| column.name).collect()
    };
    let wanted = |columns: &[flix_study::sysid::table::Column]| -> Vec<&str> {
        columns.iter().map(|column| column.name).collect()
    };
    assert_eq!(names(&COLUMNS), wanted(&study_air::TABLE.columns));
    assert_eq!(names(&drops::COLUMNS), wanted(&study_drops::TABLE.columns));
    let walks = [&study_walks::TABLE.columns[..], &study_walks::OPTIONAL[..1]].concat();
    assert_eq!(names(&walks::COLUMNS), wanted(&walks));
}
