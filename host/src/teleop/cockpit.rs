//! State between link and screen: pictures for the operator, commands of the operator.

use std::collections::VecDeque;
use std::time::Duration;

use flix_protocol::message::{
    Command, Identity, Order, Outcome, ParameterCommand, Refusal, Setpoint, State, Telemetry,
};
use flix_protocol::session::ConnectError;
use flix_protocol::units::{Hertz, Instant};

use super::action::Action;
use super::attention::Attention;
use super::floor::Floor;
use super::paper_modes::PaperMode;
use super::scope::{self, Viewer};
use super::settings::{Answered, Settings};
use crate::link::explain;
use crate::link::{Client, Update, Wish, line_difference};
use crate::nav::Footing;
use crate::pose::{LATE, PoseSample};

/// Interval between two points of the histories.
pub(crate) const HISTORY_INTERVAL: Duration = Duration::from_millis(200);
/// Points in a history: more than a terminal is wide.
pub(crate) const HISTORY_LENGTH: usize = 400;
/// Lines in the log.
const LOG_LENGTH: usize = 200;
/// Factor by which the rotors are shown slower than they turn: 30 Hz as one turn per second.
pub const SLOW_MOTION: f32 = 30.0;
/// Frequency below which the rotors are shown as they turn, Hz.
const REAL_TIME_BELOW_HZ: f32 = 1.0;
/// Silence that is shown: a few telemetry intervals.
const SHOWN_SILENCE: Duration = Duration::from_millis(150);
/// Current at the end of the gauge while the limit of the robot is unknown, A.
const ASSUMED_CURRENT_LIMIT: f32 = 3.0;
/// Setting at the end of the current's gauge.
const CURRENT_LIMIT: &str = "current_limit";
/// The setting below which the battery is low, V.
const BATTERY_LOW: &str = "battery_low";
/// A low battery that comes and goes, as by a contact that bounces, is noted once in this time.
const BATTERY_NOTED: Duration = Duration::from_secs(10);

/// State of the link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Link {
    /// Connected.
    Connected,
    /// Silent for this time.
    Silent(Duration),
    /// Connecting again.
    Connecting,
    /// The last attempt failed; the next is under way.
    Failed(ConnectError),
}

/// Severity of a line of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Weight {
    /// Information.
    Note,
    /// Something was not done.
    Warning,
    /// A fault, or a lost link.
    Alarm,
}

/// A line of the log.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Time since the start of the program.
    pub at: Duration,
    /// Severity.
    pub weight: Weight,
    /// Sentence of the event.
    pub text: String,
}

/// One point of the histories.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// f, Hz.
    pub frequency: f32,
    /// theta, degrees.
    pub direction: f32,
    /// Amplitude of the current vector of top and bottom motor, A.
    pub currents: [f32; 2],
    /// Bus voltage, V, where it is measured.
    pub battery: Option<f32>,
}

/// The state between link and screen.
#[derive(Debug, Clone)]
pub struct Cockpit {
    /// The robot, as the operator named it.
    pub robot: String,
    /// Identity of the robot.
    pub identity: Option<Identity>,
    /// State of the link.
    pub link: Link,
    /// Newest round trip.
    pub round_trip: Option<Duration>,
    /// Share of unanswered commands, from 0 to 1.
    pub loss: f64,
    /// Newest telemetry.
    pub telemetry: Option<Telemetry>,
    /// The pair that the operator commands.
    pub setpoint: Setpoint,
    /// Whether a stop was sent and is not acknowledged yet.
    pub is_stopping: bool,
    /// End of the current's gauge, A.
    pub current_limit: f32,
    /// Voltage below which the battery is low, V; `None` until the robot has stated it.
    pub battery_low: Option<f32>,
    /// History, oldest first.
    pub history: VecDeque<Sample>,
    /// Log, oldest first.
    pub log: VecDeque<Line>,
    /// Whether the record has ended before the drive.
    pub is_unrecorded: bool,
    /// The robot's settings, once a screen has asked for them.
    pub settings: Settings,
    /// Captures of the robot's scope for a screen.
    pub scope: Viewer,
    /// Where the robot is, once poses are trusted.
    pub floor: Option<Floor>,
    /// Whether it stands on its feet while it walks.
    footing: Footing,
    is_unseen: bool,
    /// By how much the newest pose came late.
    late: Duration,
    /// Shaking phase in slow motion, degrees clockwise.
    pub phase: f32,
    start: Instant,
    heard: Instant,
    sampled: Instant,
    animated: Instant,
    asked: Vec<u32>,
    battery_noted: Option<Instant>,
    attention: Option<Attention>,
}

