//! Registers that keep what is written and do nothing here: each with the reason why that is enough.

use super::adc::GAIN;
use super::analog::RIGHT_INITIAL_CODE;
use super::{Answer, Unmodelled};
use crate::registers::Values;

/// Block, offsets, and why its effect is outside of what is emulated.
const HELD: [(&str, std::ops::RangeInclusive<u32>, &str); 17] = [
    ("PMU", 0x000..=0x154, "power domains: all are on while the image runs"),
    ("LP_CLKRST", 0x00..=0x28, "clocks of the low-power side run at their nominal rate"),
    ("LP_AON", 0x00..=0x50, "memory that survives resets, and pads that are not held"),
    ("LP_IO", 0x00..=0x78, "low-power pads: all pins belong to the matrix"),
    ("LP_ANA", 0x00..=0x30, "brown-out: seen by the scenario that lowers the supply"),
    ("LP_PERI", 0x00..=0x04, "gates of low-power peripherals that are not used"),
    ("LP_TIMER", 0x00..=0x48, "the low-power timer: read for times during sleep only"),
    ("LP_APM", 0xC4..=0xC4, "access rights: a single world"),
    ("LP_APM0", 0xC4..=0xC4, "access rights: a single world"),
    ("HP_APM", 0xC4..=0xC4, "access rights: a single world"),
    ("MODEM_SYSCON", 0x00..=0x20, "clocks of the radio, which is emulated at its library's border"),
    ("MODEM_LPCON", 0x00..=0x28, "clocks of the radio, which is emulated at its library's border"),
    ("ASSIST_DEBUG", 0x00..=0x78, "no debugger is attached"),
    ("GPIO_SD", 0x20..=0x20, "sigma-delta outputs are not used"),
    ("EFUSE", 0x2C..=0x1D4, "what this chip was given when it was made"),
    ("I2C0", 0x00..=0x00, "reset with its clock gate alone"),
    ("USB_DEVICE", 0x00..=0x00, "no computer at the USB port"),
];

const EFUSE: &str = "EFUSE";
const EFUSE_MAC: u32 = 0x44;
const EFUSE_REVISION: u32 = 0x50;
/// Revision 0.1, and the first version of the converter's calibration.
const REVISION: u32 = 1 << 18 | 1 << 27;
/// At 11 dB: the converter's initial code over 1,600, and its counts at 1.37 V over 1,500 (esp-hal's `efuse`).
const EFUSE_CALIBRATION: u32 = 0x70;
const INITIAL_CODE: u32 = RIGHT_INITIAL_CODE - 1_600;
const CODE_AT_REFERENCE: u32 = (1_370.0 / 3_300.0 * 4_095.0 * GAIN) as u32 - 1_500;
const LP_PERI: &str = "LP_PERI";
const RANDOM: u32 = 0x08;
const RESET_CAUSE: u32 = 0x10;

/// The blocks.
pub(crate) struct Held {
    blocks: Vec<Values>,
    random: u64,
}

impl Held {
    pub(crate) fn new(seed: u64) -> Self {
        let mut blocks: Vec<Values> = HELD.iter().map(|(name, ..)| Values::reset(name)).collect();
        for values in blocks.iter_mut().filter(|values| values.block.name == EFUSE) {
            // A MAC of the locally administered range.
            values.set(EFUSE_MAC, 0x0000_C6F1);
            values.set(EFUSE_MAC + 4, 0x0000_0200);
            values.set(EFUSE_REVISION, REVISION);
            values.set(EFUSE_CALIBRATION, INITIAL_CODE << 15);
            values.set(EFUSE_CALIBRATION + 4, CODE_AT_REFERENCE << 23);
        }
        Self { blocks, random: seed | 1 }
    }

    /// Takes over what the low-power side keeps over a reset.
    pub(crate) fn survive(&mut self, before: &Self) {
        for (values, old) in self.blocks.iter_mut().zip(&before.blocks) {
            if values.block.name == "LP_AON" {
                *values = old.clone();
            }
        }
        self.random = before.random;
    }

    /// States why the chip started.
    pub(crate) fn set_reset_cause(&mut self, cause: u32) {
        for values in self.blocks.iter_mut().filter(|values| values.block.name == "LP_CLKRST") {
            values.set(RESET_CAUSE, cause);
        }
    }

    fn find(&mut self, block: &str, offset: u32) -> Answer<&mut Values> {
        let held = |(name, offsets, _): &(&str, std::ops::RangeInclusive<u32>, &str)| {
            *name == block && offsets.contains(&offset)
        };
        let index = HELD.iter().position(held).ok_or(Unmodelled::Register)?;
        self.blocks.get_mut(index).ok_or(Unmodelled::Register)
    }

    pub(crate) fn read(&mut self, block: &str, offset: u32) -> Answer<u32> {
        if (block, offset) == (LP_PERI, RANDOM) {
            // xorshift64: repeatable.
            self.random ^= self.random << 13;
            self.random ^= self.random >> 7;
            self.random ^= self.random << 17;
            return Ok((self.random >> 16) as u32);
        }
        self.find(block, offset).map(|values| values.get(offset))
    }

    pub(crate) fn write(&mut self, block: &str, offset: u32, value: u32) -> Answer<()> {
        if block == EFUSE {
            return Err(Unmodelled::Value("fuses are not burnt here"));
        }
        self.find(block, offset).map(|values| values.set(offset, value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registers::BLOCKS;

    #[test]
    fn every_held_block_is_in_the_table() {
        for (name, ..) in &HELD {
            assert!(BLOCKS.iter().any(|block| block.name == *name), "{name}");
        }
    }
}
