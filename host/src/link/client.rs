//! The client without a clock or a socket: repeats the order of its operator as the sign of life, sends requests until they are
//! answered, and opens a lost session again.
//!
//! An order that moves the robot or clears it is a [`Wish`], [pressed](Client::press) by a person or by a program that starts. It takes the
//! permit that telemetry showed last, and counts only while the robot states the same one: after a halt the walk of a robot that is
//! driven becomes f = 0 under the permit that it had, every other order [`Order::Off`], and [`Update::Ended`] reports why; the robot
//! at f = 0 may halt, and end, once more. Halts that the order itself led to (the end of its alignment or trial) end nothing.
//! [`Client::hold`] changes f and theta of a walk in force, with its permit.

use std::collections::VecDeque;
use std::time::Duration;

use flix_protocol::frame::Frame;
use flix_protocol::message::{
    Command, EventReport, Faults, Halt, OperatorName, Order, Outcome, ParameterCommand, Permit,
    Refusal, Reply, Request, Setpoint, State, Telemetry, ToOperator, ToRobot, Trial, Withheld,
};
use flix_protocol::session::{
    ConnectError, Key, LinkHealth, OperatorReceived, OperatorSession, SendError, Status,
    StopSession, StopStatus,
};
use flix_protocol::units::{Hertz, Instant};

use super::statistics::Statistics;
use super::{
    DISARMED_AFTER, KEEP_ALIVE, PASSING_PATIENCE, REQUEST_PATIENCE, REQUEST_RETRY, SILENCE,
    STOP_BESIDE_AFTER,
};

/// How often a program repeats a wish that ended because orders stayed away while the motors were aligned or tried.
const MOST_LAPSES: u32 = 3;

/// An order that begins movement or clears the robot, before it gets the permit that was shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Wish {
    /// Make the motors ready and hold them at rest.
    Arm,
    /// Shake with this pair.
    Shake(Setpoint),
    /// Do one trial; the robot is disarmed before and after.
    Try(Trial),
    /// Forget the latched stop and the faults whose cause is gone.
    Clear,
}

impl Wish {
    const fn order(self, permit: Permit) -> Order {
        match self {
            Self::Arm => Order::Arm(permit),
            Self::Shake(setpoint) => Order::Shake(permit, setpoint),
            Self::Try(trial) => Order::Try(permit, trial),
            Self::Clear => Order::Clear(permit),
        }
    }
}

/// Why a wish is not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NotTaken {
    /// The robot has stated no permit in this session.
    #[error("the robot has not stated yet whether it may be moved")]
    NotShown,
    /// The robot has not acknowledged the last stop.
    #[error("a stop is on its way: wait until the robot acknowledges it")]
    Stopping,
    /// The robot has not disarmed yet, as this client has ordered: a walk sent now would take the place of an order that may not
    /// have arrived.
    #[error("the robot disarms: press Enter once it has")]
    Disarming,
}

/// An event of the link, for the owner of the client.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "few are ever waiting")]
pub enum Update {
    /// The session is open.
    Connected,
    /// The robot could not be reached, or refused.
    Failed(ConnectError),
    /// The robot fell silent; every wish ends, and the client connects again.
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
    /// The order in force was replaced: refused, without effect in time, or the robot halted.
    Ended {
        /// The order of the wish.
        order: Order,
        /// Why; `None` where the robot stated no reason in time.
        why: Option<Refusal>,
    },
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
    request: Request,
    send_at: Instant,
    give_up_at: Instant,
}

/// A wish in force to arm, to clear or for a trial.
#[derive(Debug, Clone, Copy)]
struct Pressed {
    /// Without an effect until then it ends.
    until: Instant,
    /// How often it is repeated where orders stay away while the motors are aligned or tried.
    lapses: u32,
}

