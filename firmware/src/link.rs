//! The robot's end of the link: an operator's orders and requests become what is [`Asked`] of the fast half, and the reports of
//! the fast half become replies, telemetry and events.
//!
//! - **Who**: only the operator that holds the session of [`flix_protocol::session`]. Whenever a session begins or ends, the robot
//!   ramps down and disarms: nobody inherits a running robot.
//! - **Orders** are handed on whole: the supervisor of the fast half decides whether an order moves the robot. Here an order is
//!   withheld where it is out of range or too old, and judged for whether motors may begin to be driven: the link was steady for
//!   [`PROVING_TIME`](flix_protocol::failsafe::PROVING_TIME), and the settings are known and stable ([`Asked::begins`]).
//! - **Signs of life** are orders alone. The fast half watches their age ([`Asked::heard`], [`Asked::expires`]), so that its
//!   deadlines hold even when this half hangs.
//! - **Stop**: any operator latches the stop, also without the session, which goes on; its operator learns of that by an event.
//! - **Age**: an order or a change counts only while it is fresh ([`flix_protocol::session`]), up to the setting `command_age`.
//!   [`Order::Off`], [`Order::Stop`] and questions count at any age.
//! - **Requests** are answered once each. A refused request changes nothing, and the refusal says what would be accepted.
//! - **Events** carry numbers that count up by one. At most [`EVENTS`] wait for an operator, the
//!   oldest go first, and the gap in the numbers shows it.
//!
//! Time and datagrams come in as arguments, datagrams go out: no clock, no socket, no allocation,
//! and no panic on any input.

mod readiness;
#[cfg(test)]
mod table;

use core::borrow::BorrowMut;
use core::net::SocketAddr;
use core::time::Duration;

use flix_protocol::frame::{Frame, HandshakeFrame};
use flix_protocol::message::{
    Bridges, BuildId, Command, CrashReport, EncoderHealth, Event, EventReport, Identity,
    LinkQuality, Magnet, Mark, MotorTelemetry, OperatorName, Order, Outcome, PARAMETERS_PER_REPLY,
    ParameterCommand, Refusal, Reply, Request, ResetReason, ScopeCommand, Setpoint, State,
    Telemetry, ToOperator, ToRobot, Withheld,
};
use flix_protocol::session::{Operators, RobotReceived, RobotSession};
use flix_protocol::units::{Amperes, Degrees, Instant, Ratio, Volts};
use heapless::{Deque, Vec};

use crate::blackbox::{BlackBox, RUN_BYTES};
use crate::fast::exchange::{Asked, Report, Wanted};
use crate::hardware::{Hardware, SettingsStore};
use crate::scope::{Memory, Scope};
use crate::settings::{self, Settings, Tuning, text};
use readiness::{Judged, Steadiness};

/// Events that wait for an operator.
pub const EVENTS: usize = 32;
/// Replies that wait to be sent. The network task sends after each datagram that it receives.
const REPLIES: usize = 4;
/// Longest time between two telemetry datagrams while an operator gives orders: an order states the newest datagram that its
/// sender has received, and its age counts from there.
const SLOWEST_TELEMETRY: Duration = Duration::from_millis(20);
/// Time between two reports of the fast half.
const REPORT_INTERVAL: Duration = Duration::from_millis(1);
/// Time for which telemetry states the worst state of a magnet, after the encoder last reported that state.
pub const MAGNET_SHOWN: Duration = Duration::from_secs(5);
/// Handshake datagrams that wait to be sent.
const ANSWERS: usize = 4;

