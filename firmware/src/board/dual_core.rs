//! What the ESP32 and the ESP32-S3 have in common: core 1 belongs to the fast loop.

use esp_hal::Blocking;
use esp_hal::i2c::master::{Config, I2c, SoftwareTimeout};
use esp_hal::mcpwm::PwmPeripheral;
use esp_hal::peripherals::CPU_CTRL;
use esp_hal::system::{CpuControl, Stack};
use esp_hal::time::{Duration, Rate};
use esp_println::println;
use esp_storage::FlashStorage;
use flix_firmware::board::encoder::{AS5600_ADDRESS, AS5600_STATUS_REGISTER, as5600};
use flix_firmware::board::{BridgePins, EncoderKind, I2cPins};
use static_cell::StaticCell;

use crate::bridge::{self, ThreePhase, pin};
use crate::choice::BOARD;
use crate::encoders::{Encoders, SAMPLES, Sample, SpiEncoders};
use crate::fast;

/// Stack of core 1: the fast loop and the encoders; interrupts nest three deep at most.
const STACK_BYTES: usize = 12 * 1024;
/// Fastest clock of the AS5600.
const I2C_CLOCK: Rate = Rate::from_mhz(1);
/// A reading takes 54 microseconds; one that takes this long is a failure.
const I2C_PATIENCE: Duration = Duration::from_millis(1);

/// Runs `work` on core 1, which has no scheduler.
pub(crate) fn start(core: CPU_CTRL<'static>, work: impl FnOnce() + Send + 'static) {
    static STACK: StaticCell<Stack<STACK_BYTES>> = StaticCell::new();
    match CpuControl::new(core).start_app_core(STACK.init_with(Stack::new), work) {
        // Dropping it would park the core.
        Ok(guard) => core::mem::forget(guard),
        Err(error) => println!("core 1 does not start: {error:?}"),
    }
}

/// A bridge on the three outputs A of a unit.
fn bridge<PWM: PwmPeripheral + 'static>(unit: PWM, pins: BridgePins) -> ThreePhase<PWM, true> {
    let pwm = bridge::start(unit);
    let [a, b, c] = pins.phases.map(pin);
    ThreePhase::new(
        pwm.operator0.with_pin_a(a, bridge::phase()),
        pwm.operator1.with_pin_a(b, bridge::phase()),
        pwm.operator2.with_pin_a(c, bridge::phase()),
        pins.enable,
    )
}

/// Both bridges of the board, a unit each.
pub(crate) fn bridges<Top: PwmPeripheral + 'static, Bottom: PwmPeripheral + 'static>(
    top: Top,
    bottom: Bottom,
) -> (ThreePhase<Top, true>, ThreePhase<Bottom, true>) {
    let [top_pins, bottom_pins] = BOARD.bridges;
    (bridge(top, top_pins), bridge(bottom, bottom_pins))
}

/// Flash is written with this core's neighbour parked.
pub(crate) fn share_with_other_core(flash: FlashStorage<'static>) -> FlashStorage<'static> {
    flash.multicore_auto_park()
}

/// The units that encoders can be on.
pub(crate) struct EncoderUnits<Top, Bottom, Spi> {
    /// I2C master of the top encoder.
    pub(crate) top: Top,
    /// I2C master of the bottom encoder.
    pub(crate) bottom: Bottom,
    /// Bus of both SPI encoders.
    pub(crate) spi: Spi,
}

/// Both I2C encoders' buses; `None` where a bus cannot be had, or the encoders are not on I2C.
pub(crate) type I2cBuses = [Option<I2c<'static, Blocking>>; 2];

impl<Top, Bottom, Spi> EncoderUnits<Top, Bottom, Spi>
where
    Top: esp_hal::i2c::master::Instance + 'static,
    Bottom: esp_hal::i2c::master::Instance + 'static,
    Spi: esp_hal::spi::master::Instance + 'static,
{
    /// Takes the units that the board's encoders need.
    pub(crate) fn start(self) -> (Encoders, I2cBuses) {
        match (BOARD.encoder, BOARD.i2c) {
            (EncoderKind::As5600, Some([top, bottom])) => {
                (Encoders::Mailboxes, [i2c(self.top, top), i2c(self.bottom, bottom)])
            }
            (kind, _) => {
                let spi = SpiEncoders::new(self.spi, BOARD.spi, kind);
                (spi.map_or(Encoders::Mailboxes, Encoders::Spi), [None, None])
            }
        }
    }
}

fn i2c(
    unit: impl esp_hal::i2c::master::Instance + 'static,
    pins: I2cPins,
) -> Option<I2c<'static, Blocking>> {
    let config = Config::default()
        .with_frequency(I2C_CLOCK)
        .with_software_timeout(SoftwareTimeout::Transaction(I2C_PATIENCE));
    Some(I2c::new(unit, config).ok()?.with_sda(pin(pins.sda)).with_scl(pin(pins.scl)))
}

/// Reads both AS5600 in turn, below the fast loop, and leaves what they say for it.
pub(crate) fn read_i2c_for_ever(mut buses: I2cBuses) -> ! {
    loop {
        for (bus, mailbox) in buses.iter_mut().zip(&SAMPLES) {
            let Some(bus) = bus else { continue };
            let mut frame = [0; 3];
            let before = fast::now();
            let outcome = bus.write_read(AS5600_ADDRESS, &[AS5600_STATUS_REGISTER], &mut frame);
            // The angle is latched as its first byte is read, about in the middle.
            let half = fast::now().as_micros().saturating_sub(before.as_micros()) / 2;
            let time = flix_protocol::units::Instant::from_micros(before.as_micros() + half);
            let angle = outcome.ok().and_then(|()| as5600(frame));
            mailbox.put(Sample { angle, time });
        }
    }
}
