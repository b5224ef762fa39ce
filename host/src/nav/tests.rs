//! Whole runs on a kinematic robot: chaotic speeds, ramping rotors, a link with latency and loss,
//! noisy poses. Virtual time.

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};
use std::sync::{Arc, LazyLock};
use std::time::Duration;

use flix_protocol::units::Instant;

use super::experience::tests::quicker_and_slower;
use super::modes::tests::model_w;
use super::motion::{Gait, Motion, REST, motions};
use super::*;
use crate::pose::{Pose, PoseSample, Quaternion};

/// Standard normal numbers from a seed (SplitMix64, Box and Muller).
struct Chance(u64);

impl Chance {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (TAU * self.uniform()).cos()
    }
}

/// A link towards the robot.
#[derive(Clone, Copy)]
struct Link {
    latency: Duration,
    loss: f64,
}

const GOOD: Link = Link { latency: Duration::from_millis(20), loss: 0.05 };
const BAD: Link = Link { latency: Duration::from_millis(100), loss: 0.20 };

/// A robot that moves as the table says, with its own constant errors and wandering speeds.
struct Walker {
    truth: Vec<Motion>,
    response: Response,
    gait: Gait,
    pose: PlanarPose,
    wander: [f64; 3],
    chance: Chance,
    link: Link,
    underway: VecDeque<(Instant, usize)>,
}

/// Scatter of the speeds: constant error of each mode and wandering, as shares and floors.
const MODE_ERROR: f64 = 0.15;
const WANDER_SPEED: f64 = 0.02;
const WANDER_YAW: f64 = 0.5;
const WANDER_TIME: f64 = 0.5;
const STEP: Duration = Duration::from_millis(5);

impl Walker {
    fn new(seed: u64, link: Link, pose: PlanarPose) -> Self {
        let mut chance = Chance(seed.wrapping_mul(0x1234_5678_9abc_def1) + 1);
        let mut truth = motions(&model_w());
        for motion in &mut truth[1..] {
            motion.twist.forward *= 1.0 + MODE_ERROR * chance.normal();
            motion.twist.lateral *= 1.0 + MODE_ERROR * chance.normal();
            motion.twist.yaw *= 1.0 + MODE_ERROR * chance.normal();
        }
        let response = Response { frequency_ramp: 50.0, direction_slew: 300.0, settling: 0.15 };
        Self {
            truth,
            response,
            gait: Gait::at_rest(),
            pose,
            wander: [0.0; 3],
            chance,
            link,
            underway: VecDeque::new(),
        }
    }

    fn send(&mut self, now: Instant, mode: usize) {
        if self.chance.uniform() >= self.link.loss {
            self.underway.push_back((now + self.link.latency, mode));
        }
    }

    fn step(&mut self, now: Instant) {
        while self.underway.front().is_some_and(|c| c.0 <= now) {
            if let Some((_, mode)) = self.underway.pop_front() {
                self.gait =
                    self.gait.commanded(mode, self.pose.heading, &self.truth, &self.response);
            }
        }
        let dt = STEP.as_secs_f64();
        self.gait.advance(&mut self.pose, dt, &self.truth, &self.response);
        for (value, sigma) in self.wander.iter_mut().zip([WANDER_SPEED, WANDER_SPEED, WANDER_YAW]) {
            let kick = sigma * (2.0 * dt / WANDER_TIME).sqrt() * self.chance.normal();
            *value += -*value * dt / WANDER_TIME + kick;
        }
        if self.gait.mode() != REST {
            let [forward, lateral, yaw] = self.wander;
            self.pose = self.pose.moved(Twist { forward, lateral, yaw }, dt);
        }
    }

    fn sample(&mut self, now: Instant) -> PoseSample {
        let shaking = if self.gait.mode() == REST { 0.0 } else { 1.0 };
        let mut noisy = |value: f64, sigma: f64| value + sigma * self.chance.normal();
        let pose = PlanarPose {
            x: noisy(self.pose.x, 0.0005 + 0.001 * shaking),
            y: noisy(self.pose.y, 0.0005 + 0.001 * shaking),
            heading: noisy(self.pose.heading, 0.003 + 0.02 * shaking),
        };
        PoseSample { time: now, pose: Pose::planar(pose, 0.06), valid: true, picture: None }
    }
}

struct Run {
    navigator: Navigator,
    walker: Walker,
    now: Instant,
    last: Decision,
    /// What a hand adds to the pose in each of so many steps.
    push: ([f64; 3], u32),
}

