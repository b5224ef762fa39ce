//! A network in the attacker's hands, between an operator with the key and his robot.
//!
//! A robot lives through several sessions. In each the operator connects, arms and shakes it. At a random moment the
//! network begins one of [`HOLD_UPS`]; at another the operator's intent to move ends
//! ([`Departure`]); the network goes on, and releases what it kept. In some sessions the robot then restarts or gets
//! another key, and all that was ever sent to it is played to it again; in some a next operator waits for it.
//!
//! What counts is the plant: how long a rotor still turns after the operator's last intent to move.

use core::net::SocketAddr;
use std::collections::VecDeque;
use std::time::Duration;

use flix_host::link::{Client, Update, Wish};
use flix_protocol::failsafe::COMMAND_AGE;
use flix_protocol::frame::Frame;
use flix_protocol::message::{Permit, Setpoint, State};
use flix_protocol::session::{Key, StopSession};
use flix_protocol::units::{Hertz, Instant};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::findings::{Findings, raise};
use super::forgery::{NETWORK, TICKS_PER_MS};
use super::kind::{HOLD_UPS, Kind};
use crate::reliability::fault_matrix::REST_HZ;
use crate::rig::bench::{Base, BenchError, bench_knowing, setpoint};
use crate::rig::hardware_fault::{BOOT_TIME, HardwareFault, Injected};
use crate::rig::lossy_network::{ChannelParameters, Release};
use crate::rig::operation::{Operation, Towards};
use crate::rig::simulated::Processor;

/// Share of the datagrams of somebody else's stop that are lost, each way.
const FOREIGN_LOSS: f64 = 0.2;
/// From where somebody else stops the robot.
const ELSEWHERE: ([u8; 4], u16) = ([192, 0, 2, 250], 40_000);

/// Interval at which the operator looks at his robot and asks again.
pub(super) const LOOK: u64 = 100;
/// Time after which a session goes on although its robot could not be brought to move, ms.
const PATIENCE: u64 = 6_000;
/// Interval that keeps every deadline of silence.
const ONE_BY_ONE: Duration = Duration::from_millis(90);
/// Interval just before a session is forgotten.
const SLOWLY: Duration = Duration::from_secs(9);
/// Recorded datagrams that are played in a millisecond.
const PLAYED_PER_MS: usize = 4;
/// For how long an operator wants nothing, ms, before he arms his robot, where idle orders are delayed.
const IDLE: u64 = 1_000;
/// Longest datagram, bytes, that passes a network which lets no telemetry through: telemetry takes more than 200.
const LONGEST_WITHOUT_TELEMETRY: usize = 160;
/// Longest time from an order to the halt that crosses it.
const CROSSING: Duration = Duration::from_millis(50);
/// Share of the orders that a halt crosses.
const CROSSED: f64 = 0.4;
/// For how long a fault, or a silence, lasts that crosses an order.
const CROSSING_LASTS: Duration = Duration::from_millis(350);

/// How an operator's intent to move ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Departure {
    /// His program ends without a word.
    Ends,
    /// His program hangs, goes on for a while, and ends.
    Hangs,
    /// His program says goodbye.
    Leaves,
    /// He wants the robot to stop.
    Stops,
    /// He wants the rotors at rest.
    Rests,
    /// Somebody else with the key stops the robot, while he goes on.
    IsOverruled,
}

const DEPARTURES: [Departure; 6] = [
    Departure::IsOverruled,
    Departure::Ends,
    Departure::Hangs,
    Departure::Leaves,
    Departure::Stops,
    Departure::Rests,
];

/// What happens in a session, when: milliseconds since the robot moved.
#[derive(Debug, Clone, Copy)]
struct Plan {
    kind: Kind,
    departure: Departure,
    /// The network begins its harm; 0: as soon as the operator connects.
    harms: u64,
    departs: u64,
    /// A program that hung goes on, and ends.
    returns: u64,
    ends: u64,
    /// Restart, or another key.
    turns: u64,
    /// What was kept is released.
    releases: u64,
    /// The next operator begins to connect.
    is_followed: bool,
    follows: u64,
    over: u64,
}

