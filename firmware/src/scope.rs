//! The scope's memory: a ring of rows that the fast half fills in every tick, and that operators read once it is
//! complete. It lies in the [`Exchange`](crate::fast::exchange::Exchange), so that no half waits for the other.

use core::borrow::BorrowMut;

use flix_protocol::message::{
    Outcome, Refusal, SCOPE_CHANNELS, SCOPE_VALUES, SCOPE_VALUES_PER_REPLY, ScopeCommand,
    ScopePlan, ScopeRows, ScopeState, ScopeStatus, Trigger,
};
use flix_protocol::units::Instant;
use heapless::Vec;

/// One value of each channel of the plan, in its order; zeros behind them.
pub type Row = [i16; SCOPE_CHANNELS];

/// What the fast half sees of itself in one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sample {
    /// Time of the tick.
    pub time: Instant,
    /// [`Scope::revision`] of the plan that named its channels.
    pub revision: u8,
    /// Values of these channels.
    pub row: Row,
    /// Whether a fault is latched.
    pub is_faulted: bool,
    /// Whether the motors are driven.
    pub is_driven: bool,
    /// Whether the pattern of a trial is under way.
    pub is_pattern: bool,
}

/// Room for the rows.
pub type Memory = [i16; SCOPE_VALUES];

/// A ring of rows, and how far their capture is. `M` is its memory, or a reference to it where that has a place of its
/// own: it is too large for the stack of a small chip.
#[derive(Debug, Clone)]
pub struct Scope<M = Memory> {
    memory: M,
    plan: ScopePlan,
    /// Counts beginnings; wraps.
    revision: u8,
    state: ScopeState,
    /// Rows that fit.
    capacity: u16,
    /// Rows that were captured, at most `capacity`.
    rows: u16,
    /// Where the next row goes: its number, and its first value.
    next: u16,
    place: usize,
    /// Rows still to come, that of the trigger among them.
    left: u16,
    trigger_time: Instant,
    was_faulted: bool,
    /// The last value of the channel whose level is waited for.
    last_level: Option<i16>,
}

impl<M: BorrowMut<Memory>> Scope<M> {
    /// Watches for faults, with this memory, whatever is in it.
    #[must_use]
    pub fn new(memory: M) -> Self {
        let mut scope = Self {
            memory,
            plan: ScopePlan::watch(),
            revision: 0,
            state: ScopeState::Waiting,
            capacity: 0,
            rows: 0,
            next: 0,
            place: 0,
            left: 0,
            trigger_time: Instant::START,
            was_faulted: false,
            last_level: None,
        };
        scope.begin();
        scope
    }

    /// Returns what is captured.
    #[must_use]
    pub const fn plan(&self) -> &ScopePlan {
        &self.plan
    }

    /// Returns a number that changes whenever a capture begins.
    #[must_use]
    pub const fn revision(&self) -> u8 {
        self.revision
    }

    /// Does what an operator wants of it.
    ///
    /// # Errors
    /// [`Refusal::Scope`] for a plan that is not possible; [`Refusal::NotCaptured`] when rows are wanted of a capture
    /// that is not complete.
    pub fn obey(&mut self, command: ScopeCommand) -> Result<Outcome, Refusal> {
        match command {
            ScopeCommand::Begin(plan) if plan.is_possible() => {
                self.plan = plan;
                self.begin();
                Ok(Outcome::Scope(self.status()))
            }
            ScopeCommand::Begin(_) => Err(Refusal::Scope),
            ScopeCommand::Status => Ok(Outcome::Scope(self.status())),
            ScopeCommand::Read(first) if self.state == ScopeState::Complete => {
                Ok(Outcome::ScopeRows(self.read(first)))
            }
            ScopeCommand::Read(_) => Err(Refusal::NotCaptured),
        }
    }

    /// Watches for faults again, unless it does: whoever wanted something else has gone.
    pub fn release(&mut self) {
        if self.plan.trigger != Trigger::Fault {
            self.plan = ScopePlan::watch();
            self.begin();
        }
    }

