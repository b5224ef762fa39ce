//! The robot's two halves and its operator, whose datagrams arrive at once. Nothing crosses between the halves unless a test says
//! so: it lets the fast half tick, or writes its report.

use core::net::SocketAddr;
use core::time::Duration;

use flix_firmware::fast::exchange::{Asked, Exchange, Report};
use flix_firmware::hardware::{Actuation, Hardware, TICK};
use flix_firmware::robot::{FastHalf, SlowHalf, halves};
use flix_protocol::frame::Frame;
use flix_protocol::message::{
    Command, Event, Order, Outcome, ParameterCommand, Permit, SCOPE_VALUES, Telemetry, ToOperator,
    ToRobot,
};
use flix_protocol::session::{Key, OperatorReceived, OperatorSession, Status};
use flix_protocol::units::Instant;

use crate::known_motors::KnownMotors;
use crate::still::AT_REST;

/// Time between two orders.
pub(crate) const REPETITION: Duration = Duration::from_millis(20);
pub(crate) const MILLISECOND: Duration = Duration::from_millis(1);

pub(crate) struct Ends {
    pub(crate) fast: FastHalf,
    pub(crate) slow: SlowHalf<KnownMotors>,
    pub(crate) exchange: Exchange,
    pub(crate) operator: OperatorSession,
    pub(crate) now: Instant,
    /// How the fast half is, where it does not tick.
    pub(crate) report: Report,
    /// The newest order, as it is repeated.
    order: Order,
    /// Requests so far.
    requests: u32,
    pub(crate) outcomes: Vec<Outcome>,
    pub(crate) events: Vec<(u32, Event)>,
    pub(crate) telemetry: Vec<Telemetry>,
    /// As the last tick left it.
    pub(crate) actuation: Actuation,
}

pub(crate) fn key() -> Key {
    Key::new([9; 32])
}

pub(crate) fn address() -> SocketAddr {
    ([192, 168, 4, 2], 4_000).into()
}

/// Returns the command that changes a setting.
pub(crate) fn set(name: &str, value: f32) -> Command {
    Command::Parameter(ParameterCommand::Set(name.try_into().unwrap(), value))
}

impl Ends {
    pub(crate) fn unconnected(hardware: Hardware) -> Self {
        let (fast, slow, report) =
            halves(hardware, "ends", Some(key()), [11; 32], KnownMotors::new());
        let now = Instant::from_micros(1_000);
        Self {
            fast,
            slow,
            exchange: Exchange::new(report, [0; SCOPE_VALUES]),
            operator: OperatorSession::new(key(), [22; 32], now),
            now,
            report,
            order: Order::Off,
            requests: 0,
            outcomes: Vec::new(),
            events: Vec::new(),
            telemetry: Vec::new(),
            actuation: Actuation::OFF,
        }
    }

    pub(crate) fn connect(&mut self) {
        while self.operator.status(self.now) != Status::Connected {
            let frame = self.operator.poll(self.now).unwrap();
            self.hear(&frame);
        }
    }

    /// Another operator, whom the robot does not know yet, from the same address.
    pub(crate) fn change_operator(&mut self) {
        self.operator = OperatorSession::new(key(), [33; 32], self.now);
        self.order = Order::Off;
        self.telemetry.clear();
    }

    /// The slow half takes a datagram, and the operator all that comes back.
    pub(crate) fn hear(&mut self, datagram: &[u8]) {
        self.slow.receive(self.now, address(), datagram);
        self.drain();
    }

    /// Gives the operator all that the slow half has to send now.
    pub(crate) fn drain(&mut self) {
        let mut frame = Frame::new();
        while self.slow.poll_at(self.now).is_some_and(|at| at <= self.now) {
            let to = self.slow.transmit(self.now, &mut frame);
            assert_eq!(to, Some(address()), "there was something to send");
            match self.operator.receive(self.now, &frame) {
                OperatorReceived::Message(ToOperator::Reply(it)) => self.outcomes.push(it.outcome),
                OperatorReceived::Message(ToOperator::Event(it)) => {
                    self.events.push((it.number, it.event));
                }
                OperatorReceived::Message(ToOperator::Telemetry(it)) => self.telemetry.push(it),
                _ => {}
            }
        }
    }

    /// Returns the operator's next datagram.
    pub(crate) fn seal(&mut self, message: ToRobot) -> Frame {
        self.operator.send(self.now, &message).unwrap()
    }

    pub(crate) fn send(&mut self, message: ToRobot) {
        let frame = self.seal(message);
        self.hear(&frame);
    }

    /// Makes a request.
    pub(crate) fn ask(&mut self, command: Command) {
        self.requests += 1;
        self.send(ToRobot::request(self.requests, command));
    }

    /// Makes a request that is answered at once.
    pub(crate) fn say(&mut self, command: Command) -> Outcome {
        self.ask(command);
        self.outcomes.pop().expect("an answer at once")
    }

    /// Gives an order, which is repeated from here on.
    pub(crate) fn give(&mut self, order: Order) {
        self.order = order;
        self.repeat();
    }

    pub(crate) fn repeat(&mut self) {
        self.send(ToRobot::Order(self.order));
    }

    /// Returns the newest permit that the operator was shown.
    pub(crate) fn permit(&self) -> Permit {
        self.telemetry.last().map_or(Permit::default(), |telemetry| telemetry.permit)
    }

    pub(crate) fn asked(&self) -> &Asked {
        self.slow.link.asked()
    }

    /// Each half takes over what the other has left for it.
    pub(crate) fn cross(&mut self) {
        self.slow.exchange(&mut self.exchange);
    }

    /// The fast half alone.
    pub(crate) fn tick(&mut self, ticks: u32) {
        for _ in 0..ticks {
            self.now = self.now + TICK;
            self.actuation = self.fast.tick(self.now, &AT_REST, &mut self.exchange);
        }
    }
}
