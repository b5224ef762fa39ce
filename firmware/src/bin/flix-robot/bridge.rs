//! Both three-phase bridges on one MCPWM unit, and the tick that is tied to them.
//!
//! Timer 0 counts up and down, 20,000 periods a second: each phase's pulse lies around its zero, and the phases' ripple is
//! zero there and at its peak. Timer 1 counts two of these periods on the same clock with whole counts, and its zero is the
//! tick of the fast loop. Both are started in one critical section, so a tick begins with a period, now and for ever.

use esp_hal::gpio::Output;
use esp_hal::interrupt::{InterruptHandler, bind_handler};
use esp_hal::mcpwm::operator::{PwmActions, PwmPin, PwmPinConfig, PwmUpdateMethod, UpdateAction};
use esp_hal::mcpwm::timer::{PwmWorkingMode, Timer};
use esp_hal::mcpwm::{McPwm, PeripheralClockConfig};
use esp_hal::peripherals::{Interrupt, MCPWM0};
use flix_firmware::board::PWM_FREQUENCY_HZ;
use flix_firmware::hardware::{Actuation, Bridge, Duty, TICK_RATE_HZ};

use crate::pins::{self, low};

/// Clock of the MCPWM, undivided, on all three chips.
pub(crate) const PWM_CLOCK_HZ: u32 = 160_000_000;
/// Counts up in a half period; the counter runs up and down.
pub(crate) const HALF_PERIOD: u16 = whole(PWM_CLOCK_HZ, 2 * PWM_FREQUENCY_HZ);
/// Counts of a tick.
const TICK_COUNTS: u16 = whole(PWM_CLOCK_HZ, TICK_RATE_HZ);
const _: () = assert!(
    TICK_COUNTS.is_multiple_of(2 * HALF_PERIOD),
    "a tick takes a whole number of PWM periods"
);

/// Divides without a rest.
const fn whole(clock_hz: u32, hz: u32) -> u16 {
    let counts = clock_hz / hz;
    assert!(counts * hz == clock_hz, "the clock has to be a multiple");
    assert!(counts <= u16::MAX as u32);
    counts as u16
}

/// Describes how a phase's output follows the counter. High from the comparison on the way down to that on
/// the way up; low at the peak whatever was missed, so that a duty of zero is zero.
const fn phase<const IS_A: bool>() -> PwmPinConfig<IS_A> {
    PwmPinConfig::new(
        PwmActions::<IS_A>::UP_DOWN_ACTIVE_HIGH
            .on_up_counting_timer_equals_period(UpdateAction::SetLow)
            .on_down_counting_timer_equals_period(UpdateAction::SetLow),
        PwmUpdateMethod::SYNC_ON_PERIOD,
    )
}

/// The timer whose period is the PWM's.
pub(crate) type Carrier = Timer<0, MCPWM0<'static>>;

/// Both bridges off: enables and phases are outputs, low.
pub(crate) struct Quiet {
    enables: [Option<Output<'static>>; 2],
    phases: [[Output<'static>; 3]; 2],
}

/// Switches both bridges off, the enables first. Until then nothing drives their pins, which are what the board makes of
/// them: it comes before everything that takes time.
pub(crate) fn quiet([top, bottom]: [pins::Bridge; 2]) -> Quiet {
    let enables = [top.enable, bottom.enable].map(|enable| enable.map(low));
    let phases = [top.phases, bottom.phases].map(|phases| phases.map(low));
    Quiet { enables, phases }
}

/// Starts the PWM with both bridges off, and the tick's timer. `undivided` feeds the unit with its whole clock.
pub(crate) fn start(
    unit: MCPWM0<'static>,
    Quiet { enables: [top_enable, bottom_enable], phases: [top, bottom] }: Quiet,
    undivided: impl FnOnce(),
) -> (Motors, Carrier) {
    let clock = PeripheralClockConfig::with_prescaler(0);
    let mut pwm = McPwm::new(unit, clock);
    undivided();
    pwm.operator0.set_timer(&pwm.timer0);
    pwm.operator1.set_timer(&pwm.timer0);
    pwm.operator2.set_timer(&pwm.timer0);
    let carrier = clock.timer_clock_with_prescaler(HALF_PERIOD, PwmWorkingMode::UpDown, 0);
    let tick = clock.timer_clock_with_prescaler(TICK_COUNTS - 1, PwmWorkingMode::Increase, 0);
    critical_section::with(|_| {
        pwm.timer0.start(carrier);
        pwm.timer1.start(tick);
    });
    // The HAL leaves an output as it is and connects the PWM to it, whose own outputs are low: no phase floats meanwhile.
    let ([top_a, top_b, top_c], [bottom_a, bottom_b, bottom_c]) = (top, bottom);
    let (top_a, bottom_a) = pwm.operator0.with_pins(top_a, phase(), bottom_a, phase());
    let (top_b, bottom_b) = pwm.operator1.with_pins(top_b, phase(), bottom_b, phase());
    let (top_c, bottom_c) = pwm.operator2.with_pins(top_c, phase(), bottom_c, phase());
    let motors = Motors {
        tick: pwm.timer1,
        top: ThreePhase::new(top_a, top_b, top_c, top_enable),
        bottom: ThreePhase::new(bottom_a, bottom_b, bottom_c, bottom_enable),
    };
    (motors, pwm.timer0)
}

/// Lets every tick interrupt the core that calls; the handler acknowledges it.
pub(crate) fn listen(handler: InterruptHandler) {
    acknowledge();
    bind_handler(Interrupt::MCPWM0, handler);
    MCPWM0::regs().int_ena().write(|w| w.timer1_tez().set_bit());
}

/// Acknowledges a tick.
pub(crate) fn acknowledge() {
    MCPWM0::regs().int_clr().write(|w| w.timer1_tez().clear_bit_by_one());
}

/// Both bridges.
pub(crate) struct Motors {
    /// The timer of the tick. The PWM's clock runs as long as a timer or an operator is kept: the last to go gates it.
    tick: Timer<1, MCPWM0<'static>>,
    top: ThreePhase<true>,
    bottom: ThreePhase<false>,
}

impl Motors {
    /// Drives the bridges until the next tick. The outputs take duties over at the counter's peaks, of which a tick has two: a loop
    /// that was quick waits for the first to pass, so that each tick's duties come into force at the second, always as late.
    pub(crate) fn apply(&mut self, actuation: &Actuation) {
        while self.tick.status().0 <= HALF_PERIOD {}
        let [top, bottom] = actuation.bridges;
        self.top.apply(top);
        self.bottom.apply(bottom);
    }
}

/// The bridge of one motor: output A or B of the unit's three operators.
struct ThreePhase<const IS_A: bool> {
    a: PwmPin<'static, MCPWM0<'static>, 0, IS_A>,
    b: PwmPin<'static, MCPWM0<'static>, 1, IS_A>,
    c: PwmPin<'static, MCPWM0<'static>, 2, IS_A>,
    enable: Option<Output<'static>>,
}

impl<const IS_A: bool> ThreePhase<IS_A> {
    /// Takes the three outputs, at a duty of zero, and the enable, which is low.
    fn new(
        a: PwmPin<'static, MCPWM0<'static>, 0, IS_A>,
        b: PwmPin<'static, MCPWM0<'static>, 1, IS_A>,
        c: PwmPin<'static, MCPWM0<'static>, 2, IS_A>,
        enable: Option<Output<'static>>,
    ) -> Self {
        let mut bridge = Self { a, b, c, enable };
        bridge.apply(Bridge::Off);
        bridge
    }

    /// Drives the bridge until the next call.
    fn apply(&mut self, bridge: Bridge) {
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
