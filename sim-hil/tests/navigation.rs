//! The host's navigation drives the whole simulated robot over the link, in virtual time.

use std::time::Duration;

use flix_host::nav::{
    ControllerKind, EndReason, Identification, IdentificationSettings, Navigator, PAPER_PAIRS,
    Path, PlanarPose, Position, Settings, Task, Twist,
};
use flix_host::pilot::steering::names;
use flix_host::pilot::{Ending, Pilot};
use flix_protocol::message::{Setpoint, State};
use flix_sim::experiment::course::{Conditions, Course};
use flix_sim::model::RobotModel;
use flix_sim::rig::motion_capture::{Lie, TrackerFault};
use flix_sim::rig::shipped_mode_tables::shipped_table;

const LATENCY: Duration = Duration::from_millis(20);
/// Time for which a hand moves the robot.
const CARRY: Duration = Duration::from_millis(1500);

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
fn along_a_figure_eight_the_robot_keeps_to_neither_side() {
    let path = Path::figure_eight(1.2, 0.6).unwrap();
    let start = path.start();
    let mut course = course(Task::Follow { path, laps: 1 }, 11, start);
    assert_eq!(until_end(&mut course, 200), Ending::Finished);
    let progress = course.pilot().helm().progress();
    assert!(progress.error_mean.abs() < 1.5e-3 && progress.error_rms < 0.012, "{progress:?}");
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
    course.push((0.0, 2.0), 0.0, CARRY);
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
    course.push((0.0, -0.7), 0.0, CARRY);
    let ending = until_end(&mut course, 60);
    assert!(matches!(ending, Ending::Stopped(EndReason::OffPath { .. })), "{ending:?}");
    let (state, frequency) = at_last(&mut course);
    assert!(state == State::Disarmed && frequency < 1.0, "{state}, {frequency} Hz");
}

/// A run around the figure eight whose tracker lies after 5 s of walking: the ending, the way of the robot since then, m, and
/// whether it rests 3 s later.
fn deceived(lie: Lie, lasts: Duration, every: Duration) -> (Ending, f64, bool) {
    let path = Path::figure_eight(1.6, 0.8).unwrap();
    let start = path.start();
    let mut course = course(Task::Follow { path, laps: 2 }, 8, start);
    until_walking(&mut course);
    for _ in 0..500 {
        assert_eq!(course.step().unwrap(), None);
    }
    let (from, here) = (course.now(), course.truth());
    course.deceive(Some(TrackerFault { lie, from, lasts, every }));
    let ending = until_end(&mut course, 30);
    while course.now().since(from) < Duration::from_secs(3) {
        course.step().unwrap();
    }
    (ending, course.truth().distance_to(here.position()), course.robot().1.abs() < 1.0)
}

const FOR_EVER: Duration = Duration::from_secs(3600);

#[test]
fn swapped_with_a_robot_that_walks_the_run_ends_at_rest_within_250_mm() {
    for away in [0.7, 0.1] {
        let walks = Twist { forward: 0.1, lateral: 0.0, yaw: 0.4 };
        let other = PlanarPose { x: 0.2 + away, y: 0.2, heading: 1.0 };
        let (ending, way, rests) = deceived(Lie::OtherBody(other, walks), FOR_EVER, FOR_EVER);
        assert!(matches!(ending, Ending::Stopped(EndReason::Jumped { .. })), "{ending:?}");
        assert!(rests && way < 0.25, "{away}: {way} m");
    }
}

#[test]
fn by_poses_of_another_robot_that_walks_no_walk_begins() {
    let path = Path::figure_eight(1.6, 0.8).unwrap();
    let start = path.start();
    let mut course = course(Task::Follow { path, laps: 2 }, 8, start);
    let walks = Twist { forward: 0.08, lateral: -0.02, yaw: -0.6 };
    let other = PlanarPose { x: 0.06, y: 0.08, heading: 2.0 };
    course.deceive(Some(TrackerFault::for_ever(Lie::OtherBody(other, walks), course.now())));
    let ending = until_end(&mut course, 10);
    assert!(matches!(ending, Ending::Stopped(EndReason::NotAnswering { .. })), "{ending:?}");
    let way = course.truth().distance_to(start.position());
    assert!(way < 0.01, "{way} m");
}

