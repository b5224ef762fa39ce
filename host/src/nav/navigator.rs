//! From poses to commands: tells what the robot shall do now.
//!
//! [`Navigator::observe`] takes poses as they come, [`Navigator::decide`] says what to command. Both
//! may be called at any rate; `decide` thinks anew every [`Settings::decision_period`] and repeats
//! itself in between. No clock, no socket, no thread.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use flix_protocol::message::Setpoint;
use flix_protocol::units::Instant;

use super::estimator::Estimator;
use super::geometry::PlanarPose;
use super::modes::ModeTable;
use super::motion::{REST, Response};
use super::path::Path;
use super::predictive::{Goal, Prospects};
use super::safety::{Fence, Stop};
use super::two_state::{LOOK_AHEAD, MissingTurn, TwoState};
use crate::pose::PoseSample;

/// What the robot shall do.
#[derive(Debug, Clone, PartialEq)]
pub enum Task {
    /// Follow a path for so many laps (an open path: once, to its end).
    Follow {
        /// The path.
        path: Path,
        /// Laps of a closed path.
        laps: u32,
    },
    /// Come to a point and rest there; `stay` goes back whenever it is moved away.
    Reach {
        /// Where, m.
        point: (f64, f64),
        /// Whether to hold the place until told otherwise.
        stay: bool,
    },
}

/// Who chooses the modes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ControllerKind {
    /// Of all modes the one with the best predicted future.
    #[default]
    Predictive,
    /// The paper's: turn left or turn right.
    TwoState,
}

/// Every number that navigation is tuned with.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Who chooses.
    pub controller: ControllerKind,
    /// From sending a command to the robot's obeying it.
    pub latency: Duration,
    /// How the robot follows a command.
    pub response: Response,
    /// Time between two decisions.
    pub decision_period: Duration,
    /// Shortest stay in a mode, which also lasts until the robot moves as the mode does: the rotors
    /// are not thrown about.
    pub minimum_dwell: Duration,
    /// A pose older than this stops the robot.
    pub pose_deadline: Duration,
    /// A run without trusted poses ends after this long.
    pub pose_patience: Duration,
    /// Where the robot may be.
    pub fence: Fence,
    /// Farther off its path than this (m) the run ends.
    pub error_limit: f64,
    /// Within this of its goal (m) the robot has arrived.
    pub arrival_radius: f64,
    /// Moved farther than this from its goal (m), a robot that stays goes back.
    pub return_radius: f64,
}

/// What to command now.
#[derive(Debug, Clone, PartialEq)]
pub enum Decision {
    /// Shake so, in the mode of this index in the table.
    Drive {
        /// Index in [`ModeTable::modes`].
        mode: usize,
        /// Its pair.
        setpoint: Setpoint,
    },
    /// Stand still for now.
    Rest(Resting),
    /// Done; stand still.
    Finished,
    /// Ended early; stop the robot.
    Stopped(Stop),
}

/// Why the robot stands for now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Resting {
    /// No pose yet.
    NoPoseYet,
    /// The newest trusted pose is too old.
    PoseTooOld,
    /// It is where it should be.
    Arrived,
}

/// How the run goes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Progress {
    /// Distance from the path or the goal at the last pose, m; positive left of a path.
    pub error: f64,
    /// Root mean square of the error over time since the path was joined, m.
    pub error_rms: f64,
    /// Largest error since then, m.
    pub error_peak: f64,
    /// Arc length made good on the path, m.
    pub arc_length: f64,
    /// The same in laps since the path was joined, or in shares of an open path.
    pub laps: f64,
    /// Whether the path was joined: the robot came as near as [`JOINED_WITHIN`].
    pub joined: bool,
    /// Changes of mode so far.
    pub switches: u32,
}

/// A robot nearer than this to its path is on it, m.
pub const JOINED_WITHIN: f64 = 0.05;

/// The end of an open path is approached as a point from here on, m.
const FINAL_APPROACH: f64 = 0.12;

