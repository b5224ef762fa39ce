//! Integer arithmetic of the fast loop: products that keep their upper half, limits, conversion.
//!
//! Nothing here panics. A 32 x 32 product of which only the upper 32 bits are kept is one
//! instruction on RV32IM (`mulh`) and on Xtensa (`mulsh`), so scales are chosen to need just that.

/// Upper half of the product: `a b / 2^32`, rounded down. Never overflows.
#[inline(always)]
pub(crate) const fn multiply_high(a: i32, b: i32) -> i32 {
    ((a as i64 * b as i64) >> 32) as i32
}

/// `value` within `bound` of zero. A negative bound counts as its nearest: the result is then
/// `bound` itself.
#[inline(always)]
pub(crate) const fn within(value: i32, bound: i32) -> i32 {
    let low = bound.wrapping_neg();
    let raised = if value < low { low } else { value };
    if raised > bound { bound } else { raised }
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
    fn conversion_saturates_and_ignores_nan() {
        assert_eq!(scaled(1e30, 16), i32::MAX);
        assert_eq!(scaled(-1e30, 16), i32::MIN);
        assert_eq!(scaled(f64::NAN, 16), 0);
        assert_eq!(scaled(-1.5, 16), -98_304);
    }
}
