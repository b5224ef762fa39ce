//! A robot's end of the link with just enough of a robot behind it to test operators.
#![allow(dead_code, unreachable_pub, reason = "every test file uses its part")]
#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use flix_protocol::message::{
    Bridges, Command, CrashReport, Event, EventReport, Fault, Faults, Halt, Identity, LoopTiming,
    Mark, MotorTelemetry, OperatorName, Order, Outcome, Parameter, ParameterCommand, Permit,
    Refusal, Reply, Request, ResetReason, Setpoint, State, Telemetry, ToOperator, ToRobot,
    Withheld,
};
use flix_protocol::session::{Key, RobotReceived, RobotSession};
use flix_protocol::units::{Amperes, Degrees, Hertz, Instant, Ratio, Volts};

/// The key that robot and operator share in tests.
pub fn key() -> Key {
    Key::new([7; 32])
}

/// A mode table.
pub const MODES: &str = r#"
robot = "test"
source = "made up"

[[mode]]
name = "forward"
frequency_hz = -30.0
direction_deg = 30.0
forward_m_s = { mean = 0.08, spread = 0.01 }
lateral_m_s = { mean = 0.0, spread = 0.01 }
yaw_rad_s = { mean = 0.3, spread = 0.1 }
"#;

const TELEMETRY_INTERVAL: Duration = Duration::from_millis(20);
const LINK_PROOF: Duration = Duration::from_millis(500);
const COMMAND_DEADLINE: Duration = Duration::from_millis(250);
const DISARM: Duration = Duration::from_secs(1);

/// Bridges of a board that measures no phase currents.
const BRIDGES: Bridges = Bridges {
    dead_time_ns: 300,
    pwm_frequency_hz: 20_000,
    measures_bus: true,
    measures_current: false,
};

/// Datagrams with where they go.
pub type Datagrams = Vec<(SocketAddr, Vec<u8>)>;

/// A robot without a body: it is at once what it is commanded to be.
pub struct FakeRobot {
    session: RobotSession,
    pub reset: ResetReason,
    pub crash: Option<CrashReport>,
    pub state: State,
    pub stopped: bool,
    /// Who is reported to have latched the stop.
    pub stopped_by: OperatorName,
    /// When it was asked to stop for the last time.
    pub stopped_at: Option<Instant>,
    pub failed_at: Option<Instant>,
    pub faults: Faults,
    pub setpoint: Setpoint,
    pub parameters: Vec<Parameter>,
    /// All commands that arrived, in order; an order that is repeated is one.
    pub messages: Vec<ToRobot>,
    /// Number of orders that arrived.
    pub orders: usize,
    /// Latches this fault as soon as it runs.
    pub fault_when_running: Option<Fault>,
    /// Reports so many times while it runs that it ramps down, as after commands that came late.
    pub reports_of_late_commands: u32,
    /// Passes over that many orders to arm or to clear, as a robot does while its rotors ramp down.
    pub ramps_down_for: u32,
    /// Does not arm with the settings that it has.
    pub minds_settings: bool,
    /// Reports a low battery as soon as it is armed.
    pub is_low: bool,
    /// Never takes its link for steady.
    pub is_unproven: bool,
    /// The number that an order has to carry.
    pub permit: Permit,
    /// Why that was counted up last.
    pub halted_by: Halt,
    /// The largest number of a request that was to change something, as a robot keeps it.
    changed: Option<u32>,
    /// Comes over it once it is cleared.
    pub after_clearing: Option<fn(&mut Self)>,
    /// Messages that are lost on their way, however often they are sent.
    pub loses: fn(&ToRobot) -> bool,
    /// Hears nothing, and is still heard.
    pub is_deaf: bool,
    /// States nothing, and still answers.
    pub is_mute: bool,
    /// Takes for ever to align its motors.
    pub aligns_for_ever: bool,
    /// Disarms once instead of aligning its motors, for this reason.
    pub lapses: Option<Halt>,
    /// The newest order.
    order: Option<Order>,
    /// The newest order that is not withheld.
    wanted: Order,
    /// Whether that may begin anything.
    begins: bool,
    withheld: Option<Withheld>,
    heard: u64,
    heard_at: Instant,
    proven_since: Option<Instant>,
    telemetry_at: Instant,
    events: u32,
}

