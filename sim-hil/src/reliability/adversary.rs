//! Somebody on the network who sees everything, sends anything from any address, and does not have the key.
//!
//! Two robots of one seed go through the same scenario, tick by tick: each is connected to, armed, shaken, reversed, stopped,
//! armed again, and at last given another key or restarted in the middle of a run. One of them is under attack. Whatever
//! the attack does, the two must stay the same to the last bit: a tick in which what the robot obeys differs is an
//! accepted forgery, one in which the plant differs is a movement caused.
//!
//! The network of both neither loses nor delays by chance, since answers that the attacker provokes would else change
//! the fate of the operator's own datagrams.

use core::net::{Ipv4Addr, SocketAddr};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use flix_firmware::hardware::TICK_RATE_HZ;
use flix_protocol::frame::{
    Datagram, HANDSHAKE_LENGTHS, HEAD, MAGIC, MAXIMUM_DATAGRAM, MAXIMUM_MESSAGE, SEALED,
    SEALED_COUNTER, SEALED_HEADER, TAG_LENGTH,
};
use flix_protocol::message::{
    Command, DropReason, Dropped, State, ToOperator, ToRobot, unreadable,
};
use flix_protocol::provision::{Answer, FrameReader, Request};
use flix_protocol::session::{Key, OperatorSession};
use flix_protocol::units::{Instant, OutOfRange};
use rand::{Rng, RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use serde::Serialize;

use crate::plant::Plant;
use crate::rig::bench::{Base, BenchError, bench_knowing, learnt, setpoint};
use crate::rig::channel::ChannelParameters;
use crate::rig::hardware_fault::{BOOT_TIME, HardwareFault, Injected};
use crate::rig::operation::{Operation, Towards};
use crate::rig::robot::Processor;

/// What the attacker sends, each as often as the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Any bytes.
    Noise,
    /// Any bytes behind a good head of any kind, in the length of that kind as often as not.
    Headed,
    /// The head of the present session with a counter to come, before any body.
    Forged,
    /// A genuine datagram with one to three bits flipped.
    Flipped,
    /// A genuine datagram cut short.
    Truncated,
    /// A genuine datagram with bytes more.
    Extended,
    /// The beginning of one genuine datagram and the end of another.
    Spliced,
    /// A genuine datagram of the present session again.
    Replayed,
    /// A genuine datagram under another counter.
    Recounted,
    /// What the robot itself sent.
    Reflected,
    /// What was sent in an earlier session with this robot.
    EarlierSession,
    /// What was sent to another robot with the same key.
    OtherRobot,
    /// A handshake, or what follows it, under another key.
    OtherKey,
    /// Hellos from made-up addresses.
    HelloFlood,
    /// A second operator, with the right key.
    SecondOperator,
}

/// All of them.
pub const KINDS: [Kind; 15] = [
    Kind::Noise,
    Kind::Headed,
    Kind::Forged,
    Kind::Flipped,
    Kind::Truncated,
    Kind::Extended,
    Kind::Spliced,
    Kind::Replayed,
    Kind::Recounted,
    Kind::Reflected,
    Kind::EarlierSession,
    Kind::OtherRobot,
    Kind::OtherKey,
    Kind::HelloFlood,
    Kind::SecondOperator,
];

/// How the last stretch of a scenario begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Turn {
    /// Another key is given to the live robot; its operator goes on with the old one.
    KeyChange,
    /// The robot restarts while it shakes, and knows nothing of the session any more.
    Restart,
}

/// Ticks in a millisecond.
const TICKS_PER_MS: u64 = TICK_RATE_HZ as u64 / 1_000;
/// Length of a scenario.
const LENGTH: Duration = Duration::from_secs(9);
/// Time of its last turn.
const TURN: Duration = Duration::from_millis(7_500);
/// Datagrams in a scenario when there are enough for several: 100,000 a second, ten times a flood.
const DATAGRAMS_PER_SCENARIO: u64 = 900_000;
/// Each way.
const NETWORK: ChannelParameters =
    ChannelParameters { delay: Duration::from_millis(2), ..ChannelParameters::PERFECT };
/// Genuine datagrams that the attacker keeps: the newest of each way.
const KEPT: usize = 64;
/// Bytes fuzzed in one piece of work.
const FUZZED_AT_ONCE: u64 = 5_000_000;
/// Longest fuzzed input: longer than any datagram.
const LONGEST_FUZZED: usize = MAXIMUM_DATAGRAM + 88;

