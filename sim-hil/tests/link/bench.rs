//! An operator whose datagrams arrive in the tick in which they are sent.

use std::net::SocketAddr;
use std::time::Duration;

use flix_firmware::settings::Settings;
use flix_protocol::frame::Frame;
use flix_protocol::message::{
    Command, Event, EventReport, LinkQuality, Order, Outcome, Permit, Reply, Setpoint, State,
    Telemetry, ToOperator, ToRobot,
};
use flix_protocol::session::{Key, OperatorReceived, OperatorSession};
use flix_protocol::units::Instant;
use flix_sim::model::RobotModel;
use flix_sim::plant::Plant;
use flix_sim::rig::simulated::{Flash, RobotParameters, SimulatedRobot};

pub(crate) use flix_firmware::hardware::TICK;
/// How often the operators here repeat themselves.
pub(crate) const KEEP_ALIVE: Duration = Duration::from_millis(20);
/// Longer than any alignment.
const PATIENCE: Duration = Duration::from_secs(20);

/// The operator's end of a session, and what came out of it.
pub(crate) struct Operator {
    pub(crate) address: SocketAddr,
    pub(crate) session: OperatorSession,
    requests: u32,
    pub(crate) replies: Vec<Reply>,
    pub(crate) events: Vec<EventReport>,
    pub(crate) telemetry: Vec<Telemetry>,
    pub(crate) is_connected: bool,
}

impl Operator {
    pub(crate) fn new(key: Key, number: u8, now: Instant) -> Self {
        Self {
            address: SocketAddr::from(([192, 0, 2, number], 40_000)),
            session: OperatorSession::new(key, [number; 32], now),
            requests: 0,
            replies: Vec::new(),
            events: Vec::new(),
            telemetry: Vec::new(),
            is_connected: false,
        }
    }

    /// The sealed datagram of an order.
    pub(crate) fn seal(&mut self, now: Instant, order: Order) -> Frame {
        self.session.send(now, &ToRobot::Order(order)).unwrap()
    }

    /// The sealed datagram of a request.
    pub(crate) fn ask(&mut self, now: Instant, command: Command) -> Frame {
        self.requests += 1;
        self.session.send(now, &ToRobot::request(self.requests, command)).unwrap()
    }

    pub(crate) fn receive(&mut self, now: Instant, datagram: &[u8]) {
        match self.session.receive(now, datagram) {
            OperatorReceived::Connected => self.is_connected = true,
            OperatorReceived::Message(ToOperator::Reply(reply)) => self.replies.push(reply),
            OperatorReceived::Message(ToOperator::Event(event)) => self.events.push(event),
            OperatorReceived::Message(ToOperator::Telemetry(telemetry)) => {
                self.telemetry.push(telemetry);
            }
            OperatorReceived::Left => self.is_connected = false,
            OperatorReceived::Progress | OperatorReceived::Dropped(_) => {}
        }
    }
}

/// A robot and one operator.
pub(crate) struct Bench {
    pub(crate) robot: SimulatedRobot,
    pub(crate) operator: Operator,
}

pub(crate) fn key() -> Key {
    Key::new([7; 32])
}

pub(crate) fn setpoint(frequency: f64, direction: f64) -> Setpoint {
    flix_sim::rig::bench::setpoint(frequency, direction).unwrap()
}

impl Bench {
    pub(crate) fn new() -> Self {
        Self::with_flash(Flash::with(&Settings::DEFAULT.entered()))
    }

    pub(crate) fn with_flash(flash: Flash) -> Self {
        Self::of_seed(1, flash)
    }

    /// The robot of this seed: its motors' difference, its encoders' errors, its noise.
    pub(crate) fn of_seed(seed: u64, flash: Flash) -> Self {
        let mechanics = Plant::new(&RobotModel::named("bench-fixed").unwrap()).unwrap();
        let parameters = RobotParameters { flash, ..RobotParameters::new(key(), seed) };
        let robot = SimulatedRobot::new(parameters, mechanics);
        let operator = Operator::new(key(), 1, robot.now());
        Self { robot, operator }
    }

    /// With a session and its first telemetry, no order given yet.
    pub(crate) fn connected() -> Self {
        let mut bench = Self::new();
        bench.connect();
        bench
    }

    /// Armed, at rest.
    pub(crate) fn armed() -> Self {
        let mut bench = Self::connected();
        bench.arm();
        bench
    }

    /// Shaking at 20 Hz for a while.
    pub(crate) fn shaking() -> Self {
        let mut bench = Self::armed();
        bench.hold(bench.walk(20.0, 0.0), Duration::from_millis(600));
        assert_eq!(bench.state(), State::Running);
        bench
    }

    pub(crate) fn now(&self) -> Instant {
        self.robot.now()
    }

    pub(crate) fn state(&self) -> State {
        self.robot.report().state
    }

    /// Largest speed of a rotor, Hz, by the plant.
    pub(crate) fn speed(&self) -> f64 {
        let speeds = self.robot.truth().rotor_speed;
        speeds.iter().fold(0.0, |most, speed: &f64| speed.abs().max(most)) / std::f64::consts::TAU
    }