/// Steps for which a hand pushes the robot: 0.5 s.
const PUSH: u32 = 100;

impl Run {
    fn new(
        task: Task,
        controller: ControllerKind,
        link: Link,
        seed: u64,
        pose: PlanarPose,
    ) -> Self {
        let settings = Settings { controller, latency: link.latency, ..Settings::for_task(&task) };
        Self {
            navigator: Navigator::new(task, &model_w(), settings).unwrap(),
            walker: Walker::new(seed, link, pose),
            now: Instant::START,
            last: Decision::Rest(Resting::NoPoseYet),
            push: ([0.0; 3], 0),
        }
    }

    /// Pushes the robot to a pose.
    fn push(&mut self, to: PlanarPose) {
        let from = self.walker.pose;
        let way = [to.x - from.x, to.y - from.y, wrap(to.heading - from.heading)];
        self.push = (way.map(|part| part / f64::from(PUSH)), PUSH);
    }

    fn mode(&self) -> usize {
        match self.last {
            Decision::Drive { mode, .. } => mode + 1,
            _ => REST,
        }
    }

    /// Poses at 100 Hz, commands at 50 Hz.
    fn step(&mut self) {
        self.now = self.now + STEP;
        self.walker.step(self.now);
        if self.push.1 > 0 {
            let ([x, y, turn], steps) = &mut self.push;
            let pose = &mut self.walker.pose;
            (pose.x, pose.y, pose.heading) = (pose.x + *x, pose.y + *y, pose.heading + *turn);
            *steps -= 1;
        }
        let tick = self.now.as_micros() / STEP.as_micros() as u64;
        if tick.is_multiple_of(2) {
            let sample = self.walker.sample(self.now);
            self.navigator.observe(&sample);
        }
        if tick.is_multiple_of(4) {
            self.last = self.navigator.decide(self.now);
            let mode = self.mode();
            self.walker.send(self.now, mode);
        }
    }

    fn seconds(&self) -> f64 {
        self.now.as_micros() as f64 * 1e-6
    }

    fn until_end(&mut self, longest: f64) {
        while self.seconds() < longest
            && !matches!(self.last, Decision::Finished | Decision::Stopped(_))
        {
            self.step();
        }
    }
}

fn eight(laps: u32) -> Task {
    Task::Follow { path: Path::figure_eight(1.6, 0.8).unwrap(), laps }
}

/// RMS path error (mm) and duration (s) of two laps.
fn track(controller: ControllerKind, link: Link, seed: u64) -> (f64, f64) {
    let start = PlanarPose { x: 0.0, y: 0.0, heading: 0.0 };
    let mut run = Run::new(eight(2), controller, link, seed, start);
    run.until_end(3000.0);
    assert_eq!(run.last, Decision::Finished, "seed {seed}, {:?}", run.navigator.progress());
    (run.navigator.progress().error_rms * 1e3, run.seconds())
}

/// For each push: error at rest (mm) and time to get there (s); `None` where it did not arrive.
fn pushes(link: Link, count: u32, seed: u64) -> Vec<Option<(f64, f64)>> {
    let task = Task::Reach { point: Position::ORIGIN, stay: true };
    let mut run = Run::new(task, ControllerKind::Predictive, link, seed, PlanarPose::default());
    let mut chance = Chance(seed ^ 0xabcd);
    (0..count)
        .map(|_| {
            let (bearing, distance) = (TAU * chance.uniform(), 0.5 * chance.uniform().sqrt());
            run.push(PlanarPose {
                x: distance * bearing.cos(),
                y: distance * bearing.sin(),
                heading: TAU * chance.uniform() - PI,
            });
            arrival(&mut run)
        })
        .collect()
}

/// Waits until the robot has rested for a second.
fn arrival(run: &mut Run) -> Option<(f64, f64)> {
    let begin = run.seconds();
    let mut rested = 0.0;
    while run.seconds() - begin < 120.0 {
        run.step();
        let rests = run.last == Decision::Rest(Resting::Arrived) && run.push.1 == 0;
        rested = if rests { rested + STEP.as_secs_f64() } else { 0.0 };
        if rested > 1.0 {
            let error = run.walker.pose.distance_to(Position::ORIGIN) * 1e3;
            return Some((error, run.seconds() - begin - 1.0));
        }
    }
    None
}