/// The robot's end of the link.
pub struct Link {
    session: RobotSession,
    identity: Identity,
    black_box: BlackBox,
    /// What the board measures and can do.
    hardware: Hardware,
    signal_dbm: Option<i8>,
    asked: Asked,
    /// Who asked first for the stop that is latched, or on its way.
    stopped_by: Option<OperatorName>,
    /// Time of the last request to stop, or of the last latched fault, whichever is later.
    latched_at: Instant,
    /// The largest number of a request of this session that was to change something.
    changed: Option<u32>,
    /// The newest order, where this session gives any.
    order: Option<Order>,
    /// The newest order that was handed on.
    handed_on: Order,
    /// Counter and arrival of its newest datagram.
    repeated: (u64, Instant),
    /// The same of the newest that the fast half has looked at.
    heard: (u64, Instant),
    /// Why the newest order was not handed on, or cannot begin.
    withheld: Option<Withheld>,
    /// Whether commands arrived too old to count, and have not been steady since.
    is_slow: bool,
    report: Report,
    steadiness: Steadiness,
    answers: Deque<(SocketAddr, HandshakeFrame), ANSWERS>,
    replies: Deque<Reply, REPLIES>,
    /// Commands to the scope, which lies where both halves reach it.
    scope: Deque<(u32, ScopeCommand), REPLIES>,
    /// Whether the scope is to watch for faults again.
    releases_scope: bool,
    events: Events,
    /// When each encoder last said this of its magnet: good, weak, strong, missing.
    magnets: [[Option<Instant>; Magnet::ALL.len()]; 2],
    telemetry_due: Instant,
    judged: Judged,
}

impl Link {
    /// Starts with nobody connected. Without operators everybody is refused, without a current sense
    /// every trial.
    ///
    /// `report` is the fast half's first. `entropy` comes from a hardware random source, fresh at
    /// every start.
    #[must_use]
    pub fn new(
        identity: Identity,
        hardware: &Hardware,
        operators: impl Into<Operators>,
        entropy: [u8; 32],
        settings: &Settings,
        report: Report,
    ) -> Self {
        let mut events = Events::default();
        events.push(report.time, Event::Started);
        let mut session = RobotSession::new(operators, entropy);
        session.set_command_age(command_age(settings));
        Self {
            session,
            black_box: BlackBox::new(&identity.version),
            identity,
            hardware: *hardware,
            signal_dbm: None,
            asked: Asked::default(),
            stopped_by: None,
            latched_at: Instant::START,
            changed: None,
            order: None,
            handed_on: Order::Off,
            repeated: (0, Instant::START),
            heard: (0, Instant::START),
            withheld: None,
            is_slow: false,
            report,
            steadiness: Steadiness::default(),
            answers: Deque::new(),
            replies: Deque::new(),
            scope: Deque::new(),
            releases_scope: false,
            events,
            magnets: Default::default(),
            telemetry_due: report.time,
            judged: Judged::of(settings, hardware),
        }
    }

    /// Returns what the fast half is asked for.
    #[must_use]
    pub const fn asked(&self) -> &Asked {
        &self.asked
    }

    /// Returns how the fast half was when it was last observed.
    #[must_use]
    pub const fn report(&self) -> &Report {
        &self.report
    }

    /// Returns the address of the operator who holds the session.
    #[must_use]
    pub fn operator(&self, now: Instant) -> Option<SocketAddr> {
        self.session.peer(now)
    }

    /// Returns the name of the operator who holds the session.
    #[must_use]
    pub fn driver(&self, now: Instant) -> Option<OperatorName> {
        self.session.operator(now)
    }

    /// Returns how well the robot hears.
    #[must_use]
    pub fn quality(&self, now: Instant) -> LinkQuality {
        LinkQuality { signal_dbm: self.signal_dbm, ..self.session.quality(now) }
    }

    /// Takes other operators, or none: ends the session and disarms, unless its holder is among them.
    pub fn set_operators(&mut self, operators: impl Into<Operators>) {
        if !self.session.set_operators(operators) {
            self.change_operator();
        }
    }

    /// Changes the name that the robot answers to [`Command::Identify`], cut to what fits.
    pub fn set_name(&mut self, name: &str) {
        self.identity.name = text(name);
    }

    /// Changes why it says that it last started.
    pub fn set_reset(&mut self, reset: ResetReason) {
        self.identity.reset = reset;
    }

    /// Changes what it says of the run before its last start.
    pub fn set_crash(&mut self, crash: Option<CrashReport>) {
        self.black_box.set_crash(crash);
    }

    /// Notes which build of the firmware runs, for the next run.
    pub fn set_build(&mut self, build: Option<BuildId>) {
        self.black_box.set_build(build);
    }

