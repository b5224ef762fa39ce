//! The client without a clock or a socket: opens a session, repeats what is not answered, and takes a lost link up again.

use std::collections::VecDeque;
use std::time::Duration;

use flix_protocol::frame::Frame;
use flix_protocol::message::{
    Command, EventReport, Faults, OperatorName, Outcome, Refusal, Reply, Setpoint, State,
    Telemetry, ToOperator, ToRobot,
};
use flix_protocol::session::{
    ConnectError, Key, LinkHealth, OperatorReceived, OperatorSession, SendError, Status,
    StopSession, StopStatus,
};
use flix_protocol::units::Instant;

use super::statistics::Statistics;
use super::{
    DISARMED_AFTER, KEEP_ALIVE, LAST_ANSWER, REQUEST_PATIENCE, REQUEST_RETRY, SILENCE,
    STOP_BESIDE_AFTER, STOP_RETRY, TRY_AGAIN, passes_by_itself,
};

/// Numbers of requests that are remembered: more than are asked while an answer is under way.
const NUMBERS: usize = 64;

/// An event of the link, for the owner of the client.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "few are ever waiting")]
pub enum Update {
    /// The session is open.
    Connected,
    /// The robot could not be reached, or refused.
    Failed(ConnectError),
    /// The robot fell silent; the held setpoint is dropped, and the client connects again.
    Lost,
    /// The robot closed the session.
    Left,
    /// The answer to a request.
    Answer {
        /// The number that [`Client::request`] returned.
        request: u32,
        /// The result.
        outcome: Outcome,
    },
    /// A request ended without an answer: in time, or because of a stop or a lost session.
    Unanswered {
        /// The number that [`Client::request`] returned.
        request: u32,
    },
    /// The robot refuses the held setpoint. Reported once for each reason.
    SetpointRefused(Refusal),
    /// The robot has stopped, or ramps down, and the stop is latched.
    StopAcknowledged,
    /// Telemetry of the robot.
    Telemetry(Telemetry),
    /// An event of the robot.
    Event(EventReport),
}

/// Progress of a stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopState {
    /// No stop was requested.
    None,
    /// Requested, and not acknowledged yet.
    Sending,
    /// Acknowledged by the robot.
    Acknowledged,
}

/// A request on its way.
#[derive(Debug, Clone)]
struct Pending {
    message: ToRobot,
    /// Copies that were sent and not answered; those that were lost, too.
    unanswered: u32,
    send_at: Instant,
    /// From then on no copy is sent.
    send_until: Instant,
    give_up_at: Instant,
    /// Until when it is asked again where the robot refuses it for a state that passes; `None` where its owner does that.
    insists_until: Option<Instant>,
    /// While it waits for its turn it is given up then.
    waits_until: Instant,
    /// The newest answer, when that does not end it.
    refusal: Option<Refusal>,
}

impl Pending {
    /// Returns whether it goes on although the robot refused it; `is_told`: by whom it is stopped.
    fn outlives(&mut self, now: Instant, refusal: &Refusal, is_told: bool) -> bool {
        let passes = passes_by_itself(refusal) || *refusal == Refusal::Stopped && !is_told;
        let insists_until = self.insists_until.filter(|_| passes);
        if matches!(refusal, Refusal::Late { .. }) && now < self.give_up_at {
            // With a newer echo.
            self.send_next(now);
        } else if let Some(until) = insists_until.filter(|until| now + TRY_AGAIN < *until) {
            self.send_until = until;
            self.give_up_at = (now + TRY_AGAIN + REQUEST_PATIENCE).min(until + LAST_ANSWER);
            self.send_next(now + TRY_AGAIN);
        } else if insists_until.is_some() && self.moves() && self.unanswered > 0 {
            // Another copy may be under way and come when that has passed.
            self.send_until = now;
            self.give_up_at = self.give_up_at.min(now + LAST_ANSWER);
            self.send_next(now);
        } else {
            return false;
        }
        self.refusal = Some(refusal.clone());
        true
    }

    /// Plans the next copy, unless it would be one too many.
    fn send_next(&mut self, at: Instant) {
        self.send_at = if at < self.send_until { at } else { self.give_up_at };
    }

