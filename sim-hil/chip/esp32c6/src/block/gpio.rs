//! Pins: GPIO matrix, pads and what drives them (technical reference manual, chapter 7).

use super::{Answer, Unmodelled};
use crate::registers::Values;

const OUT: u32 = 0x04;
const OUT_SET: u32 = 0x08;
const OUT_CLEAR: u32 = 0x0C;
const ENABLE: u32 = 0x20;
const ENABLE_SET: u32 = 0x24;
const ENABLE_CLEAR: u32 = 0x28;
const STRAP: u32 = 0x38;
const IN: u32 = 0x3C;
const STATUS: u32 = 0x44;
const STATUS_SET: u32 = 0x48;
const STATUS_CLEAR: u32 = 0x4C;
const PIN: u32 = 0x74;
const INPUT: u32 = 0x154;
const OUTPUT: u32 = 0x554;

/// Pins of the chip.
pub(crate) const PINS: u32 = 31;
/// Signals at the matrix, by number (esp-hal's table of the ESP32-C6).
mod signal {
    pub(super) const UART0: u32 = 6;
    pub(super) const SPI_CLOCK: u32 = 63;
    pub(super) const SPI_MISO: u32 = 64;
    pub(super) const SPI_MOSI: u32 = 65;
    pub(super) const PWM: u32 = 87;
    pub(super) const GPIO: u32 = 128;
    /// Choices of an input that are no pin: always high, always low.
    pub(super) const INPUT_HIGH: u32 = 0x38;
    pub(super) const INPUT_LOW: u32 = 0x3C;
}

/// What drives a pin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Driver {
    /// Nothing: high impedance, pulled as the pad is set.
    None,
    /// The output register.
    Level(bool),
    /// Generator A or B (`false`, `true`) of an MCPWM operator, perhaps inverted.
    Pwm {
        operator: usize,
        is_b: bool,
        is_inverted: bool,
    },
    SpiClock,
    SpiMosi,
    Uart0,
    /// A peripheral that is not modelled, by signal.
    Other(u32),
}

/// Matrix and pads.
pub(crate) struct Gpio {
    pub(crate) matrix: Values,
    pub(crate) pads: Values,
}

impl Gpio {
    pub(crate) fn new() -> Self {
        let mut gpio = Self { matrix: Values::reset("GPIO"), pads: Values::reset("IO_MUX") };
        // Normal boot from flash.
        gpio.matrix.set(STRAP, 0x8);
        // The ROM's console: pads of UART0 in their first function.
        gpio.pads.set(pad(17), gpio.pads.get(pad(17)) | 1 << 9);
        gpio
    }

    /// Returns what drives a pin.
    pub(crate) fn driver(&self, pin: u32) -> Driver {
        let function = self.pads.field(pad(pin), 12, 3);
        match (function, pin) {
            (1, _) => {}
            (0, 16) => return Driver::Uart0,
            (2, 6) => return Driver::SpiClock,
            (2, 7) => return Driver::SpiMosi,
            // JTAG, the console's input, the flash.
            (0, 4..=7 | 17 | 24..=30) => return Driver::None,
            // All others have the matrix twice.
            (0, _) => {}
            _ => return Driver::Other(function),
        }
        let selection = self.matrix.get(OUTPUT + 4 * pin);
        let (signal, is_inverted) = (selection & 0xFF, selection >> 8 & 1 == 1);
        let own_enable = signal == signal::GPIO || selection >> 9 & 1 == 1;
        let is_enabled = (!own_enable || self.matrix.bit(ENABLE, pin)) ^ (selection >> 10 & 1 == 1);
        if !is_enabled {
            return Driver::None;
        }
        match signal {
            signal::GPIO => {
                let level = self.matrix.bit(OUT, pin) ^ is_inverted;
                let is_open_drain = self.matrix.bit(PIN + 4 * pin, 2);
                if is_open_drain && level { Driver::None } else { Driver::Level(level) }
            }
            signal::UART0 => Driver::Uart0,
            signal::SPI_CLOCK if !is_inverted => Driver::SpiClock,
            signal::SPI_MOSI if !is_inverted => Driver::SpiMosi,
            signal::PWM..=92 => Driver::Pwm {
                operator: ((signal - signal::PWM) / 2) as usize,
                is_b: (signal - signal::PWM) % 2 == 1,
                is_inverted,
            },
            other => Driver::Other(other),
        }
    }

    /// Returns the level that a pin without a driver is pulled to.
    pub(crate) fn pull(&self, pin: u32) -> Option<bool> {
        match (self.pads.bit(pad(pin), 8), self.pads.bit(pad(pin), 7)) {
            (true, false) => Some(true),
            (false, true) => Some(false),
            _ => None,
        }
    }