#[test]
fn poses_of_a_lost_body_and_flips_that_last_end_the_run_at_rest() {
    let second = Duration::from_secs(1);
    for lie in [Lie::DefaultPose, Lie::Turned(std::f64::consts::PI), Lie::Turned(1.0)] {
        let (ending, way, rests) = deceived(lie.clone(), second, 5 * second);
        assert!(matches!(ending, Ending::Stopped(EndReason::Jumped { .. })), "{ending:?}");
        assert!(rests && way < 0.25, "{lie:?}: {way} m");
    }
}

#[test]
fn axes_of_the_tracked_body_that_are_turned_are_named_within_10_s() {
    for (seed, degrees) in [(1, 20.0_f64), (2, -20.0), (3, 90.0), (4, 0.0)] {
        let path = Path::figure_eight(1.6, 0.8).unwrap();
        let start = path.start();
        let mut course = course(Task::Follow { path, laps: 1 }, seed, start);
        let lie = Lie::Turned(degrees.to_radians());
        course.deceive(Some(TrackerFault::for_ever(lie, course.now())));
        until_walking(&mut course);
        let end = course.now() + Duration::from_secs(10);
        let mut named = None;
        while course.now() < end && named.is_none() {
            assert_eq!(course.step().unwrap(), None);
            named = course.pilot().helm().turned();
        }
        let is_right = match named {
            Some(named) => degrees != 0.0 && (named - degrees).abs() < 5.0,
            None => degrees == 0.0,
        };
        assert!(is_right, "{degrees}: {named:?}");
    }
}

#[test]
fn with_one_pose_of_a_hundred_elsewhere_a_circle_is_walked() {
    let path = Path::circle(0.3).unwrap();
    let start = path.start();
    let mut course = course(Task::Follow { path, laps: 1 }, 1, start);
    let [lasts, every] = [10, 1000].map(Duration::from_millis);
    let from = course.now();
    course.deceive(Some(TrackerFault { lie: Lie::DefaultPose, from, lasts, every }));
    assert_eq!(until_end(&mut course, 200), Ending::Finished);
    assert!(course.pilot().helm().progress().error_rms < 0.04);
}

#[test]
fn an_identification_whose_heading_flips_ends_within_1200_mm_of_its_start() {
    let pairs =
        PAPER_PAIRS.map(|(name, f, theta)| (name.to_owned(), Setpoint::saturating(f, theta)));
    let names = pairs.iter().map(|(name, _)| name.clone()).collect();
    let identification = Identification::new(IdentificationSettings {
        pairs: pairs.to_vec(),
        stretch: Duration::from_secs(8),
        rounds: 1,
        fence: "-3,-3,3,3".parse().unwrap(),
        pose_deadline: Duration::from_millis(100),
        pose_patience: Duration::from_secs(5),
        least_battery: None,
        known: None,
    });
    let pilot = Pilot::new(identification, names, None);
    let mut course = Course::new(&conditions(3, PlanarPose::default()), pilot).unwrap();
    let [lasts, every] = [20, 40].map(Duration::from_secs);
    let from = course.now() + lasts;
    let lie = Lie::Turned(std::f64::consts::PI);
    course.deceive(Some(TrackerFault { lie, from, lasts, every }));
    let mut farthest: f64 = 0.0;
    let ending = loop {
        farthest = farthest.max(course.truth().distance_to(Position::ORIGIN));
        if let Some(ending) = course.step().unwrap() {
            break ending;
        }
    };
    assert!(matches!(ending, Ending::Stopped(EndReason::Jumped { .. })), "{ending:?}");
    assert!(farthest < 1.2, "{farthest} m");
}