impl Cockpit {
    /// Creates a cockpit that knows nothing yet.
    #[must_use]
    pub fn new(robot: &str, now: Instant) -> Self {
        Self {
            robot: robot.to_owned(),
            identity: None,
            link: Link::Connecting,
            round_trip: None,
            loss: 0.0,
            telemetry: None,
            setpoint: Setpoint::REST,
            is_stopping: false,
            current_limit: ASSUMED_CURRENT_LIMIT,
            battery_low: None,
            history: VecDeque::new(),
            log: VecDeque::new(),
            is_unrecorded: false,
            settings: Settings::default(),
            scope: Viewer::default(),
            floor: None,
            footing: Footing::default(),
            is_unseen: false,
            late: Duration::ZERO,
            phase: 0.0,
            start: now,
            heard: now,
            sampled: now,
            animated: now,
            asked: Vec::new(),
            battery_noted: None,
            attention: None,
        }
    }

    /// Lets the robot rest after so long without an action or another sign of the operator.
    pub const fn be_attended(&mut self, patience: Duration, now: Instant) {
        self.attention = Some(Attention { patience, unsure: None, since: now });
    }

    /// Shortens that time to this one while it cannot be known whether the operator sees the screen, and says so once.
    pub fn be_unsure(&mut self, unsure: Option<Duration>, now: Instant) {
        let Some(attention) = &mut self.attention else { return };
        let was_unsure = std::mem::replace(&mut attention.unsure, unsure).is_some();
        let patience = attention.patience().as_secs();
        if unsure.is_some() && !was_unsure {
            let text = format!(
                "it is not known whether anybody sees this terminal (mosh, editors, no answer): a walk ends after {patience} s without a key"
            );
            self.note(now, Weight::Warning, &text);
        }
    }

    /// Takes a sign of the operator that is no action: any key, a stick that is held.
    pub const fn attend(&mut self, now: Instant) {
        if let Some(attention) = &mut self.attention {
            attention.since = now;
        }
    }

    /// Returns how long the robot still walks without a sign of the operator, as of the last [`tick`](Self::tick); nothing where
    /// it is at rest, or for ever.
    #[must_use]
    pub fn walks_for(&self) -> Option<Duration> {
        self.left(self.animated)
    }

    fn left(&self, now: Instant) -> Option<Duration> {
        self.attention.filter(|_| self.is_walking()).map(|attention| attention.left(now))
    }

    /// Lets the robot rest if the operator has shown no sign for too long, and keeps the heading that is held, as long as poses
    /// show it. Call it some hundred times a second.
    pub fn watch(&mut self, client: &mut Client, now: Instant) {
        self.steer(client, now);
        if self.left(now) == Some(Duration::ZERO) {
            let patience = self.attention.map_or(0, |attention| attention.patience().as_secs());
            self.abandon(&format!("no key, touch or stick for {patience} s"), client, now);
        }
    }

    /// Lets a robot that walks rest, since its operator is not there; `why` in words.
    pub fn abandon(&mut self, why: &str, client: &mut Client, now: Instant) {
        if self.is_walking() {
            self.want(Setpoint::REST, client, now);
            self.note(now, Weight::Warning, &format!("{why}: the robot rests"));
        }
    }

    fn is_walking(&self) -> bool {
        self.setpoint.frequency() != Hertz::ZERO
    }