/// See the module's text.
#[derive(Debug, Clone)]
pub struct Navigator {
    task: Task,
    settings: Settings,
    setpoints: Vec<Setpoint>,
    estimator: Estimator,
    two_state: Option<TwoState>,
    mode: usize,
    mode_since: Instant,
    decided: Option<Instant>,
    started: Option<Instant>,
    trusted: Option<Instant>,
    measured: PlanarPose,
    squares: (f64, f64),
    /// Arc length at which a closed path was joined.
    joined_at: f64,
    progress: Progress,
    stop: Option<Stop>,
    finished: bool,
}

impl Settings {
    /// Settings for a task: defaults, with the fence half a metre around the path (or a metre and a
    /// half around the goal).
    #[must_use]
    pub fn for_task(task: &Task) -> Self {
        let fence = match task {
            Task::Follow { path, .. } => Fence::around(path.bounds(), 0.5),
            Task::Reach { point, .. } => Fence::around((*point, *point), 1.5),
        };
        Self {
            controller: ControllerKind::default(),
            latency: Duration::from_millis(25),
            response: Response::default(),
            decision_period: Duration::from_millis(100),
            minimum_dwell: Duration::from_millis(300),
            pose_deadline: Duration::from_millis(100),
            pose_patience: Duration::from_secs(5),
            fence,
            error_limit: 0.4,
            arrival_radius: 0.02,
            return_radius: 0.04,
        }
    }
}

impl Navigator {
    /// A navigator for one run.
    ///
    /// # Errors
    /// When the two-state controller is asked for and the table lacks one of its turns.
    pub fn new(task: Task, table: &ModeTable, settings: Settings) -> Result<Self, MissingTurn> {
        let two_state = match settings.controller {
            ControllerKind::Predictive => None,
            ControllerKind::TwoState => Some(TwoState::new(table)?),
        };
        Ok(Self {
            estimator: Estimator::new(table, settings.response, settings.latency),
            setpoints: table.modes().iter().map(|m| m.setpoint).collect(),
            task,
            settings,
            two_state,
            mode: REST,
            mode_since: Instant::START,
            decided: None,
            started: None,
            trusted: None,
            measured: PlanarPose::default(),
            squares: (0.0, 0.0),
            joined_at: 0.0,
            progress: Progress::default(),
            stop: None,
            finished: false,
        })
    }

    /// What it is doing.
    #[must_use]
    pub fn task(&self) -> &Task {
        &self.task
    }

    /// With which numbers.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// How the run goes.
    #[must_use]
    pub fn progress(&self) -> Progress {
        self.progress
    }

    /// Whether the robot was told to stand and, as far as known, does.
    #[must_use]
    pub fn is_resting(&self) -> bool {
        let newest = self.trusted.unwrap_or(Instant::START);
        self.started.is_some()
            && self.trusted.is_some()
            && self.mode == REST
            && self.estimator.predicted(newest).1.is_steady()
    }

    /// Ends the run well: the next decision is [`Decision::Finished`].
    pub fn conclude(&mut self) {
        self.finished = true;
    }

    /// The filtered pose; `None` before the first.
    #[must_use]
    pub fn pose(&self) -> Option<PlanarPose> {
        self.estimator.pose()
    }

    /// From sending a command to the robot's obeying it, as measured on the link.
    pub fn set_latency(&mut self, latency: Duration) {
        self.settings.latency = latency;
        self.estimator.set_latency(latency);
    }

    /// A pose came in. Poses that are not trusted, not sound or from the past are not used.
    pub fn observe(&mut self, sample: &PoseSample) {
        let late = self.trusted.is_some_and(|newest| sample.time <= newest);
        if late || !sample.valid || !sample.pose.is_sound() {
            return;
        }
        let pose = sample.pose.on_the_floor();
        let elapsed = self.trusted.map_or(Duration::ZERO, |before| sample.time.since(before));
        let first = self.trusted.is_none();
        self.trusted = Some(sample.time);
        self.measured = pose;
        self.estimator.observe(sample.time, pose);
        self.measure_error(first, elapsed.min(self.settings.pose_deadline));
    }

