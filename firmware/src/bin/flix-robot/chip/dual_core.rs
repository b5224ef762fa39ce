//! What the ESP32 and the ESP32-S3 have in common: core 1 belongs to the fast loop.

use core::ptr::NonNull;
use core::sync::atomic::{AtomicPtr, AtomicUsize, Ordering};

use esp_hal::Blocking;
use esp_hal::analog::adc::{Adc, AdcChannel, AdcConfig, AdcPin, Attenuation};
use esp_hal::gpio::AnyPin;
use esp_hal::i2c::master::{Config, I2c, SoftwareTimeout};
use esp_hal::mcpwm::timer::CounterDirection;
use esp_hal::peripherals::{ADC1, CPU_CTRL, I2C0, I2C1, MCPWM0, Peripherals, SPI3, TIMG1};
use esp_hal::system::{CpuControl, Stack};
use esp_hal::time::{Duration, Rate};
use esp_storage::FlashStorage;
use flix_firmware::board::as5600::As5600;
use flix_firmware::board::{I2cPins, centred_start, counts_of_millivolts};
use flix_protocol::message::ProgramCounters;
use static_cell::StaticCell;

use super::chosen::{BottomA, BottomB, Calibration, Divider, TopA, TopB, is_converting};
use super::parts::Parts;
use crate::bridge::{self, Carrier, HALF_PERIOD, Motors, PWM_CLOCK_HZ, Quiet};
use crate::choice::BOARD;
use crate::clock::now;
use crate::encoders::{Encoders, SAMPLES, Sample};
use crate::log::log;
use crate::pins::{self, Pins};

/// Stack of core 1: the fast loop and the encoders; interrupts nest three deep at most.
const STACK_BYTES: usize = 12 * 1024;
/// What fills it before the core starts, to be found again where nothing wrote.
const STACK_PAINT: u8 = 0xA5;
/// Its lowest bytes, among them the HAL's guard (esp-hal 1.2, `stack-guard-offset`).
const STACK_GUARD_BYTES: usize = 64;
/// The lowest address of what is painted and no longer needed to start the core, and how many bytes there are from it on.
static PAINTED: AtomicPtr<u8> = AtomicPtr::new(core::ptr::null_mut());
/// See [`PAINTED`].
static PAINTED_BYTES: AtomicUsize = AtomicUsize::new(0);
/// Fastest clock of the AS5600.
const I2C_CLOCK: Rate = Rate::from_mhz(1);
/// Clock of a bus whose pull-ups are too weak for that.
const I2C_SLOW_CLOCK: Rate = Rate::from_khz(400);
/// A reading takes 54 microseconds at most; one that takes this long is a failure.
const I2C_PATIENCE: Duration = Duration::from_millis(1);

/// What core 1 owns.
pub(crate) struct FastParts {
    core: CPU_CTRL<'static>,
    bridges: Quiet,
    pwm: MCPWM0<'static>,
    converter: ADC1<'static>,
    encoders: EncoderUnits,
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
            core: chip.CPU_CTRL,
            bridges,
            pwm: chip.MCPWM0,
            converter: chip.ADC1,
            encoders: EncoderUnits {
                pins: pins.encoders,
                top: chip.I2C0,
                bottom: chip.I2C1,
                spi: chip.SPI3,
            },
            timers: chip.TIMG1,
        },
    }
}

