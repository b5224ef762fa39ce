//! What the electronics see of the plant: angles, currents and the bus, with all that is wrong with them.
//!
//! ```text
//! encoder: angle(t - delay) + eccentricity(angle) + noise, cut to so many bits, every so many ticks
//! current: sign x gain x i / step + zero + offset + noise, rounded, clipped to what the amplifier gives
//! bus:     gain x V / step + noise, rounded
//! ```
//!
//! Noise is white and Gaussian. The eccentricity error of a magnet beside the axis has one period a turn, that
//! of a tilted one two (ams AS5600 data sheet, "integral non-linearity").

use std::f64::consts::TAU;
use std::num::NonZeroU16;

use flix_firmware::board::{EncoderKind, encoder};
use flix_firmware::hardware::{self, CurrentSense, EncoderAngle, EncoderReading};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

/// A kind of angle encoder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EncoderParameters {
    /// Steps per turn are 2 to this power, 1 to 32.
    pub bits: u32,
    /// Standard deviation of a reading, rad.
    pub noise: f64,
    /// Ticks from one reading to the next, at least 1.
    pub period: u64,
    /// Time from the sampled angle to the tick, as its driver states it, microseconds.
    pub age_us: u16,
    /// By how much every reading is older than stated, microseconds: a filter that is slower than the driver believes.
    pub late_us: f64,
    /// How far the true age may be from that, microseconds either side.
    pub age_error_us: f64,
    /// Largest amplitude of the error with one and with two periods a turn, rad.
    pub eccentricity: [f64; 2],
    /// How well the zero was set on the bench, rad either side.
    pub zero_error: f64,
}

/// ams AS5600 over its own 1 MHz I2C bus, with the filter that the firmware sets.
pub const AS5600: EncoderParameters = as5600(encoder::AS5600_CONFIGURATION);

/// Returns an ams AS5600 with the filter that these two bytes of CONF set: 12 bits, read over its own 1 MHz I2C bus in
/// two ticks; a reading is late by half of what the filter settles in. Data sheet v1-06: noise and settling time of the
/// four slow filters, SF; non-linearity at most 1 degree.
#[must_use]
pub const fn as5600(configuration: [u8; 2]) -> EncoderParameters {
    let (settling_us, noise_deg) = match configuration[0] & 0b11 {
        0b00 => (2200.0, 0.015),
        0b01 => (1100.0, 0.021),
        0b10 => (550.0, 0.030),
        _ => (286.0, 0.043),
    };
    let stated_us = EncoderKind::As5600.delay_us();
    EncoderParameters {
        bits: 12,
        noise: noise_deg * RADIANS_PER_DEGREE,
        period: 2,
        age_us: stated_us + AS5600_BUS_US,
        late_us: settling_us / 2.0 - stated_us as f64,
        age_error_us: 15.0,
        eccentricity: [0.6 * RADIANS_PER_DEGREE, 0.3 * RADIANS_PER_DEGREE],
        zero_error: 0.2 * RADIANS_PER_DEGREE,
    }
}

/// From the angle's latching to the tick: half a reading, and its wait for the tick, microseconds.
const AS5600_BUS_US: u16 = 57;

/// MagnTek MT6701 over SSI, read in every tick: 14 bits, 5 us of delay (data sheet rev. 1.8).
pub const MT6701: EncoderParameters = EncoderParameters {
    bits: 14,
    noise: 0.02 * RADIANS_PER_DEGREE,
    period: 1,
    age_us: 10,
    late_us: 0.0,
    age_error_us: 3.0,
    eccentricity: [0.6 * RADIANS_PER_DEGREE, 0.3 * RADIANS_PER_DEGREE],
    zero_error: 0.2 * RADIANS_PER_DEGREE,
};

const RADIANS_PER_DEGREE: f64 = TAU / 360.0;

/// One encoder on its rotor.
#[derive(Debug, Clone)]
pub struct Encoder {
    parameters: EncoderParameters,
    /// Amplitude and phase of the error with one and with two periods a turn, rad.
    harmonics: [(f64, f64); 2],
    zero: f64,
    /// True age, s.
    age: f64,
    /// The tick of its period in which it delivers.
    slot: u64,
}

impl Encoder {
    /// Creates one of its kind, mounted as well as chance has it.
    #[must_use]
    pub fn mounted(parameters: EncoderParameters, random: &mut impl Rng) -> Self {
        let mut symmetric = |limit: f64| limit * (2.0 * random.random::<f64>() - 1.0);
        let zero = symmetric(parameters.zero_error);
        let age_error = symmetric(parameters.age_error_us);
        let harmonics = parameters.eccentricity.map(|largest| {
            (largest * (0.5 + 0.5 * random.random::<f64>()), TAU * random.random::<f64>())
        });
        Self {
            parameters,
            harmonics,
            zero,
            age: (f64::from(parameters.age_us) + parameters.late_us + age_error) * 1e-6,
            slot: random.next_u64() % parameters.period.max(1),
        }
    }