/// Verdict of an attack.
#[derive(Debug, Clone, Serialize)]
pub struct Verdict {
    /// Which robots.
    pub seed: u64,
    /// Sent by the attacker.
    pub datagrams: u64,
    /// The same by kind.
    pub kinds: BTreeMap<Kind, u64>,
    /// What the robots dropped, by reason, whoever sent it.
    pub dropped: BTreeMap<String, u64>,
    /// Ticks in which a robot obeyed something that its twin did not; a scenario ends with its first.
    pub accepted_forgeries: u64,
    /// Ticks in which a robot moved otherwise than its twin.
    pub movements: u64,
    /// Longest time from the operator's first Hello to the session, under the flood, in virtual time.
    pub handshake_s: f64,
    /// Ticks of the fast loop that came too late.
    pub overruns: u64,
    /// Fed to decoders, sessions and [`flix_firmware::robot::Robot::receive`].
    pub fuzzed_bytes: u64,
    /// Of any of them.
    pub panics: u64,
    /// Whether nothing was accepted, nothing moved, nothing panicked, and the operator got through.
    pub pass: bool,
}

/// Longest time that a handshake may take under a flood, s.
pub const HANDSHAKE_LIMIT_S: f64 = 1.0;

/// Sends so many datagrams at robots, and feeds them so many bytes. `done` is called with what was sent or fed since
/// its last call: datagrams, bytes.
///
/// # Errors
/// When a robot cannot be armed even without an attack.
pub fn measure(
    seed: u64,
    datagrams: u64,
    bytes: u64,
    done: impl Fn(u64, u64) + Sync,
) -> Result<Verdict, BenchError> {
    let flash = learnt(Base::Free, seed)?;
    // One for each turn at least.
    let scenarios = datagrams.div_ceil(DATAGRAMS_PER_SCENARIO).max(2);
    let accounts: Vec<Account> = (0..scenarios)
        .into_par_iter()
        .map(|number| {
            let share = datagrams / scenarios + u64::from(number < datagrams % scenarios);
            let turn = if number % 2 == 0 { Turn::KeyChange } else { Turn::Restart };
            let account = Scenario::new(seed, number, turn, flash.clone())?.run(share)?;
            done(account.kinds.iter().sum(), 0);
            Ok::<_, BenchError>(account)
        })
        .collect::<Result<_, _>>()?;
    let pieces = bytes.div_ceil(FUZZED_AT_ONCE);
    let fuzzed: Vec<(u64, u64)> = (0..pieces)
        .into_par_iter()
        .map(|piece| {
            let share = bytes / pieces + u64::from(piece < bytes % pieces);
            let outcome = catch_unwind(AssertUnwindSafe(|| fuzz(seed ^ piece << 32, share)));
            done(0, share);
            outcome.map_or((0, 1), |fuzzed| (fuzzed, 0))
        })
        .collect();
    Ok(verdict(seed, &accounts, &fuzzed))
}

fn verdict(seed: u64, accounts: &[Account], fuzzed: &[(u64, u64)]) -> Verdict {
    let sum = |figure: &dyn Fn(&Account) -> u64| accounts.iter().map(figure).sum::<u64>();
    let kinds = KINDS.into_iter().enumerate();
    let kinds = kinds.map(|(index, kind)| (kind, sum(&|account| account.kinds[index])));
    let dropped = DropReason::ALL.into_iter().map(|reason| {
        let count = sum(&|account| u64::from(account.dropped.get(reason)));
        (reason.to_string().replace(' ', "_"), count)
    });
    let mut verdict = Verdict {
        seed,
        datagrams: sum(&|account| account.kinds.iter().sum()),
        kinds: kinds.collect(),
        dropped: dropped.collect(),
        accepted_forgeries: sum(&|account| account.forgeries),
        movements: sum(&|account| account.movements),
        handshake_s: accounts.iter().map(|account| account.handshake_s).fold(0.0, f64::max),
        overruns: sum(&|account| account.overruns),
        fuzzed_bytes: fuzzed.iter().map(|(bytes, _)| bytes).sum(),
        panics: fuzzed.iter().map(|(_, panics)| panics).sum(),
        pass: false,
    };
    verdict.pass = verdict.accepted_forgeries == 0
        && verdict.movements == 0
        && verdict.panics == 0
        && verdict.overruns == 0
        && verdict.handshake_s < HANDSHAKE_LIMIT_S
        && accounts.iter().all(|account| account.is_complete);
    verdict
}

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