/// RMS distance from the figure eight, mm, and time, s, of four robots on a good link.
static ON_A_GOOD_LINK: LazyLock<[(f64, f64); 4]> =
    LazyLock::new(|| SEEDS.map(|seed| track(ControllerKind::Predictive, GOOD, seed)));
const SEEDS: [u64; 4] = [0, 1, 2, 3];

#[test]
fn follows_the_figure_eight_within_40_mm_over_two_laps() {
    for (seed, (rms, seconds)) in SEEDS.iter().zip(*ON_A_GOOD_LINK) {
        println!("seed {seed}: {rms:.1} mm, {seconds:.0} s");
        assert!(rms <= 40.0 && seconds < 300.0, "seed {seed}: {rms:.1} mm in {seconds:.0} s");
    }
}

#[test]
fn a_bad_link_at_most_doubles_the_path_error() {
    let mean = |runs: [(f64, f64); 4]| runs.iter().map(|run| run.0).sum::<f64>() / 4.0;
    let bad = mean(SEEDS.map(|seed| track(ControllerKind::Predictive, BAD, seed)));
    let good = mean(*ON_A_GOOD_LINK);
    println!("good {good:.1} mm, bad {bad:.1} mm");
    assert!(bad <= 2.0 * good, "{bad:.1} mm against {good:.1} mm");
}

#[test]
fn returns_home_from_twenty_pushes_of_twenty() {
    for (link, seed) in [(GOOD, 1), (GOOD, 2), (BAD, 3), (BAD, 4)] {
        let arrivals: Vec<_> = pushes(link, 20, seed).into_iter().flatten().collect();
        let worst = arrivals.iter().map(|a| a.0).fold(0.0, f64::max);
        let mut seconds: Vec<_> = arrivals.iter().map(|a| a.1).collect();
        seconds.sort_by(f64::total_cmp);
        println!(
            "seed {seed}: {} of 20, worst {worst:.0} mm, median {:.1} s",
            arrivals.len(),
            seconds[10]
        );
        assert!(
            arrivals.len() == 20 && worst <= 50.0 && seconds[10] < 60.0,
            "seed {seed}: {arrivals:?}"
        );
    }
}

#[test]
fn the_papers_controller_finishes_the_eight_too() {
    let (rms, seconds) = track(ControllerKind::TwoState, GOOD, 1);
    println!("two-state: {rms:.1} mm, {seconds:.0} s");
    assert!(rms < 100.0);
}

/// A run on the figure eight that has joined its path.
fn under_way() -> Run {
    let mut run = Run::new(eight(2), ControllerKind::Predictive, GOOD, 1, PlanarPose::default());
    while run.seconds() < 5.0 {
        run.step();
    }
    assert!(run.navigator.progress().joined && run.mode() != REST);
    run
}

fn after(run: &Run, milliseconds: u64) -> Instant {
    run.now + Duration::from_millis(milliseconds)
}

#[test]
fn a_pose_older_than_100_ms_stops_the_robot_and_a_fresh_one_lets_it_go_on() {
    let mut run = under_way();
    let too_old = run.navigator.decide(after(&run, 111));
    assert_eq!(too_old, Decision::Rest(Resting::PoseTooOld));
    let later = after(&run, 300);
    let fresh = run.walker.sample(later);
    run.navigator.observe(&fresh);
    assert!(matches!(run.navigator.decide(later), Decision::Drive { .. }));
}

#[test]
fn poses_that_are_not_trusted_do_not_keep_the_robot_walking() {
    let mut run = under_way();
    for milliseconds in 1..=111 {
        let time = after(&run, milliseconds);
        let sample = run.walker.sample(time);
        let lost = Pose { orientation: Quaternion::default(), ..sample.pose };
        run.navigator.observe(&PoseSample { valid: false, ..sample });
        run.navigator.observe(&PoseSample { pose: lost, ..sample });
    }
    let decision = run.navigator.decide(after(&run, 111));
    assert_eq!(decision, Decision::Rest(Resting::PoseTooOld));
}

#[test]
fn poses_lost_for_long_end_the_run() {
    let mut run = under_way();
    let end = run.navigator.decide(after(&run, 6000));
    assert!(matches!(end, Decision::Stopped(EndReason::PoseLost { .. })), "{end:?}");
    let fresh = run.walker.sample(after(&run, 6010));
    run.navigator.observe(&fresh);
    assert_eq!(run.navigator.decide(after(&run, 6010)), end, "an ended run stays ended");
}

