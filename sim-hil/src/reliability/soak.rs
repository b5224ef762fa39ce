//! Soak test: hours of random commands, faults and link trouble in virtual time.
//!
//! Several robots run side by side, each with two operators who hold its key and one who does not. A scenario goes
//! in episodes: for some seconds chance commands, breaks the hardware, spoils network and clocks; then all is mended,
//! and the first operator has to get the robot shaking again. In every tick, [`Rule`]s are checked against the plant's truth.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use flix_firmware::hardware::TICK;
use flix_host::link::Update;
use flix_protocol::message::{Command, ParameterCommand, Setpoint, State};
use flix_protocol::session::{HOLDER_SILENCE, Key};
use flix_protocol::units::{Instant, OutOfRange};
use rand::{Rng, RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use serde::Serialize;

use crate::experiment::metrics::line_error;
use crate::plant::Plant;
use crate::reliability::fault_matrix::{REST_HZ, REST_LIMIT_S};
use crate::rig::bench::{BASES, BenchError, bench_knowing, learnt, setpoint};
use crate::rig::channel::{Bursts, ChannelParameters};
use crate::rig::hardware_fault::{BOOT_TIME, HardwareFault, Injected};
use crate::rig::operation::{Operation, Operator};
use crate::rig::simulated::{Processor, Truth};

/// What must hold in every tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// With sound hardware no phase carries more than the setting `current_limit`; with an amplifier or an encoder
    /// that lies, none more than `over_current` for longer than the trip takes.
    Current,
    /// No rotor spins for longer than the ramp takes while the robot is disarmed or faulted.
    SpinsDisarmed,
    /// Nobody takes the robot from an operator whose last command arrived less than a second ago, and nobody without the
    /// key ever.
    TwoOperators,
    /// The fast loop is late only when the processor was made to hang.
    LateTick,
    /// No state that leads to another lasts.
    StuckState,
    /// When all is mended, the first operator gets the robot to shake as he wants.
    Recovery,
}

/// All of them.
pub const RULES: [Rule; 6] = [
    Rule::Current,
    Rule::SpinsDisarmed,
    Rule::TwoOperators,
    Rule::LateTick,
    Rule::StuckState,
    Rule::Recovery,
];

/// The process may grow by this between the first and the last quarter, bytes: a few pages of each allocator arena.
pub const GROWTH_LIMIT: u64 = 2 << 20;
/// What a trip of the current may take, with what the windings then still carry.
const TRIP_TIME: Duration = Duration::from_millis(1);
/// After hardware was mended it counts as sound once what it did has died away.
const AFTERMATH: Duration = Duration::from_millis(700);
/// Longest time from arming to the first answer of alignment.
const ALIGNING_LIMIT: Duration = Duration::from_secs(15);
/// Longest time for ramping down, and then braking.
const STOPPING_LIMIT: Duration = Duration::from_secs(1);
/// Longest time from when all is mended until the robot shakes as commanded.
const RECOVERY_LIMIT: Duration = Duration::from_secs(30);
/// The chip's watchdog restarts a loop that hangs for so long.
const WATCHDOG: Duration = Duration::from_millis(200);
/// Mean time between two things that chance does.
const PACE: f64 = 0.25;
/// Longest scenario of one robot: more than the 71.6 minutes in which 32 bits of microseconds come round. There are
/// at least two at a time.
const LONGEST_SCENARIO: Duration = Duration::from_secs(7_200);

/// Verdict of a soak test.
#[derive(Debug, Clone, Serialize)]
pub struct Verdict {
    /// The robots.
    pub seed: u64,
    /// Virtual time of all robots together.
    pub virtual_hours: f64,
    /// How many.
    pub robots: u64,
    /// Times that all was mended and the robot had to shake again.
    pub episodes: u64,
    /// Commands given.
    pub commands: u64,
    /// Times that networks or clocks changed.
    pub link_troubles: u64,
    /// Times that hardware broke.
    pub hardware_faults: u64,
    /// Restarts of the robot's software.
    pub restarts: u64,
    /// Longest time from when all was mended until the robot shook as commanded.
    pub longest_recovery_s: f64,
    /// Largest phase current while the hardware was sound.
    pub largest_current_a: f64,
    /// Times that each rule was broken.
    pub violations: BTreeMap<Rule, u64>,
    /// The first few, in words.
    pub examples: Vec<String>,
    /// Scenarios that ended in a panic.
    pub panics: u64,
    /// By how much the process grew from the first to the last quarter; none where the system does not report it.
    pub growth_bytes: Option<i64>,
    /// Whether no rule was broken, nothing panicked, and memory stayed flat.
    pub pass: bool,
}