    /// Returns what to leave in [`RUN`](crate::blackbox::RUN) for the next run when it has changed since the last call.
    pub fn keep(&mut self) -> Option<[u8; RUN_BYTES]> {
        self.black_box.keep()
    }

    /// Notes the radio power as last received, for telemetry.
    pub fn set_signal(&mut self, dbm: Option<i8>) {
        self.signal_dbm = dbm;
    }

    /// Adds an event of the slow half to those that wait for the operator.
    pub fn add_event(&mut self, now: Instant, event: Event) {
        self.events.push(now, event);
    }

    /// Takes a datagram that came from `from`, and returns whether its operator sent it just now: whether it
    /// is authentic, new and fresh. What there is to send in turn comes out of [`Link::transmit`]. Never panics.
    pub fn receive<S: SettingsStore>(
        &mut self,
        now: Instant,
        from: SocketAddr,
        datagram: &[u8],
        tuning: &mut Tuning<S>,
    ) -> bool {
        self.session.set_at_rest(self.report.stopped && self.is_at_rest());
        let received = self.session.receive(now, from, datagram);
        let is_authentic =
            matches!(received, RobotReceived::Connected(_) | RobotReceived::Message(_));
        match received {
            RobotReceived::Answer(answer) | RobotReceived::Dropped(_, Some(answer)) => {
                push_newest(&mut self.answers, (from, answer));
            }
            RobotReceived::Connected(answer) => {
                self.change_operator();
                self.telemetry_due = now;
                if let Some(operator) = self.session.operator(now) {
                    self.events.push(now, Event::OperatorConnected(operator));
                }
                push_newest(&mut self.answers, (from, answer));
            }
            RobotReceived::Message(message) => {
                self.steadiness.heard(now);
                self.is_slow &= !self.steadiness.is_proven();
                match message {
                    ToRobot::Order(order) => {
                        self.receive_order(now, order, None, tuning.settings());
                    }
                    ToRobot::Request(request) => self.take(now, request, tuning),
                }
            }
            RobotReceived::Late { message, age } => {
                let [age_ms, limit_ms] = self.note_late(now, age);
                match message {
                    ToRobot::Order(order) => {
                        let late = Some(Withheld::Late { age_ms, limit_ms });
                        self.receive_order(now, order, late, tuning.settings());
                    }
                    ToRobot::Request(request) if request.command.is_question() => {
                        self.take(now, request, tuning);
                    }
                    ToRobot::Request(Request { number, .. }) => {
                        self.reply(number, Err(Refusal::Late { age_ms, limit_ms }));
                    }
                }
            }
            RobotReceived::Unreadable(number) => self.reply(number, Err(Refusal::Malformed)),
            RobotReceived::Left => {
                self.change_operator();
                self.events.push(now, Event::OperatorLeft);
            }
            RobotReceived::Stop(answer, operator) => {
                self.latch_stop(now, Some(operator));
                self.asked.halts = self.asked.halts.wrapping_add(1);
                self.events.push(now, Event::StoppedFromOutside(operator));
                push_newest(&mut self.answers, (from, answer));
            }
            RobotReceived::Dropped(_, None) => {}
        }
        is_authentic
    }

    /// Returns the next datagram to send, and to whom; `None` when there is none for now.
    pub fn transmit(
        &mut self,
        now: Instant,
        settings: &Settings,
        frame: &mut Frame,
    ) -> Option<SocketAddr> {
        if let Some((to, answer)) = self.answers.pop_front() {
            frame.clear();
            frame.extend_from_slice(&answer).ok()?;
            return Some(to);
        }
        let operator = self.session.operator(now)?;
        let message = self.next_message(now, operator, settings)?;
        let (to, sealed) = self.session.send(now, &message).ok()?;
        *frame = sealed;
        Some(to)
    }

    /// Returns when [`Link::transmit`] has something to send, unless a datagram or a report changes that;
    /// `None` while nobody listens.
    #[must_use]
    pub fn poll_at(&self, now: Instant) -> Option<Instant> {
        if !self.answers.is_empty() {
            return Some(now);
        }
        self.session.peer(now)?;
        let waiting = !self.replies.is_empty() || !self.events.queue.is_empty();
        Some(match self.is_counted() {
            _ if waiting => now,
            true => self.telemetry_due.max(now),
            false => now + REPORT_INTERVAL,
        })
    }