    /// Lets its time begin when its turn comes. Nobody waits longer for a robot that begins to move.
    fn wait(&mut self, now: Instant) {
        self.give_up_at = (now + REQUEST_PATIENCE).min(self.waits_until);
        self.send_until = self.give_up_at;
    }

    /// Returns whether it would move the robot or clear its stop.
    const fn moves(&self) -> bool {
        matches!(self.message.command, Command::Arm | Command::Clear | Command::Trial(_))
    }
}

/// The operator's end of the link.
///
/// After every call, and at the time of [`Client::transmit_at`]: call [`Client::transmit`] until it
/// returns `None`, send what it returns, and take [`Client::update`]. Never panics on any datagram.
pub struct Client {
    session: OperatorSession,
    was_established: bool,
    has_failed: bool,
    held: Option<Setpoint>,
    /// Counts what a person wants.
    intent: u8,
    /// What the robot had last said of its halts when the intent was counted.
    halts: u8,
    refusal: Option<Refusal>,
    stop: StopState,
    stop_number: u32,
    stop_at: Instant,
    /// When it was asked for.
    stop_since: Instant,
    /// A stop without a session: while there is none, as another operator holds the robot, or it acknowledges nothing.
    beside: Option<StopSession>,
    pending: VecDeque<Pending>,
    /// The numbers of the newest requests: an answer to one that has ended is none to a setpoint.
    asked: VecDeque<u32>,
    next_number: u32,
    keep_alive_at: Instant,
    heard: Instant,
    /// When the robot last stated whether it is stopped, in any session; before the first, when this client was made.
    informed: Instant,
    /// When the last session ended.
    ended: Instant,
    /// The same as `informed` on the robot's clock: what it states may be long under way.
    stated: Option<Instant>,
    telemetry: Option<Telemetry>,
    is_driving: bool,
    statistics: Statistics,
    farewell: Option<Frame>,
    updates: VecDeque<Update>,
}

impl Client {
    /// Creates a client that begins to connect at once. `entropy` comes from the operating system, fresh for every
    /// client; a simulation takes it from its seed.
    #[must_use]
    pub fn new(key: Key, entropy: [u8; 32], now: Instant) -> Self {
        Self {
            session: OperatorSession::new(key, entropy, now),
            was_established: false,
            has_failed: false,
            held: None,
            intent: 0,
            halts: 0,
            refusal: None,
            stop: StopState::None,
            stop_number: 0,
            stop_at: now,
            stop_since: now,
            beside: None,
            pending: VecDeque::new(),
            asked: VecDeque::new(),
            next_number: 0,
            keep_alive_at: now,
            heard: now,
            informed: now,
            ended: now,
            stated: None,
            telemetry: None,
            is_driving: false,
            statistics: Statistics::default(),
            farewell: None,
            updates: VecDeque::new(),
        }
    }

    /// Connects again after [`Update::Failed`] or [`Update::Left`].
    pub fn connect(&mut self, now: Instant) {
        self.has_failed = false;
        self.was_established = false;
        self.session.connect(now);
    }

    /// Holds a setpoint that a person asks for at this moment. Rotors that came to rest because commands stayed away turn
    /// again by nothing else. Otherwise as [`Client::hold`].
    pub fn want(&mut self, now: Instant, setpoint: Setpoint) {
        self.intent = self.intent.wrapping_add(1);
        self.halts = self.halts();
        if self.held == Some(setpoint) {
            self.refusal = None;
            self.keep_alive_at = now;
        }
        self.hold(now, setpoint);
    }

    /// Holds a setpoint: sends it now, and repeats it as sign of life until [`Client::release`], a
    /// stop or a lost session. A program that steers by itself holds what it decides; what a person asks for is
    /// [wanted](Client::want).
    pub fn hold(&mut self, now: Instant, setpoint: Setpoint) {
        if self.stop == StopState::Sending || self.held == Some(setpoint) {
            return;
        }
        self.held = Some(setpoint);
        self.is_driving = true;
        self.refusal = None;
        // At once: the operator waits for nothing.
        self.keep_alive_at = now;
    }

    /// Releases the held setpoint: pings keep the session alive, and the robot's command deadline
    /// passes.
    pub fn release(&mut self) {
        self.held = None;
        self.refusal = None;
    }