/// Runs several robots for this virtual time in all. `done` is called after each virtual second.
///
/// # Errors
/// When a robot cannot be armed while all is well, or diverges.
pub fn measure(
    seed: u64,
    total: Duration,
    done: impl Fn(u64) + Sync,
) -> Result<Verdict, BenchError> {
    let robots = total.as_secs().div_ceil(LONGEST_SCENARIO.as_secs()).max(2);
    let length = total / robots as u32;
    let memory = Memory::new(total);
    let accounts: Vec<Option<Account>> = (0..robots)
        .into_par_iter()
        .map(|robot| {
            let scenario = || {
                Scenario::new(seed.wrapping_mul(1_000_003).wrapping_add(robot))?.run(
                    length,
                    &|| {
                        memory.look();
                        done(1);
                    },
                )
            };
            match catch_unwind(AssertUnwindSafe(scenario)) {
                Ok(account) => account.map(Some),
                Err(_) => Ok(None),
            }
        })
        .collect::<Result<_, BenchError>>()?;
    let panics = accounts.iter().filter(|account| account.is_none()).count() as u64;
    let mut sum = Account::default();
    for account in accounts.into_iter().flatten() {
        sum.add(account);
    }
    let growth_bytes = memory.growth();
    let is_flat = growth_bytes.is_none_or(|growth| growth <= GROWTH_LIMIT as i64);
    let pass = sum.violations == [0; RULES.len()] && panics == 0 && is_flat && sum.episodes > 0;
    Ok(Verdict {
        seed,
        virtual_hours: (length * robots as u32).as_secs_f64() / 3_600.0,
        robots,
        episodes: sum.episodes,
        commands: sum.commands,
        link_troubles: sum.link_troubles,
        hardware_faults: sum.hardware_faults,
        restarts: sum.restarts,
        longest_recovery_s: sum.longest_recovery.as_secs_f64(),
        largest_current_a: sum.largest_current,
        violations: RULES.into_iter().zip(sum.violations).collect(),
        examples: sum.examples,
        panics,
        growth_bytes,
        pass,
    })
}

/// Resident memory of this process, largest in the first and in the last quarter of the virtual time.
struct Memory {
    total: u64,
    seconds: AtomicU64,
    early: AtomicU64,
    late: AtomicU64,
}

impl Memory {
    fn new(total: Duration) -> Self {
        let [seconds, early, late] = [0, 0, 0].map(AtomicU64::new);
        Self { total: total.as_secs(), seconds, early, late }
    }

    /// Once a virtual second of any robot.
    fn look(&self) {
        let seconds = self.seconds.fetch_add(1, Ordering::Relaxed);
        let quarter = match seconds * 4 / self.total.max(1) {
            0 => &self.early,
            3 => &self.late,
            _ => return,
        };
        if let Some(resident) = resident() {
            quarter.fetch_max(resident, Ordering::Relaxed);
        }
    }

    fn growth(&self) -> Option<i64> {
        let [early, late] = [&self.early, &self.late].map(|size| size.load(Ordering::Relaxed));
        (early > 0 && late > 0).then(|| late as i64 - early as i64)
    }
}

/// Returns the resident memory of this process in bytes, where the system reports it (Linux).
fn resident() -> Option<u64> {
    /// Of every system that this is run on.
    const PAGE: u64 = 4_096;
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    Some(text.split(' ').nth(1)?.parse::<u64>().ok()? * PAGE)
}

/// What happened in one scenario.
#[derive(Debug, Clone, Default)]
struct Account {
    episodes: u64,
    commands: u64,
    link_troubles: u64,
    hardware_faults: u64,
    restarts: u64,
    longest_recovery: Duration,
    largest_current: f64,
    violations: [u64; RULES.len()],
    examples: Vec<String>,
}