    /// Takes the values of a tick, unless they are of the channels of an earlier plan. Never panics.
    #[inline]
    pub fn record(&mut self, sample: &Sample) {
        let is_new_fault = sample.is_faulted && !self.was_faulted;
        self.was_faulted = sample.is_faulted;
        if sample.revision != self.revision {
            return;
        }
        match self.state {
            ScopeState::Complete => return self.wake(sample),
            ScopeState::Waiting => {
                if self.triggers(sample, is_new_fault) {
                    self.state = ScopeState::Filling;
                    self.trigger_time = sample.time;
                    self.left = self.capacity - self.plan.before;
                }
            }
            ScopeState::Filling => {}
        }
        self.push(&sample.row);
        if self.state == ScopeState::Filling {
            self.left = self.left.saturating_sub(1);
            if self.left == 0 {
                self.state = ScopeState::Complete;
            }
        }
    }

    /// Waits for the next fault when the motors are driven again.
    fn wake(&mut self, sample: &Sample) {
        if self.plan.trigger == Trigger::Fault && sample.is_driven && !sample.is_faulted {
            self.begin();
        }
    }

    #[inline]
    fn triggers(&mut self, sample: &Sample, is_new_fault: bool) -> bool {
        match self.plan.trigger {
            Trigger::Now => true,
            Trigger::Fault => is_new_fault,
            Trigger::Pattern => sample.is_pattern,
            Trigger::Level { channel, level, rising } => {
                let Some(&value) = sample.row.get(usize::from(channel)) else { return false };
                let last = self.last_level.replace(value);
                let is_crossed = last.is_some_and(|last| {
                    if rising {
                        last < level && value >= level
                    } else {
                        last > level && value <= level
                    }
                });
                is_crossed && self.rows >= self.plan.before
            }
        }
    }

    #[inline]
    fn push(&mut self, row: &Row) {
        let end = self.place + self.plan.channels.len();
        if let Some(place) = self.memory.borrow_mut().get_mut(self.place..end) {
            for (to, from) in place.iter_mut().zip(row) {
                *to = *from;
            }
        }
        self.rows = self.capacity.min(self.rows + 1);
        (self.next, self.place) =
            if self.next + 1 < self.capacity { (self.next + 1, end) } else { (0, 0) };
    }

    fn begin(&mut self) {
        self.revision = self.revision.wrapping_add(1);
        self.state = ScopeState::Waiting;
        self.capacity = self.plan.rows();
        (self.rows, self.next, self.place, self.left) = (0, 0, 0, 0);
        self.last_level = None;
    }

    fn status(&self) -> ScopeStatus {
        let after = self.capacity - self.plan.before - self.left;
        ScopeStatus {
            plan: self.plan.clone(),
            state: self.state,
            rows: self.rows,
            trigger_row: if self.state == ScopeState::Waiting {
                0
            } else {
                self.rows.saturating_sub(after)
            },
            trigger_time_us: self.trigger_time.as_micros(),
        }
    }

    fn read(&self, first: u16) -> ScopeRows {
        let width = self.plan.channels.len();
        let oldest = if self.rows < self.capacity { 0 } else { self.next };
        let mut values = Vec::new();
        let most = SCOPE_VALUES_PER_REPLY / width.max(1);
        for row in (first..self.rows).take(most) {
            let place = usize::from((oldest + row) % self.capacity.max(1)) * width;
            let row = self.memory.borrow().get(place..place + width).unwrap_or_default();
            for byte in row.iter().flat_map(|value| value.to_le_bytes()) {
                // So many rows fit.
                let _ = values.push(byte);
            }
        }
        ScopeRows { first, values }
    }
}

/// Returns a row of these values; what does not fit is the nearest that does.
#[inline(always)]
pub fn row(values: impl Iterator<Item = i32>) -> Row {
    let mut row = [0; SCOPE_CHANNELS];
    for (place, value) in row.iter_mut().zip(values) {
        let fits = value as i16;
        *place = if i32::from(fits) == value { fits } else { i16::MAX ^ (value >> 31) as i16 };
    }
    row
}

