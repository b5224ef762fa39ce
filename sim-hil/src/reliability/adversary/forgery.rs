//! Forgeries: two robots of one seed go through the same scenario, tick by tick.
//!
//! Each is connected to, armed, shaken, reversed, stopped, armed again, and at last given another key or restarted in the
//! middle of a run. One of them is under attack. Whatever the attack does, the two must stay the same to the last bit: a
//! tick in which what the robot obeys differs is an accepted forgery, one in which the plant differs is a movement caused.
//!
//! The network of both neither loses nor delays by chance, since answers that the attacker provokes would else change
//! the fate of the operator's own datagrams.

use std::time::Duration;

use flix_firmware::hardware::TICK_RATE_HZ;
use flix_host::link::{RobotLink, Wish};
use flix_protocol::message::{Dropped, State};
use flix_protocol::session::Key;
use flix_protocol::units::{Instant, OutOfRange};

use super::attacker::Attacker;
use super::findings::Findings;
use super::kind::{FORGERIES, Kind};
use crate::rig::bench::{Base, BenchError, bench_knowing, setpoint};
use crate::rig::hardware_fault::{BOOT_TIME, HardwareFault, Injected};
use crate::rig::lossy_network::ChannelParameters;
use crate::rig::operation::{Operation, Towards};
use crate::rig::simulated::Processor;

/// How the last stretch of a scenario begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Turn {
    /// Another key is given to the live robot; its operator goes on with the old one.
    KeyChange,
    /// The robot restarts while it shakes, and knows nothing of the session any more.
    Restart,
}

/// Ticks in a millisecond.
pub(super) const TICKS_PER_MS: u64 = TICK_RATE_HZ as u64 / 1_000;
/// Length of a scenario.
const LENGTH: Duration = Duration::from_secs(9);
/// Time of its last turn.
const TURN: Duration = Duration::from_millis(7_500);
/// From where somebody else with the key stopped the robot.
const ELSEWHERE: ([u8; 4], u16) = ([192, 0, 2, 250], 40_000);
/// Each way.
pub(super) const NETWORK: ChannelParameters =
    ChannelParameters { delay: Duration::from_millis(2), ..ChannelParameters::PERFECT };

fn add(sum: &mut Dropped, more: &Dropped) {
    sum.malformed += more.malformed;
    sum.version += more.version;
    sum.forged += more.forged;
    sum.replayed += more.replayed;
    sum.stale += more.stale;
    sum.session += more.session;
    sum.busy += more.busy;
    sum.unprovisioned += more.unprovisioned;
}

/// Where two robots that should be the same are not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Divergence {
    obeyed: bool,
    moved: bool,
}

impl Divergence {
    fn between(attacked: &Operation, calm: &Operation) -> Self {
        let (attacked, calm) = (&attacked.robot, &calm.robot);
        let obeyed = attacked.software().slow.link.asked() != calm.software().slow.link.asked()
            || attacked.operator() != calm.operator()
            || attacked.report().state != calm.report().state;
        let moved = attacked.truth() != calm.truth();
        Self { obeyed, moved }
    }
}

/// A robot under attack, its twin, and the attacker.
pub(super) struct Scenario {
    turn: Turn,
    attacked: Operation,
    calm: Operation,
    attacker: Attacker,
}

impl Scenario {
    pub(super) fn new(
        seed: u64,
        number: u64,
        turn: Turn,
        flash: Option<Vec<u8>>,
    ) -> Result<Self, BenchError> {
        let twin = || bench_knowing(Base::Free, seed, flash.clone(), NETWORK);
        let (mut attacked, mut calm) = (twin()?, twin()?);
        // An earlier session, for the attacker to have heard; the twin has it too.
        let mut earlier = Vec::new();
        for operation in [&mut attacked, &mut calm] {
            earlier = overhear_session(operation)?;
        }
        let mut stranger = bench_knowing(Base::Free, seed ^ 0x5eed, None, NETWORK)?;
        let elsewhere = overhear_session(&mut stranger)?;
        let attacker = Attacker::new(seed ^ number.rotate_left(40), earlier, elsewhere);
        Ok(Self { turn, attacked, calm, attacker })
    }

    pub(super) fn run(mut self, datagrams: u64) -> Result<Findings, BenchError> {
        let start = self.attacked.now();
        let ticks = LENGTH.as_millis() as u64 * TICKS_PER_MS;
        let mut findings =
            Findings { handshake_s: Some(f64::INFINITY), driven: Some(0.0), ..Findings::default() };
        let mut shaken = [false; 2];
        let mut sent = 0;
        for tick in 0..ticks {
            for operation in [&mut self.attacked, &mut self.calm] {
                script(operation, tick, self.turn, start)?;
            }
            while sent * ticks < datagrams * (tick + 1) {
                self.attack(&mut findings);
                sent += 1;
            }
            let is_turn = self.attacked.now() == start + TURN;
            if is_turn {
                findings.answers_heard = Some(1.0 - self.attacked.client().statistics().loss());
            }
            if is_turn && self.turn == Turn::Restart {
                // A restart starts the robot's counters over.
                add(&mut findings.dropped, &self.attacked.robot.link_quality().dropped);
            }
            let attacker = &mut self.attacker;
            self.attacked.tick_overheard(|towards, datagram| attacker.keep(towards, datagram))?;
            self.calm.tick()?;
            let divergence = Divergence::between(&self.attacked, &self.calm);
            findings.forgeries += u64::from(divergence.obeyed);
            findings.movements += u64::from(divergence.moved);
            if divergence != Divergence::default() {
                break;
            }
            let now = self.attacked.now();
            if findings.handshake_s == Some(f64::INFINITY)
                && self.attacked.client().is_connected(now)
            {
                findings.handshake_s = Some(now.since(start).as_secs_f64());
            }
            let frequency = self.attacked.robot.truth().frequency();
            shaken[0] |= frequency > 25.0;
            shaken[1] |= frequency < -25.0;
        }
        add(&mut findings.dropped, &self.attacked.robot.link_quality().dropped);
        let timing = self.attacked.robot.report().timing;
        findings.overruns = timing.overruns.into();
        let is_at_rest = self.attacked.robot.truth().frequency().abs() < 0.5;
        // Whether the robot did all that its operator asked, so that there was something to disturb.
        findings.driven = Some(f64::from(u8::from(shaken == [true; 2] && is_at_rest)));
        Ok(findings)
    }

