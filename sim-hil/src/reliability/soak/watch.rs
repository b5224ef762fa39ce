//! What is checked in every tick, and what came of it.

use std::time::Duration;

use flix_firmware::hardware::TICK;
use flix_protocol::message::State;
use flix_protocol::session::HOLDER_SILENCE;
use flix_protocol::units::Instant;

use crate::reliability::fault_matrix::{REST_HZ, REST_LIMIT_S};
use crate::rig::hardware_fault::HardwareFault;
use crate::rig::operation::{Operation, Operator};
use crate::rig::simulated::{Processor, Truth};
use crate::study::{Row, Value};

/// What must hold in every tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

/// All rules, each with the name of its column.
pub const RULES: [(Rule, &str); 6] = [
    (Rule::Current, "current"),
    (Rule::SpinsDisarmed, "spins_disarmed"),
    (Rule::TwoOperators, "two_operators"),
    (Rule::LateTick, "late_tick"),
    (Rule::StuckState, "stuck_state"),
    (Rule::Recovery, "recovery"),
];

/// What a trip of the current may take, with what the windings then still carry.
const TRIP_TIME: Duration = Duration::from_millis(1);
/// After hardware was mended it counts as sound once what it did has died away.
const AFTERMATH: Duration = Duration::from_millis(700);
/// Longest time from arming to the first answer of alignment.
const ALIGNING_LIMIT: Duration = Duration::from_secs(15);
/// Longest time for ramping down, and then braking.
const STOPPING_LIMIT: Duration = Duration::from_secs(1);

/// What happened in one scenario.
#[derive(Debug, Clone, Default)]
pub(super) struct Account {
    pub(super) episodes: u64,
    pub(super) commands: u64,
    pub(super) link_troubles: u64,
    pub(super) hardware_faults: u64,
    pub(super) restarts: u64,
    pub(super) longest_recovery: Duration,
    pub(super) largest_current: f64,
    pub(super) growth: Option<f64>,
    pub(super) violations: [u64; RULES.len()],
    pub(super) examples: Vec<String>,
}

impl Account {
    /// Examples that are kept.
    const EXAMPLES: usize = 10;

    /// Returns the values of the row, in the order of the columns.
    pub(super) fn row(&self) -> Row {
        [self.episodes, self.commands, self.link_troubles, self.hardware_faults, self.restarts]
            .map(Value::from)
            .into_iter()
            .chain([self.longest_recovery.as_secs_f64(), self.largest_current].map(Value::from))
            .chain(self.violations.map(Value::from))
            .chain([self.growth.into(), self.examples.join("; ").into()])
            .collect()
    }

    pub(super) fn broken(&mut self, rule: Rule, what: impl FnOnce() -> String) {
        self.violations[rule as usize] += 1;
        if self.examples.len() < Self::EXAMPLES {
            self.examples.push(what());
        }
    }
}

/// Checks the rules.
pub(super) struct Watch {
    /// Time of the last tick.
    pub(super) now: Instant,
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
    pub(super) fn new(now: Instant) -> Self {
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

    pub(super) fn see(
        &mut self,
        operation: &mut Operation,
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
        for ((rule, _), is_broken) in RULES.into_iter().zip(broken) {
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
        operation: &Operation,
        truth: &Truth,
        breakage: Option<(HardwareFault, Instant)>,
        account: &mut Account,
    ) -> bool {
        let settings = operation.robot.software().slow.settings();
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

    fn spins_disarmed(&mut self, operation: &Operation, truth: &Truth) -> bool {
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

    fn two_operators(&mut self, operation: &Operation) -> bool {
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

    fn stuck_state(&mut self, operation: &Operation) -> bool {
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

fn amperes_per_count(operation: &Operation) -> f64 {
    let hardware = &operation.robot.parameters().electronics.hardware;
    hardware.current_sense.map_or(0.0, |sense| f64::from(sense.microamperes_per_count) * 1e-6)
}
