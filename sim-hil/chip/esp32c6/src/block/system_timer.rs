//! The system timer: two counters of 52 bits and three comparators (technical reference manual, chapter 13).

use super::clock::Clocks;
use super::{Answer, NEVER, Unmodelled, cycles_of, ticks_of};
use crate::registers::Values;

const CONF: u32 = 0x00;
const UPDATE: [u32; 2] = [0x04, 0x08];
const LOAD_VALUE: [u32; 2] = [0x0C, 0x14];
const TARGET: u32 = 0x1C;
const TARGET_CONF: u32 = 0x34;
const VALUE: [u32; 2] = [0x40, 0x48];
const TARGET_LOAD: u32 = 0x50;
const LOAD: [u32; 2] = [0x5C, 0x60];
const INTERRUPT_ENABLE: u32 = 0x64;
const INTERRUPT_RAW: u32 = 0x68;
const INTERRUPT_CLEAR: u32 = 0x6C;
const INTERRUPT_STATUS: u32 = 0x70;
const COUNTER_MASK: u64 = (1 << 52) - 1;
/// A counter's value is synchronised and can be read.
const VALID: u32 = 1 << 29;

#[derive(Clone, Copy, Default)]
struct Counter {
    count: u64,
    since: u64,
    hertz: u64,
}

impl Counter {
    fn at(self, now: u64) -> u64 {
        (self.count + ticks_of(now.saturating_sub(self.since), self.hertz)) & COUNTER_MASK
    }
}

/// The block.
pub(crate) struct SystemTimer {
    pub(crate) values: Values,
    counters: [Counter; 2],
    /// What the comparators wait for; taken over by their load registers.
    targets: [Option<u64>; 3],
    raw: u32,
}

impl SystemTimer {
    pub(crate) fn new() -> Self {
        Self {
            values: Values::reset("SYSTIMER"),
            counters: [Counter::default(); 2],
            targets: [None; 3],
            raw: 0,
        }
    }

    /// Counts on as configuration and clock now say.
    pub(crate) fn retime(&mut self, now: u64, clocks: &Clocks) {
        let conf = self.values.get(CONF);
        for (unit, counter) in self.counters.iter_mut().enumerate() {
            counter.count = counter.at(now);
            counter.since = now;
            let works = conf >> (30 - unit) & 1 == 1;
            counter.hertz = if works { clocks.system_timer_hz() } else { 0 };
        }
    }

    fn target_at(&self, index: usize) -> u64 {
        let works = self.values.bit(CONF, 24 - index as u32);
        let unit = self.values.field(TARGET_CONF + 4 * index as u32, 31, 1) as usize;
        let counter = self.counters[unit];
        match self.targets[index] {
            Some(target) if works => {
                let left = target.saturating_sub(counter.count);
                counter.since.saturating_add(cycles_of(left, counter.hertz))
            }
            _ => NEVER,
        }
    }

    pub(crate) fn next_event(&self) -> u64 {
        (0..3).map(|index| self.target_at(index)).min().unwrap_or(NEVER)
    }

    pub(crate) fn advance(&mut self, now: u64) {
        for index in 0..3 {
            if self.target_at(index) > now {
                continue;
            }
            self.raw |= 1 << index;
            let conf = self.values.get(TARGET_CONF + 4 * index as u32);
            let period = u64::from(conf & 0x3FF_FFFF);
            let repeats = conf >> 30 & 1 == 1 && period > 0;
            self.targets[index] =
                self.targets[index].filter(|_| repeats).map(|target| target + period);
        }
    }

    pub(crate) fn levels(&self) -> [bool; 3] {
        let status = self.raw & self.values.get(INTERRUPT_ENABLE);
        [0, 1, 2].map(|index| status >> index & 1 == 1)
    }

    pub(crate) fn read(&self, offset: u32) -> Answer<u32> {
        Ok(match offset {
            0x04 | 0x08 => VALID,
            INTERRUPT_RAW => self.raw,
            INTERRUPT_STATUS => self.raw & self.values.get(INTERRUPT_ENABLE),
            CONF | 0x0C..=0x4C | INTERRUPT_ENABLE | 0xFC => self.values.get(offset),
            _ => return Err(Unmodelled::Register),
        })
    }

    pub(crate) fn write(
        &mut self,
        offset: u32,
        value: u32,
        now: u64,
        clocks: &Clocks,
    ) -> Answer<()> {
        match offset {
            CONF => {
                self.retime(now, clocks);
                self.values.set(CONF, value);
                self.retime(now, clocks);
            }
            0x04 | 0x08 => {
                let unit = usize::from(offset == UPDATE[1]);
                if value >> 30 & 1 == 1 {
                    let count = self.counters[unit].at(now);
                    self.values.set(VALUE[unit], (count >> 32) as u32);
                    self.values.set(VALUE[unit] + 4, count as u32);
                }
            }
            0x5C | 0x60 => {
                let unit = usize::from(offset == LOAD[1]);
                let [high, low] = [0, 4].map(|word| self.values.get(LOAD_VALUE[unit] + word));
                self.counters[unit].count = u64::from(high) << 32 | u64::from(low);
                self.counters[unit].since = now;
            }
            TARGET_LOAD..=0x58 => {
                let index = (offset - TARGET_LOAD) / 4;
                let conf = self.values.get(TARGET_CONF + 4 * index);
                let counter = self.counters[(conf >> 31) as usize];
                let [high, low] = [0, 4].map(|word| self.values.get(TARGET + 8 * index + word));
                self.targets[index as usize] = Some(match conf >> 30 & 1 {
                    0 => u64::from(high) << 32 | u64::from(low),
                    _ => counter.at(now) + u64::from(conf & 0x3FF_FFFF),
                });
            }
            INTERRUPT_CLEAR => self.raw &= !value,
            0x0C..=0x3C | INTERRUPT_ENABLE => self.values.set(offset, value),
            _ => return Err(Unmodelled::Register),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::block::CYCLES_PER_SECOND;

    #[test]
    fn counts_sixteen_million_a_second() {
        let clocks = Clocks::new();
        let mut timer = SystemTimer::new();
        timer.retime(0, &clocks);
        timer.write(UPDATE[0], 1 << 30, CYCLES_PER_SECOND, &clocks).unwrap();
        assert_eq!(timer.read(VALUE[0] + 4).unwrap(), 16_000_000);
    }
}