    /// Returns the held setpoint.
    #[must_use]
    pub const fn held(&self) -> Option<Setpoint> {
        self.held
    }

    /// Sends a command until it is answered, and returns its number. The answer, or that there is
    /// none, comes as an update.
    ///
    /// What changes the robot is sent one after another, so that nothing that was asked earlier undoes it; [`Command::Disarm`] is
    /// sent at once, and what would move the robot or clear its stop is given up.
    ///
    /// Setpoints are better [held](Client::hold), and stops better [repeated](Client::stop). With
    /// [`Command::Arm`] rest is held, unless something else is: an armed robot wants setpoints as
    /// sign of life.
    pub fn request(&mut self, now: Instant, command: Command) -> u32 {
        self.insist(now, command, Duration::ZERO)
    }

    /// Sends it as [`Client::request`] does, and asks again every [`TRY_AGAIN`] while the robot refuses for a state that
    /// [passes](super::passes_by_itself), for at most `patience`. A stop of which the robot has not said yet by whom it is
    /// passes, too. What was asked for before the robot [halted](Client::halts) is given up.
    pub fn insist(&mut self, now: Instant, command: Command, patience: Duration) -> u32 {
        if matches!(command, Command::Clear) && self.stop == StopState::Acknowledged {
            self.stop = StopState::None;
        }
        self.is_driving |= matches!(command, Command::Arm | Command::Trial(_));
        if command == Command::Arm && self.held.is_none() && self.stop != StopState::Sending {
            self.hold(now, Setpoint::REST);
        }
        if command == Command::Disarm {
            // The robot passes over what is older than this, and answers none of it.
            self.give_up(None, |it| {
                !it.message.command.is_question() && it.message.command != Command::Disarm
            });
        }
        let request = self.number();
        if self.asked.len() == NUMBERS {
            self.asked.pop_front();
        }
        self.asked.push_back(request);
        let mut pending = Pending {
            message: ToRobot { halts: self.halts(), ..self.message(request, command) },
            unanswered: 0,
            send_at: now,
            send_until: now + REQUEST_PATIENCE,
            give_up_at: now + REQUEST_PATIENCE,
            insists_until: (!patience.is_zero()).then(|| now + patience),
            waits_until: now + Duration::MAX,
            refusal: None,
        };
        if pending.moves() {
            pending.waits_until = now + patience.max(REQUEST_PATIENCE);
        }
        self.pending.push_back(pending);
        request
    }

    /// Stops the robot: drops held setpoint and pending requests, and repeats stop until it is
    /// acknowledged.
    pub fn stop(&mut self, now: Instant) {
        self.release();
        self.abandon_requests();
        if self.stop != StopState::Sending {
            self.stop = StopState::Sending;
            self.stop_number = self.number();
            self.stop_since = now;
        }
        self.stop_at = now;
    }

    /// Returns how often the robot has halted in this session although nobody here asked for it, as far as is known. What was
    /// asked before it did, and would move it or clear a stop, is given up.
    #[must_use]
    pub fn halts(&self) -> u8 {
        self.telemetry.map_or(0, |telemetry| telemetry.halts)
    }

    /// Returns whether this client has armed or moved the robot, and the robot has not reported since
    /// that it is stopped or disarmed. A program that ends now must stop it first.
    #[must_use]
    pub const fn is_driving(&self) -> bool {
        self.is_driving
    }

    /// Returns the progress of the stop.
    #[must_use]
    pub const fn stop_state(&self) -> StopState {
        self.stop
    }

    /// Closes the session, so that the next operator need not wait.
    pub fn leave(&mut self) {
        self.farewell = self.session.goodbye().ok();
        self.session_ended(self.heard);
    }

    /// Returns the state of the connection.
    #[must_use]
    pub fn status(&self, now: Instant) -> Status {
        self.session.status(now)
    }

    /// Returns whether the session is open and the robot was received recently.
    #[must_use]
    pub fn is_connected(&self, now: Instant) -> bool {
        self.status(now) == Status::Connected
    }

