//! Watchdogs: four stages, each with its own time and its own action, started anew by every feed. The timer groups
//! have one each; the low-power side has one that also watches the boot.

use super::clock::RC_SLOW_HZ;
use super::{Answer, NEVER, Unmodelled, cycles_of, ticks_of};
use crate::registers::Values;

/// What a stage does when its time is up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Action {
    Interrupt,
    ResetCpu,
    ResetSystem,
    /// With the low-power side.
    ResetAll,
}

/// The stages.
#[derive(Debug, Default)]
pub(crate) struct Stages {
    is_on: bool,
    actions: [Option<Action>; 4],
    timeouts: [u64; 4],
    stage: usize,
    /// Ticks of the stage that had passed at `since`.
    passed: u64,
    since: u64,
    hertz: u64,
    /// When it was last switched on.
    on_since: Option<u64>,
}

impl Stages {
    /// Switches on or off; on starts at the first stage.
    pub(crate) fn configure(&mut self, now: u64, is_on: bool, actions: [Option<Action>; 4]) {
        if is_on && !self.is_on {
            self.feed(now);
            self.on_since = Some(now);
        }
        self.is_on = is_on;
        self.actions = actions;
    }

    /// Ticks of each stage.
    pub(crate) fn set_timeouts(&mut self, timeouts: [u64; 4]) {
        self.timeouts = timeouts;
    }

    /// Counts at this rate from now on.
    pub(crate) fn retime(&mut self, now: u64, hertz: u64) {
        self.passed += ticks_of(now.saturating_sub(self.since), self.hertz);
        self.since = now;
        self.hertz = hertz;
    }

    /// Starts at the first stage.
    pub(crate) fn feed(&mut self, now: u64) {
        self.stage = 0;
        self.passed = 0;
        self.since = now;
    }

    pub(crate) fn is_on(&self) -> bool {
        self.is_on && self.actions.iter().any(Option::is_some)
    }

    /// Returns when the present stage ends.
    pub(crate) fn expires_at(&self) -> u64 {
        if !self.is_on() {
            return NEVER;
        }
        let left = self.timeouts[self.stage].saturating_sub(self.passed);
        self.since.saturating_add(cycles_of(left, self.hertz))
    }

    /// Goes through the stages that have ended, up to the first that acts.
    pub(crate) fn advance(&mut self, now: u64) -> Option<Action> {
        for _ in 0..self.actions.len() {
            let at = self.expires_at();
            if at > now {
                return None;
            }
            let action = self.actions[self.stage];
            self.stage = (self.stage + 1) % self.actions.len();
            self.passed = 0;
            self.since = at;
            if action.is_some() {
                return action;
            }
        }
        None
    }
}

const CONFIG: u32 = 0x00;
const TIMEOUTS: u32 = 0x04;
const FEED: u32 = 0x14;
const PROTECT: u32 = 0x18;
const SUPER_CONFIG: u32 = 0x1C;
const SUPER_PROTECT: u32 = 0x20;
const INTERRUPT_RAW: u32 = 0x24;
const INTERRUPT_ENABLE: u32 = 0x2C;
const INTERRUPT_CLEAR: u32 = 0x30;
/// Opens the registers.
const KEY: u32 = 0x50D8_3AA1;
/// The first stage's time is stretched by this power of two: eFuse `WDT_DELAY_SEL` is 0, and one more.
const FIRST_STAGE_SHIFT: u32 = 1;
/// What the boot loader leaves for a program to start in, s.
const BOOT_SECONDS: u64 = 9;
const BOOT_ACTION: Action = Action::ResetAll;

/// The watchdog of the low-power side.
pub(crate) struct LowPowerWatchdog {
    pub(crate) values: Values,
    stages: Stages,
    raw: u32,
    /// When it was last fed.
    pub(crate) fed_at: Option<u64>,
}