    /// Begins a session: requests the identity of the robot.
    pub fn connected(&mut self, client: &mut Client, now: Instant) {
        self.link = Link::Connected;
        self.heard = now;
        self.note(now, Weight::Note, "connected: Enter arms, the space bar always stops");
        let get =
            |name: &str| name.try_into().map(ParameterCommand::Get).map(Command::Parameter).ok();
        self.asked = [Some(Command::Identify), get(CURRENT_LIMIT), get(BATTERY_LOW)]
            .into_iter()
            .flatten()
            .map(|command| client.request(now, command))
            .collect();
        self.settings.reconnected(client, now);
        self.scope.give_up();
    }

    /// Does an action of the operator, except leaving. `seen` is the time of the picture that the operator has seen: an action that
    /// begins movement, or clears the robot, is not done where the robot has halted since.
    pub fn act(&mut self, action: Action, seen: Instant, client: &mut Client, now: Instant) {
        self.attend(now);
        match action {
            Action::Arm | Action::Clear | Action::Walk(_) if seen <= client.permitted_at() => {
                let text = "not done: the robot has halted meanwhile; look, then try again";
                self.note(now, Weight::Warning, text);
            }
            Action::Stop | Action::Interrupt => {
                self.rest();
                self.is_stopping = true;
                client.stop(now);
                self.note(now, Weight::Warning, "stop");
            }
            Action::Arm => self.arm(client, now),
            Action::Disarm | Action::Quit => {
                self.rest();
                client.disarm(now);
            }
            Action::Clear => self.clear(client, now),
            Action::Walk(mode) => {
                if self.want(mode.setpoint(), client, now) {
                    self.note(now, Weight::Note, mode.name());
                    if let Some(floor) = &mut self.floor {
                        floor.begin(mode == PaperMode::Forward);
                        // A turn asks for another heading.
                        if matches!(mode, PaperMode::LeftTurn | PaperMode::RightTurn)
                            && floor.held().is_some()
                        {
                            self.hold_heading(now);
                        }
                    }
                }
            }
            Action::HoldHeading => self.hold_heading(now),
            Action::Rest => {
                self.want(Setpoint::REST, client, now);
            }
            // A wheel, or a key that is hit by mistake, begins no walk.
            Action::Frequency(_) if !self.is_walking() => {
                let text = "at rest: begin a walk first, then change f";
                self.note(now, Weight::Warning, text);
            }
            Action::Frequency(_) | Action::Direction(_) => {
                if let Some(setpoint) = action.step(self.setpoint) {
                    self.want(setpoint, client, now);
                }
            }
        }
    }

    /// Changes a walk by a [step](Action::step) of a key that is held, which is no new wish: rotors that came to rest because
    /// commands stayed away stay at rest, and at rest no step does anything.
    pub fn step(&mut self, step: Action, client: &mut Client, now: Instant) {
        if let Some(setpoint) = step.step(self.setpoint)
            && self.is_walking()
            && client.held().is_some()
        {
            self.setpoint = setpoint;
            client.hold(now, setpoint);
        }
    }

