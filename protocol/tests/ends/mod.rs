//! A robot's end and an operator's end, joined without loss, in virtual time.

#![allow(dead_code, reason = "each test file uses its own part")]

use core::net::{IpAddr, Ipv4Addr, SocketAddr};
use core::time::Duration;

use flix_protocol::message::{
    Command, Dropped, Halt, LinkQuality, LoopTiming, MotorTelemetry, OperatorName, Order, Permit,
    Setpoint, State, Telemetry, ToOperator, ToRobot,
};
use flix_protocol::session::{
    Key, OperatorReceived, OperatorSession, RobotReceived, RobotSession, SEND_SLOT, Status,
};
use flix_protocol::units::{Amperes, Degrees, Hertz, Instant, Ratio};

pub(crate) const OPERATOR: SocketAddr =
    SocketAddr::new(IpAddr::V4(Ipv4Addr::new(192, 168, 4, 2)), 4000);
pub(crate) const SECOND_OPERATOR: SocketAddr =
    SocketAddr::new(IpAddr::V4(Ipv4Addr::new(192, 168, 4, 3)), 4000);

pub(crate) fn key(number: u8) -> Key {
    Key::new([number; 32])
}

/// A walk by permit 3, which [`telemetry`] states.
pub(crate) fn walk(frequency: f32, direction: f32) -> ToRobot {
    let setpoint = Setpoint::from_numbers(frequency, direction).unwrap();
    ToRobot::Order(Order::Shake(Permit::new(3), setpoint))
}

pub(crate) const STOP: ToRobot = ToRobot::Order(Order::Stop);

pub(crate) fn ping(number: u32) -> ToRobot {
    ToRobot::request(number, Command::Ping(number))
}

pub(crate) fn telemetry(time: u64) -> ToOperator {
    let motor = MotorTelemetry {
        angle: Degrees::ZERO,
        speed: Hertz::ZERO,
        current_d: Amperes::ZERO,
        current_q: Amperes::ZERO,
        current_q_range: [Amperes::ZERO; 2],
    };
    ToOperator::Telemetry(Telemetry {
        permit: Permit::new(3),
        halt: Halt::Aligned,
        heard: 41,
        held_us: 700,
        withheld: None,
        time: Instant::from_micros(time),
        state: State::Disarmed,
        faults: Default::default(),
        first_fault: None,
        stopped: false,
        link_late: false,
        frequency_limited: false,
        setpoint: Setpoint::REST,
        frequency: Hertz::ZERO,
        direction: Degrees::ZERO,
        direction_range: [Degrees::ZERO; 2],
        motors: [motor; 2],
        encoders: Default::default(),
        bus_voltage: None,
        bus_voltage_range: None,
        modulation: Ratio::ZERO,
        timing: LoopTiming::default(),
        link: LinkQuality { dropped: Dropped::default(), ..Default::default() },
        operator: OperatorName::OWNER,
        stopped_by: None,
        latched_at: None,
    })
}

pub(crate) struct Ends {
    pub(crate) now: Instant,
    pub(crate) robot: RobotSession,
    pub(crate) operator: OperatorSession,
}

impl Ends {
    pub(crate) fn new(robot: Option<Key>, operator: Key) -> Self {
        let now = Instant::from_micros(1_000);
        Self {
            now,
            robot: RobotSession::new(robot, [11; 32]),
            operator: OperatorSession::new(operator, [22; 32], now),
        }
    }

    pub(crate) fn connected() -> Self {
        let mut ends = Self::new(Some(key(1)), key(1));
        assert_eq!(ends.run(), Status::Connected);
        ends
    }

    pub(crate) fn wait(&mut self, duration: Duration) {
        self.now = self.now + duration;
    }

    pub(crate) fn robot_hears(&mut self, datagram: &[u8]) -> RobotReceived {
        self.robot.receive(self.now, OPERATOR, datagram)
    }

    pub(crate) fn operator_hears(&mut self, datagram: &[u8]) -> OperatorReceived {
        self.operator.receive(self.now, datagram)
    }

    /// The robot speaks and the operator hears it at once: returns the moment that its next commands
    /// have.
    pub(crate) fn moment(&mut self) -> Instant {
        // Longer than a slot, so that the moment is this datagram's own; whole milliseconds.
        self.wait(2 * SEND_SLOT);
        let (_, frame) = self.robot.send(self.now, &telemetry(1)).unwrap();
        self.operator_hears(&frame);
        self.now
    }

    /// The robot hears a ping.
    pub(crate) fn ping(&mut self) {
        let frame = self.operator.send(self.now, &ping(0)).unwrap();
        self.robot_hears(&frame);
    }

    /// Lets the handshake go on until it is over.
    pub(crate) fn run(&mut self) -> Status {
        let (now, status) = connect(self.now, &mut self.operator, &mut self.robot, OPERATOR);
        self.now = now;
        status
    }
}

/// Lets a handshake go on until it is over.
pub(crate) fn connect(
    mut now: Instant,
    operator: &mut OperatorSession,
    robot: &mut RobotSession,
    address: SocketAddr,
) -> (Instant, Status) {
    while let Some(at) = operator.poll_at() {
        now = now.max(at);
        while let Some(frame) = operator.poll(now) {
            if let Some(answer) = answer(robot.receive(now, address, &frame), frame.len()) {
                operator.receive(now, &answer);
            }
        }
    }
    (now, operator.status(now))
}

/// What a robot sends back, never more than it was sent.
pub(crate) fn answer(received: RobotReceived, asked: usize) -> Option<Vec<u8>> {
    let answer = match received {
        RobotReceived::Answer(frame)
        | RobotReceived::Connected(frame)
        | RobotReceived::Stop(frame, _) => Some(frame),
        RobotReceived::Dropped(_, frame) => frame,
        _ => None,
    };
    assert!(answer.as_ref().is_none_or(|answer| answer.len() <= asked), "amplification");
    answer.map(|frame| frame.to_vec())
}