#[test]
fn without_any_pose_the_robot_never_moves() {
    let settings = Settings::for_task(&eight(1));
    let mut navigator = Navigator::new(eight(1), &model_w(), settings).unwrap();
    for milliseconds in 0..4000 {
        let decision = navigator.decide(Instant::from_micros(milliseconds * 1000));
        assert_eq!(decision, Decision::Rest(Resting::NoPoseYet));
    }
}

#[test]
fn outside_the_fence_the_run_ends_and_says_where() {
    let task = Task::Reach { point: Position::ORIGIN, stay: true };
    let start = PlanarPose { x: 1.2, y: 0.0, heading: 0.0 };
    let mut run = Run::new(task, ControllerKind::Predictive, GOOD, 1, start);
    run.until_end(0.5);
    run.push(PlanarPose { x: 2.0, ..start });
    run.until_end(10.0);
    let Decision::Stopped(stop) = run.last else { panic!("still going") };
    assert!(stop.to_string().contains("at 1.5"), "{stop}");
}

#[test]
fn too_far_from_the_path_the_run_ends_and_says_how_far() {
    let mut run = under_way();
    run.push(PlanarPose { x: 0.0, y: 0.8, heading: 0.0 });
    run.until_end(10.0);
    assert!(matches!(run.last, Decision::Stopped(EndReason::OffPath { .. })), "{:?}", run.last);
}

/// Modes of a minute's run whose beginning was seen: the one before, itself, and how long it was kept.
fn stays() -> Vec<(usize, usize, Duration)> {
    let mut run = under_way();
    let (mut stays, mut begun, mut mode) = (Vec::new(), None, run.mode());
    while run.seconds() < 60.0 {
        run.step();
        if run.mode() != mode {
            if let Some((before, since)) = begun {
                stays.push((before, mode, run.now.since(since)));
            }
            begun = Some((mode, run.now));
            mode = run.mode();
        }
    }
    stays
}

#[test]
fn a_mode_is_kept_for_its_minimum_dwell() {
    let shortest = stays().iter().map(|stay| stay.2).min();
    assert!(shortest >= Some(Duration::from_millis(300)), "{shortest:?}");
}

#[test]
fn a_reversal_is_never_taken_back_half_way() {
    let motions = motions(&model_w());
    let frequency = |mode: usize| motions[mode].frequency;
    let ramp =
        |from, to| (frequency(to) - frequency(from)).abs() / Response::default().frequency_ramp;
    let reversals: Vec<_> = stays()
        .into_iter()
        .filter(|(from, to, _)| frequency(*from) * frequency(*to) < 0.0)
        .collect();
    assert!(!reversals.is_empty());
    for (from, to, kept) in reversals {
        assert!(kept.as_secs_f64() >= ramp(from, to), "{from} to {to}: {kept:?}");
    }
}

#[test]
fn a_pushed_robot_finds_back_to_its_path_and_ends_its_laps() {
    let mut run = Run::new(eight(1), ControllerKind::Predictive, GOOD, 7, PlanarPose::default());
    while run.seconds() < 20.0 {
        run.step();
    }
    let PlanarPose { x, y, heading } = run.walker.pose;
    run.push(PlanarPose { x, y: y + 0.25, heading: heading + 2.5 });
    run.until_end(400.0);
    assert_eq!(run.last, Decision::Finished, "{:?}", run.navigator.progress());
}

#[test]
fn waypoints_are_walked_to_the_last_one_once() {
    let corners = [(0.0, 0.0), (0.5, 0.0), (0.5, 0.4)].map(|(x, y)| Position::new(x, y));
    let path = Path::through("room", &corners, false).unwrap();
    let task = Task::Follow { path, laps: 1 };
    let mut run = Run::new(task, ControllerKind::Predictive, GOOD, 3, PlanarPose::default());
    run.until_end(200.0);
    assert_eq!(run.last, Decision::Finished);
    assert!(run.walker.pose.distance_to(Position::new(0.5, 0.4)) < 0.06, "{:?}", run.walker.pose);
}

#[test]
fn poses_that_stand_still_while_the_robot_walks_end_the_run() {
    let mut run = under_way();
    let frozen = run.walker.sample(run.now);
    let end = (0..400).find_map(|tick| {
        let now = after(&run, 10 * tick);
        run.navigator.observe(&PoseSample { time: now, ..frozen });
        match run.navigator.decide(now) {
            Decision::Stopped(stop) => Some(stop),
            _ => None,
        }
    });
    assert!(matches!(end, Some(EndReason::NotMoving { .. })), "{end:?}");
}

