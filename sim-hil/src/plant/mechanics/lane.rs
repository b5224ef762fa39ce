//! Numbers that may be several numbers.
//!
//! The dynamics are written once over [`Lane`]. With `f64` they serve one body; with [`Quad`] one
//! robot's four legs go side by side, or four robots do. Every lane sees the same operations in the
//! same order, with no fused multiply-add and no library transcendentals, so that a lane's result is the
//! same bits on every machine and in every company.

use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// One or several `f64`, computed elementwise.
pub trait Lane:
    Copy
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
{
    /// How many numbers.
    const LANES: usize;
    /// The same value in every lane.
    fn splat(value: f64) -> Self;
    /// Value of one lane, `lane < LANES`.
    fn lane(self, lane: usize) -> f64;
    /// The same with one lane changed.
    #[must_use]
    fn with_lane(self, lane: usize, value: f64) -> Self;
    /// `yes` where `self < 0`, else `no`.
    fn negative_then(self, yes: Self, no: Self) -> Self;
    /// Square root, of a non-negative value.
    fn sqrt(self) -> Self;
    /// The nearest whole number.
    fn round(self) -> Self;
    /// Magnitude.
    #[inline(always)]
    fn abs(self) -> Self {
        self.negative_then(-self, self)
    }
    /// The larger.
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        (self - other).negative_then(other, self)
    }
    /// The smaller.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        (self - other).negative_then(self, other)
    }
    /// True if any lane is below zero.
    fn any_negative(self) -> bool;
    /// True if every lane is finite.
    fn all_finite(self) -> bool;
}

