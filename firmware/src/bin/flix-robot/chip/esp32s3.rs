//! ESP32-S3: the fast loop has core 1 to itself; one MCPWM unit a bridge; currents on ADC1.

use esp_hal::Blocking;
use esp_hal::analog::adc::{Adc, AdcChannel, AdcConfig, AdcPin, Attenuation};
use esp_hal::gpio::Pin;
use esp_hal::peripherals::{ADC1, GPIO1, GPIO2, GPIO4, GPIO5, GPIO6, LPWR, Peripherals};

use super::dual_core::{self, Converters, EncoderUnits};
pub(crate) use super::dual_core::{share_with_other_core, start_fast_loop};
use super::parts::{Parts, SerialParts};
use crate::choice::BOARD;

/// Bridges and converters.
pub(crate) type Electronics = dual_core::Electronics<Analog>;
type FastParts = dual_core::FastParts<Analog>;

const _: () = {
    let [top, bottom] = BOARD.bridges;
    assert!(matches!(top.currents, None | Some([1, 2])), "the top currents are on 1 and 2");
    assert!(matches!(bottom.currents, None | Some([4, 5])), "the bottom ones on 4 and 5");
    assert!(matches!(BOARD.divider_option.pin, 6), "the divider option is on 6");
};

/// Shares the chip out.
pub(crate) fn share_out(chip: Peripherals) -> Parts<FastParts> {
    let pins = (chip.GPIO1, chip.GPIO2, chip.GPIO4, chip.GPIO5, chip.GPIO6);
    Parts {
        scheduler: (chip.TIMG0, chip.FROM_CPU_INTR0),
        flash: chip.FLASH,
        wifi: chip.WIFI,
        serial: SerialParts {
            unit: chip.UART0,
            receive: chip.GPIO44.degrade(),
            transmit: chip.GPIO43.degrade(),
        },
        fast: FastParts {
            core: chip.CPU_CTRL,
            pwm: (chip.MCPWM0, chip.MCPWM1),
            analog: Analog::new(chip.ADC1, pins),
            encoders: EncoderUnits { top: chip.I2C0, bottom: chip.I2C1, spi: chip.SPI3 },
            timers: chip.TIMG1,
            software_interrupt: chip.FROM_CPU_INTR2,
        },
    }
}

type Converter = Adc<'static, ADC1<'static>, Blocking>;
type Channel<Pin> = AdcPin<Pin, ADC1<'static>>;

/// The converter, and the pins that are the generic board's options.
pub(crate) struct Analog {
    converter: Converter,
    top_a: Channel<GPIO1<'static>>,
    top_b: Channel<GPIO2<'static>>,
    bottom_a: Channel<GPIO4<'static>>,
    bottom_b: Channel<GPIO5<'static>>,
    battery: Channel<GPIO6<'static>>,
}

impl Analog {
    fn new(
        converter: ADC1<'static>,
        pins: (GPIO1<'static>, GPIO2<'static>, GPIO4<'static>, GPIO5<'static>, GPIO6<'static>),
    ) -> Self {
        let mut config = AdcConfig::new();
        let top_a = config.enable_pin(pins.0, Attenuation::_11dB);
        let top_b = config.enable_pin(pins.1, Attenuation::_11dB);
        let bottom_a = config.enable_pin(pins.2, Attenuation::_11dB);
        let bottom_b = config.enable_pin(pins.3, Attenuation::_11dB);
        let battery = config.enable_pin(pins.4, Attenuation::_11dB);
        let converter = Adc::new(converter, config);
        Self { converter, top_a, top_b, bottom_a, bottom_b, battery }
    }
}

impl Converters for Analog {
    fn currents(&mut self) -> Option<[[i16; 2]; 2]> {
        let converter = &mut self.converter;
        Some([
            [read(converter, &mut self.top_a)?, read(converter, &mut self.top_b)?],
            [read(converter, &mut self.bottom_a)?, read(converter, &mut self.bottom_b)?],
        ])
    }

    fn divider(&mut self) -> Option<u16> {
        read(&mut self.converter, &mut self.battery).map(i16::cast_unsigned)
    }
}

/// Does one conversion, 12 bits. A hung converter is a hung loop: the watchdog ends both.
fn read(converter: &mut Converter, channel: &mut Channel<impl AdcChannel>) -> Option<i16> {
    Some(converter.read_blocking(channel).cast_signed())
}

/// Lets a supply that sags reset the chip, which switches the bridges off.
pub(crate) fn reset_on_brown_out() {
    LPWR::regs().brown_out().modify(|_, w| {
        w.brown_out_rst_ena().set_bit();
        w.brown_out_ena().set_bit()
    });
}

/// Interrupts are on: Xtensa's start-up code leaves them so.
pub(crate) fn enable_interrupts() {}
