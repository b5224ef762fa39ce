//! From poses to commands: decides what the robot does now.
//!
//! [`Navigator::observe`] takes poses as they arrive, [`Navigator::decide`] returns what to command.
//! Both may be called at any rate: `decide` decides anew every [`Settings::decision_period`] and
//! repeats its decision in between. No clock, no socket, no thread.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use flix_protocol::message::Setpoint;
use flix_protocol::units::Instant;

use super::end_reason::EndReason;
use super::estimator::Estimator;
use super::experience::Experience;
use super::modes::ModeTable;
use super::motion::{Gait, REST, Response};
use super::outlook::Outlook;
use super::path::Path;
use super::plausibility::{Commanded, Plausibility};
use super::predictive::{Goal, Prospects};
use super::two_state::{LOOK_AHEAD, MissingTurn, TwoState};
use super::weights::Weights;
use crate::pose::geometry::{Area, PlanarPose, Position};
use crate::pose::{PoseSample, rate};

/// The task of a run.
#[derive(Debug, Clone, PartialEq)]
pub enum Task {
    /// Follow a path for a number of laps (an open path: once, to its end).
    Follow {
        /// The path.
        path: Path,
        /// Laps of a closed path.
        laps: u32,
    },
    /// Come to a point and rest there.
    Reach {
        /// The point.
        point: Position,
        /// Whether to return to the point whenever the robot is moved away.
        stay: bool,
    },
}

/// The controller that chooses the modes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ControllerKind {
    /// Chooses the mode with the best predicted future.
    #[default]
    Predictive,
    /// The paper's controller: turns left or right.
    TwoState,
    /// Chooses as [`ControllerKind::Predictive`] does, from many more pairs, and learns how this robot walks from
    /// [`Experience`] and its own walk.
    Learned,
}

/// The pairs that a run may command, and what is known of the motion under each.
#[derive(Debug, Clone, PartialEq)]
pub enum Repertoire {
    /// The modes that were measured with this robot.
    Table(ModeTable),
    /// What robots of its kind do.
    Experience(Arc<Experience>),
}

impl From<&ModeTable> for Repertoire {
    fn from(table: &ModeTable) -> Self {
        Self::Table(table.clone())
    }
}

impl Repertoire {
    /// Returns its pairs as a table: a mode of a decision is counted in it.
    #[must_use]
    pub fn table(&self) -> ModeTable {
        match self {
            Self::Table(table) => table.clone(),
            Self::Experience(experience) => experience.table(),
        }
    }
}

/// Why a controller cannot steer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NavigatorError {
    /// The two-state controller lacks a turn.
    #[error(transparent)]
    MissingTurn(#[from] MissingTurn),
    /// The learned controller was given a table.
    #[error(
        "the learned controller needs the experience of many robots, not the mode table of one"
    )]
    NoExperience,
}

/// Whether a run may begin away from its path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Approach {
    /// The robot has to stand within [`JOINED_WITHIN`] of the path.
    Off,
    /// It walks to the path from anywhere inside the fence.
    #[default]
    Inside,
    /// It walks to the path also from outside the fence.
    Anywhere,
}

/// Tuning of navigation.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// The controller that chooses the modes.
    pub controller: ControllerKind,
    /// Time from sending a command until the robot obeys it.
    pub latency: Duration,
    /// Response of the robot to a command.
    pub response: Response,
    /// Time between two decisions.
    pub decision_period: Duration,
    /// Shortest time in a mode. A mode is also kept until its motion is steady, to spare the rotors.
    pub minimum_dwell: Duration,
    /// A pose older than this, or than 2.5 periods of slow poses, stops the robot.
    pub pose_deadline: Duration,
    /// Without trusted poses the run ends after this time.
    pub pose_patience: Duration,
    /// The robot must stay inside.
    pub fence: Area,
    /// Whether a run may begin away from its path.
    pub approach: Approach,
    /// The run ends at this distance from the path, m.
    pub error_limit: f64,
    /// Distance from the goal at which the robot has arrived, m.
    pub arrival_radius: f64,
    /// Distance from the goal at which a robot that stays returns, m.
    pub return_radius: f64,
}

