//! The references of f and theta: what is asked, ramped.
//!
//! f changes along a ramp whose slope builds up and whose end is approached exponentially. Theta turns the short way: it is ramped
//! as twice theta, which wraps with one turn, as the line of force repeats every half turn of theta. The simulator's ideal drive
//! follows the same references.

use flix_protocol::failsafe::SLOWEST_RAMP;
use serde::{Deserialize, Serialize};

use crate::settings::Settings;
use crate::units::{
    RotorAngle, SPEED_PER_HERTZ, Speed, TICK_RATE_HZ, magnitude, multiply_high, shifted, within,
};

/// Ticks between two updates: the position loops are fifty times slower than the current loops.
pub(crate) const STRIDE: u32 = 4;
/// The same, for what is signed.
pub(crate) const STEP: i32 = STRIDE as i32;

/// Seconds between two updates.
pub const UPDATE_S: f64 = STRIDE as f64 / TICK_RATE_HZ as f64;
/// How fast a ramp closes in on its end, 1/s: the last `ramp / 50` are approached exponentially.
const FREQUENCY_APPROACH: i64 = 50;
/// The same for theta.
const DIRECTION_APPROACH: i64 = 20;
/// A ramp's slope builds up over this many updates.
pub(crate) const SLOPE_UPDATES: i32 = 16;
/// A difference of f below this is none: 0.001 Hz.
const SAME_FREQUENCY: i32 = 430;
/// Below this a reference counts as standing: 0.01 Hz.
pub(crate) const STANDING: i32 = Speed::from_centihertz(100).raw() / 100;
/// f that comes and goes at its ceiling falls less steeply than this, 2^-32 turn per tick^2: 40 Hz/s.
const GIVING_BACK: i32 = per_tick(40.0);
/// All of the headroom, 2^-15.
pub(crate) const FULL_HEADROOM: i32 = 1 << 15;

/// Converts `1/s` to a factor per tick in 2^-32.
const fn per_second(rate: i64) -> i32 {
    (rate * (1 << 32) / TICK_RATE_HZ as i64) as i32
}

/// How steeply the references change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ramps {
    /// Steepest change of f, 2^-32 turn per tick^2.
    pub(crate) frequency: i32,
    /// Fastest change of the sum (twice theta).
    pub(crate) sum: Speed,
}

impl Ramps {
    /// Returns the ramps that settings ask for.
    #[must_use]
    pub fn of(settings: &Settings) -> Self {
        Self {
            frequency: per_tick(settings.frequency_ramp).clamp(64, 60_000),
            sum: Speed::from_hertz(2.0 * settings.direction_ramp / 360.0),
        }
    }

    /// Returns the ramps by which rotors come to rest that are to stop: not so slow that they would have to brake.
    pub(crate) const fn stopping(self) -> Self {
        const SLOWEST: i32 = per_tick(SLOWEST_RAMP);
        let frequency = if self.frequency < SLOWEST { SLOWEST } else { self.frequency };
        Self { frequency, ..self }
    }
}

/// The references and their changes. Phase and sum are in 2^-32 turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reference {
    pub(crate) phase: u32,
    pub(crate) frequency: Speed,
    pub(crate) frequency_slope: i32,
    pub(crate) sum: u32,
    pub(crate) sum_speed: Speed,
}

impl Reference {
    /// Starts at rest, at twice these angles, 2^-32 turn.
    pub(crate) const fn at_rest(difference: u32, sum: u32) -> Self {
        Self {
            phase: difference >> 1,
            frequency: Speed::ZERO,
            frequency_slope: 0,
            sum,
            sum_speed: Speed::ZERO,
        }
    }

    /// Starts where f and theta have been constant.
    #[must_use]
    pub const fn steady(frequency: Speed, direction: RotorAngle) -> Self {
        Self { frequency, ..Self::at_rest(0, direction.raw().wrapping_mul(2)) }
    }

    /// Does one update, due every [`UPDATE_S`], of motors with voltage to spare.
    pub fn approach(&mut self, ramps: &Ramps, frequency: Speed, direction: RotorAngle) {
        self.ramp_frequency(ramps, FULL_HEADROOM, FULL_HEADROOM, frequency.raw());
        self.ramp_direction(ramps, Some(direction));
    }

