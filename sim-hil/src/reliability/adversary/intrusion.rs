//! Somebody in the robot's own network, or behind its router, puts frames on the wire while an operator drives.
//!
//! Here the robot's network task and the stack below it run too ([`network`]): what is attacked is the stack's knowledge
//! of neighbours, with ARP, and the robot's readiness to answer mDNS, with questions in somebody else's name. Each of
//! [`INTRUSIONS`] goes on from power-up until the robot is at rest again, at each of [`PACES`].

use core::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use core::task::Poll;
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;
use std::time::Duration;

use embassy_futures::poll_once;
use embassy_net::IpEndpoint;
use embassy_net::udp::UdpSocket;
use embassy_time::Timer;
use flix_firmware::mdns;
use flix_firmware::net::Station;
use flix_host::link::{Client, Update};
use flix_protocol::DEFAULT_PORT;
use flix_protocol::frame::{Frame, MAXIMUM_DATAGRAM};
use flix_protocol::message::Setpoint;
use flix_protocol::session::StopSession;
use flix_protocol::units::Instant;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::findings::{Findings, raise};
use super::forgery::NETWORK;
use super::hold_up::{LOOK, drive};
use super::kind::{INTRUSIONS, Kind};
use crate::plant::Diverged;
use crate::reliability::fault_matrix::REST_HZ;
use crate::rig::bench::{Base, BenchError, bench_key, bench_knowing, setpoint};
use crate::rig::network_task::{
    self as network, Arp, Network, OPERATOR, ROBOT, ROUTER, TICK, Wire, arp, now,
};
use crate::rig::simulated::SimulatedRobot;

/// Frames a second: more than the neighbours that a stack knows, and a flood.
const PACES: [u64; 2] = [14, 1_000];
/// How the operator's intent ends: his program ends, or somebody else with the key stops the robot.
const DEPARTURES: [Departure; 2] = [Departure::Ends, Departure::IsOverruled];

/// All of these, of each kind.
pub(super) const COUNT: usize = INTRUSIONS.len() * PACES.len() * DEPARTURES.len();

/// Interval at which the operator looks at the robot, us.
const LOOK_US: u64 = LOOK * 1_000;
/// Time after which a robot that does not move will not.
const PATIENCE: Duration = Duration::from_secs(6);
/// From the robot's first movement to the end of the operator's intent, and from there to the end.
const DRIVEN: Duration = Duration::from_millis(2_500);
const WATCHED: Duration = Duration::from_millis(1_500);
/// Time until the robot has announced itself, unasked.
const ANNOUNCED: Duration = Duration::from_millis(2_000);
/// The longest name that a robot may have: its answers are the longest.
const NAME: &str = "flix-walker-with-a-name-too-long";
/// Questions for robots: for their service, and for all about it.
const QUESTIONS: [&[u8]; 2] = [
    b"\0\0\0\0\0\x01\0\0\0\0\0\0\x05_flix\x04_udp\x05local\0\0\x0c\0\x01",
    b"\0\0\0\0\0\x01\0\0\0\0\0\0\x05_flix\x04_udp\x05local\0\0\xff\0\x01",
];
/// Cards and address of the intruder, and the router's card.
const INTRUDER: u8 = 66;
const VICTIM: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 77);
const ROUTER_CARD: u8 = 254;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Departure {
    Ends,
    IsOverruled,
}

/// mDNS after the announcements, without headers.
#[derive(Debug, Clone, Default)]
struct Discovery {
    asked_bytes: u64,
    answered_bytes: u64,
    /// Answers in each second.
    answers: BTreeMap<u64, u64>,
}

impl Discovery {
    /// Returns the bytes that each byte of a question brought out.
    fn amplification(&self) -> f64 {
        self.answered_bytes as f64 / self.asked_bytes.max(1) as f64
    }

    /// Returns the most answers in a second.
    fn answers_per_s(&self) -> u64 {
        self.answers.values().copied().max().unwrap_or(0)
    }

    fn note_question(&mut self, at: Instant, bytes: u64) {
        if at > Instant::START + ANNOUNCED {
            self.asked_bytes += bytes;
        }
    }

    fn note_answer(&mut self, at: Instant, bytes: usize) {
        if at > Instant::START + ANNOUNCED {
            self.answered_bytes += bytes as u64;
            *self.answers.entry(at.as_micros() / 1_000_000).or_default() += 1;
        }
    }
}

/// Lets robots of this seed live through all intrusions, one after the other: they share virtual time.
///
/// # Errors
/// When the mechanics diverge.
pub(super) fn run_all(seed: u64, flash: &Option<Vec<u8>>) -> Result<Vec<Findings>, BenchError> {
    let mut all = Vec::new();
    for kind in INTRUSIONS {
        for pace in PACES {
            for departure in DEPARTURES {
                all.push(run(seed, kind, pace, departure, flash.clone())?);
            }
        }
    }
    Ok(all)
}

