//! ESP32-C6: one core.
//!
//! Its converter has to settle for 40 microseconds a conversion, so it reads the battery alone,
//! one step of a conversion a tick, and the motors run in voltage mode.

use core::ops::Range;

use esp_hal::Blocking;
use esp_hal::analog::adc::{
    Adc, AdcCalCurve, AdcCalScheme, AdcChannel, AdcConfig, Attenuation, RegisterAccess,
};
use esp_hal::peripherals::{ADC1, GPIO0, LP_ANA, MCPWM0, PCR, Peripherals, SPI2, TIMG1};
use esp_storage::FlashStorage;
use flix_firmware::backtrace;
use flix_firmware::board::counts_of_millivolts;
use flix_protocol::message::ProgramCounters;

use super::parts::Parts;
use crate::bridge::{self, Motors, Quiet};
use crate::choice::BOARD;
use crate::encoders::Encoders;
use crate::pins::{self, Pins};

/// The processor's memory (esp-hal 1.2, `ld/esp32c6/memory.x`).
const MEMORY: Range<usize> = 0x4080_0000..0x4088_0000;
/// How much of a stack is searched for calls.
const STACK_BYTES: usize = 4096;

/// What the fast loop owns.
pub(crate) struct FastParts {
    bridges: Quiet,
    pwm: MCPWM0<'static>,
    converter: (ADC1<'static>, GPIO0<'static>),
    encoders: (SPI2<'static>, pins::Encoders),
    timers: TIMG1<'static>,
}

/// Shares the chip out, with both bridges off.
pub(crate) fn share_out(chip: Peripherals) -> Parts<FastParts> {
    let pins = Pins::new(chip.IO_MUX);
    let bridges = bridge::quiet(pins.bridges);
    Parts {
        scheduler: (chip.TIMG0, chip.FROM_CPU_INTR0),
        low_power: chip.RTC_TIMER,
        flash: chip.FLASH,
        wifi: chip.WIFI,
        serial: (chip.UART0, pins.serial),
        status_led: pins.status_led,
        fast: FastParts {
            bridges,
            pwm: chip.MCPWM0,
            converter: (chip.ADC1, chip.GPIO0),
            encoders: (chip.SPI2, pins.encoders),
            timers: chip.TIMG1,
        },
    }
}

/// Starts the fast loop above everything else on the only core.
pub(crate) fn start_fast_loop(
    parts: FastParts,
    start: impl FnOnce(Electronics, Encoders, TIMG1<'static>),
) {
    let encoders = match parts.encoders {
        // `Board::check` refuses them on this chip.
        (_, pins::Encoders::I2c(_)) => Encoders::elsewhere(),
        (unit, pins::Encoders::Spi(pins)) => Encoders::on_spi(unit, pins),
    };
    let electronics = Electronics::new(parts.pwm, parts.bridges, parts.converter);
    start(electronics, encoders, parts.timers);
}

/// There is no second stack.
pub(crate) const fn unused_stack() -> Option<[usize; 2]> {
    None
}

/// Bridges and converters.
pub(crate) struct Electronics {
    /// Both bridges.
    pub(crate) motors: Motors,
    battery: Option<Battery>,
}

impl Electronics {
    fn new(
        unit: MCPWM0<'static>,
        bridges: Quiet,
        (converter, divider): (ADC1<'static>, GPIO0<'static>),
    ) -> Self {
        let (motors, _carrier) = bridge::start(unit, bridges, undivided_pwm_clock);
        let battery = BOARD.divider.map(|_| Battery::new(converter, divider));
        Self { motors, battery }
    }

    /// Returns nothing: voltage mode.
    pub(crate) fn phase_current(&mut self) -> Option<[[i16; 2]; 2]> {
        None
    }

    /// Counts of the divider.
    pub(crate) fn bus_voltage(&mut self) -> Option<u16> {
        self.battery.as_mut().and_then(Battery::step)
    }
}

const _: () = assert!(
    matches!(BOARD.divider_option.pin, 0),
    "the divider of the generic ESP32-C6 is wired to GPIO 0 below"
);

/// Where a conversion stands.
#[derive(Clone, Copy)]
enum Conversion {
    Start,
    /// Started once; the converter must be started again when it has settled.
    Settle,
    Finish,
}

/// Widest range: 3.3 V, nominal.
const ATTENUATION: Attenuation = Attenuation::_11dB;

/// The divider, one step of a conversion a tick.
struct Battery {
    _converter: Adc<'static, ADC1<'static>, Blocking>,
    channel: u8,
    /// What the chip's fuses say of its converter.
    calibration: AdcCalCurve<ADC1<'static>>,
    conversion: Conversion,
    counts: Option<u16>,
}

impl Battery {
    fn new(converter: ADC1<'static>, divider: GPIO0<'static>) -> Self {
        let channel = divider.adc_channel();
        let mut config = AdcConfig::new();
        config.enable_pin(divider, ATTENUATION);
        let converter = Adc::new(converter, config);
        let calibration = AdcCalCurve::new_cal_with_channel(ATTENUATION, channel);
        ADC1::calibration_init();
        ADC1::set_init_code(calibration.adc_cal());
        Self {
            _converter: converter,
            channel,
            calibration,
            conversion: Conversion::Start,
            counts: None,
        }
    }

    fn step(&mut self) -> Option<u16> {
        self.conversion = match self.conversion {
            Conversion::Start => {
                ADC1::config_onetime_sample(self.channel, ATTENUATION as u8);
                ADC1::start_onetime_sample();
                Conversion::Settle
            }
            Conversion::Settle => {
                ADC1::start_onetime_sample();
                Conversion::Finish
            }
            Conversion::Finish if ADC1::is_done() => {
                let millivolts = self.calibration.adc_val(ADC1::read_data());
                self.counts = Some(counts_of_millivolts(millivolts));
                ADC1::reset();
                Conversion::Start
            }
            Conversion::Finish => Conversion::Finish,
        };
        self.counts
    }
}

/// Returns the flash as it is: there is no other core.
pub(crate) fn share_with_other_core(flash: FlashStorage<'static>) -> FlashStorage<'static> {
    flash
}

/// Does it: no other core is parked.
pub(crate) fn parking<R>(work: impl FnOnce() -> R) -> R {
    work()
}

/// Every revision will do.
pub(crate) const fn unsuitable() -> Option<&'static str> {
    None
}

/// Lets a supply that sags reset the chip, which switches the bridges off.
pub(crate) fn reset_on_brown_out() {
    LP_ANA::regs()
        .bod_mode0_cntl()
        .modify(|_, w| w.bod_mode0_reset_sel().set_bit().bod_mode0_reset_ena().set_bit());
}

/// Feeds the MCPWM undivided. After a reset the chip divides its clock by five, and the HAL leaves that so.
#[expect(unsafe_code, reason = "a field that the HAL's description does not bound")]
fn undivided_pwm_clock() {
    // SAFETY: every value of the field is a divider; the outputs are not connected yet.
    PCR::regs().pwm_clk_conf().modify(|_, w| unsafe { w.pwm_div_num().bits(0) });
}

/// Returns the calls that led here, as far as the stack shows them.
#[expect(unsafe_code, reason = "a stack is looked at while the processor uses it")]
pub(crate) fn calls() -> ProgramCounters {
    let top: usize;
    // SAFETY: it reads a register.
    unsafe { core::arch::asm!("mv {}, sp", out(reg) top) };
    let within = if MEMORY.contains(&top) { top..MEMORY.end.min(top + STACK_BYTES) } else { 0..0 };
    // SAFETY: all of this is memory, aligned as the stack is; every value of a word is one.
    let word =
        |address| unsafe { core::ptr::with_exposed_provenance::<u32>(address).read_volatile() };
    backtrace::calls(within.step_by(size_of::<u32>()).map(word), code)
}

/// Returns two bytes of the program; `None` where there is none.
#[expect(unsafe_code, reason = "the program is looked at as data")]
fn code(address: u32) -> Option<u16> {
    unsafe extern "C" {
        static _start: u8;
        static _rtc_fast_sidata: u8;
        static _rwtext_start: u8;
        static _rwtext_end: u8;
    }
    let address = usize::try_from(address).ok()?;
    let in_flash = (&raw const _start).addr()..(&raw const _rtc_fast_sidata).addr();
    let in_memory = (&raw const _rwtext_start).addr()..(&raw const _rwtext_end).addr();
    if !(in_flash.contains(&address) || in_memory.contains(&address)) {
        return None;
    }
    // SAFETY: the linker put the program there, from its first function to what follows the last; it begins and ends at
    // even addresses, and callers ask for even ones. Nothing writes it.
    Some(unsafe { core::ptr::with_exposed_provenance::<u16>(address).read_volatile() })
}

/// Lets interrupts in. The architecture has them off after a reset, and no start-up code of ours enables them: only
/// some boot loaders do.
#[expect(unsafe_code, reason = "a control register of the processor")]
pub(crate) fn enable_interrupts() {
    // SAFETY: `esp_hal::init` has set up handlers and priorities; no critical section is open.
    unsafe { core::arch::asm!("csrsi mstatus, 8") };
}
