//! From encoder readings to the rotor's angle and speed.
//!
//! A reading is turned clockwise, corrected by a table for the magnet's eccentricity, brought
//! forward by its age at the present speed, and followed by a phase-locked loop of second order:
//!
//! ```text
//! angle' = angle + speed
//! error  = reading - angle'            accepted if below 1/32 turn
//! angle  = angle' + (2 zeta w + w^2 d) T n error
//! speed  = speed + (w T)^2 n error     n: ticks since the reading before, d: latency of the encoder
//! ```
//!
//! With `w^2 d` the loop has the poles of `w` and zeta however late the readings are.
//!
//! A reading that stays the same while the rotor turns quickly is not believed either: the encoder is
//! stuck. The loop follows a steady speed without error, and predicts where no reading came. All arithmetic
//! wraps with the turn.

use crate::hardware::{Encoder, EncoderReading};
use crate::units::{
    EncoderAngle, RotorAngle, Speed, TICK_US, cosine_sine, multiply_high, shifted, within,
};

/// Entries of the eccentricity table: between them a second harmonic of 1 degree is interpolated
/// to within 0.005 degree.
pub(crate) const TABLE_LENGTH: usize = 64;
/// A reading further from the prediction is not believed, 2^-32 turn: 1/32 turn. The largest torque
/// moves a rotor by a hundredth of it before the loop follows.
const PLAUSIBLE: i32 = 1 << 27;
/// A reading further from the prediction is believed, but counted, 2^-32 turn: 1/128 turn, 2.8 degrees. Noise, what is left
/// of the eccentricity and the steepest ramps stay below a fifth of it.
const NOTICED: i32 = 1 << 25;
/// From this speed on a reading that is the same as the one before is none: 10 Hz are four steps of a 12-bit encoder a tick.
const MOVING: Speed = Speed::from_centihertz(1_000);
/// Ticks for which that is no trouble: an AS5600 that is read in every tick has a new angle every 150 us.
const SAMPLING_TICKS: u16 = 2;
/// Ticks without a believable reading after which the encoder is lost: 3 ms.
pub(crate) const LOST_AFTER_TICKS: u16 = 30;
/// Ticks after a first reading in which every reading is believed: 20 ms.
const SETTLING_TICKS: u16 = 200;
/// Fastest speed that is followed: 75 Hz.
const FASTEST: Speed = Speed::from_centihertz(7_500);
/// Oldest reading that is brought forward, microseconds.
const OLDEST_US: i32 = 4_000;
/// Most ticks between readings that raise the gain of the next.
const LARGEST_WEIGHT: i32 = 4;

/// Fixed point of [`EncoderModel::angle_gain`]: 500 Hz and readings 3 ms late make 3.5.
pub(crate) const ANGLE_GAIN_BITS: u32 = 29;

/// An encoder and how to follow it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct EncoderModel {
    /// +1 where it counts clockwise seen from above, else -1.
    pub(crate) direction_sign: i32,
    /// Clockwise angle of the eccentric mass from forward at reading zero.
    pub(crate) zero: RotorAngle,
    /// Constant delay of every reading, microseconds.
    pub(crate) latency_us: i32,
    /// `(2 zeta w + w^2 d) T`, in 2^-[`ANGLE_GAIN_BITS`].
    pub(crate) angle_gain: i32,
    /// `(w T)^2` in 2^-32.
    pub(crate) speed_gain: i32,
    /// What the encoder reads too much, by its uncorrected angle, 2^-32 turn.
    pub(crate) eccentricity: [i32; TABLE_LENGTH],
}

impl EncoderModel {
    /// Converts a reading to the angle of the rotor, with the magnet's eccentricity still in.
    #[inline(always)]
    pub(crate) const fn uncorrected(&self, reading: EncoderAngle) -> RotorAngle {
        self.zero.turned(reading.raw().wrapping_mul(self.direction_sign as u32) as i32)
    }