    /// Returns whether the fast half has counted all halts: until then telemetry waits, so that no operator is shown a permit of before
    /// his session.
    const fn is_counted(&self) -> bool {
        self.asked.halts == self.report.halts
    }

    /// Notes each kind of trouble with a magnet once: one on the border comes and goes.
    fn look_at_magnets(&mut self, report: &Report) {
        let encoders = report.encoders.iter().zip(&mut self.magnets);
        for (motor, (EncoderHealth { magnet, .. }, said)) in (0..).zip(encoders) {
            let Some(said) = said.get_mut(*magnet as usize) else { continue };
            if said.replace(report.time).is_none() && *magnet != Magnet::Good {
                self.events.push(report.time, Event::Magnet { motor, magnet: *magnet });
            }
        }
    }

    /// Returns how the encoders are, each with the worst that it said of its magnet within [`MAGNET_SHOWN`].
    fn encoders(&self) -> [EncoderHealth; 2] {
        let is_recent = |at: &Instant| self.report.time.since(*at) < MAGNET_SHOWN;
        [0, 1].map(|motor| {
            let said = Magnet::ALL.into_iter().zip(self.magnets[motor]).rev();
            let mut recent = said.filter(|(_, at)| at.as_ref().is_some_and(is_recent));
            let magnet = recent.next().map_or(Magnet::Good, |(magnet, _)| magnet);
            EncoderHealth { magnet, ..self.report.encoders[motor] }
        })
    }

    /// Takes over how the fast half is, and notes what happened since it was last observed.
    pub fn observe(&mut self, report: &Report) {
        let last = core::mem::replace(&mut self.report, *report);
        self.black_box.observe(&last, report);
        let now = report.time;
        let (new, old) = (&report.events, &last.events);
        let voltage = report.bus_voltage.map_or(Volts::ZERO, Volts::from);
        let counted = [
            (new.cleared.wrapping_sub(old.cleared), Event::Cleared),
            (new.stopped.wrapping_sub(old.stopped), Event::Stopped),
            (new.link_late.wrapping_sub(old.link_late), Event::LinkLate),
            (new.command_deadline.wrapping_sub(old.command_deadline), Event::CommandDeadline),
            (new.command_age.wrapping_sub(old.command_age), Event::CommandAge),
            (new.link_lost.wrapping_sub(old.link_lost), Event::LinkLost),
            (new.battery_low.wrapping_sub(old.battery_low), Event::BatteryLow(voltage)),
            (
                new.frequency_limited.wrapping_sub(old.frequency_limited),
                Event::FrequencyLimited(report.frequency.into()),
            ),
        ];
        for (count, event) in counted {
            for _ in 0..count {
                self.events.push(now, event);
            }
        }
        for fault in report.faults.iter().filter(|fault| !last.faults.contains(*fault)) {
            self.latched_at = now;
            self.events.push(now, Event::Fault(fault));
        }
        if report.obeyed == self.asked.number {
            self.heard = self.repeated;
        }
        self.look_at_magnets(report);
        if report.state != last.state {
            self.events.push(now, Event::State(report.state));
        }
    }

    fn reply(&mut self, request: u32, outcome: Result<Outcome, Refusal>) {
        let outcome = outcome.unwrap_or_else(Outcome::Refused);
        push_newest(&mut self.replies, Reply { request, outcome });
    }

    /// Disarms for another operator, or none: the robot obeys them only from arming on.
    fn change_operator(&mut self) {
        self.asked.want(Wanted::Off, self.report.permit);
        self.asked.halts = self.asked.halts.wrapping_add(1);
        self.steadiness = Steadiness::default();
        self.is_slow = false;
        self.changed = None;
        (self.order, self.withheld) = (None, None);
        self.handed_on = Order::Off;
        (self.repeated, self.heard) = ((0, Instant::START), (0, Instant::START));
        self.replies.clear();
        self.scope.clear();
        self.releases_scope = true;
    }

