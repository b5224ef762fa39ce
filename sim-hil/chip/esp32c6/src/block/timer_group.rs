//! A timer group: one timer of 54 bits, one watchdog, and the calibration of slow clocks (technical reference manual,
//! chapter 14).

use super::clock::{Clocks, RC_SLOW_HZ, XTAL_HZ};
use super::watchdog::{Action, Stages};
use super::{Answer, NEVER, Unmodelled, cycles_of, ticks_of};
use crate::registers::Values;

const CONFIG: u32 = 0x00;
const LOW: u32 = 0x04;
const HIGH: u32 = 0x08;
const UPDATE: u32 = 0x0C;
const ALARM_LOW: u32 = 0x10;
const ALARM_HIGH: u32 = 0x14;
const LOAD_LOW: u32 = 0x18;
const LOAD_HIGH: u32 = 0x1C;
const LOAD: u32 = 0x20;
const WATCHDOG_CONFIG: u32 = 0x48;
const WATCHDOG_PRESCALE: u32 = 0x4C;
const WATCHDOG_STAGES: u32 = 0x50;
const WATCHDOG_FEED: u32 = 0x60;
pub(crate) const WATCHDOG_PROTECT: u32 = 0x64;
const CALIBRATION: u32 = 0x68;
const CALIBRATION_RESULT: u32 = 0x6C;
const INTERRUPT_ENABLE: u32 = 0x70;
const INTERRUPT_RAW: u32 = 0x74;
const INTERRUPT_STATUS: u32 = 0x78;
const INTERRUPT_CLEAR: u32 = 0x7C;
const CALIBRATION_TIMEOUT: u32 = 0x80;
const CLOCK: u32 = 0xFC;

/// Opens the watchdog's registers.
pub(crate) const WATCHDOG_KEY: u32 = 0x50D8_3AA1;

const ALARM_ENABLE: u32 = 1 << 10;
const DIVIDER_RESET: u32 = 1 << 12;
const AUTO_RELOAD: u32 = 1 << 29;
const COUNTS_UP: u32 = 1 << 30;
const ENABLE: u32 = 1 << 31;
/// Interrupts of timer and watchdog.
const TIMER_INTERRUPT: u32 = 1;
const WATCHDOG_INTERRUPT: u32 = 2;

/// One of the two groups.
pub(crate) struct TimerGroup {
    pub(crate) values: Values,
    index: usize,
    count: u64,
    /// When `count` was right.
    since: u64,
    /// Hertz of the timer's counter; 0 when it stands.
    hertz: u64,
    alarm_at: u64,
    raw: u32,
    watchdog: Stages,
    /// Times that the watchdog was fed.
    pub(crate) feeds: u64,
}

impl TimerGroup {
    pub(crate) fn new(index: usize) -> Self {
        let mut values = Values::reset(["TIMG0", "TIMG1"][index]);
        // The boot loader has switched its own watchdog off.
        values.set(WATCHDOG_CONFIG, values.get(WATCHDOG_CONFIG) & !(1 << 14));
        Self {
            values,
            index,
            count: 0,
            since: 0,
            hertz: 0,
            alarm_at: NEVER,
            raw: 0,
            watchdog: Stages::default(),
            feeds: 0,
        }
    }

    fn config(&self) -> u32 {
        self.values.get(CONFIG)
    }

    fn counter(&self, now: u64) -> u64 {
        let ticks = ticks_of(now.saturating_sub(self.since), self.hertz);
        match self.config() & COUNTS_UP {
            0 => self.count.wrapping_sub(ticks) & COUNTER_MASK,
            _ => self.count.wrapping_add(ticks) & COUNTER_MASK,
        }
    }

    /// Holds the counter and counts on as configuration and clocks now say.
    pub(crate) fn retime(&mut self, now: u64, clocks: &Clocks) {
        self.count = self.counter(now);
        self.since = now;
        let config = self.config();
        let divider = match u64::from(config >> 13 & 0xFFFF) {
            0 => 65_536,
            divider => divider.max(2),
        };
        self.hertz = match config & ENABLE {
            0 => 0,
            _ => clocks.timer_hz(self.index) / divider,
        };
        self.aim();
        let prescale = u64::from(self.values.field(WATCHDOG_PRESCALE, 16, 16)).max(1);
        let hertz = clocks.timer_watchdog_hz(self.index) / prescale;
        self.watchdog.retime(now, hertz);
    }