    /// Returns f and the speed of the line of force (positive to the right), turns per second.
    #[must_use]
    pub fn speeds(&self) -> [f64; 2] {
        let hertz = |speed: Speed| f64::from(speed.raw()) / f64::from(SPEED_PER_HERTZ);
        [hertz(self.frequency), hertz(self.sum_speed) / 2.0]
    }

    /// Returns whether f is this and neither it nor theta changes.
    #[must_use]
    pub fn is_steady_at(&self, frequency: Speed) -> bool {
        self.frequency == frequency && self.frequency_slope == 0 && self.sum_speed == Speed::ZERO
    }

    /// Returns whether f and theta stand still.
    pub(crate) const fn is_standing(&self) -> bool {
        magnitude(self.frequency.raw()) < STANDING && magnitude(self.sum_speed.raw()) < STANDING
    }

    /// Returns whether f is being lowered towards zero.
    pub(crate) const fn is_slowing(&self) -> bool {
        self.frequency_slope != 0 && (self.frequency_slope ^ self.frequency.raw()) < 0
    }

    /// Returns whether f is lowered so steeply that the rotors give energy back, and no ceiling asks for it.
    pub(crate) const fn gives_back(&self) -> bool {
        self.is_slowing() && magnitude(self.frequency_slope) > GIVING_BACK
    }

    /// Moves phase and sum on by ticks.
    pub(crate) const fn skip(&mut self, ticks: u32) {
        self.phase = moved(self.phase, self.frequency, ticks);
        self.sum = moved(self.sum, self.sum_speed, ticks);
    }

    /// Moves f and phase on, upwards and downwards with so much headroom; returns the acceleration of the difference,
    /// 2^-40.
    #[inline(always)]
    pub(crate) fn ramp_frequency(
        &mut self,
        ramps: &Ramps,
        headroom: i32,
        headroom_down: i32,
        setpoint: i32,
    ) -> i32 {
        let frequency = self.frequency.raw();
        let gap = setpoint.wrapping_sub(frequency);
        if magnitude(gap) < SAME_FREQUENCY {
            self.frequency = Speed::from_raw(setpoint);
            self.frequency_slope = 0;
        } else {
            // Slowing down takes less voltage than going on: it needs no headroom, but motors that can brake so fast.
            let slows = (gap ^ frequency) < 0;
            let steepest = (ramps.frequency * if slows { headroom_down } else { headroom }) >> 15;
            let slope = within(multiply_high(gap, per_second(FREQUENCY_APPROACH)), steepest);
            let change = slope - self.frequency_slope;
            // One that is steeper than these ramps, of a stop that is taken back, ends quickly, too.
            let largest = ramps.frequency.max(magnitude(self.frequency_slope));
            self.frequency_slope += within(change, largest / SLOPE_UPDATES);
            self.frequency = Speed::from_raw(frequency.wrapping_add(self.frequency_slope * STEP));
        }
        self.phase = moved(self.phase, self.frequency, STRIDE);
        shifted(self.frequency_slope, 9)
    }

    /// Moves theta on, the short way; returns the acceleration of the sum, 2^-40.
    #[inline(always)]
    pub(crate) fn ramp_direction(&mut self, ramps: &Ramps, direction: Option<RotorAngle>) -> i32 {
        let ramp = ramps.sum.raw();
        let speed = direction.map_or(0, |direction| {
            let gap = direction.raw().wrapping_mul(2).wrapping_sub(self.sum) as i32;
            within(multiply_high(gap, per_second(DIRECTION_APPROACH)), ramp)
        });
        let steepest = multiply_high(ramp, per_second(DIRECTION_APPROACH));
        let change = within(speed - self.sum_speed.raw(), (steepest + 1) * STEP);
        self.sum_speed = self.sum_speed + Speed::from_raw(change);
        self.sum = moved(self.sum, self.sum_speed, STRIDE);
        shifted(change, 6)
    }
}

/// Converts Hz/s to 2^-32 turn per tick^2.
const fn per_tick(ramp: f32) -> i32 {
    (ramp * SPEED_PER_HERTZ / TICK_RATE_HZ as f32) as i32
}

/// Returns an angle, 2^-32 turn, after so many ticks at this speed.
#[inline(always)]
pub(crate) const fn moved(angle: u32, speed: Speed, ticks: u32) -> u32 {
    angle.wrapping_add((speed.raw() as u32).wrapping_mul(ticks))
}