impl Account {
    /// Examples that are kept.
    const EXAMPLES: usize = 10;

    fn add(&mut self, other: Self) {
        self.episodes += other.episodes;
        self.commands += other.commands;
        self.link_troubles += other.link_troubles;
        self.hardware_faults += other.hardware_faults;
        self.restarts += other.restarts;
        self.longest_recovery = self.longest_recovery.max(other.longest_recovery);
        self.largest_current = self.largest_current.max(other.largest_current);
        for (sum, more) in self.violations.iter_mut().zip(other.violations) {
            *sum += more;
        }
        self.examples.extend(other.examples);
        self.examples.truncate(Self::EXAMPLES);
    }

    fn broken(&mut self, rule: Rule, what: impl FnOnce() -> String) {
        self.violations[rule as usize] += 1;
        if self.examples.len() < Self::EXAMPLES {
            self.examples.push(what());
        }
    }
}

/// One robot, those who want it, and all that goes wrong with it.
struct Scenario {
    operation: Operation<Plant>,
    random: Xoshiro256PlusPlus,
    seed: u64,
    watch: Watch,
    /// When the last hardware fault ends, and which it is.
    breakage: Option<(HardwareFault, Instant)>,
    /// When each operator, who failed or left, tries again.
    retry: [Option<Instant>; 3],
    account: Account,
    next_second: Instant,
}

impl Scenario {
    fn new(seed: u64) -> Result<Self, BenchError> {
        let base = BASES[(seed % 2) as usize];
        let flash = learnt(base, seed)?;
        let mut operation = bench_knowing(base, seed, flash, ChannelParameters::QUIET_WIFI)?;
        let key = operation.robot.parameters().key().unwrap_or_else(|| Key::new([0; 32]));
        operation.add_operator(key, ChannelParameters::QUIET_WIFI);
        operation.add_operator(Key::new([0x66; 32]), ChannelParameters::QUIET_WIFI);
        Ok(Self {
            random: Xoshiro256PlusPlus::seed_from_u64(seed ^ 0x50a4),
            seed,
            watch: Watch::new(operation.now()),
            operation,
            breakage: None,
            retry: [None; 3],
            account: Account::default(),
            next_second: Instant::from_micros(1_000_000),
        })
    }

    fn run(mut self, length: Duration, second: &dyn Fn()) -> Result<Account, BenchError> {
        let end = self.operation.now() + length;
        while self.operation.now() < end {
            self.inject(second)?;
            self.mend(second)?;
            self.recover(second)?;
        }
        Ok(self.account)
    }

    fn below(&mut self, limit: u64) -> u64 {
        self.random.next_u64() % limit
    }

    fn between(&mut self, lowest: f64, highest: f64) -> f64 {
        lowest + (highest - lowest) * self.random.random::<f64>()
    }

    /// Injects random commands, faults and link trouble for some seconds.
    fn inject(&mut self, second: &dyn Fn()) -> Result<(), BenchError> {
        self.isolate(ChannelParameters::QUIET_WIFI);
        let end = self.operation.now() + Duration::from_secs_f64(self.between(4.0, 20.0));
        while self.operation.now() < end {
            match self.below(10) {
                0 => self.spoil_link(),
                1 => self.spoil_clock(),
                2 | 3 => self.break_hardware(),
                _ => self.command()?,
            }
            let pause = -PACE * (1.0 - self.random.random::<f64>()).ln();
            self.advance(Duration::from_secs_f64(pause.min(3.0)), second)?;
        }
        Ok(())
    }

    fn advance(&mut self, duration: Duration, second: &dyn Fn()) -> Result<(), BenchError> {
        let end = self.operation.now() + duration;
        while self.operation.now() < end {
            self.tick(second)?;
        }
        Ok(())
    }

    fn tick(&mut self, second: &dyn Fn()) -> Result<(), BenchError> {
        self.operation.tick()?;
        self.listen();
        self.watch.see(&mut self.operation, self.breakage, &mut self.account);
        if self.operation.now() >= self.next_second {
            self.next_second = self.next_second + Duration::from_secs(1);
            second();
        }
        Ok(())
    }