/// What to command now.
#[derive(Debug, Clone, PartialEq)]
pub enum Decision {
    /// Command this mode.
    Drive {
        /// Index in [`ModeTable::modes`].
        mode: usize,
        /// Its pair.
        setpoint: Setpoint,
    },
    /// Rest for now.
    Rest(Resting),
    /// The task is done; rest.
    Finished,
    /// The run ended early; stop the robot.
    Stopped(EndReason),
}

/// Why the robot rests for now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Resting {
    /// No pose has arrived yet.
    NoPoseYet,
    /// The newest trusted pose is too old.
    PoseTooOld,
    /// The poses move before the robot walks.
    Moving,
    /// The robot is at its goal.
    Arrived,
}

/// Progress of a run.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Progress {
    /// Distance from the path or the goal at the last pose, m; positive left of a path.
    pub error: f64,
    /// Root mean square of the error over the time since the path was joined, m.
    pub error_rms: f64,
    /// Mean of the error over that time, m.
    pub error_mean: f64,
    /// Largest error since then, m.
    pub error_peak: f64,
    /// Arc length covered on the path, m.
    pub arc_length: f64,
    /// Arc length in laps since the path was joined, or as a share of an open path.
    pub laps: f64,
    /// Whether the path was joined: the robot came within [`JOINED_WITHIN`] of it.
    pub joined: bool,
    /// Number of changes of mode.
    pub switches: u32,
}

/// Distance at which a robot has joined its path, m.
pub const JOINED_WITHIN: f64 = 0.05;

/// Room around a robot that approaches its fence from outside, m: half a turn of the widest mode.
const CORRIDOR_MARGIN: f64 = 0.3;

/// A robot that has not left this length of its path, m, is held.
const HELD_WITHIN: f64 = 0.05;

/// Rate at which the error along the path is integrated into [`Prospects::trim`], 1/s: slower than a change of mode by far; and the
/// largest trim, m.
const TRIM_RATE: f64 = 0.15;
const LARGEST_TRIM: f64 = 0.015;

/// Time for which poses stand before the robot walks, s, and the longest time to wait for that: those of a robot that walks
/// are not believed for so long.
const STILL: f64 = 0.15;
const LONGEST_STILL: Duration = Duration::from_millis(2500);

/// Time for which a robot may walk without leaving its place on the path: it turns round within 5 s.
const PROGRESS_PATIENCE: Duration = Duration::from_secs(30);

/// Distance before the end of an open path from which the end is approached as a point, m.
const FINAL_APPROACH: f64 = 0.12;

/// Chooses the modes, with what it keeps from one decision to the next.
#[derive(Debug, Clone)]
enum Controller {
    Predictive,
    TwoState(TwoState),
    Learned { outlook: Outlook },
}

/// Navigator of one run; see the module's documentation.
#[derive(Debug, Clone)]
pub struct Navigator {
    task: Task,
    settings: Settings,
    setpoints: Vec<Setpoint>,
    estimator: Estimator,
    controller: Controller,
    mode: usize,
    mode_since: Instant,
    decided: Option<Instant>,
    started: Option<Instant>,
    trusted: Option<Instant>,
    measured: PlanarPose,
    /// Integral of the squared error over time, m^2 s.
    squared_error: f64,
    /// Integral of the error over time, m s.
    summed_error: f64,
    /// See [`Prospects::trim`].
    trim: f64,
    /// Time since the path was joined, s.
    joined_for: f64,
    /// Arc length at which a closed path was joined.
    joined_at: f64,
    progress: Progress,
    stop: Option<EndReason>,
    finished: bool,
    /// Age beyond which a pose is too old to walk by.
    pose_deadline: Duration,
    plausibility: Plausibility,
    /// Whether the robot is commanded to walk.
    walks: bool,
    /// Arc length of the place that the robot has not left by [`HELD_WITHIN`], m, and since when.
    held: (f64, Instant),
    /// Where the robot may be on its way into the fence.
    corridor: Option<Area>,
}

