//! A whole run: connects, arms the robot, drives it by a [`Helm`], and leaves it at rest and disarmed.
//!
//! The pilot has no clock and no socket. Its owner moves datagrams in and out of the [`Client`] and
//! calls [`Pilot::step`] some hundred times a second, with the poses that have arrived: the simulator
//! in virtual time, [`real_time`] on a socket.

#[cfg(not(target_family = "wasm"))]
pub mod real_time;
pub mod steering;

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use flix_protocol::message::{Setpoint, State, Telemetry};
use flix_protocol::session::ConnectError;
use flix_protocol::units::Instant;

use crate::link::{ARM_PATIENCE, Client, LinkError, REVOKED_PATIENCE, StopState, Update, Wish};
use crate::nav::{
    Decision, EndReason, Footing, Identification, Navigator, PlanarPose, Progress, Resting,
};
use crate::pose::rate::{PoseRate, is_too_low};
use crate::pose::{LATE, PoseSample};
use crate::record::{Level, RecordError, Recorder};

/// Longest time for coming to rest and disarming at the end.
pub(crate) const END_PATIENCE: Duration = Duration::from_secs(3);
/// Longest wait of an armed robot for poses that tell how often they come.
const RATE_PATIENCE: Duration = Duration::from_secs(2);
/// Interval of the navigation rows in the record.
const RECORD_PERIOD: Duration = Duration::from_millis(50);
/// Shaking frequency below which a robot is at rest, Hz.
const RESTING_FREQUENCY: f32 = 1.0;

/// What decides where to drive.
pub trait Helm {
    /// Takes a pose.
    fn observe(&mut self, sample: &PoseSample);
    /// Returns what to command now.
    fn decide(&mut self, now: Instant) -> Decision;
    /// Sets the time from sending a command until the robot obeys it, as measured on the link.
    fn set_latency(&mut self, _latency: Duration) {}
    /// Sets the time from one pose to the next, as measured.
    fn set_pose_period(&mut self, _period: Duration) {}
    /// Takes telemetry that was sent at `sent` at the latest, on the clock of [`Helm::decide`].
    fn hear(&mut self, _telemetry: &Telemetry, _sent: Instant) {}
    /// Returns the filtered pose and the progress, if the helm has them.
    fn progress(&self) -> Option<(PlanarPose, Progress)> {
        None
    }
    /// Returns by how many degrees the axes of the tracked body are turned to the left of the robot's, if the helm can tell.
    fn turned(&self) -> Option<f64> {
        None
    }
}

impl Helm for Navigator {
    fn observe(&mut self, sample: &PoseSample) {
        self.observe(sample);
    }

    fn decide(&mut self, now: Instant) -> Decision {
        self.decide(now)
    }

    fn set_latency(&mut self, latency: Duration) {
        self.set_latency(latency);
    }

    fn set_pose_period(&mut self, period: Duration) {
        self.set_pose_period(period);
    }

    fn progress(&self) -> Option<(PlanarPose, Progress)> {
        self.pose().map(|pose| (pose, self.progress()))
    }

    fn turned(&self) -> Option<f64> {
        self.turned()
    }
}

impl Helm for Identification {
    fn observe(&mut self, sample: &PoseSample) {
        self.observe(sample);
    }

    fn hear(&mut self, telemetry: &Telemetry, sent: Instant) {
        self.hear(sent, telemetry);
    }

    fn set_pose_period(&mut self, period: Duration) {
        self.set_pose_period(period);
    }

    fn decide(&mut self, now: Instant) -> Decision {
        self.decide(now)
    }
}

/// How a run ended. The robot is stopped or disarmed, or stops by itself because it receives nothing.
#[derive(Debug, Clone, PartialEq)]
pub enum Ending {
    /// The task is done.
    Finished,
    /// The helm ended it.
    Stopped(EndReason),
    /// The program was interrupted.
    Interrupted,
    /// The run took longer than it may.
    OutOfTime(Duration),
    /// The robot did not do what it was asked, or could not be asked.
    Robot(LinkError),
    /// The run could not be recorded any more: what was said about it.
    NotRecorded(String),
}