impl FakeRobot {
    pub fn new(key: Option<Key>) -> Self {
        Self {
            session: RobotSession::new(key, [3; 32]),
            reset: ResetReason::PowerOn,
            crash: None,
            state: State::Disarmed,
            stopped: false,
            stopped_by: OperatorName::OWNER,
            stopped_at: None,
            failed_at: None,
            faults: Faults::NONE,
            setpoint: Setpoint::REST,
            parameters: parameters(),
            messages: Vec::new(),
            orders: 0,
            fault_when_running: None,
            reports_of_late_commands: 0,
            ramps_down_for: 0,
            minds_settings: false,
            is_low: false,
            is_unproven: false,
            permit: Permit::default(),
            halted_by: Halt::Started,
            changed: None,
            after_clearing: None,
            loses: |_| false,
            is_deaf: false,
            is_mute: false,
            aligns_for_ever: false,
            lapses: None,
            order: None,
            wanted: Order::Off,
            begins: false,
            withheld: None,
            heard: 0,
            heard_at: Instant::START,
            proven_since: None,
            telemetry_at: Instant::START,
            events: 0,
        }
    }

    /// Starts anew, as after a loss of power.
    pub fn restart(&mut self) {
        let robot = Self::new(Some(key()));
        *self = Self { session: RobotSession::new(Some(key()), [4; 32]), ..robot };
    }

    /// Is stopped by its owner's other program.
    pub fn stop_from_outside(&mut self) {
        self.stopped = true;
        self.count(Halt::StoppedFromOutside);
        self.come_to_rest();
    }

    /// Halts by itself, as after commands that stayed away.
    pub fn halt(&mut self) {
        self.count(Halt::Rested);
    }

    /// Disarms by itself, as after commands that stayed away for long.
    pub fn lose_link(&mut self) {
        self.count(Halt::LinkLost);
        self.come_to_rest();
    }

    /// Latches a fault.
    pub fn fail(&mut self, fault: Fault) {
        self.faults = self.faults.with(fault);
        self.state = State::Faulted;
        self.setpoint = Setpoint::REST;
        self.count(Halt::Fault);
    }

    fn count(&mut self, halt: Halt) {
        (self.permit, self.halted_by) = (self.permit.next(), halt);
    }

    fn come_to_rest(&mut self) {
        self.setpoint = Setpoint::REST;
        if self.state != State::Faulted {
            self.state = State::Disarmed;
        }
    }

    /// Knows another key alone from now on.
    pub fn revoke(&mut self) {
        self.session.set_operators(Some(Key::new([8; 32])));
        self.change_operator();
    }

    fn change_operator(&mut self) {
        self.count(Halt::Operator);
        self.come_to_rest();
        (self.order, self.wanted, self.withheld, self.heard) = (None, Order::Off, None, 0);
        self.changed = None;
    }

