//! What happens from a reset to the first tick of the fast loop: what drives each pin, and when flash and radio are first used.

use crate::block::gpio::{Driver, Gpio, PINS};
use serde::Serialize;

/// What drives a pin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Line {
    /// Nothing.
    Floats,
    /// A plain output, low.
    Low,
    /// A plain output, high.
    High,
    /// A peripheral: of the bridges' pins the PWM.
    Peripheral,
}

impl From<Driver> for Line {
    fn from(driver: Driver) -> Self {
        match driver {
            Driver::None => Self::Floats,
            Driver::Level(false) => Self::Low,
            Driver::Level(true) => Self::High,
            _ => Self::Peripheral,
        }
    }
}

/// A pin that is driven otherwise than before, and when, in cycles since power-on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Change {
    pub(crate) at: u64,
    pub(crate) pin: u32,
    pub(crate) line: Line,
}

/// From the last reset on, in cycles since power-on. Until a pin is in `changes` for the first time, nothing drives it.
#[derive(Debug, Default)]
pub(crate) struct Early {
    pub(crate) changes: Vec<Change>,
    /// The first operation of the ROM's flash driver.
    pub(crate) flash: Option<u64>,
    /// The first call of the radio's library.
    pub(crate) radio: Option<u64>,
    /// The first tick that the fast loop acknowledges.
    pub(crate) tick: Option<u64>,
}

impl Early {
    /// Returns what drives a pin since its last change.
    fn line(&self, pin: u32) -> Line {
        let last = self.changes.iter().rev().find(|change| change.pin == pin);
        last.map_or(Line::Floats, |change| change.line)
    }

    /// Looks at all pins after something that may have changed them.
    pub(crate) fn look(&mut self, gpio: &Gpio, now: u64) {
        if self.tick.is_some() {
            return;
        }
        for pin in 0..PINS {
            let line = gpio.driver(pin).into();
            if line != self.line(pin) {
                self.changes.push(Change { at: now, pin, line });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Offsets of registers (technical reference manual, section 7.14): set an output and clear it, drive a pin and let go of it,
    /// choose what drives pin 10.
    const SET: u32 = 0x08;
    const CLEAR: u32 = 0x0C;
    const DRIVE: u32 = 0x24;
    const LET_GO: u32 = 0x28;
    const CHOICE: u32 = 0x554 + 4 * 10;
    /// The output register, and the PWM's first output.
    const PLAIN: u32 = 128;
    const PWM: u32 = 87;

    #[test]
    fn each_change_of_a_pin_is_kept_until_the_first_tick() {
        let (mut gpio, mut early) = (Gpio::new(), Early::default());
        for (at, (register, value)) in (1..).zip([
            (CHOICE, PLAIN),
            (DRIVE, 1 << 10),
            (SET, 1 << 10),
            (SET, 1 << 11),
            (CLEAR, 1 << 10),
            (CHOICE, PWM),
            (CHOICE, PLAIN),
            (LET_GO, 1 << 10),
        ]) {
            assert!(gpio.write(register, value).is_ok(), "{register:#x}");
            early.look(&gpio, at);
        }
        let changes = early.changes.iter().filter(|change| change.pin == 10);
        let lines: Vec<(u64, Line)> = changes.map(|change| (change.at, change.line)).collect();
        let expected = [
            (2, Line::Low),
            (3, Line::High),
            (5, Line::Low),
            (6, Line::Peripheral),
            (7, Line::Low),
            (8, Line::Floats),
        ];
        assert_eq!(lines, expected);
        early.tick = Some(9);
        assert!(gpio.write(DRIVE, 1 << 10).is_ok());
        early.look(&gpio, 10);
        assert_eq!(early.line(10), Line::Floats);
    }
}