#[test]
fn pushed_at_rest_and_on_its_way_a_robot_that_stays_comes_home() {
    let mut course =
        course(Task::Reach { point: Position::ORIGIN, stay: true }, 9, PlanarPose::default());
    let run = |course: &mut Course<Navigator>, steps: u32| {
        for _ in 0..steps {
            assert_eq!(course.step().unwrap(), None);
        }
    };
    run(&mut course, 300);
    for (offset, turn, milliseconds) in
        [((0.4, 0.1), 2.0, 300), ((-0.3, 0.3), -3.0, 1000), ((0.1, -0.4), 1.0, 600)]
    {
        course.push(offset, turn, Duration::from_millis(milliseconds));
        run(&mut course, 400);
        course.push((0.1, 0.1), -1.0, Duration::from_millis(milliseconds));
        run(&mut course, 2500);
        let error = course.truth().distance_to(Position::ORIGIN);
        assert!(course.pilot().helm().is_resting() && error < 0.05, "{offset:?}: {error} m");
    }
}

#[test]
fn set_down_elsewhere_unseen_a_walking_robot_ends_its_run() {
    let mut course = course(home(), 6, PlanarPose { x: 0.4, y: 0.0, heading: 0.0 });
    until_walking(&mut course);
    course.set_down((0.0, 0.5), 1.0);
    let ending = until_end(&mut course, 60);
    assert!(matches!(ending, Ending::Stopped(EndReason::Jumped { .. })), "{ending:?}");
}

#[test]
fn a_closed_path_with_a_spur_is_walked_once_round_in_100_s() {
    let path = Path::from_text("spur", "0,0\n0.6,0\n0.6,0.3\n0.6,0\n0,0").unwrap();
    let start = path.start();
    for seed in [1, 2] {
        let mut course = course(Task::Follow { path: path.clone(), laps: 1 }, seed, start);
        assert_eq!(until_end(&mut course, 100), Ending::Finished);
        let progress = course.pilot().helm().progress();
        assert!(progress.laps >= 0.95 && progress.error_rms < 0.03, "{progress:?}");
    }
}

#[test]
fn paths_as_people_draw_them_are_walked_once_round() {
    // A star, a rectangle with spurs, a hypocycloid, a polygon before whose tip a robot trembled for ever.
    [5, 6, 7, 19].into_iter().for_each(crate::drawn_paths::assert_walked);
}

/// Returns how a walk along a circle ends with so many pictures a second, and how often robots change between rest and walk a second.
fn walked_with(pictures: f64) -> (Ending, f64, f64) {
    let path = Path::circle(0.3).unwrap();
    let start = path.start();
    let mut course = course(Task::Follow { path, laps: 1 }, 1, start);
    course.set_pose_period(Duration::from_secs_f64(1.0 / pictures));
    let (mut changes, mut walks) = (0, false);
    let begun = course.now();
    let ending = loop {
        if let Some(ending) = course.step().unwrap() {
            break ending;
        }
        let now_walks = course.robot().1.abs() > 5.0;
        changes += u32::from(now_walks != std::mem::replace(&mut walks, now_walks));
        assert!(course.now().since(begun) < Duration::from_secs(300));
    };
    let seconds = course.now().since(begun).as_secs_f64();
    (ending, f64::from(changes) / seconds, course.pilot().helm().progress().error_rms)
}

#[test]
fn a_robot_walks_by_ten_pictures_a_second_and_by_fewer_not_at_all() {
    for pictures in [10.0, 12.0, 16.0, 30.0, 55.0] {
        let (ending, changes, error) = walked_with(pictures);
        assert_eq!(ending, Ending::Finished, "{pictures} a second");
        // A reversal counts as two.
        assert!(changes <= 0.5 && error < 0.02, "{pictures} a second: {changes}, {error}");
    }
    for pictures in [4.0, 6.0, 9.0] {
        let (ending, changes, _) = walked_with(pictures);
        let is_named = matches!(ending, Ending::Stopped(EndReason::TooFewPoses { .. }));
        assert!(is_named && changes == 0.0, "{pictures} a second: {ending}, {changes}");
    }
}