    /// Obeys a request, and answers it; one to the scope waits until [`Link::consult`]. A request that was overtaken has no answer.
    fn take<S: SettingsStore>(&mut self, now: Instant, request: Request, tuning: &mut Tuning<S>) {
        let Request { number, command } = request;
        if self.is_overtaken(number, &command) {
            return;
        }
        let outcome = match command {
            Command::Parameter(command) => self.tune(now, command, tuning),
            Command::Identify => Ok(Outcome::Identity(self.identity.clone())),
            Command::Bridges => Ok(Outcome::Bridges(bridges(&self.hardware))),
            Command::Crash => Ok(Outcome::Crash(self.black_box.crash().cloned())),
            Command::Ping(sent) => Ok(Outcome::Pong(sent)),
            Command::Scope(command) => return push_newest(&mut self.scope, (number, command)),
        };
        self.reply(number, outcome);
    }

    /// Returns whether a request would undo one that was made after it.
    fn is_overtaken(&mut self, number: u32, command: &Command) -> bool {
        if command.is_question() {
            return false;
        }
        let is_old =
            self.changed.is_some_and(|newest| number.wrapping_sub(newest).cast_signed() < 0);
        if !is_old {
            self.changed = Some(number);
        }
        is_old
    }

    /// Returns whether something waits for the scope.
    #[must_use]
    pub fn asks_scope(&self) -> bool {
        self.releases_scope || !self.scope.is_empty()
    }

    /// Lets the scope obey the oldest command that waits for it; watch for faults again first, after another operator.
    pub fn consult(&mut self, scope: &mut Scope<impl BorrowMut<Memory>>) {
        if core::mem::take(&mut self.releases_scope) {
            scope.release();
        } else if let Some((request, command)) = self.scope.pop_front() {
            let outcome = scope.obey(command);
            self.reply(request, outcome);
        }
    }

    /// Reports once that commands come late; returns the age of this one and the limit, milliseconds.
    fn note_late(&mut self, now: Instant, age: Option<Duration>) -> [u16; 2] {
        let [age_ms, limit_ms] = [age, Some(self.session.command_age())].map(milliseconds);
        if !self.is_slow {
            self.is_slow = true;
            self.events.push(now, Event::CommandsLate { age_ms, limit_ms });
        }
        [age_ms, limit_ms]
    }

    /// Hands an order on to the fast half, with whether motors may begin to be driven. One that is out of range, or too old and
    /// not always safe, is withheld: it is no sign of life and changes nothing. `late`: its age, where that is too much.
    fn receive_order(
        &mut self,
        now: Instant,
        order: Order,
        late: Option<Withheld>,
        settings: &Settings,
    ) {
        let is_latched = self.order == Some(Order::Stop) && self.report.stopped;
        self.order = Some(order);
        self.telemetry_due = self.telemetry_due.min(now + SLOWEST_TELEMETRY);
        let range = |is_good: bool| (!is_good).then_some(Withheld::Range);
        self.withheld = match order {
            Order::Off | Order::Stop => None,
            Order::Shake(_, setpoint) => late.or(range(setpoint.check().is_ok())),
            Order::Try(..) if !self.measures_current() => Some(Withheld::NoCurrentSense),
            Order::Try(_, trial) => late.or(range(trial.check().is_ok())),
            Order::Arm(_) | Order::Clear(_) => late,
        };
        if self.withheld.is_some() {
            return;
        }
        if late.is_none() {
            self.note_sign_of_life(now);
        }
        (self.handed_on, self.repeated) = (order, (self.session.newest_message(), now));
        self.withheld = self.check_begin(&order, settings);
        self.asked.begins = self.withheld.is_none();
        let wanted = match order {
            Order::Off => Wanted::Off,
            Order::Stop => {
                // The order is repeated until telemetry states the stop.
                if !is_latched {
                    self.latch_stop(now, self.session.operator(now));
                }
                Wanted::Off
            }
            Order::Arm(_) => Wanted::Arm,
            Order::Shake(_, setpoint) => {
                self.asked.set(&setpoint);
                Wanted::Shake
            }
            Order::Try(_, trial) => {
                self.asked.trial = Some(trial);
                Wanted::Try
            }
            Order::Clear(_) => Wanted::Clear,
        };
        self.asked.want(wanted, order.permit().unwrap_or(self.report.permit));
    }