impl Settings {
    /// Returns the default settings for a task. The fence is half a metre around the path, or a metre
    /// and a half around the goal.
    #[must_use]
    pub fn for_task(task: &Task) -> Self {
        let fence = match task {
            Task::Follow { path, .. } => path.bounds().widened(0.5),
            Task::Reach { point, .. } => Area::around([*point]).widened(1.5),
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
            approach: Approach::default(),
            error_limit: 0.4,
            arrival_radius: 0.02,
            return_radius: 0.04,
        }
    }
}

impl Settings {
    /// Returns the same settings for another controller.
    #[must_use]
    pub fn steered_by(self, controller: ControllerKind) -> Self {
        let response = match controller {
            ControllerKind::Learned => Response::MEASURED,
            ControllerKind::Predictive | ControllerKind::TwoState => Response::default(),
        };
        Self { controller, response, ..self }
    }
}

impl Navigator {
    /// Creates the navigator of a run.
    ///
    /// # Errors
    /// When the two-state controller is asked for and the table lacks one of its turns, or the learned one and there is
    /// no experience.
    pub fn new(
        task: Task,
        repertoire: impl Into<Repertoire>,
        settings: Settings,
    ) -> Result<Self, NavigatorError> {
        let repertoire = repertoire.into();
        let table = repertoire.table();
        let (response, latency) = (settings.response, settings.latency);
        let controller = match settings.controller {
            ControllerKind::Predictive => Controller::Predictive,
            ControllerKind::TwoState => Controller::TwoState(TwoState::new(&table)?),
            ControllerKind::Learned => {
                Controller::Learned { outlook: Outlook::new(Weights::LEARNED) }
            }
        };
        let estimator = match (settings.controller, &repertoire) {
            (ControllerKind::Learned, Repertoire::Experience(experience)) => {
                Estimator::experienced(experience, response, latency)
            }
            (ControllerKind::Learned, Repertoire::Table(_)) => {
                return Err(NavigatorError::NoExperience);
            }
            _ => Estimator::new(&table, response, latency),
        };
        Ok(Self {
            estimator,
            pose_deadline: settings.pose_deadline,
            setpoints: table.modes().iter().map(|m| m.setpoint).collect(),
            task,
            settings,
            controller,
            mode: REST,
            mode_since: Instant::START,
            decided: None,
            started: None,
            trusted: None,
            measured: PlanarPose::default(),
            squared_error: 0.0,
            summed_error: 0.0,
            trim: 0.0,
            joined_for: 0.0,
            joined_at: 0.0,
            progress: Progress::default(),
            stop: None,
            finished: false,
            plausibility: Plausibility::default(),
            walks: false,
            held: (f64::NEG_INFINITY, Instant::START),
            corridor: None,
        })
    }

    /// Returns the task.
    #[must_use]
    pub fn task(&self) -> &Task {
        &self.task
    }

    /// Returns by how many degrees the axes of the tracked body are turned to the left of the robot's; `None` where the robot walks
    /// as commanded, or differs from its mode table in more than that angle.
    #[must_use]
    pub fn turned(&self) -> Option<f64> {
        self.plausibility.turned()
    }

    /// Returns the settings.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Returns the progress of the run.
    #[must_use]
    pub fn progress(&self) -> Progress {
        self.progress
    }

    /// Returns whether the robot was commanded to rest and, as far as known, is at rest.
    #[must_use]
    pub fn is_resting(&self) -> bool {
        let newest = self.trusted.unwrap_or(Instant::START);
        self.started.is_some()
            && self.trusted.is_some()
            && self.mode == REST
            && self.estimator.predicted(newest).1.is_steady()
    }

    /// Ends the run successfully: the next decision is [`Decision::Finished`].
    pub fn conclude(&mut self) {
        self.finished = true;
    }

    /// Returns the filtered pose; `None` before the first.
    #[must_use]
    pub fn pose(&self) -> Option<PlanarPose> {
        self.estimator.pose()
    }