/// Starts the fast loop on core 1, which has no scheduler, and what reads I2C encoders below it.
pub(crate) fn start_fast_loop(
    parts: FastParts,
    start: impl FnOnce(Electronics, Encoders, TIMG1<'static>) + Send + 'static,
) {
    static STACK: StaticCell<Stack<STACK_BYTES>> = StaticCell::new();
    let FastParts { core, bridges, pwm, converter, encoders, timers } = parts;
    let work = move || {
        let (encoders, i2c) = encoders.start();
        let electronics = Electronics::new(pwm, bridges, Analog::new(converter));
        start(electronics, encoders, timers);
        read_i2c_for_ever(i2c)
    };
    let stack = STACK.init_with(Stack::new);
    stack.mem.write([STACK_PAINT; STACK_BYTES]);
    // The HAL hands the closure over at the bottom, above its guard; what was there is no paint, and no sign of a deep stack.
    let beginning = STACK_GUARD_BYTES + size_of_val(&work) + align_of_val(&work);
    PAINTED_BYTES.store(STACK_BYTES.saturating_sub(beginning), Ordering::Relaxed);
    PAINTED.store(stack.mem.as_mut_ptr().cast::<u8>().wrapping_add(beginning), Ordering::Release);
    match CpuControl::new(core).start_app_core(stack, work) {
        // Dropping it would park the core.
        Ok(guard) => core::mem::forget(guard),
        Err(error) => log!("core 1 does not start: {error:?}"),
    }
}

/// Returns nothing: where an Xtensa function returns to is in its register windows.
pub(crate) const fn calls() -> ProgramCounters {
    ProgramCounters::new()
}

/// Returns how many bytes of core 1's stack were never used, and how many it has; `None` before it starts.
#[expect(unsafe_code, reason = "a stack is looked at while its core uses it")]
pub(crate) fn unused_stack() -> Option<[usize; 2]> {
    let painted = NonNull::new(PAINTED.load(Ordering::Acquire))?;
    // SAFETY: the index is within the stack, which lives for ever; every value of a byte is one.
    let is_painted = |index: &usize| unsafe { painted.add(*index).read_volatile() } == STACK_PAINT;
    let unused = (0..PAINTED_BYTES.load(Ordering::Relaxed)).take_while(is_painted).count();
    Some([unused, STACK_BYTES])
}

/// Bridges and converter.
pub(crate) struct Electronics {
    /// Both bridges.
    pub(crate) motors: Motors,
    analog: Analog,
    carrier: Carrier,
    /// Count of the carrier, upwards, at which the four conversions begin.
    first_conversion: u16,
}

/// Rounds of conversions whose time is measured at the start: as many forwards as backwards.
const TIMED_ROUNDS: u32 = 8;

impl Electronics {
    fn new(unit: MCPWM0<'static>, bridges: Quiet, mut analog: Analog) -> Self {
        let (motors, carrier) = bridge::start(unit, bridges, || ());
        let first_conversion = analog.first_conversion();
        Self { motors, analog, carrier, first_conversion }
    }

    /// Waits until the ripple is about to be zero, and returns counts of phases A and B of the top, then of the bottom motor.
    pub(crate) fn phase_current(&mut self) -> Option<[[i16; 2]; 2]> {
        self.analog.amplifiers.as_ref()?;
        let is_time = |(count, direction)| {
            matches!(direction, CounterDirection::Increasing)
                && (self.first_conversion..=HALF_PERIOD).contains(&count)
        };
        // At most a PWM period. A carrier that stands is a hung loop: the watchdog ends both.
        while !is_time(self.carrier.status()) {}
        self.analog.currents()
    }

    /// Counts of the divider.
    pub(crate) fn bus_voltage(&mut self) -> Option<u16> {
        let Analog { converter, divider, .. } = &mut self.analog;
        divider.as_mut().and_then(|divider| read(converter, divider)).map(i16::cast_unsigned)
    }
}

type Converter = Adc<'static, ADC1<'static>, Blocking>;
type Channel<Pin> = AdcPin<Pin, ADC1<'static>, Calibration>;

/// The pins of both motors' amplifiers.
struct Amplifiers {
    top: (Channel<TopA>, Channel<TopB>),
    bottom: (Channel<BottomA>, Channel<BottomB>),
}

/// The converter, and the pins of the amplifiers and the divider, where the board has them.
struct Analog {
    converter: Converter,
    amplifiers: Option<Amplifiers>,
    divider: Option<Channel<Divider>>,
    /// Whether the currents are converted from the last to the first next time.
    backwards: bool,
}

impl Analog {
    #[expect(unsafe_code, reason = "the chip's file names these pins by type")]
    fn new(converter: ADC1<'static>) -> Self {
        let mut config = AdcConfig::new();
        let range = Attenuation::_11dB;
        // SAFETY: `Board::check` gave these pins to the converter alone, and each is taken once: a divider in an amplifier's place
        // leaves the board without current sense.
        let amplifiers = BOARD.hardware.current_sense.map(|_| unsafe {
            Amplifiers {
                top: (
                    config.enable_pin_with_cal(TopA::steal(), range),
                    config.enable_pin_with_cal(TopB::steal(), range),
                ),
                bottom: (
                    config.enable_pin_with_cal(BottomA::steal(), range),
                    config.enable_pin_with_cal(BottomB::steal(), range),
                ),
            }
        });
        // SAFETY: as above.
        let divider =
            BOARD.divider.map(|_| config.enable_pin_with_cal(unsafe { Divider::steal() }, range));
        Self { amplifiers, divider, converter: Adc::new(converter, config), backwards: false }
    }

    /// Measures how long the four conversions take, which data sheets give for the converter alone, and returns when they
    /// have to begin to lie around the carrier's peak, the middle of the time in which all low sides are on: the phases'
    /// ripple is zero there.
    fn first_conversion(&mut self) -> u16 {
        if self.amplifiers.is_none() {
            return 0;
        }
        let start = now();
        let is_converted = (0..TIMED_ROUNDS).all(|_| self.currents().is_some());
        let us = now().since(start).as_micros() as u32 / TIMED_ROUNDS;
        match centred_start(HALF_PERIOD, us * (PWM_CLOCK_HZ / 1_000_000)) {
            Some(first) if is_converted => first,
            _ => {
                log!(
                    "currents: four conversions take {us} us, more than there is: measured off the middle"
                );
                0
            }
        }
    }

    /// Converts the four in turn, forwards and backwards: what the ripple adds before its zero it takes away after it.
    fn currents(&mut self) -> Option<[[i16; 2]; 2]> {
        let Self { converter, amplifiers, backwards, .. } = self;
        let Amplifiers { top, bottom } = amplifiers.as_mut()?;
        *backwards = !*backwards;
        if *backwards {
            let bottom_b = read(converter, &mut bottom.1)?;
            let bottom_a = read(converter, &mut bottom.0)?;
            let top_b = read(converter, &mut top.1)?;
            let top_a = read(converter, &mut top.0)?;
            return Some([[top_a, top_b], [bottom_a, bottom_b]]);
        }
        Some([
            [read(converter, &mut top.0)?, read(converter, &mut top.1)?],
            [read(converter, &mut bottom.0)?, read(converter, &mut bottom.1)?],
        ])
    }
}

/// Does one conversion and returns the counts of an ideal converter. A hung converter is a hung loop: the watchdog ends both.
fn read(converter: &mut Converter, channel: &mut Channel<impl AdcChannel>) -> Option<i16> {
    // Until it rests, a start may be lost (ESP-IDF, `adc_oneshot_ll_start` of both chips).
    while is_converting() {}
    let millivolts = nb::block!(converter.read_oneshot(channel)).ok()?;
    Some(counts_of_millivolts(millivolts).cast_signed())
}

/// Interrupts are on: Xtensa's start-up code leaves them so.
pub(crate) fn enable_interrupts() {}

/// Parks this core's neighbour whenever flash is written.
pub(crate) fn share_with_other_core(flash: FlashStorage<'static>) -> FlashStorage<'static> {
    flash.multicore_auto_park()
}

/// Does what parks the other core, which holds no lock of both then: parked with one, it would keep it until it runs again, and
/// an interrupt of this core, many of which wait behind a change of flash, would wait for it for ever.
pub(crate) fn parking<R>(work: impl FnOnce() -> R) -> R {
    critical_section::with(|_| work())
}

/// The units that encoders can be on, and their pins.
pub(crate) struct EncoderUnits {
    /// Pins of those that the board has.
    pub(crate) pins: pins::Encoders,
    /// I2C master of the top encoder.
    pub(crate) top: I2C0<'static>,
    /// I2C master of the bottom encoder.
    pub(crate) bottom: I2C1<'static>,
    /// Bus of both SPI encoders.
    pub(crate) spi: SPI3<'static>,
}

/// Both I2C encoders' buses; `None` where a bus cannot be had, or the encoders are not on I2C.
type I2cBuses = [Option<I2c<'static, Blocking>>; 2];

impl EncoderUnits {
    /// Takes the units that the board's encoders need.
    fn start(self) -> (Encoders, I2cBuses) {
        match self.pins {
            pins::Encoders::I2c([top, bottom]) => {
                (Encoders::elsewhere(), [i2c(self.top, top), i2c(self.bottom, bottom)])
            }
            pins::Encoders::Spi(pins) => (Encoders::on_spi(self.spi, pins), [None, None]),
        }
    }
}

fn i2c(
    unit: impl esp_hal::i2c::master::Instance + 'static,
    pins: I2cPins<AnyPin<'static>>,
) -> Option<I2c<'static, Blocking>> {
    match I2c::new(unit, i2c_config(I2C_CLOCK)) {
        Ok(bus) => Some(bus.with_sda(pins.sda).with_scl(pins.scl)),
        Err(error) => {
            log!("encoders: a bus cannot be set up: {error:?}");
            None
        }
    }
}

fn i2c_config(clock: Rate) -> Config {
    Config::default()
        .with_frequency(clock)
        .with_software_timeout(SoftwareTimeout::Transaction(I2C_PATIENCE))
}

/// Reads both AS5600 in turn, below the fast loop, and leaves what they say for it.
fn read_i2c_for_ever(mut buses: I2cBuses) -> ! {
    let mut drivers = [As5600::new(); 2];
    loop {
        for (motor, newest) in SAMPLES.iter().enumerate() {
            let (driver, Some(bus)) = (&mut drivers[motor], &mut buses[motor]) else { continue };
            let (angle, time) = driver.read(bus, now);
            if driver.wants_slower_bus() && bus.apply_config(&i2c_config(I2C_SLOW_CLOCK)).is_ok() {
                log!("encoder {motor}: no or wrong answers at 1 MHz: its bus runs at 400 kHz");
            }
            newest.signal(Sample { angle, time, magnet: driver.magnet() });
        }
    }
}