    /// Returns why this order cannot begin to drive motors yet, whatever the state.
    fn check_begin(&mut self, order: &Order, settings: &Settings) -> Option<Withheld> {
        let is_arm = matches!(order, Order::Arm(_));
        if !is_arm && !matches!(order, Order::Try(..)) {
            return None;
        }
        if is_arm && self.check_settings(settings).is_err() {
            return Some(Withheld::Settings);
        }
        (!self.steadiness.is_proven()).then_some(Withheld::LinkUnproven)
    }

    /// Returns why the newest order is not obeyed, by the newest report. A fault is named before a stop: a person looks for it first.
    fn why_withheld(&self) -> Option<Withheld> {
        let order = self.order?;
        let Report { state, stopped, faults, permit, .. } = self.report;
        let is_old = order.permit().is_some_and(|it| it != permit);
        match (order, state) {
            (Order::Off | Order::Stop, _) => None,
            // Not handed on.
            _ if matches!(
                self.withheld,
                Some(Withheld::Late { .. } | Withheld::Range | Withheld::NoCurrentSense)
            ) =>
            {
                self.withheld
            }
            (Order::Arm(_), State::Aligning | State::Armed | State::Running)
            | (Order::Try(..), State::Aligning) => None,
            (Order::Clear(_), State::Disarmed | State::Faulted) => {
                (is_old && (stopped || !faults.is_empty())).then_some(Withheld::Permit)
            }
            (Order::Clear(_), _) => Some(Withheld::State),
            _ if !faults.is_empty() => Some(Withheld::Faulted),
            _ if stopped => Some(Withheld::Stopped),
            _ if is_old => Some(Withheld::Permit),
            (Order::Shake(..), State::Armed | State::Running) => None,
            (Order::Arm(_) | Order::Try(..), State::Disarmed) => self.withheld,
            _ => Some(Withheld::State),
        }
    }

    fn note_sign_of_life(&mut self, now: Instant) {
        let moment = self.session.moment().unwrap_or_default();
        self.asked.hear(now, moment + self.session.command_age());
    }

    /// Refuses settings that nothing is armed with.
    fn check_settings(&mut self, settings: &Settings) -> Result<(), Refusal> {
        match settings.assumed(self.measures_current()) {
            Some(name) => Err(self.refuse_assumed(name)),
            None => self.judge(settings).clone(),
        }
    }

    /// Returns what is to be said of settings. Changed ones are judged before anything waits for it.
    fn judge(&mut self, settings: &Settings) -> &Result<(), Refusal> {
        if !self.judged.is_of(settings) {
            self.judged = Judged::of(settings, &self.hardware);
        }
        &self.judged.verdict
    }

    const fn measures_current(&self) -> bool {
        self.hardware.current_sense.is_some()
    }

    fn refuse_assumed(&self, name: &str) -> Refusal {
        let name = text(name);
        if self.measures_current() {
            Refusal::Assumed { name }
        } else {
            Refusal::AssumedUnmeasured { name }
        }
    }

    /// Returns whether the fast half is idle and nothing on its way could change that, however old its
    /// report is: it starts to move only when it is asked to arm, or for a trial.
    fn is_at_rest(&self) -> bool {
        let Asked { number, stops, halts, .. } = self.asked;
        let report = &self.report;
        let is_obeyed = (number, stops, halts) == (report.obeyed, report.stops, report.halts);
        is_obeyed && report.settled().is_idle()
    }

    /// Returns whether the order in force may begin to drive the motors of a robot at rest. The stop or the fault of the newest
    /// report may have been cleared since.
    fn is_beginning(&self) -> bool {
        let Asked { wanted, permit, begins, .. } = self.asked;
        begins && matches!(wanted, Wanted::Arm | Wanted::Try) && permit == self.report.permit
    }

    /// Latches the stop. Who latched the stop is who asked first.
    fn latch_stop(&mut self, now: Instant, by: Option<OperatorName>) {
        if !self.report.stopped {
            self.stopped_by = by;
        }
        self.latched_at = now;
        self.asked.stops = self.asked.stops.wrapping_add(1);
    }