    /// Sets the time from sending a command until the robot obeys it, as measured on the link.
    pub fn set_latency(&mut self, latency: Duration) {
        self.settings.latency = latency;
        self.estimator.set_latency(latency);
    }

    /// Sets the time from one pose to the next, as measured.
    pub fn set_pose_period(&mut self, period: Duration) {
        self.pose_deadline = rate::deadline(self.settings.pose_deadline, period);
    }

    /// Takes a pose. Poses that are not trusted, not sound or from the past are not used.
    pub fn observe(&mut self, sample: &PoseSample) {
        let late = self.trusted.is_some_and(|newest| sample.time <= newest);
        let Some(pose) = sample.trusted().filter(|_| !late) else { return };
        if !self.believes(sample.time, pose) {
            return;
        }
        let elapsed = self.trusted.map_or(Duration::ZERO, |before| sample.time.since(before));
        let first = self.trusted.is_none();
        self.trusted = Some(sample.time);
        self.measured = pose;
        let is_outside = !self.settings.fence.contains(pose.position());
        if first && is_outside && self.settings.approach == Approach::Anywhere {
            let Area { low, high } = self.settings.fence;
            let around = Area::around([low, high, pose.position()]);
            self.corridor = Some(around.widened(CORRIDOR_MARGIN));
        }
        self.estimator.observe(sample.time, pose);
        self.measure_error(first, elapsed.min(self.pose_deadline));
        // Until it drives there is time to think.
        if self.decided.is_none() {
            self.look_further(sample.time);
        }
        // Not at the edge of the fence: a robot that walks in arcs crosses it several times.
        if self.progress.joined {
            self.corridor = None;
        }
    }

    /// Returns whether the robot can be there by its commands. Until the run begins it may be carried.
    fn believes(&mut self, time: Instant, pose: PlanarPose) -> bool {
        if self.started.is_none() {
            self.plausibility.begin_again();
        }
        // What another program commands is in no table.
        let commanded = match self.estimator.moved(time) {
            Some(moved) if !self.walks || self.mode != REST => Commanded::Moved(moved),
            _ => Commanded::Walks,
        };
        self.plausibility.observe(time, pose, commanded)
    }

    /// Returns what to command now. [`Decision::Finished`] and [`Decision::Stopped`] are final.
    pub fn decide(&mut self, now: Instant) -> Decision {
        if let Some(decision) = self.judge(now, self.mode != REST) {
            return decision;
        }
        if self.decided.is_none() && self.may_be_another(now) {
            return Decision::Rest(Resting::Moving);
        }
        if self.may_change(now) {
            self.decided = Some(now);
            self.look_further(now);
            let mode = self.choose(now);
            self.command(now, mode);
        }
        self.present()
    }

    /// Returns whether the poses of a robot that has not walked yet move: they are not its own, or a hand carries it.
    fn may_be_another(&self, now: Instant) -> bool {
        let waited = self.started.map_or(Duration::ZERO, |since| now.since(since));
        waited < LONGEST_STILL && !self.plausibility.stands_for(now, STILL)
    }

    /// Returns what has to be done whoever steers: to wait for poses, to end the run, or nothing. `walks`: whether the
    /// robot is commanded to walk.
    pub fn judge(&mut self, now: Instant, walks: bool) -> Option<Decision> {
        let started = *self.started.get_or_insert(now);
        if let Some(stop) = &self.stop {
            return Some(Decision::Stopped(stop.clone()));
        }
        if self.finished {
            return Some(Decision::Finished);
        }
        self.walks = walks;
        if let Some(stop) = self.plausibility.end() {
            return Some(self.stop(now, stop));
        }
        let age = now.since(self.trusted.unwrap_or(started));
        if self.trusted.is_none() || age > self.pose_deadline {
            return Some(self.wait_for_pose(now, age));
        }
        // While this navigator steers, its decisions note where they were taken.
        if !walks || self.mode == REST {
            self.look_back(now, walks);
        }
        if let Some(stop) = self.breach(now) {
            return Some(self.stop(now, stop));
        }
        if self.is_done(now) {
            self.finished = true;
            self.command(now, REST);
            return Some(Decision::Finished);
        }
        None
    }