/// The operator's end of the link.
///
/// After every call, and at the time of [`Client::transmit_at`]: call [`Client::transmit`] until it
/// returns `None`, send each datagram, and take [`Client::update`]. Never panics on any datagram.
pub struct Client {
    session: OperatorSession,
    was_established: bool,
    has_failed: bool,
    /// The order that is sent every [`KEEP_ALIVE`].
    order: Order,
    /// Number of the first datagram of this session that carried the order.
    order_since: Option<u64>,
    pressed: Option<Pressed>,
    /// The request for the reason why the robot's settings keep it from arming.
    checking: Option<u32>,
    stop: StopState,
    /// When it was asked for.
    stop_since: Instant,
    /// A stop without a session: while there is none, as another operator holds the robot, or it acknowledges nothing.
    beside: Option<StopSession>,
    pending: VecDeque<Pending>,
    next_number: u32,
    /// When the order is sent next.
    send_at: Instant,
    heard: Instant,
    /// When the last session ended.
    ended: Instant,
    telemetry: Option<Telemetry>,
    /// When the robot first stated the present permit, or acknowledged the last stop.
    permitted_at: Instant,
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
            order: Order::Off,
            order_since: None,
            pressed: None,
            checking: None,
            stop: StopState::None,
            stop_since: now,
            beside: None,
            pending: VecDeque::new(),
            next_number: 0,
            send_at: now,
            heard: now,
            ended: now,
            telemetry: None,
            permitted_at: now,
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

    /// Takes a wish of a person, with the permit that telemetry showed last. It is given up after [`PASSING_PATIENCE`] without an
    /// effect. A wish to clear is none where neither a stop nor a fault is shown.
    ///
    /// # Errors
    /// When the robot has stated no permit in this session, or a stop is on its way.
    pub fn press(&mut self, now: Instant, wish: Wish) -> Result<(), NotTaken> {
        self.press_for(now, wish, PASSING_PATIENCE, 0)
    }

    /// Takes a wish of a program, as [`Client::press`] does, for `patience`. Where orders stayed away while the motors were aligned or
    /// tried, so that the robot let go of them, the wish is pressed again with the permit that followed, at most three times.
    ///
    /// # Errors
    /// As for [`Client::press`].
    pub fn insist_on(
        &mut self,
        now: Instant,
        wish: Wish,
        patience: Duration,
    ) -> Result<(), NotTaken> {
        self.press_for(now, wish, patience, MOST_LAPSES)
    }

    fn press_for(
        &mut self,
        now: Instant,
        wish: Wish,
        patience: Duration,
        lapses: u32,
    ) -> Result<(), NotTaken> {
        if self.stop == StopState::Sending {
            return Err(NotTaken::Stopping);
        }
        let shown = self.telemetry.ok_or(NotTaken::NotShown)?;
        match wish {
            // A robot that follows a walk is armed. A robot without stop and fault needs no clearing.
            Wish::Arm
                if self.is_armed()
                    && matches!(self.order, Order::Shake(permit, _) if permit == shown.permit) =>
            {
                return Ok(());
            }
            Wish::Clear if !shown.stopped && shown.faults.is_empty() => return Ok(()),
            Wish::Clear => self.stop = StopState::None,
            // The order to disarm may not have arrived: a walk in its place would leave the robot armed.
            Wish::Shake(setpoint)
                if matches!(self.order, Order::Off | Order::Stop) && self.is_driven() =>
            {
                let rests = setpoint.frequency() == Hertz::ZERO;
                return if rests { Ok(()) } else { Err(NotTaken::Disarming) };
            }
            Wish::Arm | Wish::Shake(_) | Wish::Try(_) => self.is_driving = true,
        }
        self.set_order(now, wish.order(shown.permit));
        let waits = !matches!(wish, Wish::Shake(_));
        self.pressed = waits.then_some(Pressed { until: now + patience, lapses });
        Ok(())
    }

    /// Commands this pair as a person does at this moment: [presses](Client::press) [`Wish::Shake`]. Does nothing where the robot has
    /// stated no permit.
    pub fn want(&mut self, now: Instant, setpoint: Setpoint) {
        // Without a permit there is nothing to move.
        let _ = self.press(now, Wish::Shake(setpoint));
    }

