//! The analog part's own registers, reached through an internal I2C master (not in the manual; esp-hal's `regi2c`).

use std::collections::BTreeMap;

use super::Answer;
use crate::registers::Values;

const CONTROL: [u32; 2] = [0x00, 0x04];
const CONFIGURATION: u32 = 0x18;
const WRITE: u32 = 1 << 24;
/// The calibration of the PLL is done.
const CALIBRATED: u32 = 1 << 24;
/// The converter's part, and the low and high byte of its initial code.
const ADC_PART: u8 = 0x69;
const ADC_INITIAL_CODE: [u8; 2] = [0x00, 0x01];
/// The code at which this chip's counts are not shifted; each chip has its own.
pub(crate) const RIGHT_INITIAL_CODE: u32 = 1_750;

/// The master and all that it reaches.
pub(crate) struct Analog {
    pub(crate) values: Values,
    parts: BTreeMap<(u8, u8), u8>,
}

impl Analog {
    pub(crate) fn new() -> Self {
        Self { values: Values::reset("I2C_ANA_MST"), parts: BTreeMap::new() }
    }

    /// Counts by which conversions are shifted.
    pub(crate) fn adc_offset(&self) -> f64 {
        let [low, high] = ADC_INITIAL_CODE
            .map(|register| u32::from(*self.parts.get(&(ADC_PART, register)).unwrap_or(&0)));
        let code = (high & 0xF) << 8 | low;
        f64::from(code) - f64::from(RIGHT_INITIAL_CODE)
    }

    pub(crate) fn read(&self, offset: u32) -> Answer<u32> {
        Ok(match offset {
            CONFIGURATION => self.values.get(offset) | CALIBRATED,
            _ => self.values.get(offset),
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Answer<()> {
        self.values.set(offset, value);
        if CONTROL.contains(&offset) {
            let [part, register, data, _] = value.to_le_bytes();
            match value & WRITE {
                0 => {
                    let found = *self.parts.get(&(part, register)).unwrap_or(&0);
                    self.values.set(offset, value & !0xFF_0000 | u32::from(found) << 16);
                }
                _ => {
                    self.parts.insert((part, register), data);
                }
            }
            // Never busy: bit 25.
            let done = self.values.get(offset) & !(1 << 25);
            self.values.set(offset, done);
        }
        Ok(())
    }
}