#[cfg(test)]
mod tests {
    use flix_protocol::message::Channel;

    use super::*;

    /// A scope of two channels, one of which counts ticks, and its inputs.
    struct Bench {
        scope: Scope,
        tick: i16,
        is_faulted: bool,
        is_driven: bool,
    }

    impl Bench {
        fn new(trigger: Trigger, before: u16) -> Self {
            let channels = [Channel::Theta, Channel::Bus].into_iter().collect();
            let plan = ScopePlan { channels, trigger, before };
            let mut bench = Self {
                scope: Scope::new([0; SCOPE_VALUES]),
                tick: 0,
                is_faulted: false,
                is_driven: true,
            };
            let begun = bench.scope.obey(ScopeCommand::Begin(plan));
            assert!(matches!(begun, Ok(Outcome::Scope(_))), "{begun:?}");
            bench
        }

        fn run(&mut self, ticks: u32) {
            for _ in 0..ticks {
                let time = Instant::from_micros(100 * self.tick.unsigned_abs() as u64);
                let row = row([i32::from(self.tick), -7].into_iter());
                let (is_faulted, is_driven, is_pattern) = (self.is_faulted, self.is_driven, false);
                let revision = self.scope.revision();
                let sample = Sample { time, revision, row, is_faulted, is_driven, is_pattern };
                self.scope.record(&sample);
                self.tick += 1;
            }
        }

        /// Returns all rows as an operator reads them.
        fn fetch(&mut self) -> std::vec::Vec<[i16; 2]> {
            let mut rows = std::vec::Vec::new();
            while let Ok(Outcome::ScopeRows(some)) =
                self.scope.obey(ScopeCommand::Read(rows.len() as u16))
                && !some.values.is_empty()
            {
                assert_eq!(usize::from(some.first), rows.len());
                rows.extend(some.values.chunks(4).map(|bytes| {
                    [[bytes[0], bytes[1]], [bytes[2], bytes[3]]].map(i16::from_le_bytes)
                }));
            }
            rows
        }
    }

    /// Of a tick in which the motors are driven.
    fn sample(time: Instant, revision: u8, row: Row) -> Sample {
        Sample { time, revision, row, is_faulted: false, is_driven: true, is_pattern: false }
    }

    const ROWS: u16 = (SCOPE_VALUES / 2) as u16;

    fn ticks(rows: &[[i16; 2]]) -> std::vec::Vec<i16> {
        rows.iter().map(|row| row[0]).collect()
    }

    #[test]
    fn the_rows_around_a_fault_are_kept_in_order() {
        let mut bench = Bench::new(Trigger::Fault, 1_000);
        bench.run(12_345);
        bench.is_faulted = true;
        bench.run(20_000);
        let status = bench.scope.status();
        assert_eq!((status.state, status.rows), (ScopeState::Complete, ROWS));
        assert_eq!((status.trigger_row, status.trigger_time_us), (1_000, 1_234_500));
        let first = 12_345 - 1_000;
        let rows = bench.fetch();
        assert_eq!(ticks(&rows), (first..first + ROWS as i16).collect::<std::vec::Vec<_>>());
        assert!(rows.iter().all(|row| row[1] == -7));
    }

    #[test]
    fn a_fault_soon_after_the_start_keeps_what_there_was() {
        let mut bench = Bench::new(Trigger::Fault, 1_000);
        bench.run(10);
        bench.is_faulted = true;
        bench.run(u32::from(ROWS));
        let status = bench.scope.status();
        assert_eq!((status.rows, status.trigger_row), (ROWS - 990, 10));
        assert_eq!(ticks(&bench.fetch())[..3], [0, 1, 2]);
    }

