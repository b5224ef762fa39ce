//! Operators and a simulated robot on a simulated network, all in one virtual time.
//!
//! Each operator is the real client of [`flix_host::link`] with a [`Channel`] either way. What it asks travels as
//! sealed datagrams through protocol, session and the robot's software, as it would on the air.

use core::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::Duration;

use flix_host::link::{Client, LinkError, RobotLink};
use flix_protocol::frame::Frame;
use flix_protocol::session::{Key, StopSession};
use flix_protocol::units::Instant;
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::plant::Diverged;
use crate::rig::lossy_network::{Channel, ChannelParameters};
use crate::rig::simulated::{SimulatedRobot, Truth};

/// Why a simulated robot did not do what its operator asked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum OperationError {
    /// The plant's state is useless.
    #[error(transparent)]
    Diverged(#[from] Diverged),
    /// The robot does not do what it is asked.
    #[error(transparent)]
    Link(#[from] LinkError),
}

/// The way that a datagram goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Towards {
    /// To the robot.
    Robot,
    /// To the operator.
    Operator,
}

/// One operator and his network.
pub struct Operator {
    /// Where the robot sees him.
    pub address: SocketAddr,
    /// The client.
    pub client: Client,
    /// Towards the robot.
    pub to_robot: Channel,
    /// Back.
    pub to_operator: Channel,
    /// The clock of his client.
    pub clock: Clock,
    /// Whether his program has ended or hangs: it takes and sends nothing, while the network goes on.
    pub is_gone: bool,
}

/// A clock that may run fast or slow. It was right when it was last set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clock {
    set: Instant,
    showed: Instant,
    rate: f64,
}

impl Clock {
    /// Always right.
    pub const TRUE: Self = Self { set: Instant::START, showed: Instant::START, rate: 1.0 };

    /// Shows `rate` seconds, more than 0, for each second from now on.
    pub fn run_at(&mut self, rate: f64, now: Instant) {
        *self = Self { set: now, showed: self.read(now), rate };
    }

    /// Returns what it shows.
    #[must_use]
    pub fn read(&self, now: Instant) -> Instant {
        if self.rate == 1.0 {
            return self.showed + now.since(self.set);
        }
        self.showed + now.since(self.set).mul_f64(self.rate)
    }
}

impl Operator {
    fn exchange(
        &mut self,
        now: Instant,
        robot: &mut SimulatedRobot,
        overhear: &mut impl FnMut(Towards, &[u8]),
    ) {
        if !self.is_gone {
            self.attend(now, overhear);
        }
        while let Some(datagram) = self.to_robot.receive(now) {
            overhear(Towards::Robot, &datagram);
            robot.receive(self.address, &datagram);
        }
    }

    /// His program takes what has arrived and sends what is due.
    fn attend(&mut self, now: Instant, overhear: &mut impl FnMut(Towards, &[u8])) {
        let shown = self.clock.read(now);
        while let Some(datagram) = self.to_operator.receive(now) {
            overhear(Towards::Operator, &datagram);
            self.client.receive(shown, &datagram);
        }
        if self.client.transmit_at().is_some_and(|at| at <= shown) {
            while let Some(datagram) = self.client.transmit(shown) {
                self.to_robot.send(now, &datagram);
            }
        }
    }
}

/// Operators and a robot.
pub struct Operation {
    /// The robot.
    pub robot: SimulatedRobot,
    /// Those who want to drive it; the first is who the methods here speak for.
    pub operators: Vec<Operator>,
    random: Xoshiro256PlusPlus,
}

impl Operation {
    /// Creates one operator, who begins to connect at once with the robot's key.
    #[must_use]
    pub fn new(robot: SimulatedRobot, network: ChannelParameters) -> Self {
        // Another stream than the plant's and the robot's own.
        let mut random = Xoshiro256PlusPlus::seed_from_u64(robot.parameters().seed);
        random.long_jump();
        let key = robot.parameters().key().unwrap_or_else(|| Key::new([0; 32]));
        let mut operation = Self { robot, operators: Vec::new(), random };
        operation.add_operator(key, network);
        operation
    }