    /// Lets the operators read their updates, and connect again after a failure.
    fn listen(&mut self) {
        let now = self.operation.now();
        for (operator, retry) in self.operation.operators.iter_mut().zip(&mut self.retry) {
            while let Some(update) = operator.client.update() {
                if matches!(update, Update::Failed(_) | Update::Left) {
                    *retry = Some(now + Duration::from_millis(500));
                }
            }
            if retry.is_some_and(|at| at <= now) {
                *retry = None;
                operator.client.connect(operator.clock.read(now));
            }
        }
    }

    fn command(&mut self) -> Result<(), OutOfRange> {
        let who = if self.below(4) == 0 { 1 } else { 0 };
        let setpoint = setpoint(self.between(-35.0, 35.0), self.between(-90.0, 90.0))?;
        let what = self.below(24);
        let rate = self.between(-5.0, 60.0) as f32;
        let operator = &mut self.operation.operators[who];
        let now = operator.clock.read(self.watch.now);
        let client = &mut operator.client;
        let name = |text: &str| text.try_into().unwrap_or_default();
        let request = match what {
            0..=7 => {
                client.want(now, setpoint);
                None
            }
            8 => {
                client.hold(now, Setpoint::REST);
                None
            }
            9 => {
                client.release();
                None
            }
            10 => {
                client.stop(now);
                None
            }
            11 => {
                client.leave();
                self.retry[who] = Some(self.watch.now + Duration::from_millis(300));
                None
            }
            12 => Some(Command::Disarm),
            13..=15 => Some(Command::Clear),
            16..=19 => Some(Command::Arm),
            20 => Some(Command::Parameter(ParameterCommand::List(0))),
            21 => Some(Command::Parameter(ParameterCommand::Set(name("telemetry_rate"), rate))),
            22 => Some(Command::Parameter(ParameterCommand::Save)),
            _ => Some(Command::Identify),
        };
        if let Some(command) = request {
            client.request(now, command);
        }
        self.account.commands += 1;
        Ok(())
    }

    fn spoil_link(&mut self) {
        let who = self.below(3) as usize;
        let network = match self.below(4) {
            0 => ChannelParameters::QUIET_WIFI,
            1 => ChannelParameters::CUT,
            _ => {
                let milliseconds = |of: &mut Self, most: f64| {
                    Duration::from_secs_f64(1e-3 * of.between(0.0, most))
                };
                let bursts = Bursts {
                    length: milliseconds(self, 400.0),
                    gap: Duration::from_millis(50) + milliseconds(self, 1_000.0),
                };
                ChannelParameters {
                    delay: milliseconds(self, 150.0),
                    jitter: milliseconds(self, 200.0),
                    loss: self.between(0.0, 0.6),
                    duplication: self.between(0.0, 0.5),
                    reordering: self.between(0.0, 0.5),
                    corruption: self.between(0.0, 0.5),
                    bursts: (self.below(2) == 0).then_some(bursts),
                    ..ChannelParameters::PERFECT
                }
            }
        };
        let ways = self.below(3);
        let operator = &mut self.operation.operators[who];
        if ways != 0 {
            operator.to_robot.parameters = network;
        }
        if ways != 1 {
            operator.to_operator.parameters = network;
        }
        self.account.link_troubles += 1;
    }

    fn spoil_clock(&mut self) {
        let (who, rate) = (self.below(3) as usize, self.between(0.9, 1.1));
        self.operation.operators[who].clock.run_at(rate, self.watch.now);
        self.account.link_troubles += 1;
    }