    /// Works out one entry of the table from cosine and sine of the first and second harmonic.
    pub(crate) fn set_entry(&mut self, entry: usize, harmonics: &[i32; 4]) {
        let angle = (entry as u32).wrapping_mul(1 << (32 - TABLE_LENGTH.trailing_zeros()));
        let factors = harmonic_factors(RotorAngle::from_raw(angle));
        let sum = harmonics.iter().zip(factors).fold(0_i32, |sum, (harmonic, factor)| {
            sum.wrapping_add(multiply_high(harmonic.wrapping_mul(2), factor))
        });
        if let Some(slot) = self.eccentricity.get_mut(entry) {
            *slot = sum;
        }
    }

    /// Returns what the encoder reads too much at this uncorrected angle, 2^-32 turn.
    #[inline(always)]
    pub(crate) const fn correction(&self, angle: RotorAngle) -> i32 {
        let angle = angle.raw();
        const ENTRY_BITS: u32 = TABLE_LENGTH.trailing_zeros();
        let index = (angle >> (32 - ENTRY_BITS)) as usize;
        let (here, next) = (
            self.eccentricity[index % TABLE_LENGTH],
            self.eccentricity[(index + 1) % TABLE_LENGTH],
        );
        // Position between the two entries in 2^-31.
        let fraction = ((angle << ENTRY_BITS) >> 1) as i32;
        here.wrapping_add(multiply_high(next.wrapping_sub(here), fraction) << 1)
    }
}

/// Returns cosine and sine of an angle and of its double, 2^-31: the factors of the harmonics.
#[inline(always)]
pub(crate) fn harmonic_factors(angle: RotorAngle) -> [i32; 4] {
    let first = cosine_sine(angle.raw());
    let second = cosine_sine(angle.raw().wrapping_mul(2));
    [first.0, first.1, second.0, second.1]
}

/// Follows one rotor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Tracker {
    angle: RotorAngle,
    speed: Speed,
    last_reading: EncoderAngle,
    silence: u16,
    settling: u16,
    /// Readings since the start that failed or were not believed.
    dropped: u32,
    /// Readings since the start that were believed beyond [`NOTICED`].
    corrected: u32,
}

impl Tracker {
    /// Starts with nothing known: the first reading is believed.
    pub(crate) const fn new() -> Self {
        Self {
            angle: RotorAngle::ZERO,
            speed: Speed::ZERO,
            last_reading: EncoderAngle::ZERO,
            silence: LOST_AFTER_TICKS,
            settling: 0,
            dropped: 0,
            corrected: 0,
        }
    }

    /// Returns the angle of the rotor at the last tick.
    #[inline(always)]
    pub(crate) const fn angle(&self) -> RotorAngle {
        self.angle
    }

    /// Returns the speed of the rotor.
    #[inline(always)]
    pub(crate) const fn speed(&self) -> Speed {
        self.speed
    }

    /// Returns whether believable readings stayed away for too long.
    #[inline(always)]
    pub(crate) const fn lost(&self) -> bool {
        self.silence >= LOST_AFTER_TICKS
    }

    /// Returns how many readings were dropped, and how many believed far from the prediction, since the start.
    pub(crate) const fn counted(&self) -> (u32, u32) {
        (self.dropped, self.corrected)
    }

    /// Returns whether angle and speed can be relied on.
    #[inline(always)]
    pub(crate) const fn settled(&self) -> bool {
        !self.lost() && self.settling == 0
    }

    /// Adds the change of speed that the motors are about to make. Without it the speed would lag
    /// behind a ramp by `2 zeta / omega` of the tracker: 2.3 ms at 125 Hz.
    #[inline(always)]
    pub(crate) fn feed_forward(&mut self, change: Speed) {
        self.speed = (self.speed + change).within(FASTEST);
    }

    /// Moves on by ticks that the loop missed.
    pub(crate) const fn skip(&mut self, ticks: u32) {
        self.angle = self.angle.after(ticks, self.speed);
    }

