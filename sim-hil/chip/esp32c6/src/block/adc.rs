//! The converter, one sample at a time (technical reference manual, chapter 38).
//!
//! Counts follow from the voltage at the pin, the attenuation and the initial code that calibration leaves in the analog
//! part: without the right one, counts are shifted.

use super::{Answer, CYCLES_PER_SECOND, NEVER, Unmodelled};
use crate::registers::Values;

const ONE_SHOT: u32 = 0x20;
const DATA: u32 = 0x2C;
const INTERRUPT_ENABLE: u32 = 0x40;
const INTERRUPT_RAW: u32 = 0x44;
const INTERRUPT_STATUS: u32 = 0x48;
const INTERRUPT_CLEAR: u32 = 0x4C;

const DONE: u32 = 1 << 31;
/// A conversion with its settling.
const CONVERSION_CYCLES: u64 = CYCLES_PER_SECOND / 1_000_000 * 40;
/// Millivolts of a full conversion at 0, 2.5, 6 and 11 dB of attenuation, nominal (data sheet, table 5-5).
const FULL_SCALE_MILLIVOLTS: [f64; 4] = [1_000.0, 1_300.0, 1_900.0, 3_300.0];
const LARGEST_COUNT: f64 = 4_095.0;
/// Counts of this chip's converter over the nominal ones; each chip has its own, and fuses that state it.
pub(crate) const GAIN: f64 = 0.95;
/// Channels with a pin. The others measure ground and the reference, which no model has.
const CHANNELS: u32 = 7;

/// The block.
pub(crate) struct Adc {
    pub(crate) values: Values,
    done_at: u64,
    raw: u32,
    counts: u32,
    /// Counts by which the initial code is off.
    pub(crate) offset: f64,
}

impl Adc {
    pub(crate) fn new() -> Self {
        Self { values: Values::reset("APB_SARADC"), done_at: NEVER, raw: 0, counts: 0, offset: 0.0 }
    }

    fn settle(&mut self, now: u64) {
        if self.done_at <= now {
            self.done_at = NEVER;
            self.raw |= DONE;
            self.values.set(DATA, self.counts);
        }
    }

    pub(crate) fn next_event(&self) -> u64 {
        if self.values.get(INTERRUPT_ENABLE) & DONE == 0 { NEVER } else { self.done_at }
    }

    pub(crate) fn advance(&mut self, now: u64) {
        self.settle(now);
    }

    pub(crate) fn level(&self) -> bool {
        self.raw & self.values.get(INTERRUPT_ENABLE) != 0
    }

    pub(crate) fn read(&mut self, offset: u32, now: u64) -> Answer<u32> {
        self.settle(now);
        Ok(match offset {
            INTERRUPT_RAW => self.raw,
            INTERRUPT_STATUS => self.raw & self.values.get(INTERRUPT_ENABLE),
            _ => self.values.get(offset),
        })
    }

    /// Writes a register. `millivolts` is asked for the voltage at the pin of a channel of ADC1.
    pub(crate) fn write(
        &mut self,
        offset: u32,
        value: u32,
        now: u64,
        clock_hz: u64,
        millivolts: impl FnOnce(u32) -> f64,
    ) -> Answer<()> {
        self.settle(now);
        match offset {
            ONE_SHOT => {
                let channel = value >> 25 & 0xF;
                let rises = value & !self.values.get(offset) & 1 << 29 != 0;
                self.values.set(offset, value);
                if rises && value >> 31 == 1 && clock_hz > 0 {
                    let full_scale = FULL_SCALE_MILLIVOLTS[(value >> 23 & 3) as usize];
                    if channel >= CHANNELS {
                        return Err(Unmodelled::Value("a conversion of a channel without a pin"));
                    }
                    let volts = millivolts(channel);
                    let counts = volts / full_scale * LARGEST_COUNT * GAIN + self.offset;
                    self.counts = counts.round().clamp(0.0, LARGEST_COUNT) as u32;
                    self.done_at = now + CONVERSION_CYCLES;
                }
            }
            INTERRUPT_CLEAR => self.raw &= !value,
            0x00..=0x24 | 0x28 | INTERRUPT_ENABLE | 0x54 => self.values.set(offset, value),
            _ => return Err(Unmodelled::Register),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn convert(attenuation: u32, offset: f64) -> u32 {
        let mut adc = Adc::new();
        adc.offset = offset;
        let sample = 1 << 31 | 1 << 29 | attenuation << 23;
        adc.write(ONE_SHOT, sample, 0, 1, |_| 1_650.0).unwrap();
        assert_eq!(adc.read(INTERRUPT_RAW, 100).unwrap(), 0, "takes its time");
        assert_eq!(adc.read(INTERRUPT_RAW, CONVERSION_CYCLES).unwrap(), DONE);
        adc.read(DATA, CONVERSION_CYCLES).unwrap()
    }

    #[test]
    fn counts_depend_on_attenuation_gain_and_initial_code() {
        assert_eq!(convert(3, 0.0), 1_945);
        assert_eq!(convert(0, 0.0), 4_095, "clipped");
        assert_eq!(convert(3, -100.0), 1_845);
    }
}