fn run(
    seed: u64,
    kind: Kind,
    pace: u64,
    departure: Departure,
    flash: Option<Vec<u8>>,
) -> Result<Findings, BenchError> {
    let mut operation = bench_knowing(Base::Free, seed, flash, NETWORK)?;
    let wanted = setpoint(30.0, 30.0)?;
    let client = operation.operators.remove(0).client;
    let robot = RefCell::new(operation.robot);
    let divergence = Cell::new(None);
    let tick = || {
        if let Err(error) = robot.borrow_mut().tick() {
            divergence.set(Some(error));
        }
    };
    let session = |network: Network| {
        let random = Xoshiro256PlusPlus::seed_from_u64(seed ^ (kind as u64) << 32 ^ pace);
        let intruder = Intruder { kind, pace, random, frames: 0, wire: network.wire.clone() };
        let socket = network.socket(40_000);
        let session = Session { robot: &robot, divergence: &divergence, departure, wanted };
        session.run(network, Operator { client, socket }, intruder)
    };
    Ok(network::play(NAME, &mut OnNetwork(&robot), tick, session)?)
}

/// The simulated robot behind the network task.
struct OnNetwork<'a>(&'a RefCell<SimulatedRobot>);

impl Station for OnNetwork<'_> {
    fn board(&self) -> &'static str {
        "bench"
    }

    fn now(&self) -> Instant {
        self.0.borrow().now()
    }
    fn exchange(&mut self) {
        // Every tick does.
    }
    fn receive(&mut self, from: SocketAddr, datagram: &[u8]) -> bool {
        self.0.borrow_mut().receive(from, datagram)
    }
    fn transmit(&mut self, frame: &mut Frame) -> Option<SocketAddr> {
        self.0.borrow_mut().transmit(frame)
    }
    fn poll_at(&self) -> Option<Instant> {
        let robot = self.0.borrow();
        robot.software().slow.poll_at(robot.now())
    }
}

/// Puts frames on the wire.
struct Intruder {
    kind: Kind,
    /// Frames a second.
    pace: u64,
    random: Xoshiro256PlusPlus,
    frames: u64,
    wire: Rc<Wire>,
}

impl Intruder {
    /// Puts the frames on the wire that are due; returns the bytes of the questions among them.
    fn intrude(&mut self, now: Instant) -> u64 {
        let mut asked = 0;
        while self.frames * 1_000_000 <= now.as_micros() * self.pace {
            if self.frames.is_multiple_of(self.pace) {
                // Who sends from these addresses has asked for the robot's.
                self.wire.inject(arp(Arp::Request, ROUTER_CARD, ROUTER, ROBOT));
                self.wire.inject(arp(Arp::Request, INTRUDER, VICTIM, ROBOT));
            }
            asked += self.frame();
            self.frames += 1;
        }
        asked
    }

    fn frame(&mut self) -> u64 {
        let number = self.frames;
        let operation = if number.is_multiple_of(2) { Arp::Request } else { Arp::Reply };
        let (card, from) = match self.kind {
            Kind::ForgedArp => {
                let claimed = match number % 14 {
                    0 | 7 => OPERATOR,
                    other => Ipv4Addr::new(10, 0, 0, 100 + other as u8),
                };
                self.wire.inject(arp(operation, INTRUDER, claimed, ROBOT));
                return 0;
            }
            Kind::CopiedFrames => {
                self.wire.copy_from(INTRUDER);
                return 0;
            }
            Kind::ForeignQuestions => (ROUTER_CARD, self.elsewhere()),
            Kind::NeighbourQuestions => (INTRUDER, VICTIM),
            _ => {
                self.wire.inject(arp(operation, INTRUDER, ROBOT, ROBOT));
                return 0;
            }
        };
        let port = if self.random.random() { mdns::PORT } else { 40_000 };
        let to = if self.random.random() { mdns::GROUP } else { ROBOT };
        let question = QUESTIONS[self.random.random_range(0..QUESTIONS.len())];
        let (from, to) = (SocketAddrV4::new(from, port), SocketAddrV4::new(to, mdns::PORT));
        self.wire.inject(network::datagram(card, from, to, question));
        question.len() as u64
    }

    /// Returns an address in another network: near the robot's as often as not.
    fn elsewhere(&mut self) -> Ipv4Addr {
        let [a, b, c] = self.random.random::<[u8; 3]>();
        if self.random.random() {
            Ipv4Addr::new(10, 0, 1 + a % 255, b)
        } else {
            Ipv4Addr::new(192, a, b, c)
        }
    }
}

/// An operator's program and its socket.
struct Operator {
    client: Client,
    socket: UdpSocket<'static>,
}

impl Operator {
    /// Takes what has arrived and sends what is due.
    async fn attend(&mut self, now: Instant) {
        let mut buffer = [0; MAXIMUM_DATAGRAM];
        while let Some(length) = take(&self.socket, &mut buffer) {
            self.client.receive(now, &buffer[..length]);
        }
        if self.client.transmit_at().is_some_and(|at| at <= now) {
            while let Some(datagram) = self.client.transmit(now) {
                send(&self.socket, &datagram).await;
            }
        }
    }
}