    #[test]
    fn nothing_is_read_of_a_capture_that_is_not_complete() {
        let mut bench = Bench::new(Trigger::Now, 0);
        assert_eq!(bench.scope.obey(ScopeCommand::Read(0)), Err(Refusal::NotCaptured));
        bench.run(u32::from(ROWS) - 1);
        assert_eq!(bench.scope.obey(ScopeCommand::Read(0)), Err(Refusal::NotCaptured));
        assert_eq!(bench.scope.status().state, ScopeState::Filling);
        bench.run(1);
        assert_eq!(bench.fetch().len(), usize::from(ROWS));
    }

    #[test]
    fn a_fault_that_stands_is_not_a_new_one() {
        let mut bench = Bench::new(Trigger::Fault, 0);
        bench.is_faulted = true;
        bench.run(1);
        let plan = bench.scope.plan().clone();
        assert!(bench.scope.obey(ScopeCommand::Begin(plan)).is_ok());
        bench.run(100);
        assert_eq!(bench.scope.status().state, ScopeState::Waiting);
    }

    #[test]
    fn a_fault_is_kept_until_the_motors_are_driven_again() {
        let mut bench = Bench::new(Trigger::Fault, 10);
        bench.run(20);
        (bench.is_faulted, bench.is_driven) = (true, false);
        bench.run(u32::from(ROWS));
        bench.is_faulted = false;
        bench.run(100);
        assert_eq!(bench.scope.status().state, ScopeState::Complete);
        bench.is_driven = true;
        bench.run(100);
        assert_eq!(bench.scope.status().state, ScopeState::Waiting);
        let complete = Bench::new(Trigger::Now, 0);
        let mut bench = Bench { is_driven: true, ..complete };
        bench.run(u32::from(ROWS) + 100);
        assert_eq!(bench.scope.status().state, ScopeState::Complete, "only a fault is watched for");
    }

    #[test]
    fn a_level_is_crossed_in_its_direction_once_the_rows_before_it_are_there() {
        // Upwards in rows 5 and 105, which come too early, and in row 1,005; downwards too early in row 100, and in 500.
        let values = || (0..100).chain(0..400).chain(-500..500);
        for (rising, expected) in [(true, 1_005), (false, 500)] {
            let level = Trigger::Level { channel: 0, level: 5, rising };
            let mut bench = Bench::new(level, 200);
            for (time, value) in (0..).zip(values()) {
                let (time, row) = (Instant::from_micros(time), row([value, 0].into_iter()));
                let revision = bench.scope.revision();
                let sample = sample(time, revision, row);
                bench.scope.record(&sample);
            }
            assert_eq!(bench.scope.status().trigger_time_us, expected, "rising: {rising}");
        }
    }

    #[test]
    fn values_of_the_channels_of_an_earlier_plan_are_not_taken() {
        let mut bench = Bench::new(Trigger::Now, 0);
        let old = bench.scope.revision();
        let plan = bench.scope.plan().clone();
        assert!(bench.scope.obey(ScopeCommand::Begin(plan)).is_ok());
        let row = [99; SCOPE_CHANNELS];
        let time = Instant::START;
        bench.scope.record(&sample(time, old, row));
        bench.run(u32::from(ROWS));
        assert_eq!(ticks(&bench.fetch())[..3], [0, 1, 2]);
    }

    #[test]
    fn a_plan_that_is_not_possible_changes_nothing() {
        let mut bench = Bench::new(Trigger::Now, 0);
        bench.run(u32::from(ROWS));
        let plan = ScopePlan { before: ROWS, ..bench.scope.plan().clone() };
        assert_eq!(bench.scope.obey(ScopeCommand::Begin(plan)), Err(Refusal::Scope));
        assert_eq!(bench.fetch().len(), usize::from(ROWS));
    }

    #[test]
    fn values_that_do_not_fit_are_the_nearest_that_do() {
        assert_eq!(row([70_000, -70_000, 3].into_iter()), [32_767, -32_768, 3, 0, 0, 0, 0, 0]);
    }
}