impl Lane for f64 {
    const LANES: usize = 1;
    #[inline(always)]
    fn splat(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn lane(self, _: usize) -> f64 {
        self
    }
    #[inline(always)]
    fn with_lane(self, _: usize, value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn negative_then(self, yes: Self, no: Self) -> Self {
        if self < 0.0 { yes } else { no }
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline(always)]
    fn round(self) -> Self {
        // To even, like the vector units; adding and taking away 1.5 * 2^52 rounds without a call.
        (self + ROUNDER) - ROUNDER
    }
    #[inline(always)]
    fn any_negative(self) -> bool {
        self < 0.0
    }
    #[inline(always)]
    fn all_finite(self) -> bool {
        self.is_finite()
    }
}

/// 1.5 * 2^52: the sum with it has no fraction bits left.
const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// Returns sine and cosine of `angle` in radians, |angle| < 1e6, to 2e-16 absolute.
///
/// Quadrant reduction in two parts (Cody and Waite) and the minimax polynomials of fdlibm.
#[inline(always)]
pub fn sin_cos<F: Lane>(angle: F) -> (F, F) {
    let c = F::splat;
    let quadrant = (angle * c(core::f64::consts::FRAC_2_PI)).round();
    let x = angle - quadrant * c(1.570_796_326_734_125_6) - quadrant * c(6.077_100_506_506_192e-11);
    let z = x * x;
    let sine = x + x
        * z
        * (c(-1.666_666_666_666_663_2e-1)
            + z * (c(8.333_333_333_322_49e-3)
                + z * (c(-1.984_126_982_985_795e-4)
                    + z * (c(2.755_731_370_707_006_8e-6)
                        + z * (c(-2.505_076_025_340_686_3e-8)
                            + z * c(1.589_690_995_211_55e-10))))));
    let cosine = c(1.0) - c(0.5) * z
        + z * z
            * (c(4.166_666_666_666_66e-2)
                + z * (c(-1.388_888_888_887_411e-3)
                    + z * (c(2.480_158_728_947_673e-5)
                        + z * (c(-2.755_731_435_139_066_3e-7)
                            + z * (c(2.087_572_321_298_175e-9)
                                + z * c(-1.135_964_755_778_819_5e-11))))));
    // quadrant mod 4 in {-2, -1, 0, 1, 2}
    let m = quadrant - c(4.0) * (quadrant * c(0.25)).round();
    let odd = c(0.5) - (m.abs() - c(1.0)).abs(); // positive for +-1
    let s = odd.negative_then(sine, cosine);
    let k = odd.negative_then(cosine, sine);
    // sine changes sign for m = 2, -2, -1; cosine for 1, 2, -2
    let flip_s = (m + c(0.5)).negative_then(c(-1.0), (c(1.5) - m).negative_then(c(-1.0), c(1.0)));
    let flip_c = (c(0.5) - m).negative_then(c(-1.0), (m + c(1.5)).negative_then(c(-1.0), c(1.0)));
    (s * flip_s, k * flip_c)
}

/// Four numbers side by side.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(align(32))]
pub struct Quad(pub [f64; 4]);

macro_rules! elementwise {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for Quad {
            type Output = Quad;
            #[inline(always)]
            fn $method(self, o: Quad) -> Quad {
                let (a, b) = (self.0, o.0);
                Quad([a[0] $op b[0], a[1] $op b[1], a[2] $op b[2], a[3] $op b[3]])
            }
        }
    };
}
elementwise!(Add, add, +);
elementwise!(Sub, sub, -);
elementwise!(Mul, mul, *);
elementwise!(Div, div, /);

impl Neg for Quad {
    type Output = Quad;
    #[inline(always)]
    fn neg(self) -> Quad {
        let a = self.0;
        Quad([-a[0], -a[1], -a[2], -a[3]])
    }
}

impl AddAssign for Quad {
    #[inline(always)]
    fn add_assign(&mut self, o: Quad) {
        *self = *self + o;
    }
}

impl SubAssign for Quad {
    #[inline(always)]
    fn sub_assign(&mut self, o: Quad) {
        *self = *self - o;
    }
}

impl Lane for Quad {
    const LANES: usize = 4;
    #[inline(always)]
    fn splat(v: f64) -> Self {
        Quad([v; 4])
    }
    #[inline(always)]
    fn lane(self, lane: usize) -> f64 {
        self.0[lane]
    }
    #[inline(always)]
    fn with_lane(mut self, lane: usize, value: f64) -> Self {
        self.0[lane] = value;
        self
    }
    #[inline(always)]
    fn negative_then(self, yes: Self, no: Self) -> Self {
        let pick = |i: usize| if self.0[i] < 0.0 { yes.0[i] } else { no.0[i] };
        Quad([pick(0), pick(1), pick(2), pick(3)])
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        let a = self.0;
        Quad([a[0].sqrt(), a[1].sqrt(), a[2].sqrt(), a[3].sqrt()])
    }
    #[inline(always)]
    fn round(self) -> Self {
        let r = Quad::splat(ROUNDER);
        (self + r) - r
    }
    #[inline(always)]
    fn any_negative(self) -> bool {
        (self.0[0] < 0.0) | (self.0[1] < 0.0) | (self.0[2] < 0.0) | (self.0[3] < 0.0)
    }
    #[inline(always)]
    fn all_finite(self) -> bool {
        self.0[0].is_finite()
            & self.0[1].is_finite()
            & self.0[2].is_finite()
            & self.0[3].is_finite()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_agree_with_the_library_over_all_quadrants() {
        let mut worst = 0.0f64;
        for i in -40_000..40_000 {
            let x = f64::from(i) * 0.001_37;
            let (s, c) = sin_cos(x);
            worst = worst.max((s - x.sin()).abs()).max((c - x.cos()).abs());
        }
        assert!(worst < 1e-14, "worst error {worst:e}");
    }

    #[test]
    fn a_lane_computes_the_same_bits_as_a_single_number() {
        let x = Quad([0.3, -2.9, 4.4, 77.7]);
        let (s, c) = sin_cos(x);
        for i in 0..4 {
            assert_eq!((s.lane(i), c.lane(i)), sin_cos(x.lane(i)));
        }
    }
}