    pub fn receive(&mut self, now: Instant, from: SocketAddr, datagram: &[u8]) -> Datagrams {
        if self.is_deaf {
            return Vec::new();
        }
        self.session.set_at_rest(self.stopped);
        match self.session.receive(now, from, datagram) {
            RobotReceived::Answer(frame) | RobotReceived::Dropped(_, Some(frame)) => {
                vec![(from, frame.to_vec())]
            }
            RobotReceived::Connected(frame) => {
                self.change_operator();
                (self.proven_since, self.heard_at) = (Some(now), now);
                let mut datagrams = vec![(from, frame.to_vec())];
                datagrams.extend(self.report(now, Event::OperatorConnected(OperatorName::OWNER)));
                datagrams
            }
            RobotReceived::Message(message) if (self.loses)(&message) => Vec::new(),
            RobotReceived::Message(ToRobot::Order(order)) => {
                self.receive_order(now, order, None);
                Vec::new()
            }
            // As a robot does: a change that was asked for before the newest does nothing, and is not answered.
            RobotReceived::Message(ToRobot::Request(request))
                if !request.command.is_question()
                    && self
                        .changed
                        .is_some_and(|it| request.number.wrapping_sub(it).cast_signed() < 0) =>
            {
                Vec::new()
            }
            RobotReceived::Message(ToRobot::Request(request)) => {
                let Request { number, command } = &request;
                if !command.is_question() {
                    self.changed = Some(*number);
                }
                let reply = Reply { request: *number, outcome: self.obey(command) };
                self.messages.push(ToRobot::Request(request));
                self.send(now, &ToOperator::Reply(reply))
            }
            RobotReceived::Late { message, age } => {
                let age_ms = age.map_or(u16::MAX, |age| age.as_millis() as u16);
                let limit_ms = 400;
                match message {
                    ToRobot::Order(order) => {
                        self.receive_order(now, order, Some(Withheld::Late { age_ms, limit_ms }));
                        Vec::new()
                    }
                    ToRobot::Request(Request { number, .. }) => {
                        self.refuse(now, number, Refusal::Late { age_ms, limit_ms })
                    }
                }
            }
            RobotReceived::Unreadable(number) => self.refuse(now, number, Refusal::Malformed),
            RobotReceived::Stop(frame, by) => {
                self.stop_from_outside();
                (self.stopped_by, self.stopped_at) = (by, Some(now));
                let mut datagrams = vec![(from, frame.to_vec())];
                datagrams.extend(self.report(now, Event::StoppedFromOutside(by)));
                datagrams
            }
            RobotReceived::Left => {
                self.change_operator();
                Vec::new()
            }
            RobotReceived::Dropped(_, None) => Vec::new(),
        }
    }

    pub fn tick(&mut self, now: Instant) -> Datagrams {
        self.climb_ladder(now);
        self.look(now);
        let mut datagrams = Vec::new();
        if self.state == State::Armed && std::mem::take(&mut self.is_low) {
            datagrams.extend(self.report(now, Event::BatteryLow(Volts::saturating(9.5))));
        }
        if let (Some(fault), State::Running) = (self.fault_when_running, self.state) {
            self.fail(fault);
            datagrams.extend(self.report(now, Event::Fault(fault)));
        }
        if now >= self.telemetry_at && !self.is_mute {
            self.telemetry_at = now + TELEMETRY_INTERVAL;
            let mut telemetry = self.telemetry(now);
            if self.state == State::Running && self.reports_of_late_commands > 0 {
                self.reports_of_late_commands -= 1;
                telemetry.state = State::Stopping;
            }
            datagrams.extend(self.send(now, &ToOperator::Telemetry(telemetry)));
        }
        datagrams
    }

    fn send(&mut self, now: Instant, message: &ToOperator) -> Datagrams {
        self.session
            .send(now, message)
            .map(|(to, frame)| (to, frame.to_vec()))
            .into_iter()
            .collect()
    }

    fn refuse(&mut self, now: Instant, request: u32, refusal: Refusal) -> Datagrams {
        let outcome = Outcome::Refused(refusal);
        self.send(now, &ToOperator::Reply(Reply { request, outcome }))
    }

    fn report(&mut self, now: Instant, event: Event) -> Datagrams {
        self.events += 1;
        let report = EventReport { number: self.events, time: now, event };
        self.send(now, &ToOperator::Event(report))
    }

    /// Takes an order; `late` where it was too old when it arrived.
    fn receive_order(&mut self, now: Instant, order: Order, late: Option<Withheld>) {
        self.orders += 1;
        if self.order.replace(order) != Some(order) {
            self.messages.push(ToRobot::Order(order));
        }
        self.withheld = match order {
            Order::Off | Order::Stop => None,
            Order::Try(..) => Some(Withheld::NoCurrentSense),
            Order::Shake(_, setpoint) if setpoint.check().is_err() => Some(Withheld::Range),
            Order::Shake(..) | Order::Arm(_) | Order::Clear(_) => late,
        };
        if self.withheld.is_some() {
            return;
        }
        if late.is_none() {
            self.heard_at = now;
        }
        self.heard = self.session.newest_message();
        if order == Order::Stop {
            (self.stopped, self.stopped_at) = (true, Some(now));
            self.stopped_by = self.session.operator(now).unwrap_or(OperatorName::OWNER);
        }
        self.withheld = self.check_begin(now, order);
        self.begins = self.withheld.is_none();
        self.wanted = order;
        self.look(now);
    }

