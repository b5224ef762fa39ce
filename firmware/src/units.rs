//! Fixed point: the integers that stand for physical quantities in the fast loop, and their arithmetic.
//!
//! | type | unit of the integer | range |
//! |---|---|---|
//! | [`EncoderAngle`] | 2^-32 turn, as the encoder counts | wraps with the turn |
//! | [`RotorAngle`] | 2^-32 turn, clockwise from forward seen from above, as theta | wraps with the turn |
//! | [`ElectricalAngle`] | 2^-32 electrical turn from phase A | wraps with the turn |
//! | [`Speed`] | 2^-32 turn per tick, clockwise positive | 5 kHz either way |
//! | [`ElectricalSpeed`] | 2^-32 electrical turn per tick | 5 kHz either way |
//! | [`Counts`] | 2^-4 count of a current amplifier | |
//! | [`Current`] | 2^-16 A | 32 kA either way |
//! | [`Voltage`] | 2^-16 V | 32 kV either way |
//! | [`Duty`] | 2^-16 of the PWM period | 0 to 0.99998 |
//!
//! A type costs nothing: it is its integer. Formulas that mix quantities work on [`raw`](Speed::raw)
//! integers, so that each product keeps its scale in sight. Nothing here panics; sums wrap.
//!
//! A 32 x 32 product of which only the upper 32 bits are kept is one instruction on RV32IM (`mulh`)
//! and on Xtensa (`mulsh`), so scales are chosen to need just that.

use core::ops::{Add, Neg, Sub};

use flix_protocol::units::{Amperes, Degrees, Hertz, Volts};
use serde::{Deserialize, Serialize};

/// Ticks of the fast loop per second.
pub const TICK_RATE_HZ: u32 = 10_000;
/// Time from tick to tick, microseconds.
pub const TICK_US: u32 = 1_000_000 / TICK_RATE_HZ;
/// Time from tick to tick.
pub const TICK: core::time::Duration = core::time::Duration::from_micros(TICK_US as u64);

/// One hertz as a [`Speed`].
pub(crate) const SPEED_PER_HERTZ: f32 = 4_294_967_296.0 / TICK_RATE_HZ as f32;
/// One degree, 2^-32 turn.
pub(crate) const TURN_PER_DEGREE: f32 = 4_294_967_296.0 / 360.0;
/// One ampere or volt, 2^-16.
const ONE: f32 = 65_536.0;