impl fmt::Display for Ending {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Finished => f.write_str("finished"),
            Self::Stopped(stop) => write!(f, "{stop}"),
            Self::Interrupted => f.write_str("interrupted"),
            Self::OutOfTime(patience) => write!(
                f,
                "not done within {} s: allow more with --patience",
                patience.as_secs_f64()
            ),
            Self::Robot(error) => write!(f, "{error}"),
            Self::NotRecorded(trouble) => f.write_str(trouble),
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
enum Phase {
    Connecting,
    Arming,
    Driving,
    /// Comes to rest after a successful end.
    Resting,
    Disarming,
    /// Stops after a failed run, and waits for the acknowledgement.
    Stopping,
    /// The robot fell silent: learns whether it refuses the key now.
    Lost,
    Over,
}

/// The record of a run that is over.
#[derive(Debug)]
pub struct Recorded {
    /// Its file, if the run was recorded. With an error it holds the rows from before the error.
    pub file: Option<PathBuf>,
    /// Why it is not complete.
    pub error: Option<RecordError>,
}

impl Recorded {
    /// Returns the file of a complete record.
    ///
    /// # Errors
    /// When it is not complete.
    pub fn complete(self) -> Result<Option<PathBuf>, RecordError> {
        self.error.map_or(Ok(self.file), Err)
    }
}

/// Pilot of one run; see the module's documentation.
pub struct Pilot<H> {
    helm: H,
    footing: Footing,
    rate: PoseRate,
    /// By how much the newest pose came later than the fastest one.
    late: Duration,
    names: Vec<String>,
    phase: Phase,
    since: Option<Instant>,
    ending: Option<Ending>,
    recorder: Option<Recorder>,
    record_error: Option<RecordError>,
    drives_unrecorded: bool,
    patience: Option<Duration>,
    recorded: Option<Instant>,
    commanded: Option<(Setpoint, String)>,
    driving_since: Option<Instant>,
}

impl<H: Helm> Pilot<H> {
    /// Creates a run that has not begun. `names`: of the modes, in the order of the helm's indices.
    #[must_use]
    pub fn new(helm: H, names: Vec<String>, recorder: Option<Recorder>) -> Self {
        Self {
            helm,
            footing: Footing::default(),
            rate: PoseRate::default(),
            late: Duration::ZERO,
            names,
            phase: Phase::Connecting,
            since: None,
            ending: None,
            recorder,
            record_error: None,
            drives_unrecorded: false,
            patience: None,
            recorded: None,
            commanded: None,
            driving_since: None,
        }
    }

    /// Goes on without a record when it cannot be written any more, for example on a full disk; the
    /// run ends then unless this is chosen.
    #[must_use]
    pub fn driving_unrecorded(mut self, goes_on: bool) -> Self {
        self.drives_unrecorded = goes_on;
        self
    }

    /// Ends the run when it has driven for longer.
    #[must_use]
    pub fn within(mut self, patience: Duration) -> Self {
        self.patience = Some(patience);
        self
    }

    /// Returns why the run goes on unrecorded.
    #[must_use]
    pub fn unrecorded(&self) -> Option<&RecordError> {
        self.record_error.as_ref().filter(|_| self.drives_unrecorded)
    }

    /// Returns the poses a second; `None` of too few poses.
    #[must_use]
    pub fn pose_rate(&self) -> Option<f64> {
        self.rate.rate()
    }

    /// Returns the helm.
    #[must_use]
    pub fn helm(&self) -> &H {
        &self.helm
    }

    /// Returns the helm, to change it.
    pub fn helm_mut(&mut self) -> &mut H {
        &mut self.helm
    }

    /// Returns when the robot was armed and driving began.
    #[must_use]
    pub fn driving_since(&self) -> Option<Instant> {
        self.driving_since
    }

    /// Returns what is commanded now: the name of the mode, or why the robot rests.
    #[must_use]
    pub fn doing(&self) -> &str {
        self.commanded.as_ref().map_or("getting ready", |(_, name)| name)
    }

    /// Ends the run early, for example as [`Ending::Interrupted`]; call [`Pilot::step`] until it returns the ending.
    pub fn end(&mut self, now: Instant, client: &mut Client, ending: Ending) {
        if self.ending.is_none() {
            self.fail(now, client, ending);
        }
    }

    /// Completes the record, with these results, and returns it with the helm. A run that was refused before it began has no
    /// record.
    pub fn finish(mut self, mut results: BTreeMap<String, String>) -> (H, Recorded) {
        if let Some(ending) = &self.ending {
            results.insert("ending".into(), ending.to_string());
        }
        let Some(recorder) = self.recorder.take() else {
            return (self.helm, Recorded { file: None, error: None });
        };
        let is_refused = matches!(
            self.ending,
            Some(Ending::Robot(LinkError::Refused(_) | LinkError::Connect(_)))
        );
        if is_refused && self.driving_since.is_none() {
            recorder.discard();
            return (self.helm, Recorded { file: None, error: None });
        }
        let file = Some(recorder.path().to_owned());
        let error = self.record_error.or_else(|| recorder.conclude(results).err());
        (self.helm, Recorded { file, error })
    }