    /// Returns the newest telemetry of the present session.
    #[must_use]
    pub const fn telemetry(&self) -> Option<&Telemetry> {
        self.telemetry.as_ref()
    }

    /// Returns who latched the stop of the robot, as it reports.
    #[must_use]
    pub fn stopped_by(&self) -> Option<OperatorName> {
        self.telemetry.and_then(|telemetry| telemetry.stopped_by)
    }

    /// Returns round trips and losses of commands.
    #[must_use]
    pub const fn statistics(&self) -> &Statistics {
        &self.statistics
    }

    /// Returns the counters of the session: datagrams that did not arrive, and those dropped.
    #[must_use]
    pub fn health(&self) -> LinkHealth {
        self.session.health()
    }

    /// Returns the next update, oldest first.
    pub fn update(&mut self) -> Option<Update> {
        self.updates.pop_front()
    }

    /// Receives a datagram from the robot's address.
    pub fn receive(&mut self, now: Instant, datagram: &[u8]) {
        if let Some(beside) = &mut self.beside
            && beside.receive(now, datagram).is_ok()
        {
            if matches!(beside.status(), StopStatus::Latched | StopStatus::AtRest) {
                self.acknowledge_stop();
            }
            return;
        }
        let received = self.session.receive(now, datagram);
        if matches!(received, OperatorReceived::Connected | OperatorReceived::Message(_)) {
            self.heard = now;
            self.note_established(now);
        }
        match received {
            OperatorReceived::Message(ToOperator::Reply(reply)) => self.replied(now, reply),
            OperatorReceived::Message(ToOperator::Telemetry(telemetry)) => {
                if self.telemetry.is_none() && telemetry.state.is_idle() {
                    self.is_driving = self.is_to_move();
                }
                let is_news = match &self.telemetry {
                    Some(before) => before.halts != telemetry.halts,
                    None => self.is_unseen(now, &telemetry),
                };
                let known = self.telemetry.map_or(Faults::NONE, |it| it.faults);
                let has_failed = telemetry.faults.iter().any(|it| !known.contains(it));
                (self.telemetry, self.informed) = (Some(telemetry), now);
                self.stated = Some(telemetry.time);
                if is_news {
                    let refusal = match telemetry {
                        Telemetry { faults, .. } if has_failed => Refusal::Faulted(faults),
                        Telemetry { stopped: true, .. } => Refusal::Stopped,
                        Telemetry { faults: Faults::NONE, .. } => Refusal::Rested,
                        Telemetry { faults, .. } => Refusal::Faulted(faults),
                    };
                    self.give_up_on_moving(Some(&refusal));
                }
                self.updates.push_back(Update::Telemetry(telemetry));
            }
            OperatorReceived::Message(ToOperator::Event(event)) => {
                self.updates.push_back(Update::Event(event));
            }
            OperatorReceived::Left => {
                self.session_ended(now);
                self.updates.push_back(Update::Left);
            }
            OperatorReceived::Connected
            | OperatorReceived::Progress
            | OperatorReceived::Dropped(_) => {}
        }
    }

    /// Returns whether the robot was asked to stop after it last stated its state. One that has started anew counts its time
    /// from zero.
    fn is_unseen(&self, now: Instant, telemetry: &Telemetry) -> bool {
        let is_younger = |at: Instant| self.stated.is_some_and(|stated| at > stated);
        let is_after = |ago| ago < now.since(self.informed);
        telemetry.stopped_at.is_some_and(is_younger)
            || telemetry.stopped_for().is_some_and(is_after)
    }

    /// Returns the next datagram to send, if one is due.
    pub fn transmit(&mut self, now: Instant) -> Option<Frame> {
        self.statistics.expire(now);
        if let Some(frame) = self.farewell.take() {
            return Some(frame);
        }
        self.give_up_on_silence(now);
        if !self.was_established && now.since(self.ended) > DISARMED_AFTER {
            // It has disarmed by itself, and whoever drives it now is somebody else.
            self.is_driving = false;
        }
        if let Some(frame) = self.stop_beside(now) {
            return Some(frame);
        }
        if let Some(frame) = self.session.poll(now) {
            return Frame::from_slice(&frame).ok();
        }
        self.note_failure(now);
        self.give_up_on_requests(now);
        if !self.was_established {
            return None;
        }
        let message = self.due(now)?;
        match self.session.send(now, &message) {
            Ok(frame) => Some(frame),
            // Every command fits a datagram (a test of the protocol), so only this is left.
            Err(SendError::NoSession | SendError::TooLong | SendError::Exhausted) => {
                self.session_ended(now);
                self.updates.push_back(Update::Lost);
                self.session.connect(now);
                None
            }
        }
    }