fn take(socket: &UdpSocket<'_>, buffer: &mut [u8]) -> Option<usize> {
    match poll_once(socket.recv_from(buffer)) {
        Poll::Ready(Ok((length, _))) => Some(length),
        Poll::Ready(Err(_)) | Poll::Pending => None,
    }
}

async fn send(socket: &UdpSocket<'_>, datagram: &[u8]) {
    let robot = IpEndpoint::new(ROBOT.into(), DEFAULT_PORT);
    // What is lost is sent again.
    let _ = socket.send_to(datagram, robot).await;
}

/// One robot from power-up until it is at rest again.
struct Session<'a> {
    robot: &'a RefCell<SimulatedRobot>,
    divergence: &'a Cell<Option<Diverged>>,
    departure: Departure,
    wanted: Setpoint,
}

impl Session<'_> {
    async fn run(
        self,
        network: Network,
        mut operator: Operator,
        mut intruder: Intruder,
    ) -> Result<Findings, Diverged> {
        let discovery = Rc::new(RefCell::new(Discovery::default()));
        watch_answers(&network.wire, &discovery);
        let mut stop = None;
        let mut findings = Findings {
            handshake_s: Some(f64::INFINITY),
            answers_heard: Some(0.0),
            driven: Some(0.0),
            ..Findings::default()
        };
        // The first movement, and the end of the operator's intent.
        let (mut moved, mut departed) = (None, None);
        let is_over = |now: Instant, moved: Option<Instant>| match moved {
            Some(moved) => now >= moved + DRIVEN + WATCHED,
            None => now >= Instant::START + PATIENCE,
        };
        while !is_over(now(), moved) {
            let now = now();
            let asked = intruder.intrude(now);
            discovery.borrow_mut().note_question(now, asked);
            let is_moving = !self.robot.borrow().truth().is_slower_than(REST_HZ);
            if is_moving {
                moved = moved.or(Some(now));
                let since = departed.map_or(0.0, |departed| now.since(departed).as_secs_f64());
                raise(&mut findings.movement_s, since);
            }
            if departed.is_none() && now.as_micros().is_multiple_of(LOOK_US) {
                self.look(&mut operator.client, now);
            }
            if departed.is_none() && moved.is_some_and(|moved| now >= moved + DRIVEN) {
                departed = Some(now);
                findings.answers_heard = Some(1.0 - operator.client.statistics().loss());
                findings.driven = Some(f64::from(u8::from(is_moving)));
                stop = (self.departure == Departure::IsOverruled).then(|| {
                    (StopSession::new(&bench_key(), [6; 32], now), network.socket(40_001))
                });
            }
            if departed.is_none() || self.departure == Departure::IsOverruled {
                operator.attend(now).await;
            }
            if findings.handshake_s == Some(f64::INFINITY) && operator.client.is_connected(now) {
                findings.handshake_s = Some(now.since(Instant::START).as_secs_f64());
            }
            if let (Some((stop, socket)), Some(asked)) = (&mut stop, departed) {
                overrule(stop, socket, now).await;
                if !self.robot.borrow().report().stopped {
                    findings.foreign_stop_s = Some(now.since(asked).as_secs_f64());
                }
            }
            if let Some(error) = self.divergence.take() {
                return Err(error);
            }
            Timer::after(TICK).await;
        }
        findings.count(intruder.kind, intruder.frames);
        findings.overruns = self.robot.borrow().report().timing.overruns.into();
        let discovery = discovery.take();
        findings.answers_per_s = Some(discovery.answers_per_s() as f64);
        match intruder.kind {
            Kind::ForeignQuestions => {
                findings.off_link_amplification = Some(discovery.amplification());
            }
            Kind::NeighbourQuestions => {
                findings.on_link_amplification = Some(discovery.amplification());
            }
            _ => {}
        }
        Ok(findings)
    }

    /// The operator looks at the robot, and asks again for what it does not do yet.
    fn look(&self, client: &mut Client, now: Instant) {
        while let Some(update) = client.update() {
            if matches!(update, Update::Failed(_) | Update::Left) {
                client.connect(now);
            }
        }
        drive(client, now, self.wanted, false);
    }
}

/// Carries on somebody else's stop.
async fn overrule(stop: &mut StopSession, socket: &UdpSocket<'_>, now: Instant) {
    let mut buffer = [0; MAXIMUM_DATAGRAM];
    while let Some(length) = take(socket, &mut buffer) {
        // What it drops it asks for again.
        let _ = stop.receive(now, &buffer[..length]);
    }
    if let Some(datagram) = stop.poll(now) {
        send(socket, &datagram).await;
    }
}

/// Counts what the robot sends from the port of mDNS.
fn watch_answers(wire: &Wire, discovery: &Rc<RefCell<Discovery>>) {
    let discovery = discovery.clone();
    wire.watch(move |frame| {
        if let Some((mdns::PORT, _, payload)) = network::ports_and_payload(frame) {
            discovery.borrow_mut().note_answer(now(), payload.len());
        }
    });
}