    pub(crate) fn connect(&mut self) {
        let end = self.now() + PATIENCE;
        while !self.operator.is_connected || self.operator.telemetry.is_empty() {
            assert!(self.now() < end, "no session");
            self.shake_hands();
            self.tick();
        }
    }

    /// Carries the operator's handshake, if one is due.
    fn shake_hands(&mut self) {
        let now = self.now();
        if let Some(frame) = self.operator.session.poll(now) {
            self.robot.receive(self.operator.address, &frame);
            self.listen();
        }
    }

    /// Proves the link, and arms.
    pub(crate) fn arm(&mut self) {
        self.hold(Order::Off, Duration::from_millis(600));
        self.arm_at_once();
    }

    /// Arms with no order before.
    pub(crate) fn arm_at_once(&mut self) {
        let (order, end) = (Order::Arm(self.permit()), self.now() + PATIENCE);
        while self.shown().state != State::Armed {
            let report = self.robot.report();
            assert!(self.now() < end && report.faults.is_empty(), "{report:?}");
            self.hold(order, KEEP_ALIVE);
        }
    }

    /// One tick; what the robot sends is heard.
    pub(crate) fn tick(&mut self) {
        self.listen();
        self.robot.tick().unwrap();
    }

    /// Hears what the robot sends to the operator.
    fn listen(&mut self) {
        self.listen_with(self.operator.address, |_, _| {});
    }

    /// Hears what the robot sends to the operator, and what it sends to another address.
    pub(crate) fn listen_with(&mut self, other: SocketAddr, mut hear: impl FnMut(Instant, &Frame)) {
        let now = self.now();
        let mut frame = Frame::new();
        while let Some(to) = self.robot.transmit(&mut frame) {
            if to == self.operator.address {
                self.operator.receive(now, &frame);
            } else if to == other {
                hear(now, &frame);
            }
        }
    }

    /// Ticks for so long with nobody saying anything.
    pub(crate) fn wait(&mut self, duration: Duration) {
        let end = self.now() + duration;
        while self.now() < end {
            self.tick();
        }
    }

    /// Ticks for so long with nobody saying anything, and sees that no rotor turns.
    pub(crate) fn hold_still(&mut self, duration: Duration) {
        let end = self.now() + duration;
        while self.now() < end {
            self.tick();
            assert!(self.speed() < 0.5, "{} Hz", self.speed());
        }
    }

    /// The newest telemetry that arrived.
    pub(crate) fn shown(&self) -> Telemetry {
        *self.operator.telemetry.last().expect("a session begins with telemetry")
    }

    /// The newest permit that was shown.
    pub(crate) fn permit(&self) -> Permit {
        self.shown().permit
    }

    /// To shake at this f and theta, by the newest permit.
    pub(crate) fn walk(&self, frequency: f64, direction: f64) -> Order {
        Order::Shake(self.permit(), setpoint(frequency, direction))
    }

    /// Gives an order once, now.
    pub(crate) fn order(&mut self, order: Order) {
        let frame = self.operator.seal(self.now(), order);
        self.robot.receive(self.operator.address, &frame);
    }

    /// Ticks for so long with an order repeated at once and every 20 ms.
    pub(crate) fn hold(&mut self, order: Order, duration: Duration) {
        self.repeat(duration, |bench| bench.order(order));
    }

    /// Ticks for so long, and acts at once and every 20 ms.
    pub(crate) fn repeat(&mut self, duration: Duration, mut act: impl FnMut(&mut Self)) {
        let end = self.now() + duration;
        while self.now() < end {
            act(self);
            let next = (self.now() + KEEP_ALIVE).min(end);
            while self.now() < next {
                self.tick();
            }
        }
    }

    /// Holds an order until telemetry tells of it.
    pub(crate) fn see(&mut self, order: Order) -> Telemetry {
        self.hold(order, 2 * KEEP_ALIVE);
        self.shown()
    }

    /// Makes a request, now, and hears the answer.
    pub(crate) fn say(&mut self, command: Command) -> Outcome {
        let frame = self.operator.ask(self.now(), command);
        self.robot.receive(self.operator.address, &frame);
        let request = self.operator.requests;
        self.listen();
        let mut replies = self.operator.replies.iter().rev();
        let reply = replies.find(|reply| reply.request == request);
        reply.expect("every request is answered at once").outcome.clone()
    }

    /// The next telemetry.
    pub(crate) fn telemetry(&mut self) -> Telemetry {
        let before = self.operator.telemetry.len();
        while self.operator.telemetry.len() == before {
            self.tick();
        }
        self.shown()
    }

    /// What the robot counts.
    pub(crate) fn quality(&mut self) -> LinkQuality {
        self.telemetry().link
    }

    pub(crate) fn events(&self) -> Vec<Event> {
        self.operator.events.iter().map(|report| report.event).collect()
    }

    /// Power off and on.
    pub(crate) fn restart(&mut self) {
        let flash = self.robot.parameters().flash.clone();
        *self = Self::with_flash(flash);
        self.connect();
    }
}