impl Plan {
    fn new(random: &mut Xoshiro256PlusPlus, kind: Kind) -> Self {
        let departs: u64 = random.random_range(500..2_500);
        let keeps = matches!(
            kind,
            Kind::ReleasedAtOnce
                | Kind::ReleasedOneByOne
                | Kind::ReleasedSlowly
                | Kind::KeptOverRestart
                | Kind::KeptOverKeyChange
                | Kind::KeptOverTakeover
        );
        // What is kept for longer is too old when it is released; the other harms may be there from the beginning.
        let longest = if keeps { 600 } else { departs * 5 / 4 };
        let harms = match kind {
            Kind::IdleReleased => 0,
            _ => departs.saturating_sub(random.random_range(0..longest)),
        };
        let departure = match kind {
            Kind::KeptOverTakeover => Departure::Ends,
            _ => DEPARTURES[random.random_range(0..DEPARTURES.len())],
        };
        let returns = departs + random.random_range(200..2_000);
        let turns = match kind {
            // While the operator drives.
            Kind::TelemetryStarved => harms + random.random_range(0..400),
            Kind::StopsBetween => random.random_range(100..departs),
            _ => departs + random.random_range(1_000..2_500),
        };
        let releases = match kind {
            Kind::KeptOverRestart | Kind::KeptOverKeyChange => {
                turns + BOOT_TIME.as_millis() as u64 + random.random_range(0..1_000)
            }
            _ => departs + random.random_range(0..5_000),
        };
        let watched = match kind {
            Kind::ReleasedSlowly => 2 * SLOWLY.as_millis() as u64 + 1_500,
            _ => 2_500,
        };
        Self {
            kind,
            departure,
            harms,
            departs,
            returns,
            ends: returns + random.random_range(100..800),
            turns,
            releases,
            is_followed: random.random::<bool>() || kind == Kind::KeptOverTakeover,
            follows: departs + random.random_range(0..1_000),
            over: releases.max(departs + 2_500) + watched,
        }
    }
}

/// Lets the robot of this seed live through a session under each of these harms; chance comes from `life` too.
///
/// # Errors
/// When the mechanics diverge.
pub(super) fn run(
    seed: u64,
    life: u64,
    kinds: &[Kind],
    flash: Option<Vec<u8>>,
) -> Result<Findings, BenchError> {
    let mut life = Life {
        operation: bench_knowing(Base::Free, seed, flash, NETWORK)?,
        random: Xoshiro256PlusPlus::seed_from_u64(seed ^ life.rotate_left(40)),
        recorded: Vec::new(),
        playing: VecDeque::new(),
        is_driving: false,
        intent: Instant::START,
        left: Instant::START,
        is_awaited: false,
        stopper: None,
        crosses_at: None,
        silent_until: None,
        shown: Vec::new(),
        looked_at: (State::Disarmed, 0),
        findings: Findings::default(),
        driven: 0,
    };
    for &kind in kinds {
        life.session(kind)?;
    }
    // Some kinds alone leave little to disturb.
    let is_whole = kinds.len() == HOLD_UPS.len();
    life.findings.driven = is_whole.then(|| f64::from(life.driven) / kinds.len() as f64);
    Ok(life.findings)
}

/// Asks for what brings the robot to shake as wanted; one that shakes is changed only if `changes`.
///
/// Returns the wish that was pressed.
pub(super) fn drive(
    client: &mut Client,
    now: Instant,
    wanted: Setpoint,
    changes: bool,
) -> Option<Wish> {
    let telemetry = client.telemetry()?;
    let wish = match telemetry.state {
        _ if telemetry.stopped => Wish::Clear,
        State::Faulted => Wish::Clear,
        State::Disarmed => Wish::Arm,
        State::Armed => Wish::Shake(wanted),
        State::Running if changes => Wish::Shake(wanted),
        State::Running | State::Aligning | State::Stopping => return None,
    };
    // A stop may be on its way.
    client.press(now, wish).ok().map(|()| wish)
}

struct Life {
    operation: Operation,
    random: Xoshiro256PlusPlus,
    /// All that was ever sent to the robot.
    recorded: Vec<Vec<u8>>,
    /// What of it is still to be played to it again.
    playing: VecDeque<Vec<u8>>,
    /// Whether the operator is there and wants the robot armed and moving.
    is_driving: bool,
    /// When an operator last wanted that.
    intent: Instant,
    /// When a program ended that had gone on without a walk.
    left: Instant,
    /// Whether the next operator waits for the robot.
    is_awaited: bool,
    /// Somebody else's stop, when he asked, and whether the robot has latched it.
    stopper: Option<(StopSession, Instant, bool)>,
    /// When what crosses an order comes.
    crosses_at: Option<Instant>,
    /// Until when the network is silent.
    silent_until: Option<Instant>,
    /// The newest permit that each operator was shown.
    shown: Vec<Option<Permit>>,
    /// State and count of clears that were looked at last.
    looked_at: (State, u8),
    findings: Findings,
    /// Sessions in which a rotor turned when the operator's intent to move ended.
    driven: u32,
}