    fn aim(&mut self) {
        let alarm = wide(self.values.get(ALARM_HIGH), self.values.get(ALARM_LOW));
        self.alarm_at = match self.config() & ALARM_ENABLE {
            0 => NEVER,
            // One that lies behind is due at once.
            _ => self.since.saturating_add(cycles_of(alarm.saturating_sub(self.count), self.hertz)),
        };
    }

    /// Returns when something happens by itself.
    pub(crate) fn next_event(&self) -> u64 {
        self.alarm_at.min(self.watchdog.expires_at())
    }

    /// Lets happen what is due; what the watchdog does to the chip.
    pub(crate) fn advance(&mut self, now: u64) -> Option<Action> {
        while self.alarm_at <= now {
            self.raw |= TIMER_INTERRUPT;
            let config = self.config();
            if config & AUTO_RELOAD == 0 {
                self.values.set(CONFIG, config & !ALARM_ENABLE);
                self.alarm_at = NEVER;
                break;
            }
            // Counts on from the alarm, not from when it was seen.
            self.since = self.alarm_at;
            self.count = wide(self.values.get(LOAD_HIGH), self.values.get(LOAD_LOW));
            self.aim();
        }
        match self.watchdog.advance(now) {
            Some(Action::Interrupt) => {
                self.raw |= WATCHDOG_INTERRUPT;
                None
            }
            other => other,
        }
    }

    /// Returns whether timer and watchdog interrupt.
    pub(crate) fn levels(&self) -> [bool; 2] {
        let status = self.raw & self.values.get(INTERRUPT_ENABLE);
        [status & TIMER_INTERRUPT != 0, status & WATCHDOG_INTERRUPT != 0]
    }

    /// Returns whether the watchdog is on.
    pub(crate) fn watchdog_is_on(&self) -> bool {
        self.watchdog.is_on()
    }

    pub(crate) fn read(&self, offset: u32) -> Answer<u32> {
        Ok(match offset {
            // The result of an update is there at once.
            UPDATE => 0,
            // Done at once; slow clocks have their nominal frequency.
            CALIBRATION => self.values.get(offset) | 1 << 15,
            CALIBRATION_RESULT => {
                let periods = u64::from(self.values.field(CALIBRATION, 16, 15)).max(1);
                ((periods * XTAL_HZ / RC_SLOW_HZ) as u32) << 7 | 1
            }
            INTERRUPT_RAW => self.raw,
            INTERRUPT_STATUS => self.raw & self.values.get(INTERRUPT_ENABLE),
            _ => self.values.get(offset),
        })
    }