    /// Returns why this order cannot begin anything yet.
    fn check_begin(&mut self, now: Instant, order: Order) -> Option<Withheld> {
        if matches!(order, Order::Arm(_) | Order::Clear(_)) && self.ramps_down_for > 0 {
            self.ramps_down_for -= 1;
            return Some(Withheld::State);
        }
        let is_proven = self.proven_since.is_some_and(|since| now.since(since) >= LINK_PROOF);
        match order {
            Order::Arm(_) if self.minds_settings => Some(Withheld::Settings),
            Order::Arm(_) if self.is_unproven || !is_proven => Some(Withheld::LinkUnproven),
            _ => None,
        }
    }

    /// Obeys the order in force, as long as that is the same.
    fn look(&mut self, now: Instant) {
        let order = self.wanted;
        let is_present = order.permit() == Some(self.permit);
        let may_align = self.begins && !self.stopped && now.since(self.heard_at) < COMMAND_DEADLINE;
        match (self.state, order) {
            (State::Disarmed, Order::Arm(_)) if is_present && may_align => self.align(),
            (State::Disarmed | State::Faulted, Order::Clear(_)) if is_present && self.begins => {
                self.clear();
            }
            (State::Aligning | State::Armed | State::Running, Order::Off | Order::Stop)
            | (State::Stopping, Order::Stop) => self.come_to_rest(),
            (State::Aligning, _) if !self.aligns_for_ever => {
                self.state = State::Armed;
                self.count(Halt::Aligned);
            }
            (State::Armed | State::Running, Order::Shake(_, setpoint)) if is_present => {
                self.setpoint = setpoint;
                let rests = setpoint.frequency() == Hertz::ZERO;
                self.state = if rests { State::Armed } else { State::Running };
            }
            (State::Armed | State::Running, _) => {
                (self.setpoint, self.state) = (Setpoint::REST, State::Armed);
            }
            _ => {}
        }
    }

    fn align(&mut self) {
        match self.lapses.take() {
            Some(halt) => self.count(halt),
            None if self.aligns_for_ever => self.state = State::Aligning,
            None => {
                self.state = State::Armed;
                self.count(Halt::Aligned);
            }
        }
    }

    fn clear(&mut self) {
        if !self.stopped && self.faults.is_empty() {
            return;
        }
        (self.stopped, self.faults, self.state) = (false, Faults::NONE, State::Disarmed);
        if let Some(comes) = self.after_clearing.take() {
            comes(self);
        }
    }

    /// Comes to rest, then disarms, where orders stay away.
    fn climb_ladder(&mut self, now: Instant) {
        let silence = now.since(self.heard_at);
        match self.state {
            State::Running if silence > COMMAND_DEADLINE => {
                (self.setpoint, self.state) = (Setpoint::REST, State::Armed);
                self.count(Halt::Rested);
            }
            State::Aligning if silence > COMMAND_DEADLINE => {
                self.state = State::Disarmed;
                self.count(Halt::LetGo);
            }
            State::Armed if silence > DISARM => self.lose_link(),
            _ => {}
        }
    }

    /// Returns why the newest order is not obeyed.
    fn why_withheld(&self) -> Option<Withheld> {
        let order = self.order?;
        let is_old = order.permit().is_some_and(|it| it != self.permit);
        match (order, self.state) {
            (Order::Off | Order::Stop, _)
            | (Order::Arm(_), State::Aligning | State::Armed | State::Running) => None,
            _ if self.withheld.is_some_and(|it| it != Withheld::LinkUnproven) => self.withheld,
            (Order::Clear(_), _) => {
                ((self.stopped || !self.faults.is_empty()) && is_old).then_some(Withheld::Permit)
            }
            _ if !self.faults.is_empty() => Some(Withheld::Faulted),
            _ if self.stopped => Some(Withheld::Stopped),
            _ if is_old => Some(Withheld::Permit),
            (Order::Shake(..), State::Armed | State::Running) => None,
            (Order::Arm(_), State::Disarmed) => self.withheld,
            _ => Some(Withheld::State),
        }
    }