    /// The pin whose level a peripheral's input takes, if any, through matrix or pad.
    fn input(&self, signal: u32, direct: u32) -> Option<u32> {
        let selection = self.matrix.get(INPUT + 4 * signal);
        let pin = match selection >> 7 & 1 {
            0 => direct,
            _ => selection & 0x3F,
        };
        let is_inverted = selection >> 6 & 1 == 1;
        let is_pin = pin < PINS && self.pads.bit(pad(pin), 9) && !is_inverted;
        (is_pin && pin != signal::INPUT_HIGH && pin != signal::INPUT_LOW).then_some(pin)
    }

    /// Returns whether UART0 sends and listens at the pins of the console.
    pub(crate) fn console(&self) -> [bool; 2] {
        [self.driver(16) == Driver::Uart0, self.input(signal::UART0, 17) == Some(17)]
    }

    /// Returns the pin at which the SPI master listens.
    pub(crate) fn spi_miso(&self) -> Option<u32> {
        self.input(signal::SPI_MISO, 2)
    }

    /// Returns whether a pin is a plain output, and high.
    pub(crate) fn level(&self, pin: u32) -> Option<bool> {
        match self.driver(pin) {
            Driver::Level(level) => Some(level),
            Driver::None => self.pull(pin),
            _ => None,
        }
    }

    /// Returns the levels of the outputs, a bit for each pin.
    pub(crate) fn outputs(&self) -> u32 {
        self.matrix.get(OUT)
    }

    pub(crate) fn read(&self, offset: u32) -> Answer<u32> {
        Ok(match offset {
            IN => (0..PINS)
                .filter(|pin| self.pads.bit(pad(*pin), 9) && self.level(*pin).unwrap_or(true))
                .fold(0, |levels, pin| levels | 1 << pin),
            OUT..=STRAP | STATUS..=STATUS_CLEAR => self.matrix.get(offset),
            PIN..=0xFC | INPUT..=0x350 | OUTPUT..=0x5CC | 0x62C => self.matrix.get(offset),
            _ => return Err(Unmodelled::Register),
        })
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) -> Answer<()> {
        let (register, value) = match offset {
            OUT | ENABLE | STATUS => (offset, value),
            OUT_SET | ENABLE_SET | STATUS_SET => (offset - 4, self.matrix.get(offset - 4) | value),
            OUT_CLEAR | ENABLE_CLEAR | STATUS_CLEAR => {
                (offset - 8, self.matrix.get(offset - 8) & !value)
            }
            PIN..=0xFC => {
                if value >> 7 & 7 != 0 {
                    return Err(Unmodelled::Value("interrupts of pins are not modelled"));
                }
                (offset, value)
            }
            INPUT..=0x350 | OUTPUT..=0x5CC | 0x62C => (offset, value),
            _ => return Err(Unmodelled::Register),
        };
        self.matrix.set(register, value);
        Ok(())
    }

    pub(crate) fn read_pads(&self, offset: u32) -> Answer<u32> {
        Ok(self.pads.get(offset))
    }

    pub(crate) fn write_pads(&mut self, offset: u32, value: u32) -> Answer<()> {
        self.pads.set(offset, value);
        Ok(())
    }
}

/// Offset of a pin's pad register.
const fn pad(pin: u32) -> u32 {
    0x04 + 4 * pin
}

#[cfg(test)]
mod tests {
    use super::*;

    fn routed() -> Gpio {
        let mut gpio = Gpio::new();
        gpio.write_pads(pad(18), 1 << 12).unwrap();
        gpio.write(OUTPUT + 4 * 18, signal::PWM + 3).unwrap();
        gpio
    }

    #[test]
    fn a_signal_reaches_a_pin_through_matrix_and_pad() {
        let pwm = Driver::Pwm { operator: 1, is_b: true, is_inverted: false };
        assert_eq!(routed().driver(18), pwm);
    }

    #[test]
    fn a_pin_without_output_enable_drives_nothing() {
        let mut gpio = routed();
        // Enabled by the register, which is clear.
        gpio.write(OUTPUT + 4 * 18, (signal::PWM + 3) | (1 << 9)).unwrap();
        assert_eq!(gpio.driver(18), Driver::None);
    }

    #[test]
    fn a_pad_in_another_function_does_not_see_the_matrix() {
        let mut gpio = routed();
        gpio.write_pads(pad(18), 2 << 12).unwrap();
        assert_eq!(gpio.driver(18), Driver::Other(2));
    }
}