    /// Returns the datagram of a stop without a session that is due, where one is needed.
    fn stop_beside(&mut self, now: Instant) -> Option<Frame> {
        if self.stop != StopState::Sending || self.beside_at() > now {
            return None;
        }
        let has_failed = |it: &StopSession| matches!(it.status(), StopStatus::Failed(_));
        if self.beside.as_ref().is_none_or(has_failed) {
            self.beside = Some(self.session.stop(now));
        }
        Frame::from_slice(&self.beside.as_mut()?.poll(now)?).ok()
    }

    /// Returns when a stop without a session is due.
    fn beside_at(&self) -> Instant {
        match &self.beside {
            // One that has failed is begun anew.
            Some(beside) => beside.poll_at().unwrap_or(Instant::START),
            None if self.was_established => self.stop_since + STOP_BESIDE_AFTER,
            None => self.stop_since,
        }
    }

    /// Returns when [`Client::transmit`] is due next.
    #[must_use]
    pub fn transmit_at(&self) -> Option<Instant> {
        if self.farewell.is_some() {
            return Some(Instant::START);
        }
        let give_up = self.pending.iter().map(|pending| pending.give_up_at).min();
        let beside = (self.stop == StopState::Sending).then(|| self.beside_at());
        if !self.was_established {
            return [self.session.poll_at(), give_up, beside].into_iter().flatten().min();
        }
        let stop = (self.stop == StopState::Sending).then_some(self.stop_at);
        let request = self.in_turn().map(|(_, pending)| pending.send_at).min();
        let request = request.filter(|_| self.stop != StopState::Sending);
        let keep_alive = Some(self.keep_alive_at).filter(|_| !self.is_disarming());
        [keep_alive, stop, beside, request, give_up, Some(self.heard + SILENCE)]
            .into_iter()
            .flatten()
            .min()
    }

    /// Returns the message that is due, most urgent first.
    fn due(&mut self, now: Instant) -> Option<ToRobot> {
        let place = self.in_turn().find_map(|(place, it)| (now >= it.send_at).then_some(place));
        if self.stop == StopState::Sending {
            if now >= self.stop_at {
                self.stop_at = now + STOP_RETRY;
                return Some(self.message(self.stop_number, Command::Stop));
            }
        } else if let Some(pending) = place.and_then(|place| self.pending.get_mut(place)) {
            let number = pending.message.request;
            if pending.unanswered == 0 && pending.refusal.is_none() {
                self.statistics.sent(number, now);
            } else {
                self.statistics.repeated(number);
            }
            pending.unanswered = pending.unanswered.saturating_add(1);
            pending.send_next(now + REQUEST_RETRY);
            return Some(pending.message.clone());
        }
        if now < self.keep_alive_at || self.is_disarming() {
            return None;
        }
        // A fixed rate; after a pause it starts anew and does not catch up.
        let next = self.keep_alive_at + KEEP_ALIVE;
        self.keep_alive_at = if next > now { next } else { now + KEEP_ALIVE };
        let request = self.number();
        self.statistics.sent(request, now);
        let command = self.sign_of_life().map_or(Command::Ping(request), Command::Setpoint);
        Some(self.message(request, command))
    }

    const fn message(&self, request: u32, command: Command) -> ToRobot {
        ToRobot { request, intent: self.intent, halts: self.halts, command }
    }

    /// Returns the requests that may be sent now, each with its place: questions, the oldest that changes the robot, and what
    /// disarms it. Nothing is cleared before the robot has said by what it is stopped.
    fn in_turn(&self) -> impl Iterator<Item = (usize, &Pending)> {
        let mut is_first = true;
        let is_disarming = self.is_disarming();
        self.pending.iter().enumerate().filter(move |(_, pending)| {
            let command = &pending.message.command;
            // A question is a sign of life, too.
            if is_disarming {
                return *command == Command::Disarm;
            }
            let is_turn = command.is_question() || std::mem::take(&mut is_first);
            is_turn && (*command != Command::Clear || self.telemetry.is_some())
        })
    }

