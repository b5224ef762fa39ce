//! PCR: which peripheral has a clock, from what source, and which is held in reset (technical reference manual,
//! chapter 8).
//!
//! A block without its register clock takes no writes and reads as zero; one without its function clock stands still.

use super::{Answer, CYCLES_PER_SECOND};
use crate::registers::Values;

/// The crystal.
pub(crate) const XTAL_HZ: u64 = 40_000_000;
/// The fast RC oscillator, nominal.
pub(crate) const RC_FAST_HZ: u64 = 17_500_000;
/// The slow RC oscillator, nominal.
pub(crate) const RC_SLOW_HZ: u64 = 136_000;
const PLL_80_HZ: u64 = 80_000_000;
const PLL_160_HZ: u64 = 160_000_000;

const SYSCLK_CONF: u32 = 0x110;
const CPU_FREQ_CONF: u32 = 0x118;

/// A peripheral whose clocks matter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Gate {
    Uart0,
    Timers(usize),
    SystemTimer,
    Adc,
    Mcpwm,
    Spi2,
    InterruptMatrix,
    IoMux,
}

impl Gate {
    /// Offset of the register whose bits 0 and 1 gate and reset the block.
    const fn conf(self) -> u32 {
        match self {
            Self::Uart0 => 0x00,
            Self::Timers(group) => 0x3C + 0x0C * group as u32,
            Self::SystemTimer => 0x54,
            Self::Adc => 0x80,
            Self::InterruptMatrix => 0x90,
            Self::Mcpwm => 0x9C,
            Self::Spi2 => 0xC0,
            Self::IoMux => 0xE8,
        }
    }

    /// All of them.
    pub(crate) const ALL: [Self; 9] = [
        Self::Uart0,
        Self::Timers(0),
        Self::Timers(1),
        Self::SystemTimer,
        Self::Adc,
        Self::Mcpwm,
        Self::Spi2,
        Self::InterruptMatrix,
        Self::IoMux,
    ];
}

/// The clocks.
pub(crate) struct Clocks {
    pub(crate) values: Values,
}

impl Clocks {
    /// Creates the clocks as the boot loader hands them over: on the PLL, everything else out of reset.
    pub(crate) fn new() -> Self {
        let mut values = Values::reset("PCR");
        values.set(SYSCLK_CONF, values.get(SYSCLK_CONF) | 1 << 16);
        Self { values }
    }

    /// Returns whether the block's registers have a clock.
    pub(crate) fn is_clocked(&self, gate: Gate) -> bool {
        let enable = if gate == Gate::Adc { 2 } else { 0 };
        self.values.bit(gate.conf(), enable)
    }

    /// Returns whether the block is held in reset.
    pub(crate) fn is_reset(&self, gate: Gate) -> bool {
        self.values.bit(gate.conf(), if gate == Gate::Adc { 3 } else { 1 })
    }

    /// A function clock: gate in bit 22, source in bits 20 and 21 of the register at `offset`.
    fn function_clock(&self, offset: u32, sources: [u64; 4]) -> u64 {
        match self.values.bit(offset, 22) {
            true => sources[self.values.field(offset, 20, 2) as usize],
            false => 0,
        }
    }

    /// Returns the clock of the UART, before its own divider; hertz.
    pub(crate) fn uart0_hz(&self) -> u64 {
        let source = self.function_clock(0x04, [0, PLL_80_HZ, RC_FAST_HZ, XTAL_HZ]);
        source / u64::from(self.values.field(0x04, 12, 8) + 1)
    }

    /// Returns the clock of a timer group's timer, before its divider; hertz.
    pub(crate) fn timer_hz(&self, group: usize) -> u64 {
        let offset = 0x40 + 0x0C * group as u32;
        self.function_clock(offset, [XTAL_HZ, PLL_80_HZ, RC_FAST_HZ, 0])
    }

    /// Returns the clock of a timer group's watchdog, before its prescaler; hertz.
    pub(crate) fn timer_watchdog_hz(&self, group: usize) -> u64 {
        let offset = 0x44 + 0x0C * group as u32;
        self.function_clock(offset, [XTAL_HZ, PLL_80_HZ, RC_FAST_HZ, 0])
    }

    /// Returns the clock of the system timer: the crystal's by 2.5; hertz.
    pub(crate) fn system_timer_hz(&self) -> u64 {
        let source = self.function_clock(0x58, [XTAL_HZ, RC_FAST_HZ, XTAL_HZ, RC_FAST_HZ]);
        source * 2 / 5
    }

    /// Returns the clock of the MCPWM, before its own prescalers; hertz.
    pub(crate) fn mcpwm_hz(&self) -> u64 {
        let source = self.function_clock(0xA0, [0, PLL_160_HZ, XTAL_HZ, RC_FAST_HZ]);
        source / u64::from(self.values.field(0xA0, 12, 8) + 1)
    }

    /// Returns the clock of the SPI master, before its own divider; hertz.
    pub(crate) fn spi2_hz(&self) -> u64 {
        self.function_clock(0xC4, [XTAL_HZ, PLL_80_HZ, RC_FAST_HZ, 0])
    }

    /// Returns the clock of the converter; hertz.
    pub(crate) fn adc_hz(&self) -> u64 {
        let source = self.function_clock(0x84, [XTAL_HZ, 240_000_000, RC_FAST_HZ, 0]);
        source / u64::from(self.values.field(0x84, 12, 8) + 1)
    }

    /// Returns the clock of the processor; hertz.
    pub(crate) fn cpu_hz(&self) -> u64 {
        match self.values.field(SYSCLK_CONF, 16, 2) {
            1 => PLL_160_HZ / u64::from(self.values.field(CPU_FREQ_CONF, 8, 8) + 1),
            0 => XTAL_HZ / u64::from(self.values.field(CPU_FREQ_CONF, 0, 8) + 1),
            _ => RC_FAST_HZ,
        }
    }

    /// Returns how many cycles of 160 MHz the processor takes for one of its own.
    pub(crate) fn cpu_divider(&self) -> u64 {
        CYCLES_PER_SECOND.div_ceil(self.cpu_hz().max(1))
    }

    /// Reads a register.
    pub(crate) fn read(&self, offset: u32) -> Answer<u32> {
        Ok(self.values.get(offset))
    }

    /// Writes a register.
    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Answer<()> {
        self.values.set(offset, value);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_without_its_gate_stands() {
        let mut clocks = Clocks::new();
        clocks.write(0xA0, 1 << 22 | 1 << 20).unwrap();
        assert_eq!(clocks.mcpwm_hz(), 160_000_000);
        clocks.write(0xA0, 1 << 20).unwrap();
        assert_eq!(clocks.mcpwm_hz(), 0);
    }
}