    /// Commands this pair as a program does that steers: changes the walk in force, or begins one of the robot that this client
    /// armed, with the permit that arming led to. Does nothing otherwise.
    pub fn hold(&mut self, now: Instant, setpoint: Setpoint) {
        let shown = self.telemetry.map(|it| (it.permit, it.halt));
        let order = match (self.order, shown) {
            (Order::Shake(permit, held), Some((shown, _)))
                if shown == permit && held != setpoint =>
            {
                Order::Shake(permit, setpoint)
            }
            (Order::Arm(permit), Some((shown, Halt::Aligned))) if shown == permit.next() => {
                Order::Shake(shown, setpoint)
            }
            // The robot was armed when it was asked to arm: without an alignment its permit is the same.
            (Order::Arm(permit), Some((shown, _))) if shown == permit && self.is_armed() => {
                Order::Shake(shown, setpoint)
            }
            _ => return,
        };
        self.set_order(now, order);
        self.pressed = None;
    }

    /// Disarms the robot, or lets it stay disarmed: ends every wish.
    pub fn disarm(&mut self, now: Instant) {
        if self.stop != StopState::Sending {
            self.set_order(now, Order::Off);
            self.pressed = None;
        }
    }

    /// Ends a wish to arm, to clear or for a trial that the robot has not fulfilled, also while it ramps down or aligns its motors.
    pub fn give_up(&mut self, now: Instant) {
        let stays = self.is_armed() && matches!(self.order, Order::Arm(_));
        if self.pressed.take().is_some() && !stays {
            self.disarm(now);
        }
    }

    fn set_order(&mut self, now: Instant, order: Order) {
        if order != self.order {
            (self.order, self.order_since) = (order, None);
            // At once: the operator waits for nothing.
            self.send_at = now;
        }
    }

    /// Returns the order in force.
    #[must_use]
    pub const fn order(&self) -> Order {
        self.order
    }

    /// Returns the pair of a walk in force, rest among them.
    #[must_use]
    pub const fn held(&self) -> Option<Setpoint> {
        match self.order {
            Order::Shake(_, setpoint) => Some(setpoint),
            _ => None,
        }
    }

    /// Returns whether telemetry is of a robot that had looked at the order in force.
    #[must_use]
    pub fn is_heard(&self, telemetry: &Telemetry) -> bool {
        self.order_since.is_some_and(|since| telemetry.heard >= since)
    }

    fn is_armed(&self) -> bool {
        let state = self.telemetry.map(|it| it.state);
        matches!(state, Some(State::Armed | State::Running))
    }

    fn is_driven(&self) -> bool {
        self.telemetry.is_some_and(|it| !it.state.is_idle())
    }

    /// Sends a request until it is answered, and returns its number. The answer, or that there is none, comes as an update.
    ///
    /// Requests that change the robot are sent one after another. Movement takes an [order](Client::press).
    pub fn request(&mut self, now: Instant, command: Command) -> u32 {
        self.next_number = self.next_number.wrapping_add(1);
        let request = Request { number: self.next_number, command };
        let give_up_at = now + REQUEST_PATIENCE;
        self.pending.push_back(Pending { request, send_at: now, give_up_at });
        self.next_number
    }

    /// Stops the robot: ends every wish and request, and repeats the stop until it is acknowledged.
    pub fn stop(&mut self, now: Instant) {
        self.abandon_requests();
        self.pressed = None;
        self.set_order(now, Order::Stop);
        if self.stop != StopState::Sending {
            (self.stop, self.stop_since) = (StopState::Sending, now);
        }
        self.send_at = now;
    }

    /// Takes that datagrams leave from another address now: a stop without a session begins anew, since the robot answers each of its
    /// datagrams at the address that sent the first.
    pub fn move_address(&mut self) {
        self.beside = None;
    }

    /// Returns the permit that the robot states, a number for each halt of it; `None` before the first telemetry of the session.
    #[must_use]
    pub fn permit(&self) -> Option<Permit> {
        self.telemetry.map(|telemetry| telemetry.permit)
    }