/// The reason for which a run under way ends within 3 s, by poses that a tracker reports in place of the robot's.
fn ends_by(lie: impl Fn(PlanarPose, f64) -> PlanarPose) -> Option<EndReason> {
    let mut run = under_way();
    let begin = run.seconds();
    while run.seconds() < begin + 3.0 {
        run.now = run.now + STEP;
        run.walker.step(run.now);
        let sample = run.walker.sample(run.now);
        let seen = lie(sample.trusted()?, run.seconds() - begin);
        run.navigator.observe(&PoseSample { pose: Pose::planar(seen, 0.06), ..sample });
        run.last = run.navigator.decide(run.now);
        if let Decision::Stopped(stop) = &run.last {
            return Some(stop.clone());
        }
        let mode = run.mode();
        run.walker.send(run.now, mode);
    }
    None
}

#[test]
fn poses_that_jump_away_from_a_walking_robot_end_the_run() {
    let other = |_, seconds: f64| PlanarPose { x: 0.3 + 0.1 * seconds, y: -0.2, heading: 0.5 };
    let flipped = |pose: PlanarPose, _| PlanarPose { heading: pose.heading + PI, ..pose };
    let lost = |_, _| PlanarPose { x: 0.0, y: 0.0, heading: 0.0 };
    for end in [ends_by(other), ends_by(flipped), ends_by(lost)] {
        assert!(matches!(end, Some(EndReason::Jumped { .. })), "{end:?}");
    }
}

#[test]
fn poses_that_move_against_the_commands_end_the_run() {
    let begin = under_way().walker.pose;
    let backwards = |pose: PlanarPose, _| PlanarPose {
        x: 2.0 * begin.x - pose.x,
        y: 2.0 * begin.y - pose.y,
        heading: 2.0 * begin.heading - pose.heading,
    };
    let end = ends_by(backwards);
    assert!(matches!(end, Some(EndReason::NotAnswering { .. })), "{end:?}");
}

#[test]
fn single_poses_that_come_back_end_nothing() {
    let outlier = |pose: PlanarPose, seconds: f64| {
        let is_out = (seconds % 1.0) < 0.01;
        if is_out { PlanarPose { x: 9.0, y: 9.0, heading: 0.0 } } else { pose }
    };
    assert_eq!(ends_by(outlier), None);
}

#[test]
fn a_robot_that_trembles_in_its_place_for_30_s_ends_its_run() {
    let mut run = Run::new(eight(2), ControllerKind::Predictive, GOOD, 1, PlanarPose::default());
    let end = (0..8000).find_map(|_| {
        run.now = run.now + STEP;
        // To and fro by more than a standing robot, and nowhere. Another program commands it to walk.
        run.walker.pose.heading = 0.3 * (TAU * run.seconds()).sin();
        let sample = run.walker.sample(run.now);
        run.navigator.observe(&sample);
        run.navigator.judge(run.now, true)
    });
    assert!(matches!(end, Some(Decision::Stopped(EndReason::NoProgress { .. }))), "{end:?}");
    assert!(run.seconds() > 29.0, "after {} s", run.seconds());
}

#[test]
fn a_closed_path_with_a_spur_is_walked_once_round_to_its_tip() {
    let path = Path::from_text("spur", "0,0\n0.6,0\n0.6,0.3\n0.6,0\n0,0").unwrap();
    let tip = Position::new(0.6, 0.3);
    for seed in 1..=8 {
        let task = Task::Follow { path: path.clone(), laps: 1 };
        let mut run = Run::new(task, ControllerKind::Predictive, GOOD, seed, PlanarPose::default());
        let mut nearest = f64::MAX;
        while run.seconds() < 100.0 && run.last != Decision::Finished {
            run.step();
            nearest = nearest.min(run.walker.pose.distance_to(tip));
        }
        let progress = run.navigator.progress();
        assert_eq!(run.last, Decision::Finished, "{progress:?}");
        assert!(nearest < 0.04, "{nearest} m from the tip");
        assert!(progress.laps >= 0.95 && progress.error_rms < 0.04, "{progress:?}");
    }
}

