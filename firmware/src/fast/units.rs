//! Integer arithmetic of the fast loop: products that keep their upper half, limits, conversion.
//!
//! Nothing here panics. A 32 x 32 product of which only the upper 32 bits are kept is one
//! instruction on RV32IM (`mulh`) and on Xtensa (`mulsh`), so scales are chosen to need just that.

use crate::hardware::TICK_RATE_HZ;

/// 2^-32 turn per tick.
pub type Speed = i32;

/// 2^32 / 10 kHz: one hertz as a [`Speed`].
pub const SPEED_PER_HERTZ: f32 = 4_294_967_296.0 / TICK_RATE_HZ as f32;
/// One degree as an angle, 2^-32 turn.
pub const TURN_PER_DEGREE: f32 = 4_294_967_296.0 / 360.0;

/// Upper half of the product: `a b / 2^32`, rounded down. Never overflows.
#[inline(always)]
pub(crate) const fn multiply_high(a: i32, b: i32) -> i32 {
    ((a as i64 * b as i64) >> 32) as i32
}

/// `value` within `bound` of zero; `bound` is not negative. Most values are, so that is the short
/// way through.
#[inline(always)]
pub(crate) const fn within(value: i32, bound: i32) -> i32 {
    if value.wrapping_add(bound) as u32 <= (bound as u32).wrapping_mul(2) {
        return value;
    }
    core::hint::cold_path();
    if value < 0 { bound.wrapping_neg() } else { bound }
}

/// Magnitude; that of `i32::MIN` is `i32::MAX`.
#[inline(always)]
pub(crate) const fn magnitude(value: i32) -> i32 {
    value.saturating_abs()
}

/// `value` times `2^bits`, rounded towards zero and saturated; NaN becomes zero. Slow path only.
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

/// By its series, to double precision within half a turn either side.
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

/// Cosine and sine of a wrapping angle, 2^-31, wrong by at most 2.3e-5: the nearest entry of a table
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
