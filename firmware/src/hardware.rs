//! The border between the robot's software and whatever carries it: a chip or a simulator.
//!
//! Everything that crosses in the fast loop is an integer, so that host, ESP32 and ESP32-C6
//! compute the same bits. Motors are listed top, bottom.

use core::num::NonZeroU16;

use serde::{Deserialize, Serialize};

pub use crate::units::{Duty, EncoderAngle, TICK, TICK_RATE_HZ, TICK_US};
pub use flix_protocol::message::Magnet;

/// One reading of an absolute angle encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct EncoderReading {
    /// Angle of the rotor; a 12-bit encoder fills the upper 12 bits.
    pub angle: EncoderAngle,
    /// Microseconds between the moment that the angle was sampled and this tick.
    pub age_us: u16,
}

/// What an encoder gave in this tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Encoder {
    /// A new reading.
    Reading(EncoderReading),
    /// The bus is slower than the loop and nothing new came: predict.
    Pending,
    /// It does not answer, its check sum is wrong, or its magnet is missing.
    Failed,
}

/// All that the fast loop measures in one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sensors {
    /// Top and bottom encoder.
    pub encoders: [Encoder; 2],
    /// What each of them last said of its magnet.
    pub magnets: [Magnet; 2],
    /// Raw counts of the phase current amplifiers, phases A and B of each motor. Positive counts
    /// above the zero count are current into the motor, up to a sign that alignment finds.
    /// `None` where the board has no usable current sense.
    pub phase_current: Option<[[i16; 2]; 2]>,
    /// Raw counts of the battery divider, where there is one.
    pub bus_voltage: Option<u16>,
}

/// What one three-phase bridge does until the next tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Bridge {
    /// Off: the motor coasts where the board can switch its bridges off, else all low sides are on.
    Off,
    /// High-side share of each phase, A B C.
    Duty([Duty; 3]),
}

impl Bridge {
    /// All low sides on: the shorted motor brakes itself, within 0.3 s from 35 Hz.
    pub const BRAKE: Self = Self::Duty([Duty::ZERO; 3]);
    /// All high sides on: it brakes as well, where a leg is stuck at the high rail.
    pub const BRAKE_HIGH: Self = Self::Duty([Duty::MAX; 3]);
}

/// What the hardware does until the next tick: the top and the bottom motor's bridge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Actuation {
    /// Top, bottom.
    pub bridges: [Bridge; 2],
}

impl Actuation {
    /// Both bridges off.
    pub const OFF: Self = Self { bridges: [Bridge::Off; 2] };
}

/// How the phase currents are measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CurrentSense {
    /// Microamperes per count.
    pub microamperes_per_count: u16,
    /// Count at no current, as designed; the true one is measured at rest.
    pub zero_count: i16,
    /// First and last count that the amplifier and the chip's converter do not clip, but for these two themselves.
    pub valid_counts: (i16, i16),
}

/// What the software has to know of the electronics that carry it. Data, one constant a board.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Hardware {
    /// For people, for example `MKS DUAL FOC V3.3 PLUS`.
    #[serde(skip)]
    pub name: &'static str,
    /// `None` runs the motors in voltage mode: no current sense, or one that clips negative currents.
    pub current_sense: Option<CurrentSense>,
    /// Microvolts of the bus per count of the divider; `None` where the board has no divider.
    pub bus_microvolts_per_count: Option<NonZeroU16>,
    /// Count of the divider that the chip's converter states for every higher bus, too.
    pub bus_largest_count: u16,
    /// Time in each PWM period in which neither switch of a phase conducts, nanoseconds.
    pub dead_time_ns: u16,
    /// PWM frequency, hertz.
    pub pwm_frequency_hz: u32,
    /// From the samples of a tick to the middle of the interval in which its duties act, microseconds: what the setting
    /// `actuation_delay` is where it is zero. See [`Hardware::actuation_delay`].
    pub actuation_delay_us: u16,
    /// Whether a bridge that is off lets the motor coast (else it brakes it).
    pub can_coast: bool,
}

impl Hardware {
    /// Returns the actuation delay of a board whose PWM runs at this frequency, Hz, with each tick at a trough of its carrier and
    /// duties taken over at its peaks: those of a tick act from the second peak on, for as long as a tick. Microseconds.
    #[must_use]
    pub const fn actuation_delay(pwm_frequency_hz: u32) -> u16 {
        (1_500_000 / pwm_frequency_hz + TICK_US / 2) as u16
    }
}

/// Where settings survive power-off: a flash partition, a file, an array.
///
/// The robot encodes and checks (version, checksum) the bytes itself; the store only keeps them,
/// and must lose neither the old nor the new when power goes in the middle of a write.
pub trait SettingsStore {
    /// Why reading or writing failed.
    type Error: core::fmt::Debug;

    /// Copies what was last written into `buffer`; `None` when nothing ever was.
    ///
    /// # Errors
    /// When the store cannot be read, or holds more than fits.
    fn load(&mut self, buffer: &mut [u8]) -> Result<Option<usize>, Self::Error>;

    /// Replaces what is kept.
    ///
    /// # Errors
    /// When it cannot be written; what was kept before is kept still.
    fn save(&mut self, bytes: &[u8]) -> Result<(), Self::Error>;

    /// Replaces what is kept, and erases what was kept before: no copy of it remains anywhere. For a
    /// store that writes in place this is [`SettingsStore::save`].
    ///
    /// # Errors
    /// When it cannot be written or erased; [`SettingsStore::load`] says what is kept now.
    fn save_and_sweep(&mut self, bytes: &[u8]) -> Result<(), Self::Error> {
        self.save(bytes)
    }

    /// Erases what [`SettingsStore::save_and_sweep`] left because power went.
    ///
    /// # Errors
    /// When it cannot be erased.
    fn sweep(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }
}

/// A store that keeps nothing: settings are the defaults after each start.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoStore;

impl SettingsStore for NoStore {
    type Error = core::convert::Infallible;

    fn load(&mut self, _: &mut [u8]) -> Result<Option<usize>, Self::Error> {
        Ok(None)
    }

    fn save(&mut self, _: &[u8]) -> Result<(), Self::Error> {
        Ok(())
    }
}