    pub(crate) fn write(
        &mut self,
        offset: u32,
        value: u32,
        now: u64,
        clocks: &Clocks,
    ) -> Answer<()> {
        let is_locked = self.values.get(WATCHDOG_PROTECT) != WATCHDOG_KEY;
        match offset {
            CONFIG => {
                // Up to here by the old configuration.
                self.count = self.counter(now);
                self.since = now;
                self.values.set(CONFIG, value & !DIVIDER_RESET);
                self.retime(now, clocks);
            }
            UPDATE => {
                let count = self.counter(now);
                self.values.set(LOW, count as u32);
                self.values.set(HIGH, (count >> 32) as u32);
            }
            ALARM_LOW | ALARM_HIGH => {
                self.values.set(offset, value);
                self.retime(now, clocks);
            }
            LOAD_LOW | LOAD_HIGH | CALIBRATION | CALIBRATION_TIMEOUT | INTERRUPT_ENABLE | CLOCK => {
                self.values.set(offset, value);
            }
            LOAD => {
                self.count = wide(self.values.get(LOAD_HIGH), self.values.get(LOAD_LOW));
                self.since = now;
                self.aim();
            }
            INTERRUPT_CLEAR => self.raw &= !value,
            WATCHDOG_PROTECT => self.values.set(offset, value),
            // A locked watchdog takes no writes.
            WATCHDOG_CONFIG..=WATCHDOG_FEED if is_locked => {}
            WATCHDOG_FEED => {
                self.feeds += 1;
                self.watchdog.feed(now);
            }
            WATCHDOG_CONFIG => {
                // The bit that takes the configuration over clears itself.
                self.values.set(offset, value & !(1 << 22));
                let stages = [29, 27, 25, 23].map(|bit| match value >> bit & 3 {
                    0 => None,
                    1 => Some(Action::Interrupt),
                    2 => Some(Action::ResetCpu),
                    _ => Some(Action::ResetSystem),
                });
                self.watchdog.configure(now, value & ENABLE != 0, stages);
                self.watchdog_timeouts();
                self.retime(now, clocks);
            }
            WATCHDOG_PRESCALE | WATCHDOG_STAGES..=0x5C => {
                self.values.set(offset, value);
                self.watchdog_timeouts();
                self.retime(now, clocks);
            }
            _ => return Err(Unmodelled::Register),
        }
        Ok(())
    }

    fn watchdog_timeouts(&mut self) {
        let timeout = |stage: u32| u64::from(self.values.get(WATCHDOG_STAGES + 4 * stage));
        self.watchdog.set_timeouts([0, 1, 2, 3].map(timeout));
    }
}

/// The counter has 54 bits.
const COUNTER_MASK: u64 = (1 << 54) - 1;

fn wide(high: u32, low: u32) -> u64 {
    (u64::from(high) << 32 | u64::from(low)) & COUNTER_MASK
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CYCLES_PER_SECOND;

    /// A timer that counts 20 million a second to 2,000 and starts anew.
    fn ticking(clocks: &Clocks) -> TimerGroup {
        let mut group = TimerGroup::new(1);
        group.write(ALARM_LOW, 2_000, 0, clocks).unwrap();
        let config = ENABLE | COUNTS_UP | AUTO_RELOAD | ALARM_ENABLE | 2 << 13;
        group.write(CONFIG, config, 0, clocks).unwrap();
        group
    }

    #[test]
    fn a_reloading_timer_fires_every_hundred_microseconds_whoever_is_late() {
        let clocks = Clocks::new();
        let mut group = ticking(&clocks);
        assert_eq!(group.next_event(), 16_000);
        group.advance(16_900);
        assert_eq!(group.next_event(), 32_000);
    }

    #[test]
    fn a_timer_without_a_clock_stands() {
        let mut clocks = Clocks::new();
        let mut group = ticking(&clocks);
        clocks.write(0x4C, 0).unwrap();
        group.retime(8_000, &clocks);
        assert_eq!(group.next_event(), NEVER);
    }

    #[test]
    fn the_watchdog_bites_when_it_is_not_fed_and_takes_no_writes_while_locked() {
        let clocks = Clocks::new();
        let mut group = TimerGroup::new(1);
        group.write(WATCHDOG_PRESCALE, 1 << 16, 0, &clocks).unwrap();
        group.write(WATCHDOG_STAGES, 8_000_000, 0, &clocks).unwrap();
        group.write(WATCHDOG_CONFIG, ENABLE | 3 << 29, 0, &clocks).unwrap();
        let bite = CYCLES_PER_SECOND / 5;
        assert_eq!(group.next_event(), bite);
        group.write(WATCHDOG_FEED, 1, bite / 2, &clocks).unwrap();
        assert_eq!(group.next_event(), bite / 2 + bite);
        group.write(WATCHDOG_PROTECT, 0, bite / 2, &clocks).unwrap();
        group.write(WATCHDOG_FEED, 1, bite, &clocks).unwrap();
        assert_eq!(group.next_event(), bite / 2 + bite, "locked");
        assert_eq!(group.advance(bite / 2 + bite), Some(Action::ResetSystem));
    }
}
