//! A three-phase bridge on MCPWM: centre-aligned, 25 kHz, a pulse around the counter's zero.

use esp_hal::gpio::{AnyPin, Level, Output, OutputConfig};
use esp_hal::mcpwm::PwmPeripheral;
use esp_hal::mcpwm::operator::{PwmActions, PwmPin, PwmPinConfig, PwmUpdateMethod, UpdateAction};
use esp_hal::mcpwm::timer::PwmWorkingMode;
use esp_hal::mcpwm::{McPwm, PeripheralClockConfig};
use flix_firmware::board::{PWM_FREQUENCY_HZ, Pin};
use flix_firmware::hardware::{Bridge, Duty};

/// Clock of the MCPWM, undivided, on all three chips.
const PWM_CLOCK_HZ: u32 = 160_000_000;
/// Counts up in a half period; the counter runs up and down.
pub(crate) const HALF_PERIOD: u16 = {
    let counts = PWM_CLOCK_HZ / PWM_FREQUENCY_HZ / 2;
    assert!(counts <= u16::MAX as u32);
    counts as u16
};

/// Takes a pin of the board or the serial port by number.
#[expect(unsafe_code, reason = "pins are data here; the HAL's singletons are types")]
pub(crate) fn pin(number: Pin) -> AnyPin<'static> {
    // SAFETY: `choice::BOARD` was checked to use each pin once and none of the serial port's or
    // the flash's, every caller takes its numbers from there or is the serial port, and each part is
    // made once.
    unsafe { AnyPin::steal(number) }
}

/// Takes an output of the board, low.
pub(crate) fn output(number: Pin) -> Output<'static> {
    Output::new(pin(number), Level::Low, OutputConfig::default())
}

/// Describes how a phase's output follows the counter. High from the comparison on the way down to that on
/// the way up; low at the peak whatever was missed, so that a duty of zero is zero.
pub(crate) const fn phase<const IS_A: bool>() -> PwmPinConfig<IS_A> {
    PwmPinConfig::new(
        PwmActions::<IS_A>::UP_DOWN_ACTIVE_HIGH
            .on_up_counting_timer_equals_period(UpdateAction::SetLow)
            .on_down_counting_timer_equals_period(UpdateAction::SetLow),
        PwmUpdateMethod::SYNC_ON_PERIOD,
    )
}

/// Starts timer 0 of a unit and ties its three operators to it.
pub(crate) fn start<PWM: PwmPeripheral + 'static>(unit: PWM) -> McPwm<'static, PWM> {
    let clock = PeripheralClockConfig::with_prescaler(0);
    let mut pwm = McPwm::new(unit, clock);
    pwm.operator0.set_timer(&pwm.timer0);
    pwm.operator1.set_timer(&pwm.timer0);
    pwm.operator2.set_timer(&pwm.timer0);
    let timer = clock.timer_clock_with_prescaler(HALF_PERIOD, PwmWorkingMode::UpDown, 0);
    pwm.timer0.start(timer);
    pwm
}

/// The bridge of one motor: output A or B of a unit's three operators.
pub(crate) struct ThreePhase<PWM, const IS_A: bool> {
    a: PwmPin<'static, PWM, 0, IS_A>,
    b: PwmPin<'static, PWM, 1, IS_A>,
    c: PwmPin<'static, PWM, 2, IS_A>,
    enable: Option<Output<'static>>,
}

impl<PWM: PwmPeripheral, const IS_A: bool> ThreePhase<PWM, IS_A> {
    /// Takes the three outputs, at a duty of zero, and the enable, low.
    pub(crate) fn new(
        a: PwmPin<'static, PWM, 0, IS_A>,
        b: PwmPin<'static, PWM, 1, IS_A>,
        c: PwmPin<'static, PWM, 2, IS_A>,
        enable: Option<Pin>,
    ) -> Self {
        let mut bridge = Self { a, b, c, enable: enable.map(output) };
        bridge.apply(Bridge::Off);
        bridge
    }

    /// Drives the bridge until the next call.
    pub(crate) fn apply(&mut self, bridge: Bridge) {
        match bridge {
            // Low sides on where there is no enable: the motor brakes.
            Bridge::Off => {
                if let Some(enable) = &mut self.enable {
                    enable.set_low();
                }
                self.compare([Duty::ZERO; 3]);
            }
            Bridge::Duty(duties) => {
                self.compare(duties);
                if let Some(enable) = &mut self.enable {
                    enable.set_high();
                }
            }
        }
    }

    fn compare(&mut self, [a, b, c]: [Duty; 3]) {
        self.a.set_timestamp(counts(a));
        self.b.set_timestamp(counts(b));
        self.c.set_timestamp(counts(c));
    }
}

/// Converts a share of the period to counts of the half period: below it by at least one.
fn counts(duty: Duty) -> u16 {
    ((u32::from(duty.raw()) * u32::from(HALF_PERIOD)) >> 16) as u16
}