/// Makes a type of an integer: what is common to all.
macro_rules! fixed_point {
    ($($(#[$doc:meta])* $name:ident($integer:ty);)*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
        #[repr(transparent)]
        pub struct $name($integer);

        impl $name {
            /// Zero.
            pub const ZERO: Self = Self(0);

            /// Takes the integer in the unit of this type.
            #[inline(always)]
            #[must_use]
            pub const fn from_raw(raw: $integer) -> Self {
                Self(raw)
            }

            /// Returns the integer in the unit of this type.
            #[inline(always)]
            #[must_use]
            pub const fn raw(self) -> $integer {
                self.0
            }
        }
    )*};
}

/// Makes a type of a signed integer: sums, and what the transforms need.
macro_rules! signed {
    ($($(#[$doc:meta])* $name:ident;)*) => {
        fixed_point! { $($(#[$doc])* $name(i32);)* }
        $(
            impl $name {
                /// Returns the value within `bound` of zero; `bound` is not negative.
                #[inline(always)]
                #[must_use]
                pub const fn within(self, bound: Self) -> Self {
                    Self(within(self.0, bound.0))
                }

                /// Returns the value without its sign.
                #[inline(always)]
                #[must_use]
                pub const fn magnitude(self) -> Self {
                    Self(magnitude(self.0))
                }
            }

            impl Quantity for $name {
                #[inline(always)]
                fn from_raw(raw: i32) -> Self {
                    Self(raw)
                }

                #[inline(always)]
                fn raw(self) -> i32 {
                    self.0
                }
            }

            impl Add for $name {
                type Output = Self;

                #[inline(always)]
                fn add(self, other: Self) -> Self {
                    Self(self.0.wrapping_add(other.0))
                }
            }

            impl Sub for $name {
                type Output = Self;

                #[inline(always)]
                fn sub(self, other: Self) -> Self {
                    Self(self.0.wrapping_sub(other.0))
                }
            }

            impl Neg for $name {
                type Output = Self;

                #[inline(always)]
                fn neg(self) -> Self {
                    Self(self.0.wrapping_neg())
                }
            }
        )*
    };
}

/// Makes a type of an angle: a wrapping integer of which the whole range is one turn.
macro_rules! angle {
    ($($(#[$doc:meta])* $name:ident;)*) => {
        fixed_point! { $($(#[$doc])* $name(u32);)* }
        $(
            impl $name {
                /// Converts from degrees; angles beyond a turn wrap.
                #[must_use]
                pub fn from_degrees(degrees: f32) -> Self {
                    Self((degrees * TURN_PER_DEGREE) as i64 as u32)
                }

                /// Returns the angle turned by so much, 2^-32 turn.
                #[inline(always)]
                #[must_use]
                pub const fn turned(self, by: i32) -> Self {
                    Self(self.0.wrapping_add(by as u32))
                }

                /// Returns how far this angle is ahead of another, the short way, 2^-32 turn.
                #[inline(always)]
                #[must_use]
                pub const fn ahead_of(self, other: Self) -> i32 {
                    self.0.wrapping_sub(other.0) as i32
                }
            }
        )*
    };
}

angle! {
    /// What an absolute encoder reads: left-aligned, zero where its magnet says, counted in the
    /// direction in which the chip counts.
    EncoderAngle;
    /// Where a rotor's eccentric mass stands, or theta: clockwise from forward, seen from above.
    RotorAngle;
    /// Where the field of a rotor's magnets stands, from phase A; it turns with the phase order.
    ElectricalAngle;
}

signed! {
    /// Speed of a rotor, or f: clockwise positive.
    Speed;
    /// Speed of a rotor's field: positive in the phase order.
    ElectricalSpeed;
    /// Reading of a current amplifier.
    Counts;
    /// Current, into the motor where it is a phase's.
    Current;
    /// Voltage.
    Voltage;
}

fixed_point! {
    /// Share of the PWM period for which a phase's high side conducts.
    Duty(u16);
}

/// A signed quantity that the transforms of [`foc`](crate::fast::foc) turn.
pub trait Quantity: Copy {
    /// Takes the integer in the unit of this type.
    fn from_raw(raw: i32) -> Self;
    /// Returns the integer in the unit of this type.
    fn raw(self) -> i32;
}

impl EncoderAngle {
    /// Takes the count of an encoder that divides the turn into 2^`bits`.
    #[inline(always)]
    #[must_use]
    pub const fn from_count(count: u32, bits: u32) -> Self {
        Self(count << (u32::BITS - bits))
    }
}

impl Counts {
    /// Converts what a converter read.
    #[inline(always)]
    #[must_use]
    pub const fn new(count: i16) -> Self {
        Self(count as i32 * 16)
    }

    /// Returns the current that is so much per count: 2^-16 A, in 2^-21.
    #[inline(always)]
    #[must_use]
    pub(crate) const fn current(self, per_count: i32) -> Current {
        Current(multiply_high(self.0 << 11, per_count))
    }
}

impl RotorAngle {
    /// Returns the angle as a value within half a turn of forward, 2^-32 turn.
    #[inline(always)]
    #[must_use]
    pub const fn signed(self) -> i32 {
        self.0 as i32
    }

    /// Returns where the rotor is after so many ticks at this speed.
    #[inline(always)]
    #[must_use]
    pub const fn after(self, ticks: u32, speed: Speed) -> Self {
        Self(self.0.wrapping_add((speed.0 as u32).wrapping_mul(ticks)))
    }
}

impl ElectricalAngle {
    /// Returns the angle in degrees, 0 to 360.
    #[must_use]
    pub const fn degrees(self) -> f32 {
        self.0 as f32 / TURN_PER_DEGREE
    }
}

impl Speed {
    /// Converts hundredths of a hertz.
    #[must_use]
    pub const fn from_centihertz(centihertz: i64) -> Self {
        Self((centihertz * (1 << 32) / (100 * TICK_RATE_HZ as i64)) as i32)
    }

    /// Converts hertz; what does not fit saturates, NaN becomes zero.
    #[must_use]
    pub const fn from_hertz(hertz: f32) -> Self {
        Self((hertz * SPEED_PER_HERTZ) as i32)
    }
}

impl Current {
    /// Converts amperes; what does not fit saturates, NaN becomes zero.
    #[must_use]
    pub fn from_amperes(amperes: f64) -> Self {
        Self(scaled(amperes, 16))
    }
}

impl Voltage {
    /// Converts volts; what does not fit saturates, NaN becomes zero.
    #[must_use]
    pub fn from_volts(volts: f64) -> Self {
        Self(scaled(volts, 16))
    }
}

impl Duty {
    /// As much of the period as a bridge can conduct for.
    pub const MAX: Self = Self(u16::MAX);

    /// Returns the share of the period, 0 to 1.
    #[must_use]
    pub fn share(self) -> f64 {
        f64::from(self.0) / f64::from(u16::MAX)
    }
}

impl From<Hertz> for Speed {
    fn from(frequency: Hertz) -> Self {
        Self::from_hertz(frequency.get())
    }
}

impl From<Speed> for Hertz {
    fn from(speed: Speed) -> Self {
        Self::saturating(speed.0 as f32 / SPEED_PER_HERTZ)
    }
}

impl From<Degrees> for RotorAngle {
    fn from(angle: Degrees) -> Self {
        Self::from_degrees(angle.get())
    }
}

impl From<RotorAngle> for Degrees {
    fn from(angle: RotorAngle) -> Self {
        Self::saturating(angle.signed() as f32 / TURN_PER_DEGREE)
    }
}

impl From<Current> for Amperes {
    fn from(current: Current) -> Self {
        Self::saturating(current.0 as f32 / ONE)
    }
}

impl From<Voltage> for Volts {
    fn from(voltage: Voltage) -> Self {
        Self::saturating(voltage.0 as f32 / ONE)
    }
}

/// Returns the upper half of the product: `a b / 2^32`, rounded down. Never overflows.
#[inline(always)]
pub(crate) const fn multiply_high(a: i32, b: i32) -> i32 {
    ((a as i64 * b as i64) >> 32) as i32
}

/// Returns `value` times `2^bits`, which fits: shifts are seen by no overflow check, so that builds with assertions look here.
#[inline(always)]
pub(crate) const fn shifted(value: i32, bits: u32) -> i32 {
    debug_assert!((value << bits) >> bits == value, "a shift takes bits away");
    value << bits
}

/// Returns the product in 2^-`bits` of it, rounded down and saturated: where the range matters more than the instructions.
#[inline]
pub(crate) const fn product(a: i32, b: i32, bits: u32) -> i32 {
    let product = (a as i64 * b as i64) >> bits;
    if product > i32::MAX as i64 {
        i32::MAX
    } else if product < i32::MIN as i64 {
        i32::MIN
    } else {
        product as i32
    }
}

/// Returns `value` within `bound` of zero; `bound` is not negative. Most values are, so that is the
/// short way through.
#[inline(always)]
pub(crate) const fn within(value: i32, bound: i32) -> i32 {
    if value.wrapping_add(bound) as u32 <= (bound as u32).wrapping_mul(2) {
        return value;
    }
    core::hint::cold_path();
    if value < 0 { bound.wrapping_neg() } else { bound }
}

/// Returns the magnitude; that of `i32::MIN` is `i32::MAX`.
#[inline(always)]
pub(crate) const fn magnitude(value: i32) -> i32 {
    let magnitude = value.unsigned_abs();
    (magnitude - (magnitude >> 31)) as i32
}

/// Returns `value` times `2^bits`, rounded towards zero and saturated; NaN becomes zero. Slow path only.
pub(crate) fn scaled(value: f64, bits: u32) -> i32 {
    (value * (1_u64 << bits) as f64) as i32
}

/// Bits of an angle that choose an entry of [`SINE`].
const SINE_BITS: u32 = 9;
const SINE_LENGTH: usize = 1 << SINE_BITS;
/// A little below one, so that an entry turned by half its width still fits.
const AMPLITUDE: f64 = (1.0 - 2.2e-5) * i32::MAX as f64;
/// Sines at the middle of each 512th of a turn, and a quarter turn more for the cosine, 2^-31.
static SINE: [i32; SINE_LENGTH + SINE_LENGTH / 4] = sine_table();

const fn sine_table() -> [i32; SINE_LENGTH + SINE_LENGTH / 4] {
    let mut table = [0; SINE_LENGTH + SINE_LENGTH / 4];
    let mut entry = 0;
    while entry < table.len() {
        let turns = (entry as f64 + 0.5) / SINE_LENGTH as f64;
        let turns = if turns > 0.5 { turns - 1.0 } else { turns };
        table[entry] = (sine(turns * core::f64::consts::TAU) * AMPLITUDE) as i32;
        entry += 1;
    }
    table
}

/// Returns the sine by its series, to double precision within half a turn either side.
const fn sine(radians: f64) -> f64 {
    let mut term = radians;
    let mut sum = term;
    let mut order = 1.0;
    while order < 40.0 {
        term = -term * radians * radians / ((order + 1.0) * (order + 2.0));
        sum += term;
        order += 2.0;
    }
    sum
}

/// Returns cosine and sine of a wrapping angle, 2^-31, wrong by at most 2.3e-5: the nearest entry of a table
/// turned by the rest of the angle to first order.
#[inline(always)]
pub(crate) const fn cosine_sine(angle: u32) -> (i32, i32) {
    /// 2 pi, 2^-10.
    const TAU: i32 = 6_434;
    let entry = (angle >> (32 - SINE_BITS)) as usize;
    let (sine, cosine) = (SINE[entry], SINE[entry + SINE_LENGTH / 4]);
    // The rest from the middle of the entry, 2^-22 turn, and in 2^-32 rad.
    let rest = ((angle << SINE_BITS) ^ (1 << 31)) as i32 >> (SINE_BITS + 10);
    let radians = rest.wrapping_mul(TAU);
    (
        cosine.wrapping_sub(multiply_high(sine, radians)),
        sine.wrapping_add(multiply_high(cosine, radians)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_hold_at_the_ends_of_the_integer() {
        assert_eq!(within(i32::MIN, 7), -7);
        assert_eq!(within(i32::MAX, 7), 7);
        assert_eq!(within(-3, 7), -3);
        assert_eq!(magnitude(i32::MIN), i32::MAX);
    }

    #[test]
    fn cosine_and_sine_are_right_at_every_angle() {
        for step in 0..100_003_u32 {
            let angle = step.wrapping_mul(42_947);
            let radians = f64::from(angle) / 4_294_967_296.0 * core::f64::consts::TAU;
            let (cosine, sine) = cosine_sine(angle);
            let error = |have: i32, want: f64| (f64::from(have) / 2_147_483_648.0 - want).abs();
            assert!(error(cosine, radians.cos()) < 2.3e-5, "{angle}");
            assert!(error(sine, radians.sin()) < 2.3e-5, "{angle}");
        }
    }

    #[test]
    fn conversion_saturates_and_ignores_nan() {
        assert_eq!(scaled(1e30, 16), i32::MAX);
        assert_eq!(scaled(-1e30, 16), i32::MIN);
        assert_eq!(scaled(f64::NAN, 16), 0);
        assert_eq!(scaled(-1.5, 16), -98_304);
    }
}