    /// Returns whether the robot is asked to disarm. Until it answers it gets no sign of life: without any it disarms by itself.
    fn is_disarming(&self) -> bool {
        self.pending.iter().any(|it| it.message.command == Command::Disarm)
    }

    /// Returns the held setpoint; rest while the robot ramps down, so that commands are not late.
    fn sign_of_life(&self) -> Option<Setpoint> {
        let state = self.telemetry.as_ref().map(|telemetry| telemetry.state);
        self.held.or_else(|| (state == Some(State::Stopping)).then_some(Setpoint::REST))
    }

    fn replied(&mut self, now: Instant, reply: Reply) {
        let Reply { request, outcome } = reply;
        self.statistics.replied(request, now);
        if self.stop == StopState::Sending && request == self.stop_number {
            if outcome == Outcome::Done {
                self.acknowledge_stop();
            }
        } else if let Some(place) =
            self.pending.iter().position(|pending| pending.message.request == request)
        {
            let is_told = self.telemetry.is_some();
            if let Some(pending) = self.pending.get_mut(place) {
                pending.unanswered = pending.unanswered.saturating_sub(1);
                if let Outcome::Refused(refusal) = &outcome
                    && pending.outlives(now, refusal, is_told)
                {
                    return;
                }
            }
            let disarm = |pending: Pending| pending.message.command == Command::Disarm;
            if self.pending.remove(place).is_some_and(disarm) && outcome == Outcome::Done {
                self.is_driving = self.is_to_move();
            }
            self.updates.push_back(Update::Answer { request, outcome });
        } else if let (Outcome::Refused(refusal), Some(held)) = (outcome, self.held)
            && held != Setpoint::REST
            && !self.asked.contains(&request)
            // A late setpoint is followed by newer ones; the robot's event reports the slow link.
            && !matches!(refusal, Refusal::Late { .. })
            && self.refusal.as_ref() != Some(&refusal)
        {
            self.refusal = Some(refusal.clone());
            self.updates.push_back(Update::SetpointRefused(refusal));
        }
    }

    fn acknowledge_stop(&mut self) {
        if self.stop == StopState::Sending {
            (self.stop, self.beside) = (StopState::Acknowledged, None);
            self.is_driving = self.is_to_move();
            self.updates.push_back(Update::StopAcknowledged);
        }
    }

    fn note_established(&mut self, now: Instant) {
        if !self.was_established {
            self.was_established = true;
            self.keep_alive_at = now;
            self.updates.push_back(Update::Connected);
        }
    }

    fn note_failure(&mut self, now: Instant) {
        if let Status::Failed(error) = self.session.status(now)
            && !self.has_failed
        {
            self.has_failed = true;
            if matches!(error, ConnectError::Busy(_)) {
                // Another operator has taken it: it was disarmed before.
                self.is_driving = false;
            }
            self.updates.push_back(Update::Failed(error));
            self.abandon_requests();
        }
    }

    fn give_up_on_silence(&mut self, now: Instant) {
        if self.was_established && now.since(self.heard) >= SILENCE {
            self.updates.push_back(Update::Lost);
            self.session_ended(now);
            self.session.connect(now);
        }
    }

    /// Returns whether something is asked for that moves the robot.
    fn is_to_move(&self) -> bool {
        let moves = |it: &Pending| matches!(it.message.command, Command::Arm | Command::Trial(_));
        self.pending.iter().any(moves)
    }

    fn give_up_on_requests(&mut self, now: Instant) {
        let places: Vec<usize> = self.in_turn().map(|(place, _)| place).collect();
        let waiting = self.pending.iter_mut().enumerate().filter(|(it, _)| !places.contains(it));
        waiting.for_each(|(_, pending)| pending.wait(now));
        let updates = &mut self.updates;
        self.pending.retain(|pending| {
            let is_alive = now < pending.give_up_at;
            if !is_alive {
                let request = pending.message.request;
                updates.push_back(match &pending.refusal {
                    Some(refusal) => {
                        Update::Answer { request, outcome: Outcome::Refused(refusal.clone()) }
                    }
                    None => Update::Unanswered { request },
                });
            }
            is_alive
        });
    }