    /// Stops the robot from outside any session, with the robot's key and from this address, at once. Returns
    /// what was sent to it.
    ///
    /// # Errors
    /// When the mechanics diverge.
    pub fn stop_from(&mut self, address: SocketAddr) -> Result<Vec<Vec<u8>>, Diverged> {
        let mut entropy = [0; 32];
        self.random.fill_bytes(&mut entropy);
        let key = self.robot.parameters().key().unwrap_or_else(|| Key::new([0; 32]));
        let mut stop = StopSession::new(&key, entropy, self.robot.now());
        let mut sent = Vec::new();
        let mut frame = Frame::new();
        while stop.poll_at().is_some() {
            let now = self.robot.now();
            if let Some(datagram) = stop.poll(now) {
                self.robot.receive(address, &datagram);
                sent.push(datagram.to_vec());
            }
            while let Some(to) = self.robot.transmit(&mut frame) {
                if to == address {
                    // What it drops it asks for again.
                    let _ = stop.receive(now, &frame);
                } else if let Some(it) = self.operators.iter_mut().find(|it| it.address == to) {
                    it.to_operator.send(now, &frame);
                }
            }
            self.tick()?;
        }
        Ok(sent)
    }

    /// Adds one operator; returns his index.
    pub fn add_operator(&mut self, key: Key, network: ChannelParameters) -> usize {
        let index = self.operators.len();
        let mut entropy = [0; 32];
        self.random.fill_bytes(&mut entropy);
        // Of the range for documentation (RFC 5737).
        let host = Ipv4Addr::new(192, 0, 2, 10 + (index % 200) as u8);
        self.operators.push(Operator {
            address: SocketAddr::new(IpAddr::V4(host), 40_000),
            client: Client::new(key, entropy, self.robot.now()),
            to_robot: Channel::new(network, self.random.next_u64()),
            to_operator: Channel::new(network, self.random.next_u64()),
            clock: Clock::TRUE,
            is_gone: false,
        });
        index
    }

    /// Returns the time since the simulation began.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.robot.now()
    }

    /// What the first operator's clock shows.
    fn shown(&self) -> Instant {
        self.operators[0].clock.read(self.now())
    }

    /// Returns the first operator's client.
    pub fn client(&mut self) -> &mut Client {
        &mut self.operators[0].client
    }

    /// Advances everything by one tick.
    ///
    /// # Errors
    /// When the mechanics diverge.
    pub fn tick(&mut self) -> Result<(), Diverged> {
        self.tick_overheard(|_, _| {})
    }

    /// Advances everything by one tick; `overhear` is shown each datagram that arrives.
    ///
    /// # Errors
    /// When the mechanics diverge.
    pub fn tick_overheard(
        &mut self,
        mut overhear: impl FnMut(Towards, &[u8]),
    ) -> Result<(), Diverged> {
        let now = self.robot.now();
        for operator in &mut self.operators {
            operator.exchange(now, &mut self.robot, &mut overhear);
        }
        let mut frame = Frame::new();
        while let Some(to) = self.robot.transmit(&mut frame) {
            for operator in self.operators.iter_mut().filter(|operator| operator.address == to) {
                operator.to_operator.send(now, &frame);
            }
        }
        self.robot.tick()
    }

    /// Runs for so long and shows the plant's truth after every tick.
    ///
    /// # Errors
    /// When the mechanics diverge.
    pub fn run(
        &mut self,
        duration: Duration,
        mut watch: impl FnMut(&Truth),
    ) -> Result<(), Diverged> {
        let end = self.now() + duration;
        while self.now() < end {
            self.tick()?;
            watch(&self.robot.truth());
        }
        Ok(())
    }
}

/// The first operator's robot.
impl RobotLink for Operation {
    type Error = OperationError;

    fn operate(&mut self) -> (&mut Client, Instant) {
        let shown = self.shown();
        (self.client(), shown)
    }

    fn wait(&mut self, _: Duration) -> Result<(), OperationError> {
        Ok(self.tick()?)
    }
}
