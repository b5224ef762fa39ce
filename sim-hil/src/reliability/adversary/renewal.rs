//! A network in the attacker's hands holds back, or plays again, what renews the keys of a session.
//!
//! Sessions alone, without a robot around them: the lives of their keys are minutes. While renewals are held back for
//! less than the keys live, every command of the operator has to count; once the keys are older, none.

use core::net::SocketAddr;
use std::time::Duration;

use flix_protocol::message::{Command, Outcome, Reply, ToOperator, ToRobot};
use flix_protocol::session::{
    OperatorSession, RobotReceived, RobotSession, SESSION_LIFE, SESSION_RENEWAL, Status,
};
use flix_protocol::units::Instant;
use rand::{Rng, RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::findings::Findings;
use super::kind::Kind;
use crate::rig::bench::bench_key;

/// From one command to the next: below the silence after which a session is free.
const STEP: Duration = Duration::from_millis(200);
/// Renewals of one session.
const RENEWALS: u32 = 2;
/// Time in which a renewal that gets through is done.
const DONE: Duration = Duration::from_secs(2);
/// Share of the commands beside which a renewal is played again.
const PLAYED: f64 = 0.2;
const OPERATOR: ([u8; 4], u16) = ([192, 0, 2, 10], 40_000);

/// A robot's end and an operator's, and what the attacker recorded.
struct Link {
    now: Instant,
    robot: RobotSession,
    operator: OperatorSession,
    random: Xoshiro256PlusPlus,
    /// Renewals that are held back.
    held: Vec<Vec<u8>>,
    to_robot: Vec<Vec<u8>>,
    to_operator: Vec<Vec<u8>>,
    kind: Kind,
    findings: Findings,
}

/// Lets a session live through this kind.
pub(super) fn run(seed: u64, kind: Kind) -> Findings {
    let mut link = Link::connected(seed, kind);
    for _ in 0..RENEWALS {
        let longest = SESSION_LIFE - SESSION_RENEWAL - 2 * DONE;
        let held_back = match kind {
            Kind::RenewalHeldBack => longest.mul_f64(link.random.random()),
            _ => Duration::ZERO,
        };
        let release = link.now + SESSION_RENEWAL + held_back;
        while link.now < release + DONE {
            let counts = link.step(kind == Kind::RenewalReplayed || link.now >= release);
            link.findings.failures += u64::from(!counts);
        }
    }
    let end = link.now + SESSION_LIFE;
    while link.now < end {
        link.step(false);
    }
    // Nothing that was ever sent counts any more.
    link.findings.failures += u64::from(link.robot.peer(link.now).is_some());
    for datagram in core::mem::take(&mut link.to_robot) {
        link.findings.failures += u64::from(!link.is_dropped(&datagram));
    }
    link.findings
}

impl Link {
    fn connected(seed: u64, kind: Kind) -> Self {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed ^ (kind as u64) << 32);
        let mut fresh = || {
            let mut bytes = [0; 32];
            random.fill_bytes(&mut bytes);
            bytes
        };
        let key = bench_key();
        let now = Instant::START + STEP;
        let mut link = Self {
            now,
            robot: RobotSession::new(key.clone(), fresh()),
            operator: OperatorSession::new(key, fresh(), now),
            random,
            held: Vec::new(),
            to_robot: Vec::new(),
            to_operator: Vec::new(),
            kind,
            findings: Findings::default(),
        };
        while let Some(datagram) = link.operator.poll(now) {
            link.exchange(&datagram);
        }
        link
    }

    /// The robot reports, the operator commands, and the network lets renewals through or not. Returns whether the
    /// command counts.
    fn step(&mut self, lets_through: bool) -> bool {
        self.now = self.now + STEP;
        let report = ToOperator::Reply(Reply { request: 0, outcome: Outcome::Done });
        if let Ok((_, frame)) = self.robot.send(self.now, &report) {
            self.operator.receive(self.now, &frame);
        }
        while let Some(renewal) = self.operator.poll(self.now) {
            self.to_robot.push(renewal.to_vec());
            self.held.push(renewal.to_vec());
        }
        if lets_through {
            for renewal in core::mem::take(&mut self.held) {
                self.exchange(&renewal);
            }
        } else if self.kind == Kind::RenewalHeldBack {
            let held = self.findings.sent.entry(self.kind).or_default();
            *held = self.held.len().max(*held as usize) as u64;
        }
        let plays = lets_through && self.kind == Kind::RenewalReplayed;
        if plays && self.random.random::<f64>() < PLAYED {
            self.play();
        }
        let ping = ToRobot::request(1, Command::Ping(1));
        let Ok(frame) = self.operator.send(self.now, &ping) else { return false };
        self.to_robot.push(frame.to_vec());
        matches!(self.hear(&frame), RobotReceived::Message(_))
            && self.operator.status(self.now) == Status::Connected
    }

    /// Plays a renewal of either end to the other once more.
    fn play(&mut self) {
        let renewals = self.to_robot.iter().filter(|datagram| is_renewal(datagram));
        let renewals: Vec<_> = renewals.cloned().collect();
        if let Some(renewal) = renewals.get(self.random.random_range(0..renewals.len().max(1))) {
            self.findings.count(self.kind, 1);
            self.findings.failures += u64::from(!self.is_dropped(renewal));
        }
        let place = self.random.random_range(0..self.to_operator.len().max(1));
        if let Some(answer) = self.to_operator.get(place) {
            self.findings.count(self.kind, 1);
            self.operator.receive(self.now, answer);
        }
    }

    fn exchange(&mut self, datagram: &[u8]) {
        let received = self.hear(datagram);
        if let RobotReceived::Answer(answer) | RobotReceived::Connected(answer) = received {
            self.to_operator.push(answer.to_vec());
            self.operator.receive(self.now, &answer);
        }
    }

    fn hear(&mut self, datagram: &[u8]) -> RobotReceived {
        self.robot.receive(self.now, SocketAddr::from(OPERATOR), datagram)
    }

    fn is_dropped(&mut self, datagram: &[u8]) -> bool {
        matches!(self.hear(datagram), RobotReceived::Dropped(..))
    }
}

/// Returns the renewals of a session under the key of the robots of the bench, as somebody recorded them.
pub(super) fn foreign_renewals() -> Vec<Vec<u8>> {
    let mut link = Link::connected(0, Kind::ForeignRenewal);
    while link.held.is_empty() {
        link.step(false);
    }
    link.held
}

/// Returns whether a recorded datagram renews keys.
fn is_renewal(datagram: &[u8]) -> bool {
    use flix_protocol::frame::{Datagram, Sealed};
    matches!(Datagram::parse(datagram), Some(Datagram::Sealed(Sealed { is_renewal: true, .. })))
}