    /// Takes an update of the link.
    pub fn observe(&mut self, update: &Update, client: &mut Client, now: Instant) {
        match update {
            Update::Connected => self.connected(client, now),
            Update::Telemetry(telemetry) => {
                self.heard(telemetry, client, now);
                self.scope.look(client, now);
            }
            Update::Event(report) => {
                use flix_protocol::message::Event;
                if let Event::BatteryLow(_) = report.event {
                    let noted = self.battery_noted.replace(now);
                    if noted.is_some_and(|at| now.since(at) < BATTERY_NOTED) {
                        return;
                    }
                }
                let weight = match report.event {
                    Event::Fault(_) | Event::LinkLost | Event::SettingsDefaulted => Weight::Alarm,
                    Event::Stopped
                    | Event::LinkLate
                    | Event::CommandDeadline
                    | Event::CommandsLate { .. }
                    | Event::CommandAge
                    | Event::StoppedFromOutside(_)
                    | Event::BatteryLow(_)
                    | Event::Magnet { .. }
                    | Event::FrequencyLimited(_) => Weight::Warning,
                    _ => Weight::Note,
                };
                self.note(now, weight, &explain::event(&report.event));
            }
            Update::Answer { request, outcome } => self.answered(*request, outcome, client, now),
            Update::Unanswered { request } => {
                self.settings.unanswered(*request);
                self.scope.unanswered(*request);
            }
            Update::Ended { order, why } => {
                self.rest();
                match why {
                    // The state shows it already.
                    Some(Refusal::Faulted(_) | Refusal::Stopped)
                        if matches!(order, Order::Shake(..)) => {}
                    Some(refusal) => {
                        self.note(now, Weight::Warning, &format!("not done: {refusal}"));
                    }
                    None => {
                        let text = "not done: the robot did not answer; try again";
                        self.note(now, Weight::Warning, text);
                    }
                }
            }
            Update::StopAcknowledged => {
                self.is_stopping = false;
                self.note(now, Weight::Note, "the robot has acknowledged the stop; c clears it");
            }
            Update::Lost => self.lost("the robot fell silent: it stops by itself", now),
            Update::Left => {
                self.lost("the robot ended the session", now);
                client.connect(now);
            }
            Update::Failed(error) => {
                if self.link != Link::Failed(*error) {
                    self.note(now, Weight::Alarm, &error.to_string());
                }
                self.link = Link::Failed(*error);
                client.connect(now);
            }
        }
    }

    /// Takes a pose: keeps the heading that is held, and stops a robot that walks off its feet.
    pub fn see(&mut self, sample: &PoseSample, client: &mut Client, now: Instant) {
        if !self.is_walking() {
            self.footing = Footing::default();
        } else if let Some(stop) = self.footing.observe(sample) {
            self.act(Action::Stop, now, client, now);
            self.note(now, Weight::Alarm, &stop.to_string());
        }
        self.late = sample.late();
        let doubt = Floor::observe(&mut self.floor, sample);
        if let Some((floor, doubt)) = self.floor.as_mut().zip(doubt) {
            floor.hold(false);
            self.abandon(&format!("no heading is held any more: {doubt}"), client, now);
        }
        self.steer(client, now);
        let Some(floor) = &mut self.floor else { return };
        if let Some(turn) = floor.curve() {
            let side = if turn > 0.0 { "left" } else { "right" };
            let angle = turn.to_degrees().abs();
            let text = format!(
                "forward curves to the {side}, {angle:.0} degrees so far: h holds the heading"
            );
            self.note(now, Weight::Note, &text);
        }
    }

    /// Commands the direction that keeps the held heading; reports missing poses.
    fn steer(&mut self, client: &mut Client, now: Instant) {
        let Some(floor) = &mut self.floor else { return };
        let steered = floor.steer(now, self.setpoint);
        let is_unseen = floor.is_unseen(now);
        if self.setpoint != Setpoint::REST && !self.is_stopping {
            client.hold(now, steered);
        }
        if std::mem::replace(&mut self.is_unseen, is_unseen) != is_unseen {
            if !is_unseen {
                return self.note(now, Weight::Note, "poses are back");
            }
            let cause = if self.late > LATE {
                format!("poses come {:.1} s late", self.late.as_secs_f64())
            } else {
                "no pose for 0.5 s".to_owned()
            };
            let text = format!("{cause}: the map is old, and no heading is held");
            self.note(now, Weight::Warning, &text);
        }
    }

    fn hold_heading(&mut self, now: Instant) {
        let Some(floor) = &mut self.floor else {
            let text = "the heading is not known: start with `--pose natnet` or `--pose udp:PORT`";
            return self.note(now, Weight::Warning, text);
        };
        let holds = floor.held().is_none();
        floor.hold(holds);
        let heading = floor.pose.heading.to_degrees();
        let text = if holds {
            format!("holds the heading of {heading:.0} degrees; h ends that")
        } else {
            "the heading is free".to_owned()
        };
        self.note(now, Weight::Note, &text);
    }

