//! A robot's end of the link with just enough of a robot behind it to test operators.
#![allow(dead_code, unreachable_pub, reason = "every test file uses its part")]
#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use flix_protocol::message::{
    Bridges, Command, CrashReport, Event, EventReport, Fault, Faults, Identity, LoopTiming, Mark,
    MotorTelemetry, OperatorName, Outcome, Parameter, ParameterCommand, Refusal, Reply,
    ResetReason, Setpoint, State, Telemetry, ToOperator, ToRobot,
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
    pub faults: Faults,
    pub setpoint: Setpoint,
    /// Number of the last wish of a person.
    pub intent: u8,
    pub parameters: Vec<Parameter>,
    /// All commands that were obeyed or refused, in order.
    pub commands: Vec<Command>,
    /// Latches this fault as soon as it runs.
    pub fault_when_running: Option<Fault>,
    /// Reports so many times while it runs that it ramps down, as after commands that came late.
    pub reports_of_late_commands: u32,
    /// Refuses that many requests to arm or to clear, as a robot does while its rotors ramp down.
    pub ramps_down_for: u32,
    /// How often it halted in this session although nobody there asked for it.
    halts: u8,
    /// The largest number of a request that was to change something, as a robot keeps it.
    changed: Option<u32>,
    /// Comes over it once it is cleared.
    pub after_clearing: Option<fn(&mut Self)>,
    /// A command that is lost on its way, however often it is sent.
    pub lost: Option<Command>,
    /// A command whose answers are lost on their way.
    pub lost_answer: Option<Command>,
    /// Hears nothing, and is still heard.
    pub is_deaf: bool,
    /// Takes for ever to align its motors.
    pub aligns_for_ever: bool,
    /// Disarms once instead of aligning its motors: halted by commands that stayed away, or for no such reason.
    pub lapses: Option<bool>,
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
            faults: Faults::NONE,
            setpoint: Setpoint::REST,
            intent: 0,
            parameters: parameters(),
            commands: Vec::new(),
            fault_when_running: None,
            reports_of_late_commands: 0,
            ramps_down_for: 0,
            halts: 0,
            changed: None,
            after_clearing: None,
            lost: None,
            lost_answer: None,
            is_deaf: false,
            aligns_for_ever: false,
            lapses: None,
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
        (self.stopped, self.halts) = (true, self.halts + 1);
    }

    /// Halts by itself, as after commands that stayed away.
    pub fn halt(&mut self) {
        self.halts += 1;
    }

    /// Latches a fault.
    pub fn fail(&mut self, fault: Fault) {
        self.faults = self.faults.with(fault);
        self.state = State::Faulted;
        self.setpoint = Setpoint::REST;
        self.halt();
    }

    /// Knows another key alone from now on.
    pub fn revoke(&mut self) {
        self.session.set_operators(Some(Key::new([8; 32])));
        self.state = State::Disarmed;
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
                (self.proven_since, self.halts, self.changed) = (Some(now), 0, None);
                let mut datagrams = vec![(from, frame.to_vec())];
                datagrams.extend(self.report(now, Event::OperatorConnected(OperatorName::OWNER)));
                datagrams
            }
            RobotReceived::Command(ToRobot { command, .. })
                if self.lost.as_ref() == Some(&command) =>
            {
                Vec::new()
            }
            // As a robot does: what was asked before the newest change does nothing, and is not answered.
            RobotReceived::Command(ToRobot { request, command, .. })
                if !command.is_question()
                    && !matches!(
                        command,
                        Command::Setpoint(_) | Command::Stop | Command::Disarm
                    )
                    && self
                        .changed
                        .is_some_and(|it| request.wrapping_sub(it).cast_signed() < 0) =>
            {
                Vec::new()
            }
            RobotReceived::Command(ToRobot { request, intent, halts, command }) => {
                if !command.is_question() && !matches!(command, Command::Setpoint(_)) {
                    self.changed = Some(self.changed.map_or(request, |it| it.max(request)));
                }
                self.intent = intent;
                let outcome = match command {
                    // Asked for by somebody who has not heard of the last halt.
                    Command::Clear if halts != self.halts && self.stopped => {
                        Outcome::Refused(Refusal::Stopped)
                    }
                    Command::Clear if halts != self.halts => {
                        Outcome::Refused(Refusal::Faulted(self.faults))
                    }
                    Command::Arm if halts != self.halts && self.state.is_idle() => {
                        Outcome::Refused(Refusal::Rested)
                    }
                    _ => self.obey(now, &command),
                };
                self.commands.push(command.clone());
                if self.lost_answer.as_ref() == Some(&command) {
                    return Vec::new();
                }
                self.send(now, &ToOperator::Reply(Reply { request, outcome }))
            }
            RobotReceived::Late { command: ToRobot { request, .. }, age } => {
                let age_ms = age.map_or(u16::MAX, |age| age.as_millis() as u16);
                let refusal = Refusal::Late { age_ms, limit_ms: 400 };
                let outcome = Outcome::Refused(refusal);
                self.send(now, &ToOperator::Reply(Reply { request, outcome }))
            }
            RobotReceived::Refused { request, refusal } => {
                let outcome = Outcome::Refused(refusal);
                self.send(now, &ToOperator::Reply(Reply { request, outcome }))
            }
            RobotReceived::Stop(frame, by) => {
                self.obey(now, &Command::Stop);
                self.stopped_by = by;
                self.halts += 1;
                self.commands.push(Command::Stop);
                let mut datagrams = vec![(from, frame.to_vec())];
                datagrams.extend(self.report(now, Event::StoppedFromOutside(by)));
                datagrams
            }
            RobotReceived::Left => {
                self.state = State::Disarmed;
                Vec::new()
            }
            RobotReceived::Dropped(_, None) => Vec::new(),
        }
    }

    pub fn tick(&mut self, now: Instant) -> Datagrams {
        let silence = self.session.silence(now).unwrap_or(Duration::MAX);
        if silence > COMMAND_DEADLINE && self.state == State::Running {
            self.setpoint = Setpoint::REST;
            self.state = State::Armed;
        }
        if silence > DISARM && self.state == State::Armed {
            self.state = State::Disarmed;
            self.halt();
        }
        let mut datagrams = Vec::new();
        if let (Some(fault), State::Running) = (self.fault_when_running, self.state) {
            self.fail(fault);
            datagrams.extend(self.report(now, Event::Fault(fault)));
        }
        if now >= self.telemetry_at {
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

    fn report(&mut self, now: Instant, event: Event) -> Datagrams {
        self.events += 1;
        let report = EventReport { number: self.events, time: now, event };
        self.send(now, &ToOperator::Event(report))
    }

    fn obey(&mut self, now: Instant, command: &Command) -> Outcome {
        if matches!(command, Command::Arm | Command::Clear) && self.ramps_down_for > 0 {
            self.ramps_down_for -= 1;
            return Outcome::Refused(Refusal::State(State::Stopping));
        }
        match command {
            Command::Scope(_) => Outcome::Refused(Refusal::NotCaptured),
            Command::Trial(_) => Outcome::Refused(Refusal::NoCurrentSense),
            Command::Bridges => Outcome::Bridges(BRIDGES),
            Command::Stop => {
                (self.stopped, self.stopped_at) = (true, Some(now));
                self.setpoint = Setpoint::REST;
                if self.state != State::Faulted {
                    self.state = State::Disarmed;
                }
                Outcome::Done
            }
            Command::Clear => {
                self.stopped = false;
                self.faults = Faults::NONE;
                if self.state == State::Faulted {
                    self.state = State::Disarmed;
                }
                if let Some(comes) = self.after_clearing.take() {
                    comes(self);
                }
                Outcome::Done
            }
            Command::Disarm => {
                self.state = State::Disarmed;
                self.setpoint = Setpoint::REST;
                Outcome::Done
            }
            Command::Arm => self.arm(now),
            Command::Setpoint(setpoint) => self.shake(*setpoint),
            Command::Parameter(command) => self.parameter(command),
            Command::Identify => Outcome::Identity(Identity {
                name: "fake".try_into().unwrap(),
                board: "none".try_into().unwrap(),
                version: "0.1.0".try_into().unwrap(),
                reset: self.reset.clone(),
            }),
            Command::Crash => Outcome::Crash(self.crash.clone()),
            Command::Ping(number) => Outcome::Pong(*number),
            Command::Order(_) => Outcome::Done,
        }
    }

    fn arm(&mut self, now: Instant) -> Outcome {
        if self.stopped {
            Outcome::Refused(Refusal::Stopped)
        } else if !self.faults.is_empty() {
            Outcome::Refused(Refusal::Faulted(self.faults))
        } else if self.proven_since.is_none_or(|since| now.since(since) < LINK_PROOF) {
            Outcome::Refused(Refusal::LinkUnproven)
        } else {
            self.state = match self.lapses.take() {
                Some(is_halted) => {
                    self.halts += u8::from(is_halted);
                    State::Disarmed
                }
                None if self.aligns_for_ever => State::Aligning,
                None => State::Armed,
            };
            Outcome::Done
        }
    }

    fn shake(&mut self, setpoint: Setpoint) -> Outcome {
        if let Err(error) = setpoint.check() {
            return Outcome::Refused(error.into());
        }
        match self.state {
            State::Armed | State::Running => {
                self.setpoint = setpoint;
                let rests = setpoint == Setpoint::REST;
                self.state = if rests { State::Armed } else { State::Running };
                Outcome::Done
            }
            _ if self.stopped => Outcome::Refused(Refusal::Stopped),
            State::Faulted => Outcome::Refused(Refusal::Faulted(self.faults)),
            state => Outcome::Refused(Refusal::State(state)),
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
            state: self.state,
            faults: self.faults,
            first_fault: self.faults.iter().next(),
            stopped: self.stopped,
            link_late: false,
            frequency_limited: false,
            halts: self.halts,
            permit: Default::default(),
            halt: Default::default(),
            heard: 0,
            held_us: 0,
            withheld: None,
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
            stopped_at: self.stopped_at.filter(|_| self.stopped),
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
    pub fn new(robot: FakeRobot, mut lose: impl FnMut() -> bool + Send + 'static) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
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