    fn attack(&mut self, findings: &mut Findings) {
        let now = self.attacked.now();
        let operator = self.attacked.operators[0].address;
        let which = self.attacker.below(FORGERIES.len());
        let kind = FORGERIES[which];
        let datagram = self.attacker.datagram(kind, now);
        findings.count(kind, 1);
        // The operator, too, gets forged datagrams.
        if self.attacker.below(8) == 0 && kind != Kind::Reflected {
            let datagram = self.attacker.datagram(Kind::Flipped, now);
            self.attacked.client().receive(now, &datagram);
        }
        let pretends =
            self.attacker.below(2) == 0 && !matches!(kind, Kind::HelloFlood | Kind::SecondOperator);
        let from = match kind {
            Kind::ReplayedStop => ELSEWHERE.into(),
            _ if pretends => operator,
            _ => self.attacker.address(),
        };
        self.attacked.robot.receive(from, &datagram);
    }
}

/// What a session of one second says to the robot, and a stop from outside before it.
fn overhear_session(operation: &mut Operation) -> Result<Vec<Vec<u8>>, BenchError> {
    let mut heard = Vec::new();
    let mut overhear = |operation: &mut Operation, until: Instant| {
        while operation.now() < until {
            operation.tick_overheard(|towards, datagram| {
                if towards == Towards::Robot {
                    heard.push(datagram.to_vec());
                }
            })?;
        }
        Ok::<_, BenchError>(())
    };
    let start = operation.now();
    overhear(operation, start + Duration::from_millis(700))?;
    let mut stopped = operation.stop_from(ELSEWHERE.into())?;
    // Telemetry states the stop.
    let now = operation.now();
    overhear(operation, now + Duration::from_millis(50))?;
    let now = operation.now();
    let _ = operation.client().press(now, Wish::Clear);
    overhear(operation, now + Duration::from_millis(100))?;
    let now = operation.now();
    let _ = operation.client().press(now, Wish::Arm);
    overhear(operation, now + Duration::from_millis(1_500))?;
    operation.want(setpoint(30.0, 0.0)?);
    let now = operation.now();
    overhear(operation, now + Duration::from_millis(300))?;
    operation.client().leave();
    let now = operation.now();
    overhear(operation, now + Duration::from_millis(1_000))?;
    let now = operation.now();
    operation.client().connect(now);
    heard.append(&mut stopped);
    Ok(heard)
}

/// What the operator, and fate, do in this tick of a scenario.
fn script(
    operation: &mut Operation,
    tick: u64,
    turn: Turn,
    start: Instant,
) -> Result<(), OutOfRange> {
    let now = operation.now();
    let milliseconds = tick / TICKS_PER_MS;
    if !tick.is_multiple_of(TICKS_PER_MS) {
        return Ok(());
    }
    let is_disarmed =
        operation.client().telemetry().is_some_and(|telemetry| telemetry.state == State::Disarmed);
    let may_arm = (700..2_000).contains(&milliseconds) || (5_700..6_500).contains(&milliseconds);
    match milliseconds {
        2_000 => operation.want(setpoint(30.0, 30.0)?),
        3_500 => operation.want(setpoint(-30.0, -60.0)?),
        5_000 => operation.client().stop(now),
        5_600 => {
            let _ = operation.client().press(now, Wish::Clear);
        }
        6_600 => operation.want(setpoint(-30.0, 90.0)?),
        _ if may_arm && is_disarmed && milliseconds.is_multiple_of(100) => {
            // The next try is 0.1 s away.
            let _ = operation.client().press(now, Wish::Arm);
        }
        _ => {}
    }
    if now == start + TURN {
        match turn {
            Turn::KeyChange => operation.robot.change_operators(Some(Key::new([0xc4; 32]))),
            Turn::Restart => {
                let fault = HardwareFault::Processor(Processor::Restarts);
                operation.robot.disturb(Injected::new(fault, now, now + BOOT_TIME, 0));
            }
        }
    }
    // Nobody reads them here.
    while operation.client().update().is_some() {}
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::bench::learnt;

    /// The comparison of the twins can fail.
    #[test]
    fn one_command_more_makes_twins_differ() {
        let flash = learnt(Base::Free, 5).unwrap();
        let mut scenario = Scenario::new(5, 0, Turn::Restart, flash).unwrap();
        let mut differ = Divergence::default();
        for tick in 0..25_000 {
            for operation in [&mut scenario.attacked, &mut scenario.calm] {
                script(operation, tick, Turn::Restart, Instant::START).unwrap();
                operation.tick().unwrap();
            }
            if tick == 22_000 {
                assert_eq!(Divergence::between(&scenario.attacked, &scenario.calm), differ);
                scenario.attacked.want(setpoint(30.0, 31.0).unwrap());
            }
        }
        differ = Divergence::between(&scenario.attacked, &scenario.calm);
        assert_eq!(differ, Divergence { obeyed: true, moved: true });
    }
}