    /// Advances link figures, histories and slow motion to the present time.
    pub fn tick(&mut self, client: &Client, now: Instant) {
        let statistics = client.statistics();
        (self.round_trip, self.loss) = (statistics.last_round_trip(), statistics.loss());
        if matches!(self.link, Link::Connected | Link::Silent(_)) {
            let silence = now.since(self.heard);
            self.link =
                if silence < SHOWN_SILENCE { Link::Connected } else { Link::Silent(silence) };
        }
        self.animate(now);
        while now.since(self.sampled) >= HISTORY_INTERVAL {
            self.sampled = self.sampled + HISTORY_INTERVAL;
            if let Some(sample) = self.telemetry.as_ref().map(Sample::of) {
                if self.history.len() == HISTORY_LENGTH {
                    self.history.pop_front();
                }
                self.history.push_back(sample);
            }
        }
    }

    /// Returns whether the telemetry is older than a few intervals.
    #[must_use]
    pub fn is_stale(&self) -> bool {
        self.link != Link::Connected
    }

    /// Returns the angles at which the rotors are shown, degrees clockwise from forward; in slow motion while
    /// they turn quickly.
    #[must_use]
    pub fn shown_rotors(&self) -> Option<[f32; 2]> {
        let telemetry = self.telemetry.as_ref()?;
        if is_quick(telemetry) {
            let theta = telemetry.direction.get();
            Some([theta + self.phase, theta - self.phase])
        } else {
            Some(telemetry.motors.map(|motor| motor.angle.get()))
        }
    }

    /// Returns whether the rotors are shown in slow motion.
    #[must_use]
    pub fn is_slow_motion(&self) -> bool {
        self.telemetry.as_ref().is_some_and(is_quick)
    }

    fn animate(&mut self, now: Instant) {
        let passed = now.since(self.animated).as_secs_f32();
        self.animated = now;
        if let Some(telemetry) = &self.telemetry {
            let step = 360.0 * telemetry.frequency.get() * passed / SLOW_MOTION;
            self.phase = (self.phase + step).rem_euclid(360.0);
        }
    }

    fn arm(&mut self, client: &mut Client, now: Instant) {
        match &self.telemetry {
            Some(telemetry) if telemetry.stopped => {
                let by = telemetry.stopped_by.map_or_else(String::new, |by| format!(" by {by}"));
                let text = format!("stopped{by}: press c to clear it first");
                self.note(now, Weight::Warning, &text);
            }
            Some(telemetry) if telemetry.state == State::Faulted => {
                self.note(now, Weight::Warning, "faulted: press c to clear it first");
            }
            _ => {
                self.press(Wish::Arm, client, now);
            }
        }
    }

    fn clear(&mut self, client: &mut Client, now: Instant) {
        if self.telemetry.is_some_and(|it| !it.stopped && it.faults.is_empty()) {
            let text = "nothing to clear: neither a stop nor a fault is latched";
            return self.note(now, Weight::Note, text);
        }
        self.press(Wish::Clear, client, now);
    }

    /// Takes a wish; returns whether the client did, and says why not.
    fn press(&mut self, wish: Wish, client: &mut Client, now: Instant) -> bool {
        let pressed = client.press(now, wish);
        if let Err(not_taken) = pressed {
            self.note(now, Weight::Warning, &format!("not done: {not_taken}"));
        }
        pressed.is_ok()
    }

    fn answered(&mut self, request: u32, outcome: &Outcome, client: &mut Client, now: Instant) {
        let about = self.settings.answered(request, outcome, client, now);
        match self.scope.answered(request, outcome, client, now) {
            Some(scope::Answered::Capture) => {
                self.note(now, Weight::Note, "the scope has captured")
            }
            Some(scope::Answered::Nothing) => {
                let text = "the robot has had no fault since it was armed last: nothing is kept";
                self.note(now, Weight::Warning, text);
            }
            Some(scope::Answered::Step | scope::Answered::Refused) | None => {}
        }
        match outcome {
            Outcome::Identity(identity) if self.asked.contains(&request) => {
                self.identity = Some(identity.clone());
            }
            Outcome::Parameter(parameter) if self.asked.contains(&request) => {
                self.know(&parameter.name, parameter.value);
            }
            // A robot may lack a setting that was asked for at the beginning.
            Outcome::Refused(_) if self.asked.contains(&request) => {}
            Outcome::Refused(refusal) => {
                self.note(now, Weight::Warning, &format!("not done: {refusal}"));
            }
            _ if about == Some(Answered::List) => {
                for name in [CURRENT_LIMIT, BATTERY_LOW] {
                    if let Some(value) = self.settings.value(name) {
                        self.know(name, value);
                    }
                }
            }
            Outcome::Parameter(set) if about == Some(Answered::Change) => {
                let unit = if set.unit == "1" { String::new() } else { format!(" {}", set.unit) };
                self.note(now, Weight::Note, &format!("{} is {}{unit} now", set.name, set.value));
            }
            _ if about == Some(Answered::Save) => {
                self.note(now, Weight::Note, "the settings are saved");
            }
            _ => {}
        }
    }