    fn obey(&mut self, command: &Command) -> Outcome {
        match command {
            Command::Scope(_) => Outcome::Refused(Refusal::NotCaptured),
            Command::Bridges => Outcome::Bridges(BRIDGES),
            Command::Parameter(command) => self.parameter(command),
            Command::Identify => Outcome::Identity(Identity {
                name: "fake".try_into().unwrap(),
                board: "none".try_into().unwrap(),
                version: "0.1.0".try_into().unwrap(),
                reset: self.reset.clone(),
            }),
            Command::Crash => Outcome::Crash(self.crash.clone()),
            Command::Ping(number) => Outcome::Pong(*number),
        }
    }

    fn parameter(&mut self, command: &ParameterCommand) -> Outcome {
        let unknown = Outcome::Refused(Refusal::UnknownParameter);
        match command {
            ParameterCommand::Get(name) => {
                let found = self.parameters.iter().find(|parameter| parameter.name == *name);
                found.map_or(unknown, |parameter| Outcome::Parameter(parameter.clone()))
            }
            ParameterCommand::Set(name, value) | ParameterCommand::Put(name, value, _) => {
                let found = self.parameters.iter_mut().find(|parameter| parameter.name == *name);
                let Some(parameter) = found else { return unknown };
                let (minimum, maximum) = (parameter.minimum, parameter.maximum);
                if !(minimum..=maximum).contains(value) {
                    return Outcome::Refused(Refusal::out_of_range(name, minimum, maximum));
                }
                parameter.value = *value;
                parameter.mark = match command {
                    _ if parameter.mark.is_none() => None,
                    ParameterCommand::Put(_, _, mark) => Some(*mark),
                    _ => Some(Mark::Entered),
                };
                Outcome::Parameter(parameter.clone())
            }
            ParameterCommand::Accept => {
                for parameter in &mut self.parameters {
                    parameter.mark = parameter.mark.map(|_| Mark::Entered);
                }
                Outcome::Done
            }
            ParameterCommand::Check => {
                let assumed = |it: &&Parameter| it.mark == Some(Mark::Assumed);
                self.parameters.iter().find(assumed).map_or(Outcome::Done, |it| {
                    Outcome::Refused(Refusal::Assumed { name: it.name.clone() })
                })
            }
            ParameterCommand::List(from) => Outcome::Parameters {
                total: u16::try_from(self.parameters.len()).unwrap(),
                entries: self.parameters.iter().skip(usize::from(*from)).take(4).cloned().collect(),
            },
            ParameterCommand::Save => Outcome::Done,
            ParameterCommand::Reset => {
                for parameter in &mut self.parameters {
                    parameter.value = parameter.default;
                }
                Outcome::Done
            }
        }
    }

    pub fn telemetry(&self, now: Instant) -> Telemetry {
        Telemetry {
            time: now,
            state: match self.state {
                State::Disarmed if self.ramps_down_for > 0 => State::Stopping,
                state => state,
            },
            faults: self.faults,
            first_fault: self.faults.iter().next(),
            stopped: self.stopped,
            link_late: false,
            frequency_limited: false,
            permit: self.permit,
            halt: self.halted_by,
            heard: self.heard,
            held_us: now.since(self.heard_at).as_micros().try_into().unwrap_or(u16::MAX),
            withheld: self.why_withheld(),
            setpoint: self.setpoint,
            frequency: self.setpoint.frequency(),
            direction: self.setpoint.direction(),
            direction_range: [self.setpoint.direction(); 2],
            motors: [1.0, -1.0].map(|sign| MotorTelemetry {
                angle: Degrees::saturating(10.0 * sign),
                speed: Hertz::saturating(sign * self.setpoint.frequency().get()),
                current_d: Amperes::ZERO,
                current_q: Amperes::saturating(0.3 * sign),
                current_q_range: [0.2, 0.4].map(|it| Amperes::saturating(it * sign)),
            }),
            encoders: Default::default(),
            bus_voltage: Some(Volts::saturating(11.4)),
            bus_voltage_range: Some([Volts::saturating(11.4); 2]),
            modulation: Ratio::saturating(0.4),
            timing: LoopTiming {
                ticks: now.as_micros() / 100,
                longest_interval_us: 101,
                ..LoopTiming::default()
            },
            link: self.session.quality(now),
            operator: self.session.operator(now).unwrap_or(OperatorName::OWNER),
            stopped_by: self.stopped.then_some(self.stopped_by),
            latched_at: self
                .stopped_at
                .filter(|_| self.stopped)
                .max(self.failed_at.filter(|_| !self.faults.is_empty())),
        }
    }
}