impl Life {
    fn session(&mut self, kind: Kind) -> Result<(), BenchError> {
        let plan = Plan::new(&mut self.random, kind);
        self.operation.operators.clear();
        self.shown.clear();
        self.add_operator();
        (self.is_driving, self.is_awaited) = (true, false);
        (self.stopper, self.crosses_at, self.silent_until) = (None, None, None);
        let mut harmed_from = 0;
        if plan.harms == 0 {
            self.harm(&plan);
        }
        // Milliseconds since the session began, and since the robot moved.
        let (mut waited, mut moving) = (0, None);
        while moving.is_none_or(|moving| moving <= plan.over) {
            if moving.is_some_and(|moving| moving == plan.harms && plan.harms > 0) {
                harmed_from = self.taken();
                self.harm(&plan);
            }
            self.follow(&plan, waited, moving)?;
            let played = self.playing.len().min(PLAYED_PER_MS);
            let address = self.operation.operators[0].address;
            for datagram in self.playing.drain(..played) {
                self.operation.robot.receive(address, &datagram);
            }
            for _ in 0..TICKS_PER_MS {
                self.tick(kind)?;
            }
            waited += 1;
            let is_moving = !self.operation.robot.truth().is_slower_than(REST_HZ);
            moving = match moving {
                Some(moving) => Some(moving + 1),
                None => (is_moving || waited >= PATIENCE).then_some(1),
            };
            if moving == Some(plan.departs) {
                self.driven += u32::from(is_moving);
            }
        }
        self.findings.count(kind, self.taken() - harmed_from);
        Ok(())
    }

    /// What the operator, the next one, and fate do in this millisecond.
    fn follow(&mut self, plan: &Plan, waited: u64, moving: Option<u64>) -> Result<(), BenchError> {
        let now = self.operation.now();
        self.cross(plan.kind);
        let is_idle = plan.kind == Kind::IdleReleased && waited < IDLE;
        if moving.is_none_or(|moving| moving < plan.departs) {
            if waited.is_multiple_of(LOOK) && !is_idle {
                self.drive(plan.kind)?;
            }
        } else if moving == Some(plan.departs) {
            self.depart(plan.departure)?;
        }
        match plan.departure {
            Departure::Leaves if moving == Some(plan.departs + 1) => self.set_gone(true),
            Departure::Hangs if moving == Some(plan.returns) => self.set_gone(false),
            Departure::Hangs if moving == Some(plan.ends) => {
                // A program that goes on without a walk keeps its session for as long as it runs.
                if !self.walks() {
                    self.left = now;
                }
                self.set_gone(true);
            }
            _ => {}
        }
        if moving == Some(plan.turns) {
            self.turn(plan.kind);
        }
        let is_left =
            !matches!(plan.departure, Departure::Stops | Departure::Rests | Departure::IsOverruled);
        if is_left && plan.is_followed && moving == Some(plan.follows) {
            self.add_operator();
            self.is_awaited = true;
        }
        for (place, operator) in self.operation.operators.iter_mut().enumerate() {
            while let Some(update) = operator.client.update() {
                match update {
                    Update::Failed(_) | Update::Left if !operator.is_gone => {
                        operator.client.connect(now);
                    }
                    Update::Connected if place > 0 && self.is_awaited => {
                        self.is_awaited = false;
                        let waited = now.since(self.intent.max(self.left)).as_secs_f64();
                        raise(&mut self.findings.next_operator_s, waited);
                    }
                    _ => {}
                }
            }
        }
        Ok(())
    }

    /// Brings the robot to shake, and changes its mind about how.
    fn drive(&mut self, kind: Kind) -> Result<(), BenchError> {
        let now = self.operation.now();
        let frequency = self.random.random_range(15.0..35.0);
        let frequency = if self.random.random() { frequency } else { -frequency };
        let wanted = setpoint(frequency, self.random.random_range(-90.0..90.0))?;
        let changes = self.random.random::<f64>() < 0.2;
        let pressed = drive(self.operation.client(), now, wanted, changes);
        let is_crossed = match kind {
            Kind::HaltAtPress => pressed.is_some() && self.random.random::<f64>() < CROSSED,
            Kind::StopsBetween => {
                matches!(pressed, Some(Wish::Clear)) && self.random.random::<f64>() < CROSSED
            }
            _ => false,
        };
        if is_crossed {
            self.crosses_at = Some(now + CROSSING.mul_f64(self.random.random()));
        }
        Ok(())
    }