    /// Takes what has arrived from link and pose source, and commands the robot. Returns the ending
    /// once the run is over and the robot is stopped or disarmed (or no longer received).
    pub fn step(
        &mut self,
        now: Instant,
        client: &mut Client,
        poses: &[PoseSample],
    ) -> Option<Ending> {
        let mut off_its_feet = None;
        for sample in poses {
            off_its_feet = self.footing.observe(sample).or(off_its_feet);
            self.rate.observe(sample.time);
            self.helm.observe(sample);
            self.late = sample.late();
            self.record(|recorder| recorder.pose(sample));
        }
        if let Some(period) = self.rate.period() {
            self.helm.set_pose_period(period);
        }
        let too_few = self.rate.rate().filter(|rate| is_too_low(*rate));
        let too_few = too_few.map(|rate| EndReason::TooFewPoses { rate });
        if let Some(stop) = off_its_feet.or(too_few).filter(|_| self.phase == Phase::Driving) {
            self.fail(now, client, Ending::Stopped(stop));
        }
        while let Some(update) = client.update() {
            self.take(now, client, &update);
        }
        if let Some(error) = self.record_error.as_ref().filter(|_| !self.drives_unrecorded)
            && self.ending.is_none()
        {
            let ending = Ending::NotRecorded(error.to_string());
            self.fail(now, client, ending);
        }
        let begun = *self.since.get_or_insert(now);
        let driven = self.driving_since.map_or(Duration::ZERO, |since| now.since(since));
        if let Some(patience) = self.patience.filter(|it| driven > *it) {
            self.end(now, client, Ending::OutOfTime(patience));
        }
        match self.phase {
            // The session may stand since before the run.
            Phase::Connecting if client.insist_on(now, Wish::Arm, ARM_PATIENCE).is_ok() => {
                self.enter(now, Phase::Arming);
            }
            Phase::Connecting if now.since(begun) > ARM_PATIENCE => {
                self.fail(now, client, Ending::Robot(LinkError::Connect(ConnectError::NoAnswer)));
            }
            Phase::Arming if now.since(begun) > ARM_PATIENCE => {
                self.fail_to_reach(now, client, State::Armed);
            }
            Phase::Driving => self.drive(now, client),
            Phase::Resting => self.rest(now, client, begun),
            Phase::Disarming if now.since(begun) > END_PATIENCE => {
                self.fail_to_reach(now, client, State::Disarmed);
            }
            Phase::Lost if now.since(begun) > REVOKED_PATIENCE => self.lose(LinkError::Silent),
            Phase::Stopping => {
                let acknowledged = client.stop_state() == StopState::Acknowledged;
                if acknowledged || now.since(begun) > END_PATIENCE {
                    self.phase = Phase::Over;
                }
            }
            _ => {}
        }
        if self.phase == Phase::Over { self.ending.clone() } else { None }
    }

    fn enter(&mut self, now: Instant, phase: Phase) {
        self.phase = phase;
        self.since = Some(now);
    }

    fn take(&mut self, now: Instant, client: &mut Client, update: &Update) {
        match update {
            Update::Telemetry(telemetry) => self.hear(now, client, telemetry),
            Update::Event(report) => self.record(|recorder| recorder.event(now, report)),
            Update::Failed(ConnectError::WrongKey) if self.phase == Phase::Lost => {
                self.lose(LinkError::Revoked);
            }
            Update::Failed(error) => self.lose(LinkError::Connect(*error)),
            Update::Lost => self.enter(now, Phase::Lost),
            Update::Left => self.lose(LinkError::Left),
            Update::Connected if self.phase == Phase::Lost => self.lose(LinkError::Back),
            _ => {}
        }
        match (&self.phase, update) {
            (Phase::Arming, Update::Telemetry(telemetry)) => {
                let is_armed = matches!(telemetry.state, State::Armed | State::Running);
                if is_armed && self.knows_rate(now) {
                    self.begin_driving(now, client);
                }
            }
            (Phase::Arming, update) => {
                if let Some(error) = LinkError::while_arming(update) {
                    let telemetry = client.telemetry();
                    let known = telemetry.and_then(LinkError::of_idle);
                    self.fail(now, client, Ending::Robot(known.unwrap_or(error)));
                }
            }
            (Phase::Driving, update) => {
                if let Some(error) = LinkError::while_driven(update) {
                    self.fail(now, client, Ending::Robot(error));
                }
            }
            // Whether it holds rest or its motors coast.
            (Phase::Resting, Update::Telemetry(_)) => {
                let error = LinkError::while_driven(update);
                if let Some(error) = error.filter(|error| *error != LinkError::Lapsed) {
                    self.fail(now, client, Ending::Robot(error));
                }
            }
            (Phase::Disarming, Update::Telemetry(telemetry))
                if telemetry.state.is_idle() && client.is_heard(telemetry) =>
            {
                match LinkError::of_idle(telemetry) {
                    Some(error) => self.fail(now, client, Ending::Robot(error)),
                    None => self.phase = Phase::Over,
                }
            }
            _ => {}
        }
    }