    /// Returns what the robot gets in this tick, of a rotor at `angle` (rad about body +z) that turns at `speed`
    /// (rad/s).
    pub fn read(
        &self,
        tick: u64,
        angle: f64,
        speed: f64,
        random: &mut impl Rng,
    ) -> hardware::Encoder {
        if tick % self.parameters.period.max(1) != self.slot {
            return hardware::Encoder::Pending;
        }
        let sampled = angle - speed * self.age;
        let seen = sampled + self.error(sampled) + self.parameters.noise * gaussian(random);
        hardware::Encoder::Reading(EncoderReading {
            angle: quantised(seen, self.parameters.bits),
            age_us: self.parameters.age_us,
        })
    }

    /// Returns how far a reading is from the rotor's angle for ever, rad.
    #[must_use]
    pub fn error(&self, angle: f64) -> f64 {
        let [(first, first_phase), (second, second_phase)] = self.harmonics;
        self.zero
            + first * libm::sin(angle + first_phase)
            + second * libm::sin(2.0 * angle + second_phase)
    }
}

/// An angle in rad as a left-aligned count of `bits` bits.
fn quantised(angle: f64, bits: u32) -> EncoderAngle {
    let turns = angle / TAU;
    let share = turns - turns.floor();
    let steps = (1_u64 << bits) as f64;
    let count = ((share * steps).round() as u64) % (1_u64 << bits);
    EncoderAngle::from_count(count as u32, bits)
}

/// How wrong a current amplifier with its converter may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AmplifierParameters {
    /// Standard deviation of a sample, counts.
    pub noise: f64,
    /// Largest offset from the designed zero count, counts either side.
    pub offset: f64,
    /// Largest relative error of the gain, either side.
    pub gain_error: f64,
}

/// 0.01 ohm shunt, INA240A2 and the ESP32's 12-bit ADC1. Assumed: 5 counts of noise (the converter's own, one-shot),
/// 15 of offset, 2 % of gain (shunt 1 %, amplifier 0.2 %, converter reference the rest).
pub const INLINE_AMPLIFIER: AmplifierParameters =
    AmplifierParameters { noise: 5.0, offset: 15.0, gain_error: 0.02 };

/// The two amplifiers of one motor.
#[derive(Debug, Clone)]
pub struct CurrentSensor {
    sense: CurrentSense,
    noise: f64,
    offset: [f64; 2],
    /// Counts per ampere, with sign.
    gain: [f64; 2],
}

impl CurrentSensor {
    /// Creates a pair as chance has it; `inverted` when the board counts down for current into the motor.
    #[must_use]
    pub fn built(
        sense: CurrentSense,
        parameters: AmplifierParameters,
        inverted: bool,
        random: &mut impl Rng,
    ) -> Self {
        let mut symmetric = |limit: f64| limit * (2.0 * random.random::<f64>() - 1.0);
        let counts_per_ampere =
            1e6 / f64::from(sense.microamperes_per_count) * if inverted { -1.0 } else { 1.0 };
        Self {
            sense,
            noise: parameters.noise,
            offset: [symmetric(parameters.offset), symmetric(parameters.offset)],
            gain: [(); 2].map(|()| counts_per_ampere * (1.0 + symmetric(parameters.gain_error))),
        }
    }

    /// Counts for these currents of phases A and B, ampere into the motor.
    pub fn read(&self, currents: [f64; 2], random: &mut impl Rng) -> [i16; 2] {
        let (lowest, highest) = self.sense.valid_counts;
        core::array::from_fn(|phase| {
            let count = self.gain[phase] * currents[phase]
                + f64::from(self.sense.zero_count)
                + self.offset[phase]
                + self.noise * gaussian(random);
            (count.round() as i16).clamp(lowest, highest)
        })
    }
}

/// The battery divider.
#[derive(Debug, Clone)]
pub struct BusSensor {
    counts_per_volt: f64,
    largest: u16,
    noise: f64,
}

/// Noise of the divider's converter, counts; assumed like [`INLINE_AMPLIFIER`]'s, filtered by its capacitor.
const BUS_NOISE: f64 = 2.0;
/// Resistors of 0.5 % and the converter's reference.
const BUS_GAIN_ERROR: f64 = 0.01;

impl BusSensor {
    /// Creates a divider as chance has it.
    #[must_use]
    pub fn built(microvolts_per_count: NonZeroU16, largest: u16, random: &mut impl Rng) -> Self {
        let gain = 1.0 + BUS_GAIN_ERROR * (2.0 * random.random::<f64>() - 1.0);
        Self {
            counts_per_volt: gain * 1e6 / f64::from(microvolts_per_count.get()),
            largest,
            noise: BUS_NOISE,
        }
    }

    /// Counts at this bus voltage.
    pub fn read(&self, volts: f64, random: &mut impl Rng) -> u16 {
        let counts = (self.counts_per_volt * volts + self.noise * gaussian(random)).round() as u16;
        counts.min(self.largest)
    }
}

fn gaussian(random: &mut impl Rng) -> f64 {
    StandardNormal.sample(random)
}
