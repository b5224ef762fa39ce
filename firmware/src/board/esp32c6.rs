//! ESP32-C6: one core, one MCPWM unit whose outputs A drive the top bridge and B the bottom one.

use esp_hal::Blocking;
use esp_hal::analog::adc::{Adc, AdcConfig, AdcPin, Attenuation};
use esp_hal::mcpwm::operator::PwmPin;
use esp_hal::peripherals::{ADC1, GPIO0, MCPWM0};
use flix_firmware::hardware::Actuation;

use crate::bridge::{self, ThreePhase, pin};
use crate::choice::BOARD;

/// Bridges and converters.
pub(crate) struct Electronics {
    top: ThreePhase<MCPWM0<'static>, true>,
    bottom: ThreePhase<MCPWM0<'static>, false>,
}

impl Electronics {
    /// Takes the unit.
    pub(crate) fn new(unit: MCPWM0<'static>) -> Self {
        let pwm = bridge::start(unit);
        let [top, bottom] = BOARD.bridges;
        let (top_a, bottom_a) = pwm.operator0.with_pins(
            pin(top.phases[0]),
            bridge::phase(),
            pin(bottom.phases[0]),
            bridge::phase(),
        );
        let (top_b, bottom_b) = pwm.operator1.with_pins(
            pin(top.phases[1]),
            bridge::phase(),
            pin(bottom.phases[1]),
            bridge::phase(),
        );
        let (top_c, bottom_c) = pwm.operator2.with_pins(
            pin(top.phases[2]),
            bridge::phase(),
            pin(bottom.phases[2]),
            bridge::phase(),
        );
        Self {
            top: ThreePhase::new(top_a, top_b, top_c, top.enable),
            bottom: ThreePhase::new(bottom_a, bottom_b, bottom_c, bottom.enable),
        }
    }

    /// Until the next tick.
    pub(crate) fn apply(&mut self, actuation: &Actuation) {
        let [top, bottom] = actuation.bridges;
        self.top.apply(top);
        self.bottom.apply(bottom);
    }

    /// None: conversions take too long here.
    pub(crate) fn phase_current(&mut self) -> Option<[[i16; 2]; 2]> {
        None
    }

    /// Counts of the divider.
    pub(crate) fn bus_voltage(&mut self) -> Option<u16> {
        None
    }
}

/// A supply that sags resets the chip, which lets go of the bridges.
pub(crate) fn reset_on_brown_out() {}
