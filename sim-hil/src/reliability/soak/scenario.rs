//! What chance does to one robot, and how it is mended.

use std::time::Duration;

use flix_host::link::{Update, Wish};
use flix_protocol::message::{Command, ParameterCommand, Setpoint, State};
use flix_protocol::session::Key;
use flix_protocol::units::{Instant, OutOfRange};
use rand::{Rng, RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::memory::Memory;
use super::watch::{Account, Rule, Watch};
use crate::experiment::metrics::line_error;
use crate::rig::bench::{BASES, BenchError, bench_knowing, learnt, setpoint};
use crate::rig::hardware_fault::{BOOT_TIME, HardwareFault, Injected};
use crate::rig::lossy_network::{Bursts, ChannelParameters};
use crate::rig::operation::Operation;
use crate::rig::simulated::{Processor, Truth};

/// Longest time from when all is mended until the robot shakes as commanded.
const RECOVERY_LIMIT: Duration = Duration::from_secs(30);
/// The chip's watchdog restarts a loop that hangs for so long.
const WATCHDOG: Duration = Duration::from_millis(200);
/// Mean time between two things that chance does.
const PACE: f64 = 0.25;

/// One robot, those who want it, and all that goes wrong with it.
pub(super) struct Scenario {
    operation: Operation,
    random: Xoshiro256PlusPlus,
    seed: u64,
    watch: Watch,
    /// When the last hardware fault ends, and which it is.
    breakage: Option<(HardwareFault, Instant)>,
    /// When each operator, who failed or left, tries again.
    retry: [Option<Instant>; 3],
    account: Account,
    end: Instant,
    memory: Memory,
    next_second: Instant,
}

impl Scenario {
    pub(super) fn new(seed: u64, length: Duration) -> Result<Self, BenchError> {
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
            breakage: None,
            retry: [None; 3],
            account: Account::default(),
            end: operation.now() + length,
            memory: Memory::new(length),
            next_second: Instant::from_micros(1_000_000),
            operation,
        })
    }

    pub(super) fn run(mut self) -> Result<Account, BenchError> {
        while self.operation.now() < self.end {
            self.inject()?;
            self.mend()?;
            self.recover()?;
        }
        self.account.growth = self.memory.growth();
        Ok(self.account)
    }

    fn below(&mut self, limit: u64) -> u64 {
        self.random.next_u64() % limit
    }

    fn between(&mut self, lowest: f64, highest: f64) -> f64 {
        lowest + (highest - lowest) * self.random.random::<f64>()
    }

    /// Injects random commands, faults and link trouble for some seconds.
    fn inject(&mut self) -> Result<(), BenchError> {
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
            self.advance(Duration::from_secs_f64(pause.min(3.0)))?;
        }
        Ok(())
    }

    fn advance(&mut self, duration: Duration) -> Result<(), BenchError> {
        let end = self.operation.now() + duration;
        while self.operation.now() < end {
            self.tick()?;
        }
        Ok(())
    }

    fn tick(&mut self) -> Result<(), BenchError> {
        self.operation.tick()?;
        self.listen();
        self.watch.see(&mut self.operation, self.breakage, &mut self.account);
        if self.operation.now() >= self.next_second {
            self.next_second = self.next_second + Duration::from_secs(1);
            self.memory.look();
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
        // A wish that nobody may press now is none.
        let mut press = |wish| {
            let _ = client.press(now, wish);
        };
        match what {
            0..=7 => press(Wish::Shake(setpoint)),
            8 => client.hold(now, Setpoint::REST),
            9 => client.give_up(now),
            10 => client.stop(now),
            11 => {
                client.leave();
                self.retry[who] = Some(self.watch.now + Duration::from_millis(300));
            }
            12 => client.disarm(now),
            13..=15 => press(Wish::Clear),
            16..=19 => press(Wish::Arm),
            what => {
                let command = match what {
                    20 => ParameterCommand::List(0),
                    21 => ParameterCommand::Set(name("telemetry_rate"), rate),
                    _ => ParameterCommand::Save,
                };
                client.request(now, Command::Parameter(command));
            }
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
    fn mend(&mut self) -> Result<(), BenchError> {
        while self.breakage.is_some_and(|(_, until)| self.watch.now <= until) {
            self.tick()?;
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

    fn recover(&mut self) -> Result<(), BenchError> {
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
            self.tick()?;
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
        let wish = match telemetry.state {
            _ if telemetry.stopped || !telemetry.faults.is_empty() => Wish::Clear,
            State::Disarmed => Wish::Arm,
            State::Armed | State::Running => Wish::Shake(setpoint),
            State::Aligning | State::Stopping | State::Faulted => return,
        };
        // Telemetry has stated the permit.
        let _ = client.press(now, wish);
    }
}

fn is_near(truth: &Truth, setpoint: Setpoint) -> bool {
    let direction = f64::from(setpoint.direction().get()).to_radians();
    (truth.frequency() - f64::from(setpoint.frequency().get())).abs() < 1.0
        && line_error(truth.direction, direction).abs().to_degrees() < 5.0
}

#[cfg(test)]
mod tests {
    use flix_firmware::hardware::Actuation;
    use flix_host::link::RobotLink;

    use super::*;
    use crate::rig::simulated::Disturbance;

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
        let mut scenario = Scenario::new(2, Duration::from_secs(60)).unwrap();
        scenario.isolate(ChannelParameters::CUT);
        scenario.operation.arm().unwrap();
        scenario.operation.want(setpoint(30.0, 0.0).unwrap());
        scenario.advance(Duration::from_secs(1)).unwrap();
        scenario.operation.robot.disturb(Unsupplied);
        scenario.advance(Duration::from_secs(3)).unwrap();
        assert_eq!(scenario.account.violations[Rule::SpinsDisarmed as usize], 1);
    }
}