#[test]
fn a_robot_outside_the_fence_walks_to_its_path_when_that_is_asked_for() {
    let outside = PlanarPose { x: 0.3, y: 1.6, heading: 2.0 };
    let run = |approach| {
        let mut run = Run::new(eight(1), ControllerKind::Predictive, GOOD, 3, outside);
        run.navigator = {
            let settings = Settings { approach, ..run.navigator.settings().clone() };
            Navigator::new(eight(1), &model_w(), settings).unwrap()
        };
        run.until_end(300.0);
        run.last
    };
    assert!(matches!(run(Approach::Inside), Decision::Stopped(EndReason::OutsideFence { .. })));
    assert_eq!(run(Approach::Anywhere), Decision::Finished);
}

#[test]
fn a_robot_away_from_its_path_walks_there_unless_that_is_forbidden() {
    let path = || Path::from_text("zigzag", "0,0\n0.6,0\n0.6,0.5\n0,0.5").unwrap();
    for (seed, (x, y, heading)) in
        [(0.7, 0.5, 3.0), (0.3, 0.25, -1.6), (-0.4, 0.8, 0.0), (0.0, 0.5, 1.0)]
            .into_iter()
            .enumerate()
    {
        let start = PlanarPose { x, y, heading };
        for approach in [Approach::Inside, Approach::Off] {
            let task = || Task::Follow { path: path(), laps: 1 };
            let mut run = Run::new(task(), ControllerKind::Predictive, GOOD, seed as u64, start);
            let settings = Settings { approach, ..run.navigator.settings().clone() };
            run.navigator = Navigator::new(task(), &model_w(), settings).unwrap();
            let mut nearest = f64::MAX;
            while run.seconds() < 300.0
                && !matches!(run.last, Decision::Finished | Decision::Stopped(_))
            {
                run.step();
                nearest = nearest.min(run.walker.pose.distance_to(Position::ORIGIN));
            }
            match approach {
                // From its start, which the nearest point of it is not.
                Approach::Inside => {
                    assert_eq!(run.last, Decision::Finished, "{start:?}");
                    assert!(
                        nearest < JOINED_WITHIN + 0.01,
                        "{start:?}: {nearest} m from its start"
                    );
                }
                _ => assert!(
                    matches!(run.last, Decision::Stopped(EndReason::NotOnPath { .. })),
                    "{start:?}: {:?}",
                    run.last
                ),
            }
        }
    }
}

#[test]
fn the_learned_controller_needs_experience() {
    let settings = Settings::for_task(&eight(1)).steered_by(ControllerKind::Learned);
    let refused = Navigator::new(eight(1), &model_w(), settings).err();
    assert_eq!(refused, Some(NavigatorError::NoExperience));
}

/// Steers by experience a robot that is slow, on a floor that falls in this direction, rad.
fn on_a_slope(seed: u64, downhill: f64) {
    let mut run = Run::new(eight(1), ControllerKind::Predictive, GOOD, seed, PlanarPose::default());
    let settings = Settings { latency: GOOD.latency, ..Settings::for_task(&eight(1)) }
        .steered_by(ControllerKind::Learned);
    let repertoire = Repertoire::Experience(Arc::new(quicker_and_slower()));
    run.navigator = Navigator::new(eight(1), repertoire, settings).unwrap();
    for motion in &mut run.walker.truth[1..] {
        motion.twist = motion.twist.scaled(0.7);
        let (x, y) = (0.02 * f64::cos(downhill), 0.02 * f64::sin(downhill));
        motion.slide = [
            Twist { forward: x, lateral: 0.4 * y, yaw: 0.0 },
            Twist { forward: y, lateral: -0.4 * x, yaw: 0.0 },
        ];
    }
    run.walker.response = Response::MEASURED;
    // It is watched while it is armed.
    for _ in 0..60 {
        run.now = run.now + 2 * STEP;
        let sample = run.walker.sample(run.now);
        run.navigator.observe(&sample);
    }
    run.until_end(600.0);
    assert_eq!(run.last, Decision::Finished, "{:?}", run.navigator.progress());
    let rms = run.navigator.progress().error_rms;
    assert!(rms < 0.04, "seed {seed}: {rms}");
}

#[test]
fn by_experience_a_slow_robot_on_a_slope_follows_the_figure_eight_within_40_mm() {
    on_a_slope(1, 0.0);
}

#[test]
fn by_experience_a_slow_robot_on_another_slope_follows_the_figure_eight_within_40_mm() {
    on_a_slope(2, 2.0);
}
