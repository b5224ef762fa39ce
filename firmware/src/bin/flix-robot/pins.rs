//! The board's pins, each of them handed out once.
//!
//! Pins are data here, and types in the HAL, which has one value of each. What is measured is not here: the chips' files name
//! those pins by type.

use esp_hal::gpio::{AnyPin, Level, Output, OutputConfig};
use esp_hal::peripherals::IO_MUX;
use flix_firmware::board::{EncoderKind, I2cPins, Pin, SpiPins};

use crate::choice::BOARD;

/// Pins of one bridge.
pub(crate) struct Bridge {
    /// Phases A, B, C.
    pub(crate) phases: [AnyPin<'static>; 3],
    /// High lets it drive; `None` where it has no such input.
    pub(crate) enable: Option<AnyPin<'static>>,
}

/// Pins of the encoders that the board has.
pub(crate) enum Encoders {
    /// A bus for each: top, bottom.
    #[cfg_attr(feature = "esp32c6", expect(dead_code, reason = "it has one I2C master"))]
    I2c([I2cPins<AnyPin<'static>>; 2]),
    /// One bus for both.
    Spi(SpiPins<AnyPin<'static>>),
}

/// Pins of the serial port.
pub(crate) struct Serial {
    /// From the computer.
    pub(crate) receive: AnyPin<'static>,
    /// To the computer.
    pub(crate) transmit: AnyPin<'static>,
}

/// All of them.
pub(crate) struct Pins {
    /// Top, bottom.
    pub(crate) bridges: [Bridge; 2],
    /// Both encoders.
    pub(crate) encoders: Encoders,
    /// The LED.
    pub(crate) status_led: AnyPin<'static>,
    /// The port at the board's USB connector.
    pub(crate) serial: Serial,
}

impl Pins {
    /// Hands them out: once, because the chip has one `IO_MUX`, which routes them.
    pub(crate) fn new(_: IO_MUX<'static>) -> Self {
        #[expect(unsafe_code, reason = "pins are data here; the HAL's singletons are types")]
        fn pin(number: Pin) -> AnyPin<'static> {
            // SAFETY: nobody outside of this function can call this. `choice::BOARD` was checked to use each pin once,
            // and none of the serial port's or the flash's.
            unsafe { AnyPin::steal(number) }
        }

        let bridge = |index: usize| {
            let pins = &BOARD.bridges[index];
            Bridge { phases: pins.phases.map(pin), enable: pins.enable.map(pin) }
        };
        let i2c = |pins: I2cPins| I2cPins { sda: pin(pins.sda), scl: pin(pins.scl) };
        let encoders = match (BOARD.encoder, BOARD.i2c) {
            (EncoderKind::As5600, Some(buses)) => Encoders::I2c(buses.map(i2c)),
            _ => {
                let SpiPins { sclk, miso, mosi, selects } = BOARD.spi;
                let selects = selects.map(pin);
                Encoders::Spi(SpiPins {
                    sclk: pin(sclk),
                    miso: pin(miso),
                    mosi: pin(mosi),
                    selects,
                })
            }
        };
        let [receive, transmit] = BOARD.chip.serial_pins().map(pin);
        Self {
            bridges: [bridge(0), bridge(1)],
            encoders,
            status_led: pin(BOARD.status_led),
            serial: Serial { receive, transmit },
        }
    }
}

/// Makes a pin an output, low.
pub(crate) fn low(pin: AnyPin<'static>) -> Output<'static> {
    Output::new(pin, Level::Low, OutputConfig::default())
}

/// Drives a pin low for good, whoever has it.
///
/// # Safety
/// Nobody else may use it any more.
#[expect(unsafe_code, reason = "the pin is taken from whoever has it")]
pub(crate) unsafe fn seize(number: Pin) {
    // SAFETY: the caller's.
    core::mem::forget(low(unsafe { AnyPin::steal(number) }));
}
