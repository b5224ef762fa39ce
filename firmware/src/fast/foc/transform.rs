//! Clarke and Park transforms and their inverses, of any quantity that has two components.

use crate::units::{ElectricalAngle, Quantity, cosine_sine, multiply_high};

/// 1/sqrt(3) in 2^-31.
const INVERSE_ROOT_3: i32 = 1_239_850_262;
/// sqrt(3)/2 in 2^-31.
const HALF_ROOT_3: i32 = 1_859_775_393;

/// Two components in the stator frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Stator<T> {
    /// Along phase A.
    pub alpha: T,
    /// A quarter electrical turn ahead.
    pub beta: T,
}

/// Two components in the rotor frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Rotor<T> {
    /// Along the magnet's field.
    pub d: T,
    /// A quarter electrical turn ahead.
    pub q: T,
}

/// Direction of the rotor's field in the stator frame, 2^-31.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Direction {
    /// Cosine of the electrical angle.
    pub cosine: i32,
    /// Sine of the electrical angle.
    pub sine: i32,
}

impl Direction {
    /// Returns the direction a quarter electrical turn ahead.
    #[must_use]
    pub const fn quarter_turn_ahead(self) -> Self {
        Self { cosine: self.sine.wrapping_neg(), sine: self.cosine }
    }
}

impl From<ElectricalAngle> for Direction {
    /// Converts with an error of at most 2.3e-5.
    #[inline(always)]
    fn from(angle: ElectricalAngle) -> Self {
        let (cosine, sine) = cosine_sine(angle.raw());
        Self { cosine, sine }
    }
}

/// Transforms phases A and B (C is minus their sum) to the stator frame. Inputs below 2^29.
#[inline(always)]
#[must_use]
pub fn clarke<T: Quantity>(a: T, b: T) -> Stator<T> {
    let sum = a.raw().wrapping_add(b.raw().wrapping_mul(2));
    Stator { alpha: a, beta: T::from_raw(multiply_high(sum.wrapping_mul(2), INVERSE_ROOT_3)) }
}

/// Transforms from the stator frame to phases A, B, C. Inputs below 2^29.
#[inline(always)]
#[must_use]
pub fn inverse_clarke<T: Quantity>(vector: Stator<T>) -> [T; 3] {
    let (alpha, beta) = (vector.alpha.raw(), vector.beta.raw());
    let half = alpha >> 1;
    let swing = multiply_high(beta.wrapping_mul(2), HALF_ROOT_3);
    let (b, c) = (swing.wrapping_sub(half), swing.wrapping_add(half).wrapping_neg());
    [vector.alpha, T::from_raw(b), T::from_raw(c)]
}

/// Transforms from the stator frame to the rotor frame. Inputs below 2^29.
#[inline(always)]
#[must_use]
pub fn park<T: Quantity>(vector: Stator<T>, direction: Direction) -> Rotor<T> {
    let Direction { cosine, sine } = direction;
    let (alpha, beta) = (vector.alpha.raw().wrapping_mul(2), vector.beta.raw().wrapping_mul(2));
    let d = multiply_high(alpha, cosine).wrapping_add(multiply_high(beta, sine));
    let q = multiply_high(beta, cosine).wrapping_sub(multiply_high(alpha, sine));
    Rotor { d: T::from_raw(d), q: T::from_raw(q) }
}

/// Transforms from the rotor frame to the stator frame. Inputs below 2^29.
#[inline(always)]
#[must_use]
pub fn inverse_park<T: Quantity>(vector: Rotor<T>, direction: Direction) -> Stator<T> {
    let Direction { cosine, sine } = direction;
    let (d, q) = (vector.d.raw().wrapping_mul(2), vector.q.raw().wrapping_mul(2));
    let alpha = multiply_high(d, cosine).wrapping_sub(multiply_high(q, sine));
    let beta = multiply_high(d, sine).wrapping_add(multiply_high(q, cosine));
    Stator { alpha: T::from_raw(alpha), beta: T::from_raw(beta) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Current;
    use core::f64::consts::TAU;

    #[test]
    fn park_recovers_a_current_along_q_at_every_angle() {
        for step in 0..1000_u32 {
            let angle = step.wrapping_mul(4_294_967);
            let radians = f64::from(angle) / 4_294_967_296.0 * TAU;
            let phase = |lag: f64| (-100_000.0 * (radians - lag).sin()) as i32;
            let [a, b] = [phase(0.0), phase(TAU / 3.0)].map(Current::from_raw);
            let found = park(clarke(a, b), ElectricalAngle::from_raw(angle).into());
            let (d, q) = (found.d.raw(), found.q.raw());
            assert!(d.abs() < 8 && (q - 100_000).abs() < 8, "{angle}: {d} {q}");
        }
    }

    #[test]
    fn inverse_clarke_undoes_clarke() {
        let [a, b] = [40_000, -70_000].map(Current::from_raw);
        let [a, b, c] = inverse_clarke(clarke(a, b)).map(Current::raw);
        assert!((a - 40_000).abs() < 4 && (b + 70_000).abs() < 4 && (c - 30_000).abs() < 4);
    }
}