    /// Ends the run early.
    pub fn stop(&mut self, now: Instant, stop: EndReason) -> Decision {
        self.command(now, REST);
        self.stop = Some(stop.clone());
        Decision::Stopped(stop)
    }

    fn present(&self) -> Decision {
        match self.mode {
            REST => Decision::Rest(Resting::Arrived),
            mode => Decision::Drive { mode: mode - 1, setpoint: self.setpoints[mode - 1] },
        }
    }

    fn wait_for_pose(&mut self, now: Instant, waited: Duration) -> Decision {
        if waited > self.settings.pose_patience {
            return self.stop(now, EndReason::PoseLost { waited });
        }
        self.command(now, REST);
        let reason = if self.trusted.is_none() { Resting::NoPoseYet } else { Resting::PoseTooOld };
        Decision::Rest(reason)
    }

    fn breach(&self, now: Instant) -> Option<EndReason> {
        let at = self.measured.position();
        let fence = self.corridor.unwrap_or(self.settings.fence);
        if !fence.contains(at) {
            return Some(EndReason::OutsideFence { at, fence });
        }
        let (error, limit) = (self.progress.error.abs(), self.settings.error_limit);
        if !matches!(self.task, Task::Follow { .. }) {
            return None;
        }
        if !self.progress.joined && self.settings.approach == Approach::Off {
            return Some(EndReason::NotOnPath { error, limit: JOINED_WITHIN });
        }
        let held = self.held_for(now);
        if self.walks && self.progress.joined && held > PROGRESS_PATIENCE {
            return Some(EndReason::NoProgress { held, at });
        }
        (self.progress.joined && error > limit).then_some(EndReason::OffPath { error, limit })
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

    /// Returns whether the robot rests within the return radius of a point.
    fn has_arrived(&self, now: Instant, point: Position) -> bool {
        let rests = self.mode == REST && self.estimator.predicted(now).1.is_steady();
        rests && self.measured.distance_to(point) <= self.settings.return_radius
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

    fn choose(&mut self, now: Instant) -> usize {
        let goal = goal_of(&self.task, &self.progress);
        if let Goal::Reach { point } = goal
            && self.should_rest_at(now, point)
        {
            return REST;
        }
        if let Controller::TwoState(controller) = &mut self.controller {
            let pose = self.estimator.pose().unwrap_or(self.measured);
            let target = match goal {
                Goal::Follow { path, arc_length } => path.ahead(arc_length, LOOK_AHEAD).position(),
                Goal::Reach { point } => point,
            };
            return controller.choose(&pose, target, self.mode);
        }
        let (motions, response) = (self.estimator.motions(), self.estimator.response());
        let mut prospects = Prospects::new(motions, response);
        if let Controller::Learned { outlook } = &self.controller {
            prospects.weights = Weights::LEARNED;
            prospects.pace = self.estimator.pace();
            prospects.outlook = Some(outlook);
        } else {
            prospects.trim = self.trim;
        }
        prospects.weights = prospects.weights.held(self.held_for(now).as_secs_f64());
        let (pose, gait) = self.ahead(now);
        prospects.best_mode(pose, gait, goal)
    }

    /// Notes when the robot came to this place of its path; a robot at rest is not held.
    fn look_back(&mut self, now: Instant, walks: bool) {
        let reached = self.progress.arc_length;
        if !walks || (reached - self.held.0).abs() > HELD_WITHIN {
            self.held = (reached, now);
        }
    }

    /// Returns for how long the robot has not left its place.
    fn held_for(&self, now: Instant) -> Duration {
        now.since(self.held.1)
    }

    /// Works out some more of what the way ahead costs, where it is known how the robot walks.
    fn look_further(&mut self, now: Instant) {
        self.look_back(now, self.walks);
        let held = self.held_for(now).as_secs_f64();
        let Controller::Learned { outlook } = &mut self.controller else { return };
        if let (Some(pace), Goal::Follow { path, arc_length }) =
            (self.estimator.pace(), goal_of(&self.task, &self.progress))
        {
            let motions = self.estimator.motions();
            let progress = Weights::LEARNED.held(held).progress;
            outlook.consider(path, arc_length, motions, progress, |it| pace.best(it));
        }
    }

    /// Returns whether to rest: a resting robot until it leaves the return radius, a walking one as
    /// soon as it would come to rest within the arrival radius.
    fn should_rest_at(&self, now: Instant, point: Position) -> bool {
        if self.mode == REST {
            return self.measured.distance_to(point) <= self.settings.return_radius;
        }
        self.resting_place(now).distance_to(point) <= self.settings.arrival_radius
    }

    /// Returns where the robot would come to rest if commanded now.
    fn resting_place(&self, now: Instant) -> PlanarPose {
        const STEP: f64 = 0.05;
        const LONGEST: u32 = 60;
        let (mut pose, gait) = self.ahead(now);
        let (motions, response) = (self.estimator.motions(), self.estimator.response());
        let mut gait = gait.commanded(REST, pose.heading, motions, response);
        for _ in 0..LONGEST {
            if gait.is_steady() {
                break;
            }
            gait.advance(&mut pose, STEP, motions, response);
        }
        pose
    }

    /// Returns pose and gait for the moment when a command sent now arrives.
    fn ahead(&self, now: Instant) -> (PlanarPose, Gait) {
        self.estimator.predicted(now + self.settings.latency)
    }

    fn measure_error(&mut self, first: bool, elapsed: Duration) {
        let progress = &mut self.progress;
        match &self.task {
            Task::Follow { path, .. } => {
                let joining = first || !progress.joined;
                let place = if joining && path.is_closed() {
                    path.join(&self.measured)
                } else if joining {
                    path.beside_start(self.measured.position())
                } else {
                    path.follow(self.measured.position(), progress.arc_length)
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
            }
        }
        if progress.joined {
            let seconds = elapsed.as_secs_f64();
            self.squared_error += progress.error.powi(2) * seconds;
            self.summed_error += progress.error * seconds;
            self.joined_for += seconds;
            let trim = self.trim + TRIM_RATE * progress.error * seconds;
            self.trim = trim.clamp(-LARGEST_TRIM, LARGEST_TRIM);
            progress.error_peak = progress.error_peak.max(progress.error.abs());
        }
        if self.joined_for > 0.0 {
            progress.error_mean = self.summed_error / self.joined_for;
            progress.error_rms = (self.squared_error / self.joined_for).sqrt();
        }
    }
}

fn goal_of<'a>(task: &'a Task, progress: &Progress) -> Goal<'a> {
    let arc_length = progress.arc_length;
    match task {
        // An open path is followed from its start.
        Task::Follow { path, .. } if !path.is_closed() && !progress.joined => {
            Goal::Reach { point: path.start().position() }
        }
        Task::Follow { path, .. }
            if !path.is_closed() && path.length() - arc_length < FINAL_APPROACH =>
        {
            Goal::Reach { point: end_of(path) }
        }
        Task::Follow { path, .. } => Goal::Follow { path, arc_length },
        Task::Reach { point, .. } => Goal::Reach { point: *point },
    }
}

fn end_of(path: &Path) -> Position {
    path.at(path.length()).position()
}

impl fmt::Display for ControllerKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Predictive => "predictive",
            Self::TwoState => "two-state",
            Self::Learned => "learned",
        })
    }
}

/// A text was refused as the name of a controller.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no controller \"{0}\": choose predictive, learned or two-state")]
pub struct UnknownController(String);

impl FromStr for ControllerKind {
    type Err = UnknownController;

    fn from_str(text: &str) -> Result<Self, UnknownController> {
        match text {
            "predictive" => Ok(Self::Predictive),
            "two-state" => Ok(Self::TwoState),
            "learned" => Ok(Self::Learned),
            other => Err(UnknownController(other.to_owned())),
        }
    }
}