/// What happened in one scenario.
#[derive(Debug, Clone)]
struct Account {
    kinds: [u64; KINDS.len()],
    dropped: Dropped,
    forgeries: u64,
    movements: u64,
    handshake_s: f64,
    overruns: u64,
    /// Whether the robot did all that its operator asked, so that there was something to disturb.
    is_complete: bool,
}

/// Where two robots that should be the same are not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Divergence {
    obeyed: bool,
    moved: bool,
}

impl Divergence {
    fn between(attacked: &Operation<Plant>, calm: &Operation<Plant>) -> Self {
        let (attacked, calm) = (&attacked.robot, &calm.robot);
        let obeyed = attacked.software().order() != calm.software().order()
            || attacked.operator() != calm.operator()
            || attacked.report().state != calm.report().state;
        let moved = attacked.truth() != calm.truth();
        Self { obeyed, moved }
    }
}

/// A robot under attack, its twin, and the attacker.
struct Scenario {
    turn: Turn,
    attacked: Operation<Plant>,
    calm: Operation<Plant>,
    attacker: Attacker,
}

impl Scenario {
    fn new(seed: u64, number: u64, turn: Turn, flash: Option<Vec<u8>>) -> Result<Self, BenchError> {
        let twin = || bench_knowing(Base::Free, seed, flash.clone(), NETWORK);
        let (mut attacked, mut calm) = (twin()?, twin()?);
        // An earlier session, for the attacker to have heard; the twin has it too.
        let mut earlier = Vec::new();
        for operation in [&mut attacked, &mut calm] {
            earlier = overhear_session(operation)?;
        }
        let mut stranger = bench_knowing(Base::Free, seed ^ 0x5eed, None, NETWORK)?;
        let attacker = Attacker {
            random: Xoshiro256PlusPlus::seed_from_u64(seed ^ number.rotate_left(40)),
            to_robot: Vec::new(),
            to_operator: Vec::new(),
            earlier,
            elsewhere: overhear_session(&mut stranger)?,
        };
        Ok(Self { turn, attacked, calm, attacker })
    }

    fn run(mut self, datagrams: u64) -> Result<Account, BenchError> {
        let start = self.attacked.now();
        let ticks = LENGTH.as_millis() as u64 * TICKS_PER_MS;
        let mut account = Account {
            kinds: [0; KINDS.len()],
            dropped: Dropped::default(),
            forgeries: 0,
            movements: 0,
            handshake_s: f64::INFINITY,
            overruns: 0,
            is_complete: false,
        };
        let mut shaken = [false; 2];
        let mut sent = 0;
        for tick in 0..ticks {
            for operation in [&mut self.attacked, &mut self.calm] {
                script(operation, tick, self.turn, start)?;
            }
            while sent * ticks < datagrams * (tick + 1) {
                self.attack(&mut account);
                sent += 1;
            }
            if self.attacked.now() == start + TURN && self.turn == Turn::Restart {
                // A restart starts the robot's counters over.
                add(&mut account.dropped, &self.attacked.robot.link_quality().dropped);
            }
            let attacker = &mut self.attacker;
            self.attacked.tick_overheard(|towards, datagram| attacker.keep(towards, datagram))?;
            self.calm.tick()?;
            let divergence = Divergence::between(&self.attacked, &self.calm);
            account.forgeries += u64::from(divergence.obeyed);
            account.movements += u64::from(divergence.moved);
            if divergence != Divergence::default() {
                break;
            }
            let now = self.attacked.now();
            if account.handshake_s.is_infinite() && self.attacked.client().is_connected(now) {
                account.handshake_s = now.since(start).as_secs_f64();
            }
            let frequency = self.attacked.robot.truth().frequency();
            shaken[0] |= frequency > 25.0;
            shaken[1] |= frequency < -25.0;
        }
        add(&mut account.dropped, &self.attacked.robot.link_quality().dropped);
        let timing = self.attacked.robot.report().timing;
        account.overruns = timing.overruns.into();
        let is_at_rest = self.attacked.robot.truth().frequency().abs() < 0.5;
        account.is_complete = shaken == [true; 2] && is_at_rest;
        Ok(account)
    }