    fn tune<S: SettingsStore>(
        &mut self,
        now: Instant,
        command: ParameterCommand,
        tuning: &mut Tuning<S>,
    ) -> Result<Outcome, Refusal> {
        match command {
            ParameterCommand::Get(name) => return parameter(tuning.settings(), &name),
            ParameterCommand::List(first) => return Ok(list(tuning.settings(), first)),
            ParameterCommand::Set(name, value) => {
                return self.put(tuning, &name, value, Mark::Entered);
            }
            ParameterCommand::Put(name, value, mark) => {
                return self.put(tuning, &name, value, mark);
            }
            ParameterCommand::Check => self.check_settings(tuning.settings())?,
            ParameterCommand::Accept => {
                self.check_idle()?;
                let accepted = tuning.accept(self.measures_current());
                accepted.map_err(|name| self.refuse_assumed(name))?;
            }
            ParameterCommand::Reset => {
                self.check_idle()?;
                tuning.reset();
                self.session.set_command_age(command_age(tuning.settings()));
                let _ = self.judge(tuning.settings());
            }
            ParameterCommand::Save => {
                self.check_state(self.report.settled())?;
                tuning.save().map_err(|_| Refusal::Storage)?;
                self.events.push(now, Event::SettingsSaved);
            }
        }
        Ok(Outcome::Done)
    }

    fn put<S: SettingsStore>(
        &mut self,
        tuning: &mut Tuning<S>,
        name: &str,
        value: f32,
        mark: Mark,
    ) -> Result<Outcome, Refusal> {
        self.check_idle()?;
        tuning.put(name, value, mark)?;
        self.session.set_command_age(command_age(tuning.settings()));
        let _ = self.judge(tuning.settings());
        parameter(tuning.settings(), name)
    }

    /// Accepts a change of settings only while the motors are not driven, nor may be before the fast
    /// half reports again.
    fn check_idle(&self) -> Result<(), Refusal> {
        self.check_state(self.report.state)
    }

    fn check_state(&self, state: State) -> Result<(), Refusal> {
        match state {
            state if !state.is_idle() => Err(Refusal::State(state)),
            _ if self.is_beginning() => Err(Refusal::State(State::Aligning)),
            _ => Ok(()),
        }
    }

    /// Returns whether flash may be written, which holds up the fast loop: rotors rest, and none may turn before the fast half reports
    /// again.
    pub(crate) fn may_write(&self) -> bool {
        self.check_state(self.report.settled()).is_ok()
    }

    fn next_message(
        &mut self,
        now: Instant,
        operator: OperatorName,
        settings: &Settings,
    ) -> Option<ToOperator> {
        if let Some(reply) = self.replies.pop_front() {
            return Some(ToOperator::Reply(reply));
        }
        if let Some(event) = self.events.queue.pop_front() {
            return Some(ToOperator::Event(event));
        }
        if now < self.telemetry_due || !self.is_counted() {
            return None;
        }
        let mut interval = Duration::from_secs_f32(1.0 / settings.telemetry_rate);
        if self.order.is_some() {
            interval = interval.min(SLOWEST_TELEMETRY);
        }
        let next = self.telemetry_due + interval;
        self.telemetry_due = if next > now { next } else { now + interval };
        Some(ToOperator::Telemetry(self.telemetry(now, operator)))
    }

    /// Returns the pair that the robot follows.
    fn followed(&self) -> Setpoint {
        let Report { state, permit, .. } = self.report;
        let is_followed = matches!(state, State::Armed | State::Running);
        match self.handed_on {
            Order::Shake(shown, setpoint) if shown == permit && is_followed => setpoint,
            _ => Setpoint::REST,
        }
    }