fn parameters() -> Vec<Parameter> {
    let rows = [
        ("current_limit", "A", 1.5, 0.1, 3.0),
        ("frequency_slew", "Hz/s", 100.0, 1.0, 500.0),
        ("direction_slew", "deg/s", 720.0, 10.0, 3600.0),
        ("battery_cut_off", "V", 9.6, 6.0, 12.0),
        ("loop_gain", "1", 1.0, 0.1, 10.0),
        ("pole_pairs", "1", 7.0, 1.0, 20.0),
        ("top_phases_reversed", "1", 0.0, 0.0, 1.0),
    ];
    (0u16..)
        .zip(rows)
        .map(|(index, (name, unit, default, minimum, maximum))| Parameter {
            index,
            name: name.try_into().unwrap(),
            unit: unit.try_into().unwrap(),
            value: default,
            default,
            minimum,
            maximum,
            mark: (name == "pole_pairs").then_some(Mark::Assumed),
        })
        .collect()
}

/// A fake robot on a loopback socket, in a thread of its own, until dropped.
pub struct ServedRobot {
    pub address: SocketAddr,
    robot: Arc<Mutex<FakeRobot>>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl ServedRobot {
    /// `lose` says of each datagram, in either direction, whether the network loses it.
    pub fn new(robot: FakeRobot, lose: impl FnMut() -> bool + Send + 'static) -> Self {
        Self::at("127.0.0.1", robot, lose)
    }

    /// The same, at this address of the computer.
    pub fn at(
        address: &str,
        robot: FakeRobot,
        mut lose: impl FnMut() -> bool + Send + 'static,
    ) -> Self {
        let socket = UdpSocket::bind((address, 0)).unwrap();
        socket.set_read_timeout(Some(Duration::from_millis(2))).unwrap();
        let address = socket.local_addr().unwrap();
        let robot = Arc::new(Mutex::new(robot));
        let ends = Arc::new(AtomicBool::new(false));
        let (shared, stop) = (Arc::clone(&robot), Arc::clone(&ends));
        let thread = std::thread::spawn(move || {
            let start = std::time::Instant::now();
            let mut buffer = [0; 600];
            while !stop.load(Ordering::SeqCst) {
                let received = socket.recv_from(&mut buffer);
                let now = Instant::START + start.elapsed();
                let mut robot = shared.lock().unwrap();
                let mut answers = Datagrams::new();
                if let Ok((length, from)) = received
                    && !lose()
                {
                    answers.extend(robot.receive(now, from, &buffer[..length]));
                }
                answers.extend(robot.tick(now));
                for (to, datagram) in answers {
                    if !lose() {
                        let _ = socket.send_to(&datagram, to);
                    }
                }
            }
        });
        Self { address, robot, ends, thread: Some(thread) }
    }

    pub fn steady(robot: FakeRobot) -> Self {
        Self::new(robot, || false)
    }

    pub fn robot(&self) -> std::sync::MutexGuard<'_, FakeRobot> {
        self.robot.lock().unwrap()
    }
}

impl Drop for ServedRobot {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Loses this share of datagrams, the same ones every time.
pub fn seeded_loss(seed: u64, share: f64) -> impl FnMut() -> bool + Send {
    let mut state = seed.wrapping_mul(2).wrapping_add(1);
    move || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as f64) < share * f64::from(1u32 << 31)
    }
}