impl LowPowerWatchdog {
    /// Creates the watchdog as the boot loader hands it over: on.
    pub(crate) fn new(now: u64) -> Self {
        let mut stages = Stages::default();
        stages.retime(now, RC_SLOW_HZ);
        stages.configure(now, true, [Some(BOOT_ACTION), None, None, None]);
        stages.set_timeouts([BOOT_SECONDS * RC_SLOW_HZ, 0, 0, 0]);
        Self { values: Values::reset("LP_WDT"), stages, raw: 0, fed_at: None }
    }

    pub(crate) fn next_event(&self) -> u64 {
        self.stages.expires_at()
    }

    /// Returns when it was last switched on.
    pub(crate) fn on_since(&self) -> Option<u64> {
        self.stages.on_since
    }

    pub(crate) fn is_on(&self) -> bool {
        self.stages.is_on()
    }

    pub(crate) fn advance(&mut self, now: u64) -> Option<Action> {
        match self.stages.advance(now) {
            Some(Action::Interrupt) => {
                self.raw |= 1 << 31;
                None
            }
            other => other,
        }
    }

    pub(crate) fn level(&self) -> bool {
        self.raw & self.values.get(INTERRUPT_ENABLE) != 0
    }

    pub(crate) fn read(&self, offset: u32) -> Answer<u32> {
        match offset {
            INTERRUPT_RAW => Ok(self.raw),
            0x28 => Ok(self.raw & self.values.get(INTERRUPT_ENABLE)),
            _ => Ok(self.values.get(offset)),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: u64) -> Answer<()> {
        let is_locked = self.values.get(PROTECT) != KEY;
        let super_is_locked = self.values.get(SUPER_PROTECT) != KEY;
        match offset {
            PROTECT | SUPER_PROTECT | INTERRUPT_ENABLE => self.values.set(offset, value),
            INTERRUPT_CLEAR => self.raw &= !value,
            SUPER_CONFIG if super_is_locked => {}
            SUPER_CONFIG => self.values.set(offset, value),
            CONFIG..=FEED if is_locked => {}
            FEED => {
                if value >> 31 == 1 {
                    self.fed_at = Some(now);
                    self.stages.feed(now);
                }
            }
            CONFIG => {
                self.values.set(offset, value);
                let actions = [28, 25, 22, 19].map(|bit| match value >> bit & 7 {
                    1 => Some(Action::Interrupt),
                    2 => Some(Action::ResetCpu),
                    3 => Some(Action::ResetSystem),
                    4 => Some(Action::ResetAll),
                    _ => None,
                });
                self.stages.configure(now, value >> 31 == 1, actions);
                self.timeouts();
            }
            TIMEOUTS..=0x10 => {
                self.values.set(offset, value);
                self.timeouts();
            }
            _ => return Err(Unmodelled::Register),
        }
        Ok(())
    }

    fn timeouts(&mut self) {
        let timeout = |stage: u32| u64::from(self.values.get(TIMEOUTS + 4 * stage));
        let first = timeout(0) << FIRST_STAGE_SHIFT;
        self.stages.set_timeouts([first, timeout(1), timeout(2), timeout(3)]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::block::CYCLES_PER_SECOND;

    #[test]
    fn a_program_that_leaves_the_boot_loaders_watchdog_alone_is_reset_after_nine_seconds() {
        let mut watchdog = LowPowerWatchdog::new(0);
        assert_eq!(watchdog.next_event(), 9 * CYCLES_PER_SECOND);
        assert_eq!(watchdog.advance(9 * CYCLES_PER_SECOND), Some(Action::ResetAll));
    }

    #[test]
    fn stages_follow_each_other_until_one_is_fed() {
        let mut stages = Stages::default();
        stages.retime(0, CYCLES_PER_SECOND);
        stages.set_timeouts([100, 50, 0, 0]);
        let actions = [Some(Action::Interrupt), Some(Action::ResetSystem), None, None];
        stages.configure(0, true, actions);
        assert_eq!(stages.advance(99), None);
        assert_eq!(stages.advance(100), Some(Action::Interrupt));
        assert_eq!(stages.expires_at(), 150);
        stages.feed(120);
        assert_eq!(stages.expires_at(), 220);
    }
}
