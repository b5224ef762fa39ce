//! ESP32-S3: the fast loop has core 1 to itself; one MCPWM unit a bridge; currents on ADC1.

use esp_hal::Blocking;
use esp_hal::analog::adc::{Adc, AdcConfig, AdcPin, Attenuation};
use esp_hal::peripherals::{
    ADC1, CPU_CTRL, FLASH, FROM_CPU_INTR0, FROM_CPU_INTR2, GPIO1, GPIO2, GPIO4, GPIO5, GPIO6,
    GPIO43, GPIO44, I2C0, I2C1, LPWR, MCPWM0, MCPWM1, Peripherals, SPI3, TIMG0, TIMG1, UART0, WIFI,
};
use flix_firmware::control::Control;
use flix_firmware::hardware::Actuation;

use crate::bridge::ThreePhase;
use crate::choice::BOARD;
pub(crate) use crate::dual_core::share_with_other_core;
use crate::dual_core::{self, EncoderUnits};
use crate::fast::{self, Loop};

/// The chip, shared out.
pub(crate) struct Parts {
    /// For the scheduler.
    pub(crate) scheduler: (TIMG0<'static>, FROM_CPU_INTR0<'static>),
    /// For the settings.
    pub(crate) flash: FLASH<'static>,
    /// For the network.
    pub(crate) wifi: WIFI<'static>,
    /// For provisioning and the log.
    pub(crate) serial: SerialParts,
    /// For the fast loop.
    pub(crate) fast: FastParts,
}

/// The serial port that the board's USB connector leads to.
pub(crate) struct SerialParts {
    /// The unit.
    pub(crate) unit: UART0<'static>,
    /// Into the chip.
    pub(crate) receive: GPIO44<'static>,
    /// Out of the chip.
    pub(crate) transmit: GPIO43<'static>,
}

/// What core 1 owns.
pub(crate) struct FastParts {
    core: CPU_CTRL<'static>,
    pwm: (MCPWM0<'static>, MCPWM1<'static>),
    converter: ADC1<'static>,
    analog: AnalogPins,
    encoders: EncoderUnits<I2C0<'static>, I2C1<'static>, SPI3<'static>>,
    timers: TIMG1<'static>,
    software_interrupt: FROM_CPU_INTR2<'static>,
}

/// The ADC1 pins of the generic board's options.
struct AnalogPins {
    top_a: GPIO1<'static>,
    top_b: GPIO2<'static>,
    bottom_a: GPIO4<'static>,
    bottom_b: GPIO5<'static>,
    divider: GPIO6<'static>,
}

const _: () = {
    let [top, bottom] = BOARD.bridges;
    assert!(matches!(top.currents, None | Some([1, 2])), "the top currents are on 1 and 2");
    assert!(matches!(bottom.currents, None | Some([4, 5])), "the bottom ones on 4 and 5");
    assert!(matches!(BOARD.divider_option.pin, 6), "the divider option is on 6");
};

/// Shares the chip out.
pub(crate) fn share_out(chip: Peripherals) -> Parts {
    Parts {
        scheduler: (chip.TIMG0, chip.FROM_CPU_INTR0),
        flash: chip.FLASH,
        wifi: chip.WIFI,
        serial: SerialParts { unit: chip.UART0, receive: chip.GPIO44, transmit: chip.GPIO43 },
        fast: FastParts {
            core: chip.CPU_CTRL,
            pwm: (chip.MCPWM0, chip.MCPWM1),
            converter: chip.ADC1,
            analog: AnalogPins {
                top_a: chip.GPIO1,
                top_b: chip.GPIO2,
                bottom_a: chip.GPIO4,
                bottom_b: chip.GPIO5,
                divider: chip.GPIO6,
            },
            encoders: EncoderUnits { top: chip.I2C0, bottom: chip.I2C1, spi: chip.SPI3 },
            timers: chip.TIMG1,
            software_interrupt: chip.FROM_CPU_INTR2,
        },
    }
}

/// Starts the fast loop on core 1, and what reads I2C encoders below it.
pub(crate) fn start_fast_loop(parts: FastParts, control: Control) {
    dual_core::start(parts.core, move || {
        let (encoders, i2c) = parts.encoders.start();
        let electronics = Electronics::new(parts.pwm, parts.converter, parts.analog);
        fast::start(
            parts.timers,
            parts.software_interrupt,
            Loop { control, electronics, encoders },
        );
        dual_core::read_i2c_for_ever(i2c)
    });
}

/// Bridges and converters.
pub(crate) struct Electronics {
    top: ThreePhase<MCPWM0<'static>, true>,
    bottom: ThreePhase<MCPWM1<'static>, true>,
    converter: Adc<'static, ADC1<'static>, Blocking>,
    channels: Channels,
}

/// The pins as the converter knows them.
struct Channels {
    top_a: AdcPin<GPIO1<'static>, ADC1<'static>>,
    top_b: AdcPin<GPIO2<'static>, ADC1<'static>>,
    bottom_a: AdcPin<GPIO4<'static>, ADC1<'static>>,
    bottom_b: AdcPin<GPIO5<'static>, ADC1<'static>>,
    divider: AdcPin<GPIO6<'static>, ADC1<'static>>,
}

impl Electronics {
    fn new(
        (top, bottom): (MCPWM0<'static>, MCPWM1<'static>),
        converter: ADC1<'static>,
        analog: AnalogPins,
    ) -> Self {
        let mut config = AdcConfig::new();
        let channels = Channels {
            top_a: config.enable_pin(analog.top_a, Attenuation::_11dB),
            top_b: config.enable_pin(analog.top_b, Attenuation::_11dB),
            bottom_a: config.enable_pin(analog.bottom_a, Attenuation::_11dB),
            bottom_b: config.enable_pin(analog.bottom_b, Attenuation::_11dB),
            divider: config.enable_pin(analog.divider, Attenuation::_11dB),
        };
        let (top, bottom) = dual_core::bridges(top, bottom);
        Self { top, bottom, converter: Adc::new(converter, config), channels }
    }

    /// Until the next tick.
    pub(crate) fn apply(&mut self, actuation: &Actuation) {
        let [top, bottom] = actuation.bridges;
        self.top.apply(top);
        self.bottom.apply(bottom);
    }

    /// Counts of phases A and B of the top, then of the bottom motor.
    pub(crate) fn phase_current(&mut self) -> Option<[[i16; 2]; 2]> {
        BOARD.hardware.current_sense?;
        let Self { converter, channels, .. } = self;
        // A hung converter is a hung loop: the watchdog ends both.
        Some([
            [
                converter.read_blocking(&mut channels.top_a) as i16,
                converter.read_blocking(&mut channels.top_b) as i16,
            ],
            [
                converter.read_blocking(&mut channels.bottom_a) as i16,
                converter.read_blocking(&mut channels.bottom_b) as i16,
            ],
        ])
    }

    /// Counts of the divider.
    pub(crate) fn bus_voltage(&mut self) -> Option<u16> {
        BOARD.divider?;
        Some(self.converter.read_blocking(&mut self.channels.divider))
    }
}

/// A supply that sags resets the chip, which lets go of the bridges.
pub(crate) fn reset_on_brown_out() {
    LPWR::regs().brown_out().modify(|_, w| {
        w.brown_out_rst_ena().set_bit();
        w.brown_out_ena().set_bit()
    });
}