    /// One thing at a time: what two at once do to each other is for the tests of each.
    fn break_hardware(&mut self) {
        let now = self.watch.now;
        if self.breakage.is_some_and(|(_, until)| now <= until) {
            return;
        }
        self.operation.robot.mend();
        let motor = self.below(2) as usize;
        let mut lasts = Duration::from_secs_f64(self.between(0.0, 1.0).powi(3) * 3.0);
        let fault = match self.below(9) {
            0 => HardwareFault::EncoderStuck(motor),
            1 => HardwareFault::EncoderLost(motor),
            2 => HardwareFault::EncoderNoise(self.between(0.0, 2.0).exp2().powi(2)),
            3 => HardwareFault::OpenPhase(motor, self.below(3) as usize),
            4 => HardwareFault::CurrentOffset(motor, self.between(-700.0, 700.0) as i16),
            5 => HardwareFault::BusSag(self.between(-3.0, 6.0)),
            6 => HardwareFault::Processor(Processor::IsDeaf),
            7 => {
                lasts = lasts.min(WATCHDOG);
                HardwareFault::Processor(Processor::Hangs)
            }
            _ => {
                lasts = BOOT_TIME;
                self.account.restarts += 1;
                HardwareFault::Processor(Processor::Restarts)
            }
        };
        let (seed, mut until) = (self.random.next_u64(), now + lasts);
        self.operation.robot.disturb(Injected::new(fault, now, until, seed));
        if lasts == WATCHDOG {
            let restart = HardwareFault::Processor(Processor::Restarts);
            let hung = until;
            until = until + BOOT_TIME;
            self.operation.robot.disturb(Injected::new(restart, hung, until, seed));
            self.account.restarts += 1;
        }
        self.breakage = Some((fault, until));
        self.account.hardware_faults += 1;
    }

    /// All is well again, and only the first operator is left. The battery is swapped for a charged one.
    fn mend(&mut self, second: &dyn Fn()) -> Result<(), BenchError> {
        while self.breakage.is_some_and(|(_, until)| self.watch.now <= until) {
            self.tick(second)?;
        }
        self.operation.robot.mend();
        self.operation.robot.swap_battery(0.9);
        let now = self.watch.now;
        for operator in &mut self.operation.operators {
            operator.clock.run_at(1.0, now);
            operator.to_robot.parameters = ChannelParameters::QUIET_WIFI;
            operator.to_operator.parameters = ChannelParameters::QUIET_WIFI;
        }
        self.isolate(ChannelParameters::CUT);
        self.retry = [None; 3];
        if !self.operation.operators[0].client.is_connected(self.shown()) {
            self.retry[0] = Some(now + Duration::from_millis(500));
        }
        Ok(())
    }

    /// Puts all operators but the first on this network.
    fn isolate(&mut self, network: ChannelParameters) {
        for operator in &mut self.operation.operators[1..] {
            operator.to_robot.parameters = network;
            operator.to_operator.parameters = network;
        }
    }

    /// What the first operator's clock shows.
    fn shown(&self) -> Instant {
        self.operation.operators[0].clock.read(self.operation.now())
    }

    /// Time for which f and theta must be near before the robot counts as shaking as commanded.
    const NEAR_FOR: Duration = Duration::from_millis(300);

    fn recover(&mut self, second: &dyn Fn()) -> Result<(), BenchError> {
        let began = self.operation.now();
        let frequency = if self.below(2) == 0 { 25.0 } else { -25.0 };
        let commanded = setpoint(frequency, self.between(-90.0, 90.0))?;
        let mut near_since = None;
        self.account.episodes += 1;
        loop {
            let now = self.operation.now();
            let is_due = (now.as_micros() - began.as_micros()).is_multiple_of(100_000);
            if is_due {
                self.insist(commanded);
            }
            self.tick(second)?;
            let truth = self.operation.robot.truth();
            if is_near(&truth, commanded) {
                let since = *near_since.get_or_insert(now);
                if now.since(since) >= Self::NEAR_FOR {
                    break;
                }
            } else {
                near_since = None;
            }
            if now.since(began) > RECOVERY_LIMIT {
                let seed = self.seed;
                let robot = &self.operation.robot;
                let report = robot.report();
                self.account.broken(Rule::Recovery, || {
                    format!(
                        "robot {seed}, {:.3} s: still {} with {:?}, stopped {}, held by {:?}, f {:.2} Hz",
                        now.as_micros() as f64 * 1e-6,
                        report.state,
                        report.faults,
                        report.stopped,
                        robot.operator(),
                        truth.frequency(),
                    )
                });
                break;
            }
        }
        let took = self.operation.now().since(began);
        self.account.longest_recovery = self.account.longest_recovery.max(took);
        Ok(())
    }

