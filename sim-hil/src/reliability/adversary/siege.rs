//! What is attacked beside a session that stands: the operator's end, stops, the cable, the cockpit's server, and the moment in
//! which a silent network speaks again. Each of [`SIEGES`](super::kind::SIEGES) runs by itself, and counts its failures.

use core::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::Duration;

use flix_firmware::board::DENGFOC_V3_01;
use flix_firmware::provision::{Provisioner, Radio};
use flix_host::link::RobotLink;
use flix_host::teleop::page::connection_limits::{PATIENCE, Visitors};
use flix_protocol::failsafe::LINK_LOST;
use flix_protocol::frame::{HEAD, Nonce};
use flix_protocol::message::{Command, OperatorName, Outcome, Reply, State, ToOperator, ToRobot};
use flix_protocol::provision::{
    Answer, FrameReader, NetworkState, ProvisionRefusal, Provisioning, Request, write_frame,
};
use flix_protocol::session::{
    Key, Operator, OperatorReceived, OperatorSession, RobotReceived, RobotSession, Status,
    StopSession, StopStatus,
};
use flix_protocol::units::Instant;
use rand::{Rng, RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::findings::Findings;
use super::forgery::{NETWORK, TICKS_PER_MS};
use super::kind::Kind;
use crate::reliability::fault_matrix::REST_HZ;
use crate::rig::bench::{Base, BenchError, bench_key, bench_knowing, setpoint};
use crate::rig::simulated::Flash;

/// A radio that hears nothing.
struct Deaf;

impl Radio for Deaf {
    fn network(&self) -> NetworkState {
        NetworkState::Joining
    }

    fn scan(&self, _number: u8, _from: u8) -> Answer {
        Answer::Refused(ProvisionRefusal::Radio)
    }
}

const OPERATOR: ([u8; 4], u16) = ([192, 0, 2, 10], 40_000);
const MILLISECOND: Duration = Duration::from_millis(1);
/// Rounds of what is quick.
const ROUNDS: u64 = 60;
/// Rounds of a whole robot.
const LIVES: u64 = 3;
/// Datagrams of an impostor in a millisecond: a flood of thousands a second.
const FORGED_PER_MS: u32 = 4;
/// Time that an operator may take to connect meanwhile.
const CONNECTED_WITHIN: Duration = Duration::from_secs(1);

/// Runs this kind.
///
/// # Errors
/// When a robot cannot be armed even without an attack.
pub(super) fn run(seed: u64, kind: Kind, flash: &Option<Vec<u8>>) -> Result<Findings, BenchError> {
    let random = Xoshiro256PlusPlus::seed_from_u64(seed ^ (kind as u64) << 40);
    let mut siege = Siege { random, kind, findings: Findings::default(), earlier: Vec::new() };
    siege.earlier = siege.overhear();
    let rounds = if kind == Kind::SilencedThenHeard { LIVES } else { ROUNDS };
    for _ in 0..rounds {
        match kind {
            Kind::StopsReplayed => siege.stops(),
            Kind::RelayedAtCable => siege.cable(),
            Kind::SocketsOfStrangers => siege.sockets(false),
            Kind::SocketsBesideThePage => siege.sockets(true),
            Kind::SilencedThenHeard => siege.silence(seed, flash)?,
            _ => siege.impostor(),
        }
    }
    Ok(siege.findings)
}

struct Siege {
    random: Xoshiro256PlusPlus,
    kind: Kind,
    findings: Findings,
    /// What another session under the same key was answered.
    earlier: Vec<Vec<u8>>,
}

impl Siege {
    fn fresh(&mut self) -> [u8; 32] {
        let mut bytes = [0; 32];
        self.random.fill_bytes(&mut bytes);
        bytes
    }

    fn fails(&mut self, is_failure: bool) {
        self.findings.failures += u64::from(is_failure);
    }

    /// Many stops by holders of the key within the life of a cookie, and every one of them again, over and over.
    fn stops(&mut self) {
        let from = SocketAddr::from(OPERATOR);
        let mut robot = RobotSession::new(bench_key(), self.fresh());
        let mut now = Instant::START + Duration::from_millis(self.random.random_range(0..10_000));
        let stops = self.random.random_range(1..40);
        let mut recorded: Vec<Vec<u8>> = Vec::new();
        for _ in 0..stops {
            let mut stop = StopSession::new(&bench_key(), self.fresh(), now);
            while stop.status() == StopStatus::Asking {
                while let Some(datagram) = stop.poll(now) {
                    let answer = match robot.receive(now, from, &datagram) {
                        RobotReceived::Stop(answer, _) => {
                            recorded.push(datagram.to_vec());
                            Some(answer)
                        }
                        RobotReceived::Answer(answer) => Some(answer),
                        _ => None,
                    };
                    if let Some(answer) = answer {
                        // What is dropped is asked for again.
                        let _ = stop.receive(now, &answer);
                    }
                }
                now = now + MILLISECOND;
            }
            self.fails(stop.status() != StopStatus::Latched);
        }
        for _ in 0..3 {
            for datagram in &recorded {
                self.findings.count(self.kind, 1);
                let received = robot.receive(now, from, datagram);
                self.fails(matches!(received, RobotReceived::Stop(..)));
            }
            now = now + Duration::from_millis(self.random.random_range(1..700));
        }
    }

    /// Somebody between an operator's cable and his robot passes on all that is said, and listens for the key.
    fn cable(&mut self) {
        let key = Key::new(self.fresh());
        let name = OperatorName::OWNER;
        let Ok(lab) = Provisioning::new("walker", "lab", "password", None) else { return };
        let mut robot = Provisioner::new(Flash::default(), DENGFOC_V3_01.hardware, [0; 6]);
        let mut heard = Vec::new();
        let new = Request::Provision(lab.clone(), Operator::new(name, &key));
        self.fails(self.pass_on(&mut robot, &new, &mut Vec::new()) != Some(Answer::Done));
        let mut challenge = Nonce::default();
        self.random.fill_bytes(&mut challenge);
        let prove = Request::Prove(challenge, key.id());
        let proof = self.pass_on(&mut robot, &prove, &mut heard);
        let proves =
            matches!(&proof, Some(Answer::Proof(Some(tag))) if key.is_proved(&challenge, tag));
        self.fails(!proves);
        // What `flix provision` says to a robot that proves its key.
        let keep = Request::Keep(lab, name, key.id());
        for request in [Request::Identify, Request::Operators, Request::Network, keep] {
            self.findings.count(self.kind, 1);
            self.pass_on(&mut robot, &request, &mut heard);
        }
        let secret = key.as_bytes();
        let is_overheard = heard.windows(8).any(|part| secret.windows(8).any(|it| it == part));
        self.fails(is_overheard || robot.operators().find(&key.id()).is_none());
    }

    fn pass_on(
        &self,
        robot: &mut Provisioner<Flash>,
        request: &Request,
        heard: &mut Vec<u8>,
    ) -> Option<Answer> {
        let frame = write_frame(request)?;
        heard.extend(decoded(&frame));
        let mut responses = frame.iter().map(|byte| robot.receive(*byte, State::Disarmed, &Deaf));
        let response = responses.find_map(|response| response)?;
        heard.extend(decoded(&response.frame));
        let mut reader = FrameReader::new();
        response.frame.iter().find_map(|byte| reader.push(*byte))
    }

    /// Somebody opens sockets at the cockpit's port without end, some behind the address of the page, while pages are opened.
    fn sockets(&mut self, is_beside: bool) {
        let here = IpAddr::V4(Ipv4Addr::LOCALHOST);
        // Behind one address a page has the time of 64 sockets to say its first word.
        let rate: u64 = if is_beside { 600 } else { 20_000 };
        let mut visitors = Visitors::default();
        let mut waiting: Vec<(u64, Duration)> = Vec::new();
        let mut pages: Vec<(u64, Duration)> = Vec::new();
        let says_after = Duration::from_millis(self.random.random_range(1..80));
        for millisecond in 0..500_u64 {
            let now = millisecond as u32 * MILLISECOND;
            for _ in 0..rate / 1_000 + u64::from(self.random.random_range(0..1_000) < rate % 1_000)
            {
                let elsewhere = Ipv4Addr::new(10, 0, 0, self.random.random_range(1..4));
                self.findings.count(self.kind, 1);
                let from = if is_beside { here } else { elsewhere.into() };
                let Some((number, turned_out)) = visitors.admit(from) else { continue };
                waiting.push((number, now));
                let lost = pages.iter().any(|page| Some(page.0) == turned_out);
                self.fails(lost);
                waiting.retain(|it| Some(it.0) != turned_out);
                pages.retain(|it| Some(it.0) != turned_out);
            }
            if millisecond.is_multiple_of(100) {
                match visitors.admit(here) {
                    Some((number, _)) => pages.push((number, now)),
                    None => self.fails(true),
                }
            }
            for (number, _) in pages.extract_if(.., |it| now >= it.1 + says_after) {
                visitors.welcome(number);
                self.fails(!visitors.is_guest(number));
                visitors.leave(number);
            }
            for (number, _) in waiting.extract_if(.., |it| now >= it.1 + PATIENCE) {
                visitors.leave(number);
            }
        }
    }

    /// A network falls silent until the rotors stand, and then carries again what the operator's program repeats.
    fn silence(&mut self, seed: u64, flash: &Option<Vec<u8>>) -> Result<(), BenchError> {
        let mut operation = bench_knowing(Base::Free, seed, flash.clone(), NETWORK)?;
        operation.wait_until_connected()?;
        operation.arm()?;
        operation.want(setpoint(30.0, 30.0)?);
        operation.run(Duration::from_millis(1_200), |_| {})?;
        let silence = Duration::from_millis(self.random.random_range(620..950));
        self.fails(silence >= LINK_LOST || operation.robot.truth().is_slower_than(REST_HZ));
        let (mut released, mut has_rested) = (false, false);
        let begun = operation.now();
        operation.operators[0].is_gone = true;
        while operation.now().since(begun) < silence + Duration::from_millis(600) {
            if !released && operation.now().since(begun) >= silence {
                released = true;
                operation.operators[0].is_gone = false;
            }
            for _ in 0..TICKS_PER_MS {
                operation.tick()?;
            }
            self.findings.count(self.kind, u64::from(released));
            has_rested |= operation.robot.report().state == State::Armed;
            let turns = !operation.robot.truth().is_slower_than(REST_HZ);
            self.fails(has_rested && turns);
        }
        self.fails(!has_rested);
        Ok(())
    }

    /// Somebody plays the robot to an operator that connects, in a flood, and the true robot answers too.
    fn impostor(&mut self) {
        let from = SocketAddr::from(OPERATOR);
        let mut now = Instant::START + MILLISECOND;
        let begun = now;
        let mut robot = RobotSession::new(bench_key(), self.fresh());
        let mut operator = OperatorSession::new(bench_key(), self.fresh(), now);
        let mut genuine: Vec<Vec<u8>> = Vec::new();
        let mut asked: Vec<u8> = Vec::new();
        while now.since(begun) < 2 * CONNECTED_WITHIN {
            now = now + MILLISECOND;
            while let Some(datagram) = operator.poll(now) {
                asked = datagram.to_vec();
                // What is forged comes first: the impostor is nearer.
                self.forge(&mut operator, now, &asked, &genuine);
                if let RobotReceived::Answer(answer) | RobotReceived::Connected(answer) =
                    robot.receive(now, from, &datagram)
                {
                    genuine.push(answer.to_vec());
                    operator.receive(now, &answer);
                }
            }
            self.forge(&mut operator, now, &asked, &genuine);
            if now.since(begun) >= CONNECTED_WITHIN {
                self.fails(operator.status(now) != Status::Connected);
            }
            let ping = ToRobot::request(1, Command::Ping(1));
            if let Ok(frame) = operator.send(now, &ping)
                && matches!(robot.receive(now, from, &frame), RobotReceived::Message(_))
            {
                let reply = ToOperator::Reply(Reply { request: 1, outcome: Outcome::Done });
                if let Ok((_, frame)) = robot.send(now, &reply) {
                    genuine.push(frame.to_vec());
                    operator.receive(now, &frame);
                }
            }
            if genuine.len() > 64 {
                genuine.remove(4);
            }
        }
    }

    fn forge(
        &mut self,
        operator: &mut OperatorSession,
        now: Instant,
        asked: &[u8],
        genuine: &[Vec<u8>],
    ) {
        for _ in 0..FORGED_PER_MS {
            let Some(datagram) = self.forgery(asked, genuine) else { return };
            self.findings.count(self.kind, 1);
            let received = operator.receive(now, &datagram);
            let is_believed =
                matches!(received, OperatorReceived::Message(_) | OperatorReceived::Connected);
            self.fails(is_believed || received == OperatorReceived::Left);
        }
    }

    fn forgery(&mut self, asked: &[u8], genuine: &[Vec<u8>]) -> Option<Vec<u8>> {
        let made_up = |siege: &mut Self, datagram: &Vec<u8>| {
            let mut datagram = datagram.clone();
            siege.random.fill_bytes(datagram.get_mut(HEAD..)?);
            Some(datagram)
        };
        match self.kind {
            Kind::ForgedRefusal => {
                // What a robot with another key says, or without any.
                let key = self.random.random::<bool>().then_some(Key::new([0x66; 32]));
                let mut other = RobotSession::new(key, self.fresh());
                match other.receive(Instant::START, OPERATOR.into(), asked) {
                    RobotReceived::Dropped(_, answer) => Some(answer?.to_vec()),
                    _ => None,
                }
            }
            Kind::ForgedChallenge => made_up(self, &self.earlier.first()?.clone()),
            Kind::ForgedAccept => made_up(self, &self.earlier.get(1)?.clone()),
            kind => {
                let of = if genuine.is_empty() { &self.earlier } else { genuine };
                let mut datagram = of.get(self.random.random_range(0..of.len()))?.clone();
                if kind == Kind::FlippedToOperator {
                    let bit = self.random.random_range(0..8 * datagram.len());
                    datagram[bit / 8] ^= 1 << (bit % 8);
                }
                Some(datagram)
            }
        }
    }

    /// What a robot with the same key says to an operator that connects.
    fn overhear(&mut self) -> Vec<Vec<u8>> {
        let now = Instant::START + MILLISECOND;
        let mut robot = RobotSession::new(bench_key(), self.fresh());
        let mut operator = OperatorSession::new(bench_key(), self.fresh(), now);
        let mut heard = Vec::new();
        while let Some(datagram) = operator.poll(now) {
            if let RobotReceived::Answer(answer) | RobotReceived::Connected(answer) =
                robot.receive(now, OPERATOR.into(), &datagram)
            {
                heard.push(answer.to_vec());
                operator.receive(now, &answer);
            }
        }
        heard
    }
}

/// Returns what a frame at the cable holds, its bytes of structure left out: whoever listens can do that.
fn decoded(frame: &[u8]) -> Vec<u8> {
    let mut bytes = frame.iter().copied().filter(|byte| *byte != 0).collect::<Vec<_>>();
    let mut place = 0;
    while place < bytes.len() {
        let step = usize::from(bytes[place]);
        bytes[place] = 0;
        place += step.max(1);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_that_crosses_the_cable_is_heard() {
        let key = Key::new([0xa7; 32]);
        let lab = Provisioning::new("walker", "lab", "password", None).unwrap();
        let request = Request::Provision(lab, Operator::new(OperatorName::OWNER, &key));
        let heard = decoded(&write_frame(&request).unwrap());
        assert!(heard.windows(32).any(|part| part == key.as_bytes()));
    }
}