    /// What the robot shall do now. After [`Decision::Finished`] and [`Decision::Stopped`] it stays
    /// with that.
    pub fn decide(&mut self, now: Instant) -> Decision {
        let started = *self.started.get_or_insert(now);
        if let Some(stop) = self.stop {
            return Decision::Stopped(stop);
        }
        if self.finished {
            return Decision::Finished;
        }
        let age = now.since(self.trusted.unwrap_or(started));
        if self.trusted.is_none() || age > self.settings.pose_deadline {
            return self.wait_for_pose(now, age);
        }
        if let Some(stop) = self.breach() {
            return self.end(now, stop);
        }
        if self.is_done(now) {
            self.finished = true;
            self.command(now, REST);
            return Decision::Finished;
        }
        if self.may_change(now) {
            self.decided = Some(now);
            let mode = self.choose(now);
            self.command(now, mode);
        }
        self.present()
    }

    fn present(&self) -> Decision {
        match self.mode {
            REST => Decision::Rest(Resting::Arrived),
            mode => Decision::Drive { mode: mode - 1, setpoint: self.setpoints[mode - 1] },
        }
    }

    fn wait_for_pose(&mut self, now: Instant, waited: Duration) -> Decision {
        if waited > self.settings.pose_patience {
            return self.end(now, Stop::PoseLost { waited });
        }
        self.command(now, REST);
        let reason = if self.trusted.is_none() { Resting::NoPoseYet } else { Resting::PoseTooOld };
        Decision::Rest(reason)
    }

    fn end(&mut self, now: Instant, stop: Stop) -> Decision {
        self.command(now, REST);
        self.stop = Some(stop);
        Decision::Stopped(stop)
    }

    fn breach(&self) -> Option<Stop> {
        let at = (self.measured.x, self.measured.y);
        if !self.settings.fence.holds(at) {
            return Some(Stop::OutsideFence { at, fence: self.settings.fence });
        }
        let (error, limit) = (self.progress.error.abs(), self.settings.error_limit);
        let on_path = matches!(self.task, Task::Follow { .. }) && self.progress.joined;
        (on_path && error > limit).then_some(Stop::OffPath { error, limit })
    }

    fn is_done(&self, now: Instant) -> bool {
        match &self.task {
            Task::Follow { path, laps } if path.is_closed() => {
                self.progress.laps >= f64::from(*laps)
            }
            Task::Follow { path, .. } => {
                let left = path.length() - self.progress.arc_length;
                left < FINAL_APPROACH && self.has_arrived(now, end_of(path))
            }
            Task::Reach { point, stay } => !stay && self.has_arrived(now, *point),
        }
    }

    /// At rest within the radius of arrival.
    fn has_arrived(&self, now: Instant, point: (f64, f64)) -> bool {
        let stands = self.mode == REST && self.estimator.predicted(now).1.is_steady();
        stands && self.measured.distance_to(point) <= self.settings.return_radius
    }

    fn may_change(&self, now: Instant) -> bool {
        let due =
            self.decided.is_none_or(|decided| now.since(decided) >= self.settings.decision_period);
        let (_, gait) = self.estimator.predicted(now);
        let dwelt = now.since(self.mode_since) >= self.settings.minimum_dwell && gait.is_steady();
        due && (self.mode == REST || dwelt)
    }

    fn command(&mut self, now: Instant, mode: usize) {
        if mode != self.mode {
            self.mode_since = now;
            self.progress.switches += 1;
            self.mode = mode;
        }
        self.estimator.command(now, mode);
    }

    fn choose(&self, now: Instant) -> usize {
        match self.goal() {
            Goal::Reach { point } if self.rests_well_at(now, point) => REST,
            goal => match &self.two_state {
                Some(controller) => self.turn_towards(controller, goal),
                None => self.look_ahead(now, goal),
            },
        }
    }

