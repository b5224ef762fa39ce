//! Interrupt matrix, software interrupts and the controller with its priorities (PLIC, machine side).
//!
//! A source of the matrix is mapped to one of 31 lines; a line has a kind (level or edge), a priority and an enable.
//! The processor takes the line of the highest priority that is not below the threshold; of equals the lower number.

use super::{Answer, Unmodelled};
use crate::registers::Values;

/// Number of sources at the matrix.
const SOURCES: u32 = 77;
/// Sources by number.
pub(crate) mod source {
    pub(crate) const FROM_CPU: u32 = 22;
    pub(crate) const UART0: u32 = 43;
    pub(crate) const TIMER: [u32; 2] = [51, 54];
    pub(crate) const WATCHDOG: [u32; 2] = [53, 56];
    pub(crate) const SYSTEM_TIMER: u32 = 57;
    pub(crate) const ADC: u32 = 60;
    pub(crate) const MCPWM: u32 = 61;
    pub(crate) const SPI2: u32 = 72;
    pub(crate) const LP_WATCHDOG: u32 = 18;
}

const STATUS: u32 = 0x134;
const CLOCK_GATE: u32 = 0x140;
const FROM_CPU: u32 = 0x90;

const ENABLE: u32 = 0x00;
const KIND: u32 = 0x04;
const CLEAR: u32 = 0x08;
const PENDING: u32 = 0x0C;
const PRIORITY: u32 = 0x10;
const THRESHOLD: u32 = 0x90;
const CLAIM: u32 = 0x94;

/// The three blocks.
pub(crate) struct Interrupts {
    pub(crate) matrix: Values,
    pub(crate) software: Values,
    pub(crate) controller: Values,
    /// Level of each source.
    levels: u128,
    /// Lines whose edge was seen and not cleared.
    edges: u32,
}

impl Interrupts {
    pub(crate) fn new() -> Self {
        Self {
            matrix: Values::reset("INTERRUPT_CORE0"),
            software: Values::reset("INTPRI"),
            controller: Values::reset("PLIC_MX"),
            levels: 0,
            edges: 0,
        }
    }

    /// Sets the level of a source.
    pub(crate) fn set(&mut self, source: u32, level: bool) {
        let was = self.levels >> source & 1 == 1;
        if was == level {
            return;
        }
        self.levels ^= 1 << source;
        let line = self.line_of(source);
        if level && self.controller.bit(KIND, line) {
            self.edges |= 1 << line;
        }
    }

    fn line_of(&self, source: u32) -> u32 {
        self.matrix.field(4 * source, 0, 5)
    }

    /// Returns whether a line is that of a source.
    pub(crate) fn is_of(&self, source: u32, line: u32) -> bool {
        self.line_of(source) == line
    }

    /// Lines that ask for the processor.
    fn pending(&self) -> u32 {
        let mut levels = self.levels;
        let mut lines = 0;
        while levels != 0 {
            lines |= 1 << self.line_of(levels.trailing_zeros());
            levels &= levels - 1;
        }
        let edges = self.controller.get(KIND);
        (lines & !edges | self.edges & edges) & self.controller.get(ENABLE) & !1
    }

    /// Returns the line that the processor takes next, if it takes any, of those that `allowed` lets through.
    pub(crate) fn line(&self, allowed: impl Fn(u32) -> bool) -> Option<u32> {
        let threshold = self.threshold().max(1);
        let mut best = None;
        let mut lines = self.pending();
        while lines != 0 {
            let line = lines.trailing_zeros();
            lines &= lines - 1;
            let priority = self.controller.field(PRIORITY + 4 * line, 0, 4);
            if priority >= threshold
                && best.is_none_or(|(highest, _)| priority > highest)
                && allowed(line)
            {
                best = Some((priority, line));
            }
        }
        best.map(|(_, line)| line)
    }

    /// Lines of lower priority are not taken.
    pub(crate) fn threshold(&self) -> u32 {
        self.controller.field(THRESHOLD, 0, 8)
    }