    /// Lets come what crosses an order, and go what is over.
    fn cross(&mut self, kind: Kind) {
        let now = self.operation.now();
        if self.silent_until.take_if(|until| *until <= now).is_some() {
            let operator = &mut self.operation.operators[0];
            (operator.to_robot.parameters, operator.to_operator.parameters) = (NETWORK, NETWORK);
        }
        if self.crosses_at.take_if(|at| *at <= now).is_none() {
            return;
        }
        match self.random.random_range(0..3) {
            0 if kind == Kind::HaltAtPress => {
                let fault = HardwareFault::EncoderLost(0);
                self.operation.robot.disturb(Injected::new(fault, now, now + CROSSING_LASTS, 0));
            }
            1 if kind == Kind::HaltAtPress => {
                self.silent_until = Some(now + CROSSING_LASTS);
                self.operation.operators[0].to_robot.parameters = ChannelParameters::CUT;
            }
            _ => self.stop_from_elsewhere(),
        }
    }

    fn stop_from_elsewhere(&mut self) {
        let mut entropy = [0; 32];
        self.random.fill(&mut entropy);
        let now = self.operation.now();
        self.stopper = Some((StopSession::new(&self.key(), entropy, now), now, false));
    }

    /// Counts starts of movement, and clears, that the holder of the session was not shown the permit of.
    fn look(&mut self, kind: Kind) {
        for (operator, shown) in self.operation.operators.iter().zip(&mut self.shown) {
            *shown = operator.client.permit().or(*shown);
        }
        let robot = &self.operation.robot;
        let report = robot.report();
        let (state, cleared) =
            std::mem::replace(&mut self.looked_at, (report.state, report.events.cleared));
        let is_undone = matches!(
            (state, report.state),
            (State::Aligning | State::Armed | State::Running, State::Disarmed | State::Stopping)
        );
        self.findings.unshown +=
            u64::from(is_undone && kind == Kind::IdleReleased && self.is_driving);
        let starts = matches!(
            (state, report.state),
            (State::Disarmed, State::Aligning) | (State::Armed, State::Running)
        );
        // A robot that restarts counts from zero.
        if starts || report.events.cleared == cleared.wrapping_add(1) {
            let holder = robot.operator();
            let place = self.operation.operators.iter().position(|it| Some(it.address) == holder);
            let shown = place.and_then(|place| self.shown[place]);
            self.findings.unshown += u64::from(shown != Some(report.permit));
        }
    }

    fn depart(&mut self, departure: Departure) -> Result<(), BenchError> {
        let now = self.operation.now();
        self.is_driving = false;
        let client = self.operation.client();
        match departure {
            Departure::Ends | Departure::Hangs => self.set_gone(true),
            Departure::Leaves => client.leave(),
            Departure::Stops => client.stop(now),
            Departure::Rests => client.hold(now, Setpoint::REST),
            Departure::IsOverruled => {
                self.stop_from_elsewhere();
            }
        }
        Ok(())
    }

    /// Returns whether the first operator's program holds a walk.
    fn walks(&self) -> bool {
        let held = self.operation.operators[0].client.held();
        held.is_some_and(|setpoint| setpoint.frequency() != Hertz::ZERO)
    }

    fn set_gone(&mut self, is_gone: bool) {
        self.operation.operators[0].is_gone = is_gone;
    }

    fn add_operator(&mut self) {
        let key = self.key();
        self.operation.add_operator(key, NETWORK);
        self.shown.push(None);
    }

    /// Returns the robot's key.
    fn key(&self) -> Key {
        let key = self.operation.robot.parameters().key();
        key.unwrap_or_else(|| Key::new([0; 32]))
    }

