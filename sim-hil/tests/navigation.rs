//! The host's navigation drives the whole simulated robot over the link, in virtual time.

use std::time::Duration;

use flix_host::nav::{
    ControllerKind, EndReason, Navigator, Path, PlanarPose, Position, Settings, Task,
};
use flix_host::pilot::steering::names;
use flix_host::pilot::{Ending, Pilot};
use flix_protocol::message::State;
use flix_sim::experiment::course::{Conditions, Course};
use flix_sim::model::RobotModel;
use flix_sim::rig::shipped_mode_tables::shipped_table;

const LATENCY: Duration = Duration::from_millis(20);

fn conditions(seed: u64, start: PlanarPose) -> Conditions {
    Conditions { model: RobotModel::named("W").unwrap(), seed, latency: LATENCY, loss: 0.05, start }
}

fn course(task: Task, seed: u64, start: PlanarPose) -> Course<Navigator> {
    let table = shipped_table("W").unwrap();
    let settings = Settings { latency: LATENCY, ..Settings::for_task(&task) };
    assert_eq!(settings.controller, ControllerKind::Predictive);
    let navigator = Navigator::new(task, &table, settings).unwrap();
    Course::new(&conditions(seed, start), Pilot::new(navigator, names(&table), None)).unwrap()
}

fn home() -> Task {
    Task::Reach { point: Position::ORIGIN, stay: false }
}

fn until_end(course: &mut Course<Navigator>, seconds: u64) -> Ending {
    while course.now().as_micros() < seconds * 1_000_000 {
        if let Some(ending) = course.step().unwrap() {
            return ending;
        }
    }
    panic!("still going after {seconds} s: {:?}", course.pilot().helm().progress());
}

fn until_walking(course: &mut Course<Navigator>) {
    while course.robot().1.abs() < 20.0 {
        assert_eq!(course.step().unwrap(), None);
    }
}

/// Where the robot is after a second, once the run has ended.
fn at_last(course: &mut Course<Navigator>) -> (State, f64) {
    for _ in 0..100 {
        course.step().unwrap();
    }
    let (state, frequency) = course.robot();
    (state, frequency.abs())
}

#[test]
fn follows_a_circle_from_any_heading_within_40_mm_and_ends_disarmed() {
    for (seed, turned) in [(1, 0.0), (2, 2.4)] {
        let path = Path::circle(0.3).unwrap();
        let start = PlanarPose { heading: path.start().heading + turned, ..path.start() };
        let mut course = course(Task::Follow { path, laps: 1 }, seed, start);
        let ending = until_end(&mut course, 200);
        let progress = course.pilot().helm().progress();
        assert_eq!((ending, course.robot().0), (Ending::Finished, State::Disarmed));
        assert!(progress.error_rms < 0.04, "{progress:?}");
    }
}

#[test]
fn follows_a_figure_eight_within_40_mm_on_a_link_of_100_ms_that_loses_a_fifth() {
    let path = Path::figure_eight(1.6, 0.8).unwrap();
    let start = path.start();
    let latency = Duration::from_millis(100);
    let task = Task::Follow { path, laps: 1 };
    let settings = Settings { latency, ..Settings::for_task(&task) };
    let table = shipped_table("W").unwrap();
    let navigator = Navigator::new(task, &table, settings).unwrap();
    let conditions = Conditions { latency, loss: 0.2, ..conditions(1, start) };
    let mut course = Course::new(&conditions, Pilot::new(navigator, names(&table), None)).unwrap();
    assert_eq!(until_end(&mut course, 200), Ending::Finished);
    let progress = course.pilot().helm().progress();
    assert!(progress.error_rms < 0.04, "{progress:?}");
}

#[test]
fn comes_home_from_any_heading_within_50_mm() {
    for (seed, heading) in [(2, 3.0), (3, -1.5)] {
        let start = PlanarPose { x: 0.3, y: -0.2, heading };
        let mut course = course(home(), seed, start);
        assert_eq!(until_end(&mut course, 120), Ending::Finished);
        let error = course.truth().distance_to(Position::ORIGIN);
        assert!(error < 0.05, "seed {seed}: {error}");
    }
}

#[test]
fn an_interrupted_run_leaves_the_robot_stopped_and_disarmed() {
    let mut course = course(home(), 4, PlanarPose { x: 0.4, y: 0.0, heading: 0.0 });
    until_walking(&mut course);
    course.end(Ending::Interrupted);
    assert_eq!(until_end(&mut course, 60), Ending::Interrupted);
    let (state, frequency) = at_last(&mut course);
    assert!(state == State::Disarmed && frequency < 1.0, "{state}, {frequency} Hz");
}

#[test]
fn poses_that_are_not_trusted_any_more_bring_the_robot_to_rest() {
    let mut course = course(home(), 5, PlanarPose { x: 0.4, y: 0.0, heading: 0.0 });
    until_walking(&mut course);
    course.cover_cameras(true);
    for _ in 0..100 {
        assert_eq!(course.step().unwrap(), None);
    }
    assert!(course.robot().1.abs() < 1.0, "{} Hz", course.robot().1);
    let ending = until_end(&mut course, 60);
    assert!(matches!(ending, Ending::Stopped(EndReason::PoseLost { .. })), "{ending:?}");
}

#[test]
fn carried_over_the_fence_the_robot_is_stopped_and_disarmed() {
    let mut course = course(home(), 6, PlanarPose { x: 0.4, y: 0.0, heading: 0.0 });
    until_walking(&mut course);
    course.push((0.0, 2.0), 0.0);
    let ending = until_end(&mut course, 60);
    assert!(matches!(ending, Ending::Stopped(EndReason::OutsideFence { .. })), "{ending:?}");
    let (state, frequency) = at_last(&mut course);
    assert!(state == State::Disarmed && frequency < 1.0, "{state}, {frequency} Hz");
}

#[test]
fn too_far_off_its_path_the_robot_is_stopped_and_disarmed() {
    let path = Path::figure_eight(1.6, 0.8).unwrap();
    let start = path.start();
    let mut course = course(Task::Follow { path, laps: 1 }, 7, start);
    until_walking(&mut course);
    // South of the crossing: half a metre from the nearest branch, and inside the fence.
    course.push((0.0, -0.7), 0.0);
    let ending = until_end(&mut course, 60);
    assert!(matches!(ending, Ending::Stopped(EndReason::OffPath { .. })), "{ending:?}");
    let (state, frequency) = at_last(&mut course);
    assert!(state == State::Disarmed && frequency < 1.0, "{state}, {frequency} Hz");
}