    fn attack(&mut self, account: &mut Account) {
        let now = self.attacked.now();
        let operator = self.attacked.operators[0].address;
        let which = self.attacker.below(KINDS.len());
        let kind = KINDS[which];
        let datagram = self.attacker.datagram(kind, now);
        account.kinds[which] += 1;
        // The operator, too, gets forged datagrams.
        if self.attacker.below(8) == 0 && kind != Kind::Reflected {
            let datagram = self.attacker.datagram(Kind::Flipped, now);
            self.attacked.client().receive(now, &datagram);
        }
        let pretends =
            self.attacker.below(2) == 0 && !matches!(kind, Kind::HelloFlood | Kind::SecondOperator);
        let from = if pretends { operator } else { self.attacker.address() };
        self.attacked.robot.receive(from, &datagram);
    }
}

/// What a session of one second says to the robot.
fn overhear_session(operation: &mut Operation<Plant>) -> Result<Vec<Vec<u8>>, BenchError> {
    let mut heard = Vec::new();
    let mut overhear = |operation: &mut Operation<Plant>, until: Instant| {
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
    let now = operation.now();
    operation.client().request(now, Command::Arm);
    overhear(operation, now + Duration::from_millis(1_500))?;
    operation.hold(setpoint(30.0, 0.0)?);
    let now = operation.now();
    overhear(operation, now + Duration::from_millis(300))?;
    operation.client().leave();
    let now = operation.now();
    overhear(operation, now + Duration::from_millis(1_000))?;
    let now = operation.now();
    operation.client().connect(now);
    Ok(heard)
}

/// What the operator, and fate, do in this tick of a scenario.
fn script(
    operation: &mut Operation<Plant>,
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
        2_000 => operation.hold(setpoint(30.0, 30.0)?),
        3_500 => operation.hold(setpoint(-30.0, -60.0)?),
        5_000 => operation.client().stop(now),
        5_600 => {
            operation.client().request(now, Command::Clear);
        }
        6_600 => operation.hold(setpoint(-30.0, 90.0)?),
        _ if may_arm && is_disarmed && milliseconds.is_multiple_of(100) => {
            operation.client().request(now, Command::Arm);
        }
        _ => {}
    }
    if now == start + TURN {
        match turn {
            Turn::KeyChange => operation.robot.change_key(Key::new([0xc4; 32])),
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

/// Has seen everything, and makes datagrams of it.
struct Attacker {
    random: Xoshiro256PlusPlus,
    /// What arrived at the robot in the present session, and, at the operator.
    to_robot: Vec<Vec<u8>>,
    to_operator: Vec<Vec<u8>>,
    /// What an earlier session said to this robot, and what one said to another.
    earlier: Vec<Vec<u8>>,
    elsewhere: Vec<Vec<u8>>,
}

/// Length of the sealed datagrams that are made up: with 8 bytes of ciphertext.
const SEALED_LENGTH: usize = SEALED_HEADER + 8 + TAG_LENGTH;

impl Attacker {
    fn keep(&mut self, towards: Towards, datagram: &[u8]) {
        let kept = match towards {
            Towards::Robot => &mut self.to_robot,
            Towards::Operator => &mut self.to_operator,
        };
        if kept.len() < KEPT {
            kept.push(datagram.to_vec());
        } else {
            // The first few are the handshake: they stay.
            let place = 4 + (self.random.next_u64() % (KEPT as u64 - 4)) as usize;
            kept[place] = datagram.to_vec();
        }
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.random.next_u64() % limit.max(1) as u64) as usize
    }

    fn address(&mut self) -> SocketAddr {
        let [a, b, c, d, ..] = self.random.next_u64().to_le_bytes();
        SocketAddr::from((Ipv4Addr::new(10, a, b, c), 1024 + u16::from(d)))
    }

    fn bytes(&mut self, length: usize) -> Vec<u8> {
        let mut bytes = vec![0; length];
        self.random.fill_bytes(&mut bytes);
        bytes
    }

    fn one_of(&mut self, pick: fn(&Self) -> &Vec<Vec<u8>>) -> Vec<u8> {
        let place = self.below(pick(self).len());
        match pick(self).get(place) {
            Some(datagram) => datagram.clone(),
            None => self.bytes(40),
        }
    }

    fn genuine(&mut self) -> Vec<u8> {
        self.one_of(|attacker| &attacker.to_robot)
    }

    fn datagram(&mut self, kind: Kind, now: Instant) -> Vec<u8> {
        match kind {
            Kind::Noise => {
                let length = self.below(LONGEST_FUZZED);
                self.bytes(length)
            }
            Kind::Headed => self.headed(),
            Kind::Forged => {
                let mut datagram = self.genuine();
                let step = 1 + self.random.next_u64() % 1_000;
                advance_counter(&mut datagram, step);
                let body = datagram.len().min(SEALED_COUNTER.end);
                self.random.fill_bytes(&mut datagram[body..]);
                datagram
            }
            Kind::Flipped => {
                let mut datagram = self.genuine();
                for _ in 0..=self.below(3) {
                    let bit = self.below(8 * datagram.len());
                    datagram[bit / 8] ^= 1 << (bit % 8);
                }
                // Two flips may have met; then it is a replay, which must be dropped all the same.
                datagram
            }
            Kind::Truncated => {
                let mut datagram = self.genuine();
                let length = self.below(datagram.len());
                datagram.truncate(length);
                datagram
            }
            Kind::Extended => {
                let mut datagram = self.genuine();
                let more = 1 + self.below(64);
                datagram.extend(self.bytes(more));
                datagram
            }
            Kind::Spliced => {
                let (begin, end) = (self.genuine(), self.genuine());
                let place = self.below(begin.len().min(end.len()));
                [&begin[..place], &end[place..]].concat()
            }
            Kind::Replayed => self.genuine(),
            Kind::Recounted => {
                let mut datagram = self.genuine();
                let step = self.random.next_u64() >> self.below(64);
                advance_counter(&mut datagram, step);
                datagram
            }
            Kind::Reflected => self.one_of(|attacker| &attacker.to_operator),
            Kind::EarlierSession => self.one_of(|attacker| &attacker.earlier),
            Kind::OtherRobot => self.one_of(|attacker| &attacker.elsewhere),
            Kind::OtherKey => self.hello(Key::new([0x66; 32]), now),
            Kind::HelloFlood => {
                let mut hello = self.to_robot.first().cloned().unwrap_or_else(|| vec![0; 62]);
                // A nonce of its own, and the tag that it cannot make.
                let nonce = hello.len().min(14)..hello.len().min(30);
                self.random.fill_bytes(&mut hello[nonce]);
                hello
            }
            Kind::SecondOperator => self.hello(Key::new([0x5a; 32]), now),
        }
    }

    fn headed(&mut self) -> Vec<u8> {
        let index = self.below(HANDSHAKE_LENGTHS.len() + 1);
        let (kind, exact) =
            HANDSHAKE_LENGTHS.get(index).copied().unwrap_or((SEALED, SEALED_LENGTH));
        let length = if self.below(2) == 0 { exact } else { HEAD + self.below(LONGEST_FUZZED) };
        let mut datagram = self.bytes(length.max(HEAD));
        datagram[..MAGIC.len()].copy_from_slice(&MAGIC);
        datagram[MAGIC.len()] = kind;
        datagram
    }

    fn hello(&mut self, key: Key, now: Instant) -> Vec<u8> {
        let mut entropy = [0; 32];
        self.random.fill_bytes(&mut entropy);
        let hello = OperatorSession::new(key, entropy, now).poll(now);
        hello.map_or_else(Vec::new, |hello| hello.to_vec())
    }
}

fn advance_counter(datagram: &mut [u8], step: u64) {
    if let Some(place) = datagram.get_mut(SEALED_COUNTER)
        && let Ok(counter) = <[u8; 8]>::try_from(&*place)
    {
        let counter = u64::from_le_bytes(counter).wrapping_add(step);
        place.copy_from_slice(&counter.to_le_bytes());
    }
}

/// Feeds so many bytes to decoders and to a live robot; returns how many. Panics where they do.
fn fuzz(seed: u64, bytes: u64) -> u64 {
    let Ok(mut operation) = bench_knowing(Base::Fixed, seed, None, NETWORK) else { return 0 };
    let _ = operation.connect();
    let mut fuzzer = Fuzzer::new(seed, &operation);
    let mut fed = 0;
    while fed < bytes {
        let input = fuzzer.input((bytes - fed).min(LONGEST_FUZZED as u64) as usize);
        fed += input.len() as u64;
        fuzzer.feed(&mut operation, &input);
        // A tick for every few, so that what was obeyed is acted on.
        if fuzzer.attacker.below(16) == 0 {
            let attacker = &mut fuzzer.attacker;
            let overhear = |towards, datagram: &[u8]| attacker.keep(towards, datagram);
            if operation.tick_overheard(overhear).is_err() {
                break;
            }
            while operation.client().update().is_some() {}
        }
    }
    fed
}

struct Fuzzer {
    attacker: Attacker,
    /// Somebody with the key, who sends what no type allows.
    insider: OperatorSession,
    address: SocketAddr,
    readers: (FrameReader, FrameReader),
}

impl Fuzzer {
    fn new(seed: u64, operation: &Operation<Plant>) -> Self {
        let now = operation.now();
        Self {
            attacker: Attacker {
                random: Xoshiro256PlusPlus::seed_from_u64(seed),
                to_robot: Vec::new(),
                to_operator: Vec::new(),
                earlier: Vec::new(),
                elsewhere: Vec::new(),
            },
            insider: OperatorSession::new(Key::new([0x5a; 32]), [9; 32], now),
            address: operation.operators[0].address,
            readers: (FrameReader::new(), FrameReader::new()),
        }
    }

    /// At least one byte, and no more than `most`.
    fn input(&mut self, most: usize) -> Vec<u8> {
        let kind = [Kind::Noise, Kind::Headed, Kind::Flipped, Kind::Spliced, Kind::Forged]
            [self.attacker.below(5)];
        let mut input = self.attacker.datagram(kind, Instant::START);
        input.truncate(most);
        if input.is_empty() { vec![0] } else { input }
    }

    fn feed(&mut self, operation: &mut Operation<Plant>, input: &[u8]) {
        let now = operation.now();
        let _ = Datagram::parse(input);
        let _ = unreadable(input);
        let _ = postcard::from_bytes::<ToRobot>(input);
        let _ = postcard::from_bytes::<ToOperator>(input);
        for &byte in input {
            let _ = self.readers.0.push::<Request>(byte);
            let _ = self.readers.1.push::<Answer>(byte);
        }
        operation.client().receive(now, input);
        operation.robot.receive(self.address, input);
        self.misuse_the_key(operation, now, input);
    }

    /// Takes the session now and then, as its holder may at any time, and says these bytes in it.
    fn misuse_the_key(&mut self, operation: &mut Operation<Plant>, now: Instant, input: &[u8]) {
        if self.attacker.random.random::<f64>() < 0.001 {
            self.insider.connect(now);
        }
        while let Some(frame) = self.insider.poll(now) {
            operation.robot.receive(self.address, &frame);
            let mut answer = flix_protocol::frame::Frame::new();
            while operation.robot.transmit(&mut answer).is_some() {
                let _ = self.insider.receive(now, &answer);
            }
        }
        let plain = &input[..input.len().min(MAXIMUM_MESSAGE)];
        if let Ok(frame) = self.insider.send_bytes(plain) {
            operation.robot.receive(self.address, &frame);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_accepted_and_nothing_moves_in_two_scenarios_under_attack() {
        let verdict = measure(3, 60_000, 300_000, |_, _| ()).unwrap();
        assert!(verdict.pass, "{verdict:?}");
        assert_eq!((verdict.datagrams, verdict.fuzzed_bytes), (60_000, 300_000));
    }

    #[test]
    fn every_reason_to_drop_but_two_is_met() {
        let verdict = measure(4, 60_000, 0, |_, _| ()).unwrap();
        let never: Vec<_> = verdict.dropped.iter().filter(|(_, count)| **count == 0).collect();
        let names: Vec<&str> = never.iter().map(|(name, _)| name.as_str()).collect();
        // Nothing late is genuine here, and the robot has a key.
        assert!(names.iter().all(|name| ["stale", "unprovisioned"].contains(name)), "{names:?}");
    }

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
                scenario.attacked.hold(setpoint(30.0, 31.0).unwrap());
            }
        }
        differ = Divergence::between(&scenario.attacked, &scenario.calm);
        assert_eq!(differ, Divergence { obeyed: true, moved: true });
    }
}