    /// Carries somebody else's stop to the robot, and the answers back.
    fn overrule(&mut self) {
        let now = self.operation.now();
        let Some((stop, asked, is_latched)) = &mut self.stopper else { return };
        if !*is_latched && self.operation.robot.report().stopped {
            *is_latched = true;
            let waited = now.since(*asked).as_secs_f64();
            raise(&mut self.findings.foreign_stop_s, waited);
        }
        let Some(datagram) = stop.poll(now) else { return };
        if self.random.random::<f64>() < FOREIGN_LOSS {
            return;
        }
        let address = SocketAddr::from(ELSEWHERE);
        self.operation.robot.receive(address, &datagram);
        let mut frame = Frame::new();
        while let Some(to) = self.operation.robot.transmit(&mut frame) {
            if to == address && self.random.random::<f64>() >= FOREIGN_LOSS {
                // What it drops it asks for again.
                let _ = stop.receive(now, &frame);
            }
            let others = self.operation.operators.iter_mut();
            for operator in others.filter(|operator| operator.address == to) {
                operator.to_operator.send(now, &frame);
            }
        }
    }

    /// Datagrams that the first operator's network took.
    fn taken(&self) -> u64 {
        let operator = &self.operation.operators[0];
        operator.to_robot.taken() + operator.to_operator.taken()
    }

    fn harm(&mut self, plan: &Plan) {
        let now = self.operation.now();
        // As often as not just below the command age, where it harms most.
        let longest = if self.random.random() { COMMAND_AGE.as_millis() as u64 } else { 3_000 };
        let wait = Duration::from_millis(self.random.random_range(20..longest));
        let share = self.random.random_range(0.2..=1.0);
        let releases = Duration::from_millis(plan.releases - plan.harms);
        let calm = NETWORK;
        let late = ChannelParameters { delay: wait, ..calm };
        let kept = |release| (ChannelParameters { release, ..calm }, calm);
        let both = |parameters| (parameters, parameters);
        let (to_robot, to_operator) = match plan.kind {
            Kind::DelayedToRobot => (late, calm),
            Kind::DelayedToOperator => (calm, late),
            Kind::Dropped => both(ChannelParameters { loss: share, ..calm }),
            Kind::Reordered => both(ChannelParameters { reordering: share, jitter: wait, ..calm }),
            Kind::Duplicated => {
                both(ChannelParameters { duplication: share, jitter: wait, ..calm })
            }
            Kind::ReleasedOneByOne => kept(Release::OneEvery(ONE_BY_ONE)),
            Kind::ReleasedSlowly => kept(Release::OneEvery(SLOWLY)),
            Kind::ReleasedAtOnce
            | Kind::KeptOverRestart
            | Kind::KeptOverKeyChange
            | Kind::KeptOverTakeover => kept(Release::From(now + releases)),
            Kind::IdleReleased => (ChannelParameters { reordering: 0.5, ..calm }, calm),
            Kind::TelemetryStarved => {
                (calm, ChannelParameters { longest: LONGEST_WITHOUT_TELEMETRY, ..calm })
            }
            Kind::HaltAtPress | Kind::StopsBetween => both(calm),
            _ => both(late),
        };
        let operator = &mut self.operation.operators[0];
        operator.to_robot.parameters = to_robot;
        operator.to_operator.parameters = to_operator;
    }

    fn turn(&mut self, kind: Kind) {
        let now = self.operation.now();
        match kind {
            Kind::KeptOverRestart => {
                let fault = HardwareFault::Processor(Processor::Restarts);
                self.operation.robot.disturb(Injected::new(fault, now, now + BOOT_TIME, 0));
            }
            Kind::KeptOverKeyChange => {
                let mut key = [0; 32];
                self.random.fill(&mut key);
                self.operation.robot.change_operators(Some(Key::new(key)));
            }
            Kind::KeptOverTakeover => {}
            Kind::TelemetryStarved | Kind::StopsBetween => return self.stop_from_elsewhere(),
            _ => return,
        }
        self.is_awaited = false;
        self.playing = self.recorded.iter().cloned().collect();
    }

    fn tick(&mut self, kind: Kind) -> Result<(), BenchError> {
        self.overrule();
        let now = self.operation.now();
        // A program that hung repeats its walk: intent, unless another operator has asked for a stop since the last intent.
        let holds = !self.operation.operators[0].is_gone && self.walks();
        let is_overruled = self.stopper.as_ref().is_some_and(|(_, asked, _)| *asked >= self.intent);
        if self.is_driving || holds && !is_overruled {
            self.intent = now;
        }
        let recorded = &mut self.recorded;
        self.operation.tick_overheard(|towards, datagram| {
            if towards == Towards::Robot {
                recorded.push(datagram.to_vec());
            }
        })?;
        self.look(kind);
        if !self.operation.robot.truth().is_slower_than(REST_HZ) {
            let since = self.operation.now().since(self.intent).as_secs_f64();
            raise(&mut self.findings.movement_s, since);
        }
        Ok(())
    }
}
