//! Numbers that may be several numbers.
//!
//! The dynamics are written once over [`Lane`]. With `f64` they serve one body; with [`Quad`] one robot's four legs go
//! side by side; with [`Double`] and [`Single`] eight or sixteen robots do, on machines of short vectors four with [`Quad`] and
//! [`ShortQuad`]. Every lane sees the same operations in the same order, with no fused multiply-add and no library
//! transcendentals, so that a lane's result is the same bits on every machine and in every company.

use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// One or several numbers of one kind, computed elementwise.
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
    /// Counts the numbers.
    const LANES: usize;
    /// States whether they have the 24 bits of `f32`, not the 53 of `f64`.
    const SHORT: bool;
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
    /// `self - quarters pi/2`, for |quarters| < 1e6 (`f64`) or 100 (`f32`).
    fn less_quarter_turns(self, quarters: Self) -> Self;
}

impl Lane for f64 {
    const LANES: usize = 1;
    const SHORT: bool = false;
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
    fn less_quarter_turns(self, quarters: Self) -> Self {
        self - quarters * HALF_PI[0] - quarters * HALF_PI[1]
    }
}

/// 1.5 * 2^52: the sum with it has no fraction bits left.
const ROUNDER: f64 = 6_755_399_441_055_744.0;
/// The same for `f32`: 1.5 * 2^23.
const SHORT_ROUNDER: f32 = 12_582_912.0;
/// pi/2 in parts, the first so short that its product with a small whole number is exact (Cody and Waite).
const HALF_PI: [f64; 2] = [1.570_796_326_734_125_6, 6.077_100_506_506_192e-11];
/// The same for `f32`.
const SHORT_HALF_PI: [f32; 3] = [1.570_312_5, 4.837_513e-4, 7.549_79e-8];

/// Returns sine and cosine of `angle` in radians, to 2e-16 absolute (`f64`, |angle| < 1e6) or 2e-7 (`f32`, |angle| <
/// 100).
///
/// Quadrant reduction (Cody and Waite) and the minimax polynomials of fdlibm.
#[inline(always)]
pub fn sin_cos<F: Lane>(angle: F) -> (F, F) {
    let c = F::splat;
    let quadrant = (angle * c(core::f64::consts::FRAC_2_PI)).round();
    let x = angle.less_quarter_turns(quadrant);
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

/// Numbers side by side. Every element is written out: thousands of loops would take the compiler minutes.
macro_rules! side_by_side {
    (
        $(#[$doc:meta])* $name:ident: $number:ty, align $align:literal, rounder $rounder:expr,
        half_pi $half_pi:expr, $($i:literal)+
    ) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[repr(align($align))]
        pub struct $name(pub [$number; [$($i),+].len()]);

        impl Add for $name {
            type Output = Self;
            #[inline(always)]
            fn add(self, o: Self) -> Self {
                $name([$(self.0[$i] + o.0[$i]),+])
            }
        }
        impl Sub for $name {
            type Output = Self;
            #[inline(always)]
            fn sub(self, o: Self) -> Self {
                $name([$(self.0[$i] - o.0[$i]),+])
            }
        }
        impl Mul for $name {
            type Output = Self;
            #[inline(always)]
            fn mul(self, o: Self) -> Self {
                $name([$(self.0[$i] * o.0[$i]),+])
            }
        }
        impl Div for $name {
            type Output = Self;
            #[inline(always)]
            fn div(self, o: Self) -> Self {
                $name([$(self.0[$i] / o.0[$i]),+])
            }
        }
        impl Neg for $name {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                $name([$(-self.0[$i]),+])
            }
        }
        impl AddAssign for $name {
            #[inline(always)]
            fn add_assign(&mut self, o: Self) {
                *self = *self + o;
            }
        }
        impl SubAssign for $name {
            #[inline(always)]
            fn sub_assign(&mut self, o: Self) {
                *self = *self - o;
            }
        }

        impl Lane for $name {
            const LANES: usize = [$($i),+].len();
            const SHORT: bool = size_of::<$number>() < size_of::<f64>();
            #[inline(always)]
            fn splat(v: f64) -> Self {
                $name([v as $number; [$($i),+].len()])
            }
            #[inline(always)]
            fn lane(self, lane: usize) -> f64 {
                f64::from(self.0[lane])
            }
            #[inline(always)]
            fn with_lane(mut self, lane: usize, value: f64) -> Self {
                self.0[lane] = value as $number;
                self
            }
            #[inline(always)]
            fn negative_then(self, yes: Self, no: Self) -> Self {
                $name([$(if self.0[$i] < 0.0 { yes.0[$i] } else { no.0[$i] }),+])
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                $name([$(self.0[$i].sqrt()),+])
            }
            #[inline(always)]
            fn round(self) -> Self {
                let rounder = $name([$rounder; [$($i),+].len()]);
                (self + rounder) - rounder
            }
            #[inline(always)]
            fn any_negative(self) -> bool {
                $((self.0[$i] < 0.0))|+
            }
            #[inline(always)]
            fn less_quarter_turns(self, quarters: Self) -> Self {
                let mut rest = self;
                for part in $half_pi {
                    rest -= quarters * $name([part; [$($i),+].len()]);
                }
                rest
            }
        }
    };
}

side_by_side! {
    /// Four `f64`: the legs of a robot, or four robots.
    Quad: f64, align 32, rounder ROUNDER, half_pi HALF_PI, 0 1 2 3
}
side_by_side! {
    /// Four `f32`: four robots.
    ShortQuad: f32, align 16, rounder SHORT_ROUNDER, half_pi SHORT_HALF_PI, 0 1 2 3
}
side_by_side! {
    /// Eight `f64`: eight robots.
    Double: f64, align 64, rounder ROUNDER, half_pi HALF_PI, 0 1 2 3 4 5 6 7
}
side_by_side! {
    /// Sixteen `f32`: sixteen robots.
    Single: f32, align 64, rounder SHORT_ROUNDER, half_pi SHORT_HALF_PI,
    0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15
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
    fn short_sine_and_cosine_agree_with_the_library() {
        let mut worst = 0.0f64;
        for i in -4000..4000 {
            let x = Single([i as f32 * 0.013_7; 16]);
            let (s, c) = sin_cos(x);
            let x = x.lane(3);
            worst = worst.max((s.lane(3) - x.sin()).abs()).max((c.lane(3) - x.cos()).abs());
        }
        assert!(worst < 2e-7, "worst error {worst:e}");
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