    /// Asks for what a patient operator asks for next.
    fn insist(&mut self, setpoint: Setpoint) {
        let now = self.shown();
        let client = self.operation.client();
        let Some(telemetry) = client.telemetry().copied() else { return };
        if telemetry.stopped || !telemetry.faults.is_empty() {
            client.request(now, Command::Clear);
        } else if telemetry.state == State::Disarmed {
            client.request(now, Command::Arm);
        } else if matches!(telemetry.state, State::Armed | State::Running) {
            client.want(now, setpoint);
        }
    }
}

fn is_near(truth: &Truth, setpoint: Setpoint) -> bool {
    let direction = f64::from(setpoint.direction().get()).to_radians();
    (truth.frequency() - f64::from(setpoint.frequency().get())).abs() < 1.0
        && line_error(truth.direction, direction).abs().to_degrees() < 5.0
}

/// Checks the rules.
struct Watch {
    now: Instant,
    /// Since when each of these goes on.
    excess: Option<Instant>,
    spinning: Option<Instant>,
    state: (State, Instant),
    /// Until when the hardware does not count as sound.
    unsound_until: Instant,
    hung: bool,
    /// Who holds the session, and since when.
    holder: (Option<core::net::SocketAddr>, Instant),
    silence: Duration,
    /// A rule that was just broken, so that it counts once.
    reported: [bool; RULES.len()],
}

impl Watch {
    fn new(now: Instant) -> Self {
        Self {
            now,
            excess: None,
            spinning: None,
            state: (State::Disarmed, now),
            unsound_until: now,
            hung: false,
            holder: (None, now),
            silence: Duration::MAX,
            reported: [false; RULES.len()],
        }
    }

    fn see(
        &mut self,
        operation: &mut Operation<Plant>,
        breakage: Option<(HardwareFault, Instant)>,
        account: &mut Account,
    ) {
        self.now = operation.now();
        let truth = operation.robot.truth();
        let processor = operation.robot.processor();
        if let Some((_, until)) = breakage {
            self.unsound_until = until + AFTERMATH;
        }
        if processor == Processor::Hangs {
            self.hung = true;
        } else if processor == Processor::Restarts {
            self.hung = false;
        }
        let broken = [
            self.current(operation, &truth, breakage, account),
            self.spins_disarmed(operation, &truth),
            self.two_operators(operation),
            !self.hung
                && processor != Processor::Restarts
                && operation.robot.report().timing.overruns > 0,
            self.stuck_state(operation),
            false,
        ];
        for (rule, is_broken) in RULES.into_iter().zip(broken) {
            let was_broken = core::mem::replace(&mut self.reported[rule as usize], is_broken);
            if is_broken && !was_broken {
                let report = operation.robot.report();
                account.broken(rule, || {
                    format!(
                        "{rule:?} at {:.4} s of robot {}: {} with {}, {:.2} A, rotors at {:.1?} rad/s, \
                         broken: {breakage:?}",
                        self.now.as_micros() as f64 * 1e-6,
                        operation.robot.parameters().seed,
                        report.state,
                        report.faults,
                        truth.largest_current(),
                        truth.rotor_speed,
                    )
                });
            }
        }
    }

    fn current(
        &mut self,
        operation: &Operation<Plant>,
        truth: &Truth,
        breakage: Option<(HardwareFault, Instant)>,
        account: &mut Account,
    ) -> bool {
        let settings = operation.robot.software().settings();
        let current = truth.largest_current();
        if self.now > self.unsound_until {
            account.largest_current = account.largest_current.max(current);
            return current > f64::from(settings.current_limit);
        }
        // What an amplifier reads too much or too little, the robot cannot know.
        let error = match breakage {
            Some((HardwareFault::CurrentOffset(_, counts), _)) => {
                f64::from(counts.unsigned_abs()) * amperes_per_count(operation)
            }
            _ => 0.0,
        };
        // A bridge that gets no orders is under no limit.
        let hangs = matches!(breakage, Some((HardwareFault::Processor(Processor::Hangs), _)));
        if current <= f64::from(settings.over_current) + error || hangs {
            self.excess = None;
            return false;
        }
        let since = *self.excess.get_or_insert(self.now);
        self.now.since(since) > TRIP_TIME
    }