    fn session_ended(&mut self, now: Instant) {
        self.ended = now;
        self.was_established = false;
        self.has_failed = false;
        self.telemetry = None;
        self.release();
        self.abandon_requests();
        self.statistics.abandon();
    }

    /// Gives up on requests that would move the robot or clear its stop; `refusal` answers them.
    pub fn give_up_on_moving(&mut self, refusal: Option<&Refusal>) {
        self.give_up(refusal, Pending::moves);
    }

    fn give_up(&mut self, refusal: Option<&Refusal>, ends: impl Fn(&Pending) -> bool) {
        let updates = &mut self.updates;
        self.pending.retain(|pending| {
            let ends = ends(pending);
            if ends {
                let request = pending.message.request;
                updates.push_back(refusal.map_or(Update::Unanswered { request }, |refusal| {
                    Update::Answer { request, outcome: Outcome::Refused(refusal.clone()) }
                }));
            }
            !ends
        });
    }

    fn abandon_requests(&mut self) {
        self.give_up(None, |_| true);
    }

    fn number(&mut self) -> u32 {
        self.next_number = self.next_number.wrapping_add(1);
        self.next_number
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Instant = Instant::from_micros(1_000_000);

    /// Returns after how long a request of twice the usual patience is asked again that is refused so after so long, while so
    /// many other copies are under way; and how long it then goes on, at most.
    fn goes_on(
        refusal: &Refusal,
        after: Duration,
        is_told: bool,
        unanswered: u32,
    ) -> Option<[Duration; 2]> {
        let message = ToRobot { request: 1, intent: 0, halts: 0, command: Command::Arm };
        let mut pending = Pending {
            message,
            unanswered,
            send_at: NOW + REQUEST_RETRY,
            send_until: NOW + REQUEST_PATIENCE,
            give_up_at: NOW + 3 * REQUEST_PATIENCE,
            insists_until: Some(NOW + 2 * REQUEST_PATIENCE),
            waits_until: NOW + 2 * REQUEST_PATIENCE,
            refusal: None,
        };
        let now = NOW + after;
        pending
            .outlives(now, refusal, is_told)
            .then(|| [pending.send_at, pending.give_up_at].map(|at| at.since(now)))
    }

    #[test]
    fn a_refusal_that_passes_leads_to_the_same_request_until_patience_is_over() {
        let moment = Duration::from_micros(1);
        let late = Refusal::Late { age_ms: 400, limit_ms: 300 };
        let [again, left] = goes_on(&late, REQUEST_PATIENCE - moment, true, 0).unwrap();
        assert_eq!((again, left), (Duration::ZERO, 2 * REQUEST_PATIENCE + moment));
        let [again, left] = goes_on(&late, REQUEST_PATIENCE, true, 0).unwrap();
        assert_eq!(again, left, "no other copy");
        assert_eq!(goes_on(&late, 3 * REQUEST_PATIENCE, true, 0), None);
        let last = 2 * REQUEST_PATIENCE - TRY_AGAIN;
        for (refusal, is_told) in [(Refusal::LinkUnproven, true), (Refusal::Stopped, false)] {
            let first = goes_on(&refusal, Duration::ZERO, is_told, 0);
            assert_eq!(first, Some([TRY_AGAIN, TRY_AGAIN + REQUEST_PATIENCE]));
            let latest = goes_on(&refusal, last - moment, is_told, 0);
            assert_eq!(latest, Some([TRY_AGAIN, TRY_AGAIN + moment + LAST_ANSWER]));
            assert_eq!(goes_on(&refusal, last, is_told, 0), None);
            // An answer to another copy is awaited, and no further one sent.
            assert_eq!(goes_on(&refusal, last, is_told, 1), Some([LAST_ANSWER; 2]));
        }
        assert_eq!(goes_on(&Refusal::Stopped, moment, true, 0), None);
        assert_eq!(goes_on(&Refusal::Malformed, moment, false, 1), None);
    }
}