    fn telemetry(&mut self, now: Instant, operator: OperatorName) -> Telemetry {
        self.asked.period = self.asked.period.wrapping_add(1);
        let link = self.quality(now);
        let report = &self.report;
        let is_latched = report.stopped || !report.faults.is_empty();
        let now_alone = [report.direction; 3];
        let [direction, least, largest] = report.interval.theta().unwrap_or(now_alone);
        let bus = report.bus_voltage.map(|now| report.interval.bus().unwrap_or([now; 3]));
        Telemetry {
            time: report.time,
            state: report.state,
            faults: report.faults,
            first_fault: report.first_fault,
            stopped: report.stopped,
            link_late: report.link_late,
            frequency_limited: report.frequency_limited,
            permit: report.permit,
            halt: report.halt,
            heard: self.heard.0,
            held_us: u16::try_from(now.since(self.heard.1).as_micros()).unwrap_or(u16::MAX),
            withheld: self.why_withheld(),
            setpoint: self.followed(),
            frequency: report.frequency.into(),
            direction: direction.into(),
            direction_range: [least, largest].map(Degrees::from),
            motors: [motor(report, 0), motor(report, 1)],
            encoders: self.encoders(),
            bus_voltage: bus.map(|[mean, ..]| mean.into()),
            bus_voltage_range: bus.map(|[_, least, largest]| [least, largest].map(Volts::from)),
            modulation: Ratio::saturating(f32::from(report.modulation) / f32::from(u16::MAX)),
            timing: report.timing,
            link,
            operator,
            stopped_by: self.stopped_by.filter(|_| report.stopped),
            latched_at: is_latched.then_some(self.latched_at),
        }
    }
}

/// Returns who the robot says it is: its name and board, cut to what fits, and this firmware's version; started by power.
#[must_use]
pub fn identity(name: &str, hardware: &Hardware) -> Identity {
    Identity {
        name: text(name),
        board: text(hardware.name),
        version: text(env!("CARGO_PKG_VERSION")),
        reset: ResetReason::PowerOn,
    }
}

/// Returns what the robot answers of the board's bridges.
#[must_use]
pub const fn bridges(hardware: &Hardware) -> Bridges {
    Bridges {
        dead_time_ns: hardware.dead_time_ns,
        pwm_frequency_hz: hardware.pwm_frequency_hz,
        measures_bus: hardware.bus_microvolts_per_count.is_some(),
        measures_current: hardware.current_sense.is_some(),
    }
}

fn command_age(settings: &Settings) -> Duration {
    Duration::from_secs_f32(settings.command_age)
}

fn parameter(settings: &Settings, name: &str) -> Result<Outcome, Refusal> {
    Settings::position(name)
        .and_then(|index| settings.parameter(index))
        .map(Outcome::Parameter)
        .ok_or(Refusal::UnknownParameter)
}

fn list(settings: &Settings, first: u16) -> Outcome {
    let first = usize::from(first);
    let entries: Vec<_, PARAMETERS_PER_REPLY> = (first..first + PARAMETERS_PER_REPLY)
        .filter_map(|index| settings.parameter(index))
        .collect();
    Outcome::Parameters { total: settings::COUNT as u16, entries }
}

/// Adds an item; when the queue is full, the oldest goes.
pub(crate) fn push_newest<T, const N: usize>(queue: &mut Deque<T, N>, item: T) {
    if queue.is_full() {
        queue.pop_front();
    }
    // Just made room.
    let _ = queue.push_back(item);
}

/// Whole milliseconds; the most there is when the time is unknown or does not fit.
fn milliseconds(time: Option<Duration>) -> u16 {
    time.and_then(|time| u16::try_from(time.as_millis()).ok()).unwrap_or(u16::MAX)
}

/// Events on the way to the operator.
#[derive(Debug, Default)]
struct Events {
    next: u32,
    queue: Deque<EventReport, EVENTS>,
}

impl Events {
    fn push(&mut self, time: Instant, event: Event) {
        push_newest(&mut self.queue, EventReport { number: self.next, time, event });
        self.next = self.next.wrapping_add(1);
    }
}

fn motor(report: &Report, index: usize) -> MotorTelemetry {
    let motor = report.motors[index];
    let now_alone = [motor.current_q; 3];
    let [mean, least, largest] = report.interval.current(index).unwrap_or(now_alone);
    MotorTelemetry {
        angle: motor.angle.into(),
        speed: motor.speed.into(),
        current_d: motor.current_d.into(),
        current_q: mean.into(),
        current_q_range: [least, largest].map(Amperes::from),
    }
}
