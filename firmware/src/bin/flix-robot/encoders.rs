//! The encoders on their buses.
//!
//! SPI encoders answer within the tick. An AS5600 takes 29 to 54 microseconds on its bus, more than the
//! loop can wait for: a thread below the loop reads both in turn and leaves what it got, with
//! the time at which it was sampled, for the loop to find.

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use esp_hal::Blocking;
use esp_hal::gpio::{AnyPin, Flex, InputConfig, Output, Pull};
use esp_hal::spi::Mode;
use esp_hal::spi::master::{Config, ConfigError, Spi};
use esp_hal::time::Rate;
use flix_firmware::board::as5047p::{As5047p, As5047pReading};
use flix_firmware::board::encoder::{mt6701, mt6701_magnet};
use flix_firmware::board::{EncoderKind, SpiPins};
use flix_firmware::hardware::{Encoder, EncoderAngle, EncoderReading, Magnet, TICK_US};
use flix_protocol::units::Instant;

use crate::choice::BOARD;
use crate::log::log;
use crate::pins::low;

/// See [`EncoderKind::delay_us`].
const DELAY_US: u16 = BOARD.encoder.delay_us();

/// A reading, or the lack of one, and when.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    /// The angle; `None` when the encoder failed.
    pub(crate) angle: Option<EncoderAngle>,
    /// When it was sampled.
    pub(crate) time: Instant,
    /// What the encoder says of its magnet.
    pub(crate) magnet: Magnet,
}

impl Sample {
    /// Converts to what the fast loop takes in the tick at `now`.
    fn at(self, now: Instant) -> Encoder {
        let Some(angle) = self.angle else { return Encoder::Failed };
        let age = now.as_micros().saturating_sub(self.time.as_micros());
        let age_us = u16::try_from(age).unwrap_or(u16::MAX);
        let age_us = age_us.saturating_add(DELAY_US);
        Encoder::Reading(EncoderReading { angle, age_us })
    }
}

/// Samples of the top and the bottom encoder, from the thread that reads the bus.
pub(crate) static SAMPLES: [Signal<CriticalSectionRawMutex, Sample>; 2] =
    [const { Signal::new() }; 2];

/// How the fast loop reads the encoders.
pub(crate) enum Encoders {
    /// Read in the tick.
    Spi(SpiEncoders),
    /// Read elsewhere, found in [`SAMPLES`]; with what each encoder last said of its magnet.
    Elsewhere([Magnet; 2]),
}

impl Encoders {
    /// Takes the bus of SPI encoders. Without it, nothing ever comes: the encoders are lost.
    pub(crate) fn on_spi(
        unit: impl esp_hal::spi::master::Instance + 'static,
        pins: SpiPins<AnyPin<'static>>,
    ) -> Self {
        match SpiEncoders::new(unit, pins, BOARD.encoder) {
            Ok(spi) => Self::Spi(spi),
            Err(error) => {
                log!("encoders: their bus cannot be set up: {error:?}");
                Self::elsewhere()
            }
        }
    }

    /// Takes what another thread reads.
    pub(crate) const fn elsewhere() -> Self {
        Self::Elsewhere([Magnet::Good; 2])
    }

    /// Returns what each encoder last said of its magnet.
    pub(crate) const fn magnets(&self) -> [Magnet; 2] {
        match self {
            Self::Spi(spi) => spi.magnets,
            Self::Elsewhere(magnets) => *magnets,
        }
    }

    /// Reads top and bottom, for the tick at `now`.
    pub(crate) fn read(&mut self, now: Instant) -> [Encoder; 2] {
        match self {
            Self::Spi(spi) => spi.read(now),
            Self::Elsewhere(magnets) => [0, 1].map(|motor| {
                let Some(sample) = SAMPLES[motor].try_take() else { return Encoder::Pending };
                magnets[motor] = sample.magnet;
                sample.at(now)
            }),
        }
    }
}

/// SPI clock: both encoders allow 10 MHz and more; wires to the motors are long.
const SPI_CLOCK: Rate = Rate::from_mhz(8);

/// Two SPI encoders on one bus.
pub(crate) struct SpiEncoders {
    bus: Spi<'static, Blocking>,
    selects: [Output<'static>; 2],
    kind: EncoderKind,
    as5047p: [As5047p; 2],
    magnets: [Magnet; 2],
}

impl SpiEncoders {
    /// Takes the bus. Both kinds put data out on the rising edge: mode 1.
    fn new(
        unit: impl esp_hal::spi::master::Instance + 'static,
        pins: SpiPins<AnyPin<'static>>,
        kind: EncoderKind,
    ) -> Result<Self, ConfigError> {
        let config = Config::default().with_frequency(SPI_CLOCK).with_mode(Mode::_1);
        let mut miso = Flex::new(pins.miso);
        // Nobody there reads as ones.
        miso.apply_input_config(&InputConfig::default().with_pull(Pull::Up));
        miso.set_input_enable(true);
        let bus = Spi::new(unit, config)?
            .with_sck(pins.sclk)
            .with_mosi(pins.mosi)
            .with_miso(miso.peripheral_input());
        let mut selects = pins.selects.map(low);
        selects.iter_mut().for_each(Output::set_high);
        let magnets = [Magnet::Good; 2];
        Ok(Self { bus, selects, kind, as5047p: [As5047p::new(); 2], magnets })
    }

    fn exchange<const N: usize>(&mut self, motor: usize, mut frame: [u8; N]) -> Option<[u8; N]> {
        let select = &mut self.selects[motor];
        select.set_low();
        let outcome = self.bus.transfer(&mut frame);
        select.set_high();
        outcome.ok().map(|()| frame)
    }

    fn read(&mut self, now: Instant) -> [Encoder; 2] {
        [0, 1].map(|motor| match self.kind {
            EncoderKind::Mt6701 => {
                let frame = self.exchange(motor, [0; 3]);
                let angle = frame.and_then(mt6701);
                let magnet = match angle {
                    Some(_) => Magnet::Good,
                    None => frame.and_then(mt6701_magnet).unwrap_or(self.magnets[motor]),
                };
                self.magnets[motor] = magnet;
                Sample { angle, time: now, magnet }.at(now)
            }
            _ => self.read_as5047p(motor, now),
        })
    }

    fn read_as5047p(&mut self, motor: usize, now: Instant) -> Encoder {
        let mut driver = self.as5047p[motor];
        let reading = driver.read(|command| self.exchange(motor, command));
        self.as5047p[motor] = driver;
        self.magnets[motor] = driver.magnet();
        let angle = match reading {
            As5047pReading::Angle(angle) => Some(angle),
            As5047pReading::Other => return Encoder::Pending,
            As5047pReading::Failed => None,
        };
        // The angle was latched when the exchange before ended, one tick ago.
        let latched = now.as_micros().saturating_sub(TICK_US.into());
        let (time, magnet) = (Instant::from_micros(latched), driver.magnet());
        Sample { angle, time, magnet }.at(now)
    }
}