    fn hear(&mut self, now: Instant, client: &Client, telemetry: &Telemetry) {
        self.record(|recorder| recorder.telemetry(now, telemetry));
        let way = client.statistics().shortest_round_trip().unwrap_or_default() / 2;
        let since_start = now.since(Instant::START);
        self.helm.hear(telemetry, Instant::START + since_start.saturating_sub(way));
    }

    /// Returns whether it is known how often poses come, or that few come.
    fn knows_rate(&self, now: Instant) -> bool {
        let waited = self.since.map_or(Duration::ZERO, |since| now.since(since));
        self.rate.period().is_some() || waited > RATE_PATIENCE
    }

    fn begin_driving(&mut self, now: Instant, client: &Client) {
        let measured = client.statistics().round_trip_quantile(0.5).map(|trip| trip / 2);
        if let Some(latency) = measured {
            self.helm.set_latency(latency);
        }
        self.driving_since = Some(now);
        self.enter(now, Phase::Driving);
    }

    fn drive(&mut self, now: Instant, client: &mut Client) {
        let decision = self.helm.decide(now);
        self.note_progress(now);
        match decision {
            Decision::Drive { mode, setpoint } => {
                let name = self.names.get(mode).cloned().unwrap_or_default();
                self.command(now, client, setpoint, name);
            }
            Decision::Rest(reason) => {
                let name = match reason {
                    Resting::NoPoseYet | Resting::PoseTooOld if self.late > LATE => {
                        "rest: the poses come late"
                    }
                    Resting::NoPoseYet => "rest: no pose yet",
                    Resting::PoseTooOld => "rest: the pose is too old",
                    Resting::Moving => "rest: the poses move",
                    Resting::Arrived => "rest",
                };
                self.command(now, client, Setpoint::REST, name.to_owned());
            }
            Decision::Finished => {
                self.ending = Some(Ending::Finished);
                self.command(now, client, Setpoint::REST, "rest: finished".to_owned());
                self.enter(now, Phase::Resting);
            }
            Decision::Stopped(stop) => {
                let stop = stop.of_poses_that_come(self.late);
                self.fail(now, client, Ending::Stopped(stop));
            }
        }
    }

    fn rest(&mut self, now: Instant, client: &mut Client, begun: Instant) {
        let is_at_rest =
            client.telemetry().is_some_and(|t| t.frequency.get().abs() < RESTING_FREQUENCY);
        let patience_is_over = now.since(begun) > END_PATIENCE;
        // The newest telemetry may be older than the command to rest.
        if (is_at_rest && now.since(begun) > 2 * RECORD_PERIOD) || patience_is_over {
            client.disarm(now);
            self.enter(now, Phase::Disarming);
        }
    }

    fn command(&mut self, now: Instant, client: &mut Client, setpoint: Setpoint, name: String) {
        client.hold(now, setpoint);
        if self.commanded.as_ref().is_none_or(|last| *last != (setpoint, name.clone())) {
            self.record(|recorder| recorder.command(now, &setpoint, &name));
            self.commanded = Some((setpoint, name));
        }
    }

    fn note_progress(&mut self, now: Instant) {
        if self.recorded.is_some_and(|last| now.since(last) < RECORD_PERIOD) {
            return;
        }
        self.recorded = Some(now);
        if let Some((pose, progress)) = self.helm.progress() {
            self.record(|recorder| recorder.navigation(now, &pose, &progress));
        }
    }

    fn fail(&mut self, now: Instant, client: &mut Client, ending: Ending) {
        let sentence = ending.to_string();
        self.record(|recorder| recorder.log(now, Level::Error, &sentence));
        self.ending = Some(ending);
        client.stop(now);
        self.enter(now, Phase::Stopping);
    }

    fn fail_to_reach(&mut self, now: Instant, client: &mut Client, wanted: State) {
        let actual = client.telemetry().map_or(State::Disarmed, |it| it.state);
        self.fail(now, client, Ending::Robot(LinkError::State { wanted, actual }));
    }

    /// Ends without a stop, because the link is gone: the robot's own deadline stops the robot. A finished task ends with this error, too,
    /// because no telemetry showed the robot at rest.
    fn lose(&mut self, error: LinkError) {
        if matches!(self.ending, None | Some(Ending::Finished)) {
            self.ending = Some(Ending::Robot(error));
        }
        self.phase = Phase::Over;
    }

    fn record(&mut self, write: impl FnOnce(&mut Recorder) -> Result<(), RecordError>) {
        if self.record_error.is_some() {
            return;
        }
        if let Some(recorder) = &mut self.recorder {
            self.record_error = write(recorder).err();
        }
    }
}