    fn goal(&self) -> Goal<'_> {
        let arc_length = self.progress.arc_length;
        match &self.task {
            Task::Follow { path, .. }
                if !path.is_closed() && path.length() - arc_length < FINAL_APPROACH =>
            {
                Goal::Reach { point: end_of(path) }
            }
            Task::Follow { path, .. } => Goal::Follow { path, arc_length },
            Task::Reach { point, .. } => Goal::Reach { point: *point },
        }
    }

    /// Whether to stand: a resting robot until it is out of the return radius, a walking one as
    /// soon as it would come to rest within the arrival radius.
    fn rests_well_at(&self, now: Instant, point: (f64, f64)) -> bool {
        if self.mode == REST {
            return self.measured.distance_to(point) <= self.settings.return_radius;
        }
        self.resting_place(now).distance_to(point) <= self.settings.arrival_radius
    }

    /// Where the robot would come to rest if told so now.
    fn resting_place(&self, now: Instant) -> PlanarPose {
        const STEP: f64 = 0.05;
        const LONGEST: u32 = 60;
        let (mut pose, gait) = self.estimator.predicted(now + self.settings.latency);
        let (motions, response) = (self.estimator.motions(), self.estimator.response());
        let mut gait = gait.commanded(REST, motions, response);
        for _ in 0..LONGEST {
            if gait.is_steady() {
                break;
            }
            gait.advance(&mut pose, STEP, motions, response);
        }
        pose
    }

    fn turn_towards(&self, controller: &TwoState, goal: Goal<'_>) -> usize {
        let pose = self.estimator.pose().unwrap_or(self.measured);
        let target = match goal {
            Goal::Follow { path, arc_length } => {
                let ahead = path.at(arc_length + LOOK_AHEAD);
                (ahead.x, ahead.y)
            }
            Goal::Reach { point } => point,
        };
        controller.choose(&pose, target, self.mode)
    }

    fn look_ahead(&self, now: Instant, goal: Goal<'_>) -> usize {
        let (pose, gait) = self.estimator.predicted(now + self.settings.latency);
        Prospects::new(self.estimator.motions(), self.estimator.response())
            .best_mode(pose, gait, goal)
    }

    fn measure_error(&mut self, first: bool, elapsed: Duration) {
        let at = (self.measured.x, self.measured.y);
        let progress = &mut self.progress;
        match &self.task {
            Task::Follow { path, .. } => {
                let joining = first || !progress.joined;
                let place = if joining {
                    path.join(&self.measured)
                } else {
                    path.follow(at, progress.arc_length)
                };
                progress.error = place.error;
                progress.arc_length = place.arc_length;
                if joining && path.is_closed() {
                    self.joined_at = place.arc_length;
                }
                progress.laps = (place.arc_length - self.joined_at) / path.length();
                progress.joined |= place.error.abs() < JOINED_WITHIN;
            }
            Task::Reach { point, .. } => {
                progress.error = self.measured.distance_to(*point);
                progress.joined = true;
            }
        }
        if progress.joined {
            let seconds = elapsed.as_secs_f64();
            self.squares.0 += progress.error.powi(2) * seconds;
            self.squares.1 += seconds;
            progress.error_peak = progress.error_peak.max(progress.error.abs());
        }
        if self.squares.1 > 0.0 {
            progress.error_rms = (self.squares.0 / self.squares.1).sqrt();
        }
    }
}

fn end_of(path: &Path) -> (f64, f64) {
    let end = path.at(path.length());
    (end.x, end.y)
}

impl fmt::Display for ControllerKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Predictive => "predictive",
            Self::TwoState => "two-state",
        })
    }
}

/// What was written names no controller.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no controller \"{0}\": choose predictive or two-state")]
pub struct UnknownController(String);

impl FromStr for ControllerKind {
    type Err = UnknownController;

    fn from_str(text: &str) -> Result<Self, UnknownController> {
        match text {
            "predictive" => Ok(Self::Predictive),
            "two-state" => Ok(Self::TwoState),
            other => Err(UnknownController(other.to_owned())),
        }
    }
}