    /// Takes the value of a setting that is shown.
    fn know(&mut self, name: &str, value: f32) {
        match name {
            BATTERY_LOW => self.battery_low = Some(value),
            _ => self.current_limit = value,
        }
    }

    fn heard(&mut self, telemetry: &Telemetry, client: &mut Client, now: Instant) {
        self.heard = now;
        self.link = Link::Connected;
        self.telemetry = Some(*telemetry);
        // A robot that disarmed by itself must not start again from an earlier setpoint.
        if matches!(telemetry.state, State::Disarmed | State::Stopping | State::Faulted) {
            self.rest();
            client.hold(now, Setpoint::REST);
        }
    }

    /// Commands a setpoint, if the robot is armed.
    fn want(&mut self, setpoint: Setpoint, client: &mut Client, now: Instant) -> bool {
        let why_not = match self.telemetry.as_ref().map(|telemetry| telemetry.state) {
            _ if self.is_stopping => "a stop is on its way: wait until the robot acknowledges it",
            Some(State::Armed | State::Running) => "",
            Some(State::Aligning) => "the motors are being aligned: wait until the robot is armed",
            Some(State::Stopping) => "the rotors ramp down: press Enter once they rest",
            Some(State::Faulted) => "faulted: press c to clear it first",
            Some(State::Disarmed) => "not armed: press Enter first",
            None => "the robot has not stated yet whether it is armed",
        };
        if !why_not.is_empty() {
            self.note(now, Weight::Warning, why_not);
            return false;
        }
        let is_pressed = self.press(Wish::Shake(setpoint), client, now);
        if is_pressed {
            self.setpoint = setpoint;
        }
        is_pressed
    }

    fn rest(&mut self) {
        self.setpoint = Setpoint::REST;
        if let Some(floor) = &mut self.floor {
            floor.begin(false);
        }
    }

    fn lost(&mut self, text: &str, now: Instant) {
        self.rest();
        self.link = Link::Connecting;
        self.note(now, Weight::Alarm, text);
    }

    /// Adds a line to the log.
    pub fn note(&mut self, now: Instant, weight: Weight, text: &str) {
        if self.log.len() == LOG_LENGTH {
            self.log.pop_front();
        }
        self.log.push_back(Line { at: now.since(self.start), weight, text: text.to_owned() });
    }
}

impl Sample {
    /// Returns the point of a telemetry.
    #[must_use]
    pub fn of(telemetry: &Telemetry) -> Self {
        Self {
            frequency: telemetry.frequency.get(),
            direction: near_commanded(telemetry),
            currents: telemetry
                .motors
                .map(|motor| motor.current_d.get().hypot(motor.current_q.get())),
            battery: telemetry.bus_voltage.map(|voltage| voltage.get()),
        }
    }
}

/// Returns theta as the line of force nearest to the commanded one, degrees: otherwise a turn at 90
/// degrees would jump between +90 and -90.
fn near_commanded(telemetry: &Telemetry) -> f32 {
    let commanded = telemetry.setpoint.direction().get();
    let difference = f64::from(telemetry.direction.get() - commanded);
    commanded + line_difference(difference) as f32
}

fn is_quick(telemetry: &Telemetry) -> bool {
    telemetry.frequency.get().abs() >= REAL_TIME_BELOW_HZ
}