    /// Masks lines of lower priority.
    pub(crate) fn set_threshold(&mut self, threshold: u32) {
        self.controller.set(THRESHOLD, threshold);
    }

    /// Returns the priority that a source is mapped to; 0 where it is not.
    pub(crate) fn priority_of(&self, source: u32) -> u32 {
        let line = self.line_of(source);
        match self.controller.bit(ENABLE, line) {
            true => self.controller.field(PRIORITY + 4 * line, 0, 4),
            false => 0,
        }
    }

    pub(crate) fn read_matrix(&self, offset: u32) -> Answer<u32> {
        match offset {
            STATUS | 0x138 | 0x13C => Ok((self.levels >> (8 * (offset - STATUS))) as u32),
            _ => Ok(self.matrix.get(offset)),
        }
    }

    pub(crate) fn write_matrix(&mut self, offset: u32, value: u32) -> Answer<()> {
        match offset {
            _ if offset < 4 * SOURCES => self.matrix.set(offset, value & 0x1F),
            CLOCK_GATE => self.matrix.set(offset, value),
            _ => return Err(Unmodelled::Register),
        }
        Ok(())
    }

    pub(crate) fn read_software(&self, offset: u32) -> Answer<u32> {
        match offset {
            FROM_CPU..=0x9C => Ok(self.software.get(offset)),
            _ => Err(Unmodelled::Register),
        }
    }

    pub(crate) fn write_software(&mut self, offset: u32, value: u32) -> Answer<()> {
        match offset {
            FROM_CPU..=0x9C => {
                self.software.set(offset, value & 1);
                self.set(source::FROM_CPU + (offset - FROM_CPU) / 4, value & 1 == 1);
                Ok(())
            }
            _ => Err(Unmodelled::Register),
        }
    }

    pub(crate) fn read_controller(&self, offset: u32) -> Answer<u32> {
        match offset {
            PENDING => Ok(self.pending()),
            _ => Ok(self.controller.get(offset)),
        }
    }

    pub(crate) fn write_controller(&mut self, offset: u32, value: u32) -> Answer<()> {
        match offset {
            CLEAR => {
                self.edges &= !value;
                self.controller.set(CLEAR, value);
            }
            PENDING | CLAIM => return Err(Unmodelled::Register),
            _ => self.controller.set(offset, value),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mapped() -> Interrupts {
        let mut interrupts = Interrupts::new();
        for (source, line, priority) in [(source::UART0, 16, 1), (source::TIMER[1], 18, 3)] {
            interrupts.write_matrix(4 * source, line).unwrap();
            interrupts.write_controller(PRIORITY + 4 * line, priority).unwrap();
            let enabled = interrupts.read_controller(ENABLE).unwrap();
            interrupts.write_controller(ENABLE, enabled | 1 << line).unwrap();
        }
        interrupts
    }

    #[test]
    fn the_highest_priority_not_below_the_threshold_is_taken() {
        let mut interrupts = mapped();
        interrupts.set(source::UART0, true);
        assert_eq!(interrupts.line(|_| true), Some(16));
        interrupts.set(source::TIMER[1], true);
        assert_eq!(interrupts.line(|_| true), Some(18));
        interrupts.write_controller(THRESHOLD, 4).unwrap();
        assert_eq!(interrupts.line(|_| true), None);
        interrupts.write_controller(THRESHOLD, 3).unwrap();
        assert_eq!(interrupts.line(|_| true), Some(18));
    }

    #[test]
    fn an_edge_stays_until_it_is_cleared() {
        let mut interrupts = mapped();
        interrupts.write_controller(KIND, 1 << 16).unwrap();
        interrupts.set(source::UART0, true);
        interrupts.set(source::UART0, false);
        assert_eq!(interrupts.line(|_| true), Some(16));
        interrupts.write_controller(CLEAR, 1 << 16).unwrap();
        assert_eq!(interrupts.line(|_| true), None);
    }
}