    fn spins_disarmed(&mut self, operation: &Operation<Plant>, truth: &Truth) -> bool {
        let robot = &operation.robot;
        let is_off = matches!(robot.report().state, State::Disarmed | State::Faulted)
            && robot.processor() <= Processor::IsDeaf;
        if !is_off || truth.is_slower_than(REST_HZ) {
            self.spinning = None;
            return false;
        }
        let since = *self.spinning.get_or_insert(self.now);
        self.now.since(since).as_secs_f64() > REST_LIMIT_S
    }

    fn two_operators(&mut self, operation: &Operation<Plant>) -> bool {
        let holder = operation.robot.operator();
        let silence = core::mem::replace(
            &mut self.silence,
            Duration::from_micros(operation.robot.link_quality().silence_us.into()),
        );
        let (before, since) = self.holder;
        let is_taken = before.is_some() && holder.is_some() && before != holder;
        if before != holder {
            self.holder = (holder, self.now);
        }
        // Who said goodbye does not believe to be connected any more.
        let believes = |operator: &Operator| {
            Some(operator.address) == before
                && operator.client.is_connected(operator.clock.read(self.now))
        };
        // A command before `since` was another's. A session without any counts from its Challenge, which none here sees.
        let silence = silence.saturating_add(TICK);
        let is_robbed = silence < HOLDER_SILENCE
            && silence <= self.now.since(since)
            && operation.operators.iter().any(believes);
        let stranger = operation.operators[2].address;
        (is_taken && is_robbed) || holder == Some(stranger)
    }

    fn stuck_state(&mut self, operation: &Operation<Plant>) -> bool {
        let state = operation.robot.report().state;
        if state != self.state.0 || operation.robot.processor() > Processor::IsDeaf {
            self.state = (state, self.now);
        }
        let limit = match state {
            State::Aligning => ALIGNING_LIMIT,
            State::Stopping => STOPPING_LIMIT,
            State::Disarmed | State::Armed | State::Running | State::Faulted => return false,
        };
        self.now.since(self.state.1) > limit
    }
}

fn amperes_per_count(operation: &Operation<Plant>) -> f64 {
    let hardware = &operation.robot.parameters().electronics.hardware;
    hardware.current_sense.map_or(0.0, |sense| f64::from(sense.microamperes_per_count) * 1e-6)
}

#[cfg(test)]
mod tests {
    use flix_firmware::hardware::Actuation;

    use super::*;
    use crate::rig::simulated::Disturbance;

    #[test]
    fn two_robots_come_through_a_minute_of_trouble() {
        let verdict = measure(1, Duration::from_secs(60), |_| ()).unwrap();
        let broken: u64 = verdict.violations.values().sum();
        assert_eq!((broken, verdict.panics), (0, 0), "{:#?}", verdict.examples);
        assert!(verdict.hardware_faults > 10 && verdict.episodes > 1, "{verdict:?}");
    }

    /// Bridges without supply: they coast, whatever they are ordered.
    struct Unsupplied;

    impl Disturbance for Unsupplied {
        fn actuation(&mut self, _now: Instant, actuation: &mut Actuation) {
            *actuation = Actuation::OFF;
        }
    }

    /// What checks the rules must be able to see them broken.
    #[test]
    fn rotors_that_nothing_brakes_are_seen_to_spin_disarmed() {
        let mut scenario = Scenario::new(2).unwrap();
        scenario.isolate(ChannelParameters::CUT);
        scenario.operation.arm().unwrap();
        scenario.operation.hold(setpoint(30.0, 0.0).unwrap());
        scenario.advance(Duration::from_secs(1), &|| ()).unwrap();
        scenario.operation.robot.disturb(Unsupplied);
        scenario.advance(Duration::from_secs(3), &|| ()).unwrap();
        assert_eq!(scenario.account.violations[Rule::SpinsDisarmed as usize], 1);
    }
}