    /// Returns when the robot first stated that permit, or acknowledged a stop of this client: a picture of the robot that is older
    /// shows neither its last halt nor that stop.
    #[must_use]
    pub const fn permitted_at(&self) -> Instant {
        self.permitted_at
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

    /// Returns the operator that latched the stop, as the robot reports.
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

    /// Puts updates back that were taken before their time, in their order.
    pub(crate) fn put_back(&mut self, updates: Vec<Update>) {
        updates.into_iter().rev().for_each(|update| self.updates.push_front(update));
    }

    /// Receives a datagram from the robot's address.
    pub fn receive(&mut self, now: Instant, datagram: &[u8]) {
        if let Some(beside) = &mut self.beside
            && beside.receive(now, datagram).is_ok()
        {
            if matches!(beside.status(), StopStatus::Latched | StopStatus::AtRest) {
                self.acknowledge_stop(now);
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
                // Telemetry comes before `Update::Ended`, so that the owner knows the state when a wish ends.
                self.updates.push_back(Update::Telemetry(telemetry));
                self.take_telemetry(now, telemetry);
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

    /// Takes telemetry: the order in force ends, or goes on.
    fn take_telemetry(&mut self, now: Instant, telemetry: Telemetry) {
        let first = self.telemetry.is_none();
        let known = self.telemetry.map_or(Faults::NONE, |it| it.faults);
        if self.permit() != Some(telemetry.permit) {
            self.permitted_at = now;
        }
        self.telemetry = Some(telemetry);
        if telemetry.held_us != u16::MAX {
            let held = Duration::from_micros(telemetry.held_us.into());
            self.statistics.heard(telemetry.heard, now, held);
        }
        self.statistics.count(&telemetry.link, telemetry.heard, &self.session.health());
        let is_heard = self.is_heard(&telemetry);
        if self.stop == StopState::Sending {
            if is_heard && telemetry.stopped {
                self.acknowledge_stop(now);
            }
            return;
        }
        let begins = matches!(self.order, Order::Arm(_) | Order::Shake(..) | Order::Try(..));
        if telemetry.state.is_idle() && (first || is_heard && !begins) {
            self.is_driving = false;
        }
        let is_clear = !telemetry.stopped && telemetry.faults.is_empty();
        match self.order {
            Order::Off | Order::Stop => {}
            Order::Clear(_) if is_clear => self.disarm(now),
            order if order.permit() != Some(telemetry.permit) => {
                self.halted(now, order, &telemetry, known);
            }
            // The robot fulfils it.
            Order::Arm(_) if self.is_armed() => self.pressed = None,
            Order::Arm(_) | Order::Try(..) if !telemetry.state.is_idle() => {
                if let Some(pressed) = &mut self.pressed {
                    pressed.until = pressed.until.max(now + SILENCE);
                }
            }
            // The robot's link withholds it, and the fast loop never looks at it.
            Order::Try(..) if telemetry.withheld == Some(Withheld::NoCurrentSense) => {
                self.end(now, Some(Refusal::NoCurrentSense));
            }
            _ if is_heard => self.look_at_withheld(now, &telemetry),
            _ => {}
        }
    }

    /// Ends a wish whose permit is not the present one, unless it led there.
    fn halted(&mut self, now: Instant, order: Order, telemetry: &Telemetry, known: Faults) {
        let is_next = order.permit().map(Permit::next) == Some(telemetry.permit);
        let is_driven = !telemetry.state.is_idle();
        match (order, telemetry.halt) {
            (Order::Arm(_), Halt::Aligned | Halt::Rested) if self.is_armed() => self.pressed = None,
            (Order::Shake(_, setpoint), _) if setpoint.frequency() == Hertz::ZERO && is_driven => {}
            (Order::Try(..), Halt::Tried) if is_next => self.disarm(now),
            (Order::Arm(_) | Order::Try(..), Halt::LetGo)
                if is_next && self.pressed.is_some_and(|it| it.lapses > 0) =>
            {
                if let Some(pressed) = &mut self.pressed {
                    pressed.lapses -= 1;
                }
                self.set_order(now, order.with_permit(telemetry.permit));
            }
            _ => {
                let has_failed = telemetry.faults.iter().any(|it| !known.contains(it));
                let why = if telemetry.stopped && !has_failed {
                    Refusal::Stopped
                } else if telemetry.faults.is_empty() {
                    Refusal::Rested
                } else {
                    Refusal::Faulted(telemetry.faults)
                };
                self.end(now, Some(why));
            }
        }
    }

    /// Ends a wish that the robot withholds for a reason that does not pass.
    fn look_at_withheld(&mut self, now: Instant, telemetry: &Telemetry) {
        match telemetry.withheld {
            Some(Withheld::Settings) if self.checking.is_none() => {
                let check = Command::Parameter(ParameterCommand::Check);
                self.checking = Some(self.request(now, check));
            }
            // A robot that is disarmed follows no walk.
            Some(Withheld::State)
                if matches!(self.order, Order::Shake(..)) && telemetry.state.is_idle() =>
            {
                self.end(now, Some(Refusal::State(telemetry.state)));
            }
            Some(Withheld::Faulted) => self.end(now, Some(Refusal::Faulted(telemetry.faults))),
            Some(Withheld::Stopped) => self.end(now, Some(Refusal::Stopped)),
            _ => {}
        }
    }

    /// Ends the wish in force: a robot that is driven rests, others stay disarmed.
    fn end(&mut self, now: Instant, why: Option<Refusal>) {
        let order = self.order;
        let rest = match order {
            Order::Shake(permit, setpoint) if self.is_driven() => {
                Order::Shake(permit, setpoint.at_rest())
            }
            _ => Order::Off,
        };
        // This order can no longer move a robot that is disarmed and has seen it, or states another permit.
        self.is_driving &= !self.telemetry.is_some_and(|it| {
            it.state.is_idle() && (self.is_heard(&it) || order.permit() != Some(it.permit))
        });
        self.set_order(now, rest);
        self.pressed = None;
        self.updates.push_back(Update::Ended { order, why });
    }

    /// Ends a wish that has had no effect for too long.
    fn end_in_time(&mut self, now: Instant) {
        let is_over = self.pressed.is_some_and(|it| now >= it.until);
        if is_over && self.stop != StopState::Sending {
            let why = self.telemetry.and_then(|it| match self.order {
                // Its cause is still there.
                Order::Clear(_) if !it.faults.is_empty() => Some(Refusal::Faulted(it.faults)),
                _ => refusal(&it),
            });
            self.end(now, why);
        }
    }

    /// Returns the next datagram to send, if one is due.
    pub fn transmit(&mut self, now: Instant) -> Option<Frame> {
        self.statistics.expire(now);
        if let Some(frame) = self.farewell.take() {
            return Some(frame);
        }
        self.give_up_on_silence(now);
        if !self.was_established && now.since(self.ended) > DISARMED_AFTER {
            // The robot has disarmed by itself since; movement now is another operator's.
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
        self.end_in_time(now);
        if !self.was_established {
            return None;
        }
        let message = self.due(now)?;
        match self.session.send(now, &message) {
            Ok(frame) => {
                if matches!(message, ToRobot::Order(_)) {
                    let counter = self.session.sealed();
                    self.order_since.get_or_insert(counter);
                    self.statistics.sent(counter, now);
                }
                Some(frame)
            }
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
        let request = self.in_turn().map(|(_, pending)| pending.send_at).min();
        let ends = self.pressed.map(|it| it.until);
        [Some(self.send_at), beside, request, give_up, ends, Some(self.heard + SILENCE)]
            .into_iter()
            .flatten()
            .min()
    }

    /// Returns the message that is due: the order, then requests. A request that is repeated leaves halfway between two orders: the
    /// robot drops a message that a later one overtakes, which would happen to each repetition in step with the orders.
    fn due(&mut self, now: Instant) -> Option<ToRobot> {
        if now >= self.send_at {
            // A fixed rate; after a pause it starts anew and does not catch up.
            let next = self.send_at + KEEP_ALIVE;
            self.send_at = if next > now { next } else { now + KEEP_ALIVE };
            return Some(ToRobot::Order(self.order));
        }
        let place = self.in_turn().find_map(|(place, it)| (now >= it.send_at).then_some(place));
        let pending = self.pending.get_mut(place?)?;
        pending.send_at = self.send_at + (REQUEST_RETRY - KEEP_ALIVE / 2);
        Some(ToRobot::Request(pending.request.clone()))
    }

    /// Returns the requests that may be sent now, each with its place: questions, and the oldest that changes the robot.
    fn in_turn(&self) -> impl Iterator<Item = (usize, &Pending)> {
        let mut is_first = true;
        self.pending.iter().enumerate().filter(move |(_, pending)| {
            pending.request.command.is_question() || std::mem::take(&mut is_first)
        })
    }

    fn replied(&mut self, now: Instant, reply: Reply) {
        let Reply { request, outcome } = reply;
        let Some(place) = self.pending.iter().position(|it| it.request.number == request) else {
            return;
        };
        self.pending.remove(place);
        if self.checking.take_if(|it| *it == request).is_some() {
            match outcome {
                Outcome::Refused(refusal)
                    if matches!(self.order, Order::Arm(_) | Order::Try(..)) =>
                {
                    self.end(now, Some(refusal));
                }
                _ => {}
            }
            return;
        }
        self.updates.push_back(Update::Answer { request, outcome });
    }

    fn acknowledge_stop(&mut self, now: Instant) {
        if self.stop == StopState::Sending {
            (self.stop, self.beside) = (StopState::Acknowledged, None);
            self.is_driving = false;
            // An earlier picture of the robot does not show this stop.
            self.permitted_at = now;
            if let Some(telemetry) = &mut self.telemetry {
                telemetry.stopped = true;
            }
            self.set_order(now, Order::Off);
            self.updates.push_back(Update::StopAcknowledged);
        }
    }

    fn note_established(&mut self, now: Instant) {
        if !self.was_established {
            self.was_established = true;
            self.send_at = now;
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

    fn give_up_on_requests(&mut self, now: Instant) {
        // The time of a request begins when its turn comes.
        let places: Vec<usize> = self.in_turn().map(|(place, _)| place).collect();
        for (place, pending) in self.pending.iter_mut().enumerate() {
            if !places.contains(&place) {
                pending.give_up_at = now + REQUEST_PATIENCE;
            }
        }
        let (updates, checking) = (&mut self.updates, &mut self.checking);
        self.pending.retain(|pending| {
            let is_alive = now < pending.give_up_at;
            let request = pending.request.number;
            // The owner of the client has not asked for the check of the settings.
            if !is_alive && checking.take_if(|it| *it == request).is_none() {
                updates.push_back(Update::Unanswered { request });
            }
            is_alive
        });
    }

    fn session_ended(&mut self, now: Instant) {
        self.ended = now;
        self.was_established = false;
        self.has_failed = false;
        self.telemetry = None;
        (self.order_since, self.pressed) = (None, None);
        if self.stop != StopState::Sending {
            self.order = Order::Off;
        }
        self.abandon_requests();
        self.statistics.abandon();
    }

    fn abandon_requests(&mut self) {
        let checking = self.checking.take();
        let ended = self.pending.drain(..).map(|it| it.request.number);
        let asked = ended.filter(|request| Some(*request) != checking);
        self.updates.extend(asked.map(|request| Update::Unanswered { request }));
    }
}

/// Returns why the robot does not obey the newest order, as a refusal.
fn refusal(telemetry: &Telemetry) -> Option<Refusal> {
    Some(match telemetry.withheld? {
        // The sentence that names the setting has not come.
        Withheld::Settings => return None,
        Withheld::Permit => Refusal::Rested,
        Withheld::State => Refusal::State(telemetry.state),
        Withheld::Faulted => Refusal::Faulted(telemetry.faults),
        Withheld::Stopped => Refusal::Stopped,
        Withheld::LinkUnproven => Refusal::LinkUnproven,
        Withheld::Late { age_ms, limit_ms } => Refusal::Late { age_ms, limit_ms },
        Withheld::Range => Refusal::Malformed,
        Withheld::NoCurrentSense => Refusal::NoCurrentSense,
    })
}