    /// Counts the same rotor as another model of its encoder does: from another zero, or the other way.
    pub(crate) fn count_otherwise(&mut self, old: &EncoderModel, new: &EncoderModel) {
        let sign = old.direction_sign * new.direction_sign;
        let turned = self.angle.ahead_of(old.zero).wrapping_mul(sign);
        self.angle = new.zero.turned(turned);
        self.speed = Speed::from_raw(self.speed.raw() * sign);
    }

    /// Does one tick. Never panics.
    #[inline(always)]
    pub(crate) fn update(&mut self, model: &EncoderModel, encoder: Encoder) {
        self.angle = self.angle.after(1, self.speed);
        if self.settling != 0 {
            core::hint::cold_path();
            self.settling -= 1;
        }
        match encoder {
            Encoder::Reading(reading) => self.correct(model, reading),
            Encoder::Pending => self.miss(),
            Encoder::Failed => self.drop(),
        }
    }

    /// Notes that no believable reading came. Once lost, nothing is known of the speed.
    #[inline(always)]
    fn miss(&mut self) {
        self.silence = self.silence.saturating_add(1);
        if self.lost() {
            self.speed = Speed::ZERO;
        }
    }

    /// Notes that a reading failed, or is not believed.
    #[inline(always)]
    fn drop(&mut self) {
        core::hint::cold_path();
        self.dropped = self.dropped.wrapping_add(1);
        self.miss();
    }

    #[inline(always)]
    fn correct(&mut self, model: &EncoderModel, reading: EncoderReading) {
        let uncorrected = model.uncorrected(reading.angle);
        let sampled = uncorrected.turned(model.correction(uncorrected).wrapping_neg());
        if self.lost() {
            *self = Self {
                angle: sampled,
                speed: Speed::ZERO,
                last_reading: reading.angle,
                silence: 0,
                settling: SETTLING_TICKS,
                ..*self
            };
            return;
        }
        let measured = sampled.turned(self.travel(model, reading.age_us));
        let error = measured.ahead_of(self.angle);
        let repeated = reading.angle == self.last_reading && self.speed.magnitude() > MOVING;
        self.last_reading = reading.angle;
        let plausible = within(error, PLAUSIBLE);
        if repeated || within(error, NOTICED) != error {
            core::hint::cold_path();
            let is_settled = self.settling == 0;
            if repeated && self.silence < SAMPLING_TICKS {
                self.miss();
                return;
            }
            if repeated || (plausible != error && is_settled) {
                self.drop();
                return;
            }
            self.corrected = self.corrected.wrapping_add(is_settled.into());
        }
        let error = plausible.wrapping_mul(self.weight());
        self.angle =
            self.angle.turned(multiply_high(error, model.angle_gain) << (32 - ANGLE_GAIN_BITS));
        let change = Speed::from_raw(multiply_high(error, model.speed_gain));
        self.speed = (self.speed + change).within(FASTEST);
    }

    /// Ticks since the reading before.
    #[inline(always)]
    fn weight(&mut self) -> i32 {
        if self.silence == 0 {
            return 1;
        }
        core::hint::cold_path();
        let silence = core::mem::take(&mut self.silence);
        (i32::from(silence) + 1).min(LARGEST_WEIGHT)
    }

    /// Returns how far the rotor went since a reading of this age, 2^-32 turn.
    #[inline(always)]
    const fn travel(&self, model: &EncoderModel, age_us: u16) -> i32 {
        /// One tick per microsecond, 2^-25.
        const TICKS_PER_MICROSECOND: i32 = ((1 << 25) / TICK_US) as i32;
        let age = model.latency_us.wrapping_add(age_us as i32);
        let age = if age > OLDEST_US { OLDEST_US } else { age };
        // FASTEST takes 25 bits.
        multiply_high(shifted(self.speed.raw(), 6), age.wrapping_mul(TICKS_PER_MICROSECOND)) << 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::GENERIC_ESP32C6;
    use crate::fast::configuration::Configuration;
    use crate::settings::Settings;

    #[test]
    fn a_reading_is_brought_forward_right_at_every_speed_and_age() {
        let mut settings = Settings::DEFAULT;
        for latency_us in [0, 1, 1_234, 3_000] {
            settings.encoder_latency = latency_us as f32;
            let model = Configuration::new(&settings, &GENERIC_ESP32C6.hardware).encoders[0];
            for centihertz in [0, 3_900, 3_906, 3_907, 5_000, 7_499, 9_000, -3_907, -9_000] {
                let mut tracker = Tracker::new();
                // In two steps: neither is beyond what is followed.
                for _ in 0..2 {
                    tracker.feed_forward(Speed::from_centihertz(centihertz / 2));
                }
                let speed = i128::from(tracker.speed().raw());
                assert!(speed.abs() <= i128::from(FASTEST.raw()), "{speed}");
                for age_us in [0, 40, 999, 4_000, u16::MAX] {
                    let age = i128::from(latency_us + i32::from(age_us)).min(4_000);
                    let want = speed * age / i128::from(TICK_US);
                    let off = (i128::from(tracker.travel(&model, age_us)) - want).abs();
                    assert!(off <= 4 + want.abs() / 500_000, "{off} at {centihertz}, {age} us");
                }
            }
        }
    }

    #[test]
    fn a_speed_is_found_as_quickly_however_late_the_readings_are() {
        for late_us in [0, 1_000, 2_500, 3_000] {
            let settings = Settings { encoder_latency: late_us as f32, ..Settings::DEFAULT };
            let model = Configuration::new(&settings, &GENERIC_ESP32C6.hardware).encoders[0];
            let speed = Speed::from_centihertz(500);
            // Settled on a rotor that turns, by a tracker that takes it to stand.
            let mut tracker = Tracker::new();
            let reads = |tracker: &mut Tracker, tick: i32| {
                let ago = tick * TICK_US as i32 - late_us;
                let turned = i64::from(speed.raw()) * i64::from(ago) / i64::from(TICK_US);
                let turned = turned as i32 * model.direction_sign;
                let angle = EncoderAngle::from_raw(turned as u32);
                tracker.update(&model, Encoder::Reading(EncoderReading { angle, age_us: 0 }));
            };
            for tick in 0..300 {
                reads(&mut tracker, tick);
            }
            assert!((tracker.speed() - speed).magnitude().raw() < speed.raw() / 1_000, "{late_us}");
            // 5 % too slow: 10 ms later less than a tenth of it is left.
            tracker.speed = Speed::from_raw(speed.raw() / 20 * 19);
            for tick in 300..400 {
                reads(&mut tracker, tick);
            }
            let left = (tracker.speed() - speed).magnitude().raw();
            assert!(left < speed.raw() / 200, "{late_us} us late: {left} of {speed:?}");
        }
    }

    /// Returns how many readings are dropped in a second of those that a rotor at 20 Hz gives in every tick, new ones after so
    /// long.
    fn dropped(sampling_us: u64) -> u32 {
        let model = Configuration::new(&Settings::DEFAULT, &GENERIC_ESP32C6.hardware).encoders[0];
        let mut tracker = Tracker::new();
        for tick in 0..10_000 {
            let sampled_us = tick * u64::from(TICK_US) / sampling_us * sampling_us;
            // 20 Hz are 4,096 steps in 50 ms.
            let count = (sampled_us * 4_096 / 50_000) as u32 % 4_096;
            let age_us = (tick * u64::from(TICK_US) - sampled_us) as u16;
            let angle = EncoderAngle::from_count(count, 12);
            tracker.update(&model, Encoder::Reading(EncoderReading { angle, age_us }));
        }
        assert!(!tracker.lost());
        tracker.counted().0
    }

    #[test]
    fn an_encoder_that_is_read_more_often_than_it_samples_is_not_in_trouble_and_one_that_sticks_is()
    {
        assert_eq!([100, 147, 150, 300].map(dropped), [0; 4]);
        assert!(dropped(500) > 1_000, "{}", dropped(500));
    }
}
