//! How far the loops are from oscillating, worked out from what they are: gains, lags and delays.
//!
//! A loop is broken where its torque becomes a motion and looked at as a frequency response `L`, in ticks: `s = j phi`, with
//! `phi` radians a tick. The *margin* is the least distance of `L` from -1, over all frequencies: the largest factor by which
//! the closed loop amplifies a disturbance is one over it. It is negative where `L` passes -1 on the wrong side, and the
//! loop oscillates by itself (Nyquist's criterion).
//!
//! ```text
//! position loop    L = C zoh T / (s^2 + b R s (1 - H D_c) / Z)
//!   tracker        e = D theta / (1 - d z v + z a + z v),  v = K_v / (1 - z),  a = (K_a + v z) / (1 - z),  z = exp(-s)
//!   D              delay of a reading: latency of the encoder and age of the reading
//!   C              (kp a + kd v + ki a / s) e: the law of the shaker on what the tracker says
//!   H              speed that the tracker says over the true one: v e / s
//!   zoh            one update lasts for a stride of ticks
//!   T              current over its reference: (PI + R) D_c / Z, Z = R + s L + PI D_c; in voltage mode, where the model is
//!                  what PI sees, at once and without an integral, (P + R) D_c / (R + s L + P), and Z = R + s L
//!   b              3/2 p^2 flux^2 / (R J): how fast a shorted motor brakes
//! current loop     L = PI D_c / (R + s L)
//! ```
//!
//! Motors are taken to be as their settings say, and encoders for the slowest that there is. Twice theta and twice the phase
//! have one law, and each motor is half of either, so that one loop a motor stands for all.

use core::f32::consts::{FRAC_PI_2, PI, TAU};
use core::ops::{Add, Div, Mul, Sub};

use flix_protocol::message::Refusal;

use crate::board::EncoderKind;
use crate::fast::configuration::{braking, position_loop, regulator, tracker};
use crate::fast::foc::current::{Model, PROPORTIONAL_BITS};
use crate::fast::reference::STRIDE;
use crate::fast::shaker::{INTEGRAL_BITS, ShakerModel};
use crate::fast::tracker::{ANGLE_GAIN_BITS, EncoderModel};
use crate::settings::Settings;
use crate::units::TICK_US;

/// Least margin with which the robot arms. The plant's gain varies by some 6 % as its base yields, and motors by a few
/// per cent as they warm up; a disturbance is amplified tenfold at the most.
pub const LEAST_MARGIN: f32 = 0.1;

/// Each frequency that is looked at is so much above the one before.
const STEP: f32 = 1.03;
/// The lowest, over the natural frequency of the position loop: below it the integral alone counts.
const LOWEST: f32 = 0.05;
/// Beyond the crossover of a loop as weak as this nothing comes near -1 any more.
const WEAK: f32 = 0.3;
/// Age of a reading of the slowest encoder as its driver states it, ticks: half a reading over its bus, and the wait for
/// the tick, are 57 us.
const READING_AGE: f32 = (EncoderKind::As5600.delay_us() as f32 + 57.0) / TICK_US as f32;
/// A reading comes in every second tick: on average it is half a tick older than it says.
const READING_WAIT: f32 = 0.5;
/// The middle of the interval in which a tick's duties act is no nearer to its samples than this, ticks.
const LEAST_ACTUATION: f32 = 0.5;
/// Steps of bandwidth that are tried for what to set instead, Hz.
const ADVICE_STEP: f32 = 1.0;

/// Margins of the two kinds of loops, each of the motor that has the lesser.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margins {
    /// Of the loops that hold f and theta.
    pub position: f32,
    /// Of the current loops; `None` in voltage mode, which has none.
    pub current: Option<f32>,
}

impl Margins {
    /// Works out both. Never panics.
    #[must_use]
    pub fn of(settings: &Settings, measures_current: bool) -> Self {
        let [top, bottom] = [0, 1].map(|motor| Loop::new(settings, measures_current, motor));
        let current = measures_current.then(|| top.current_margin().min(bottom.current_margin()));
        Self { position: top.position_margin().min(bottom.position_margin()), current }
    }
}

/// Refuses settings whose loops oscillate or nearly do.
///
/// # Errors
/// When a margin is below [`LEAST_MARGIN`]: with the settings that make it, and what to set instead.
pub fn judge(settings: &Settings, measures_current: bool) -> Result<(), Refusal> {
    let margins = Margins::of(settings, measures_current);
    if let Some(margin) = margins.current.filter(|margin| *margin < LEAST_MARGIN) {
        return Err(Refusal::UnstableCurrent {
            margin,
            least: LEAST_MARGIN,
            current_bandwidth: settings.current_bandwidth,
            actuation_delay: settings.actuation_delay,
        });
    }
    if margins.position >= LEAST_MARGIN {
        return Ok(());
    }
    Err(Refusal::UnstablePosition {
        margin: margins.position,
        least: LEAST_MARGIN,
        position_bandwidth: settings.position_bandwidth,
        tracker_bandwidth: settings.tracker_bandwidth,
        encoder_latency: settings.encoder_latency,
        current_bandwidth: settings.current_bandwidth,
        position_bandwidth_instead: slower(settings, measures_current),
    })
}

/// Returns the largest position bandwidth, in whole steps, that has margin enough with the other settings; 0 when none has.
fn slower(settings: &Settings, measures_current: bool) -> f32 {
    let holds = |bandwidth: f32| {
        let slower = Settings { position_bandwidth: bandwidth, ..*settings };
        Margins::of(&slower, measures_current).position >= LEAST_MARGIN
    };
    let (mut least, mut most) = (0, (settings.position_bandwidth / ADVICE_STEP) as i32);
    // The slower, the more margin: halve what is between.
    while least < most {
        let middle = (least + most + 1) / 2;
        if holds(middle as f32 * ADVICE_STEP) {
            least = middle;
        } else {
            most = middle - 1;
        }
    }
    least as f32 * ADVICE_STEP
}

/// One motor and what holds it: gains as the fixed point has them, in ticks.
struct Loop {
    /// Natural frequency of the position loop.
    natural: f32,
    /// Gains of the shaker: of the angle, of the speed, and of the sum of angles.
    position: [f32; 3],
    /// Gains of the tracker: of the angle and of the speed.
    tracker: [f32; 2],
    /// By how much it brings a reading forward.
    forward: f32,
    /// Gains of the current loop: of the current, and of its sum, which is zero in voltage mode.
    regulator: [f32; 2],
    measures_current: bool,
    resistance: f32,
    /// Inductance, V a tick per A.
    inductance: f32,
    /// From the samples of a tick to the middle of the interval in which its duties act.
    actuation: f32,
    /// How fast the shorted motor brakes.
    braking: f32,
}

impl Loop {
    fn new(settings: &Settings, measures_current: bool, motor: usize) -> Self {
        let per = |value: i32, bits: u32| value as f32 * two_to(-(bits as i32));
        let ShakerModel { proportional, derivative, integral, .. } = position_loop(settings);
        let EncoderModel { angle_gain, speed_gain, latency_us, .. } = tracker(settings, motor);
        let Model { proportional: current, integral: sum, resistance, .. } =
            regulator(settings, motor);
        let regulator = [per(current, PROPORTIONAL_BITS), per(sum, 24)];
        let kp = per(proportional, 40);
        Self {
            natural: root(kp),
            position: [kp, per(derivative, 32), per(integral, INTEGRAL_BITS)],
            tracker: [per(angle_gain, ANGLE_GAIN_BITS), per(speed_gain, 32)],
            forward: latency_us as f32 / TICK_US as f32 + READING_AGE,
            regulator: if measures_current { regulator } else { [regulator[0], 0.0] },
            measures_current,
            resistance: per(resistance, 24),
            inductance: settings.phase_inductance[motor % 2] * 1e-3 * 1e6 / TICK_US as f32,
            actuation: (settings.actuation_delay / TICK_US as f32).max(LEAST_ACTUATION),
            braking: braking(settings, motor),
        }
    }

    /// Returns the margin of the position loop. Its integral has it come from behind -1, above the axis.
    fn position_margin(&self) -> f32 {
        margin(LOWEST * self.natural, PI / STRIDE as f32, 1, |phi| self.position_response(phi))
    }

    /// Returns the margin of the current loop, which comes from below.
    fn current_margin(&self) -> f32 {
        margin(LOWEST * self.regulator[0] / self.inductance, PI, 0, |phi| {
            self.pi(phi) * delay(phi * self.actuation) / self.winding(phi)
        })
    }

    /// Returns what the current loop adds to the voltage for an error of the current.
    fn pi(&self, phi: f32) -> Complex {
        let [proportional, integral] = self.regulator;
        Complex { re: proportional, im: -integral / phi }
    }

    fn winding(&self, phi: f32) -> Complex {
        Complex { re: self.resistance, im: phi * self.inductance }
    }

    fn position_response(&self, phi: f32) -> Complex {
        let s = Complex { re: 0.0, im: phi };
        let [speed, angle] = self.tracked(phi);
        let acts = delay(phi * self.actuation);
        let (regulated, winding) = (self.pi(phi), self.winding(phi));
        // What shows in the current is regulated away, later; what the model says is there at once.
        let impedance = if self.measures_current { winding + regulated * acts } else { winding };
        let follows = if self.measures_current { impedance } else { winding + regulated };
        let current = (regulated + Complex::ONE * self.resistance) * acts / follows;
        let [kp, kd, ki] = self.position;
        let law = angle * kp + speed * kd + angle * ki / s;
        let stride = STRIDE as f32;
        let hold = delay(phi * stride / 2.0) * (sine(phi * stride / 2.0) / (phi * stride / 2.0));
        let lag = Complex::ONE - speed / s * acts;
        let braked = s * lag / impedance * (self.braking * self.resistance);
        law * hold * current / (s * s + braked)
    }

    /// Returns speed and angle as the tracker has them, over the true angle.
    fn tracked(&self, phi: f32) -> [Complex; 2] {
        let before = delay(phi);
        // 1 - exp(-j phi), without a difference of nearly equal numbers.
        let half = sine(phi / 2.0);
        let change = Complex { re: 2.0 * half * half, im: sine(phi) };
        let [angle_gain, speed_gain] = self.tracker;
        let speed = Complex::ONE * speed_gain / change;
        let angle = (Complex::ONE * angle_gain + speed * before) / change;
        let own = Complex::ONE - speed * before * self.forward + angle * before + speed * before;
        let error = delay(phi * (self.forward + READING_WAIT)) / own;
        [speed * error, angle * error]
    }
}

/// Returns the least distance of a frequency response from -1, negative where it passes the real axis beyond -1 downwards
/// more or less often, net, than it must for a stable loop.
fn margin(lowest: f32, highest: f32, passes: i32, mut response: impl FnMut(f32) -> Complex) -> f32 {
    let (mut phi, mut least, mut passed) = (lowest, f32::INFINITY, 0);
    let mut last: Option<Complex> = None;
    while phi < highest {
        let here = response(phi);
        if let Some(last) = last {
            passed += passing(last, here);
            least = least.min(distance_squared(last, here));
        }
        let is_weak = here.square() < WEAK * WEAK;
        last = Some(here);
        if is_weak {
            break;
        }
        phi *= STEP;
    }
    let distance = root(least);
    if passed == passes { distance } else { -distance }
}

/// Returns 1 when the way from one value to the next passes the real axis beyond -1 downwards, -1 upwards, 0 else.
fn passing(from: Complex, to: Complex) -> i32 {
    if (from.im > 0.0) == (to.im > 0.0) {
        return 0;
    }
    let real = from.re + (to.re - from.re) * from.im / (from.im - to.im);
    match (real < -1.0, from.im > 0.0) {
        (false, _) => 0,
        (true, true) => 1,
        (true, false) => -1,
    }
}

/// Returns the square of the distance of -1 from the way between two values.
fn distance_squared(from: Complex, to: Complex) -> f32 {
    let way = to - from;
    let back = Complex { re: -1.0, im: 0.0 } - from;
    let length = way.square();
    let along = way.re * back.re + way.im * back.im;
    let share = if length > 0.0 { (along / length).clamp(0.0, 1.0) } else { 0.0 };
    (back - way * share).square()
}

/// Returns `exp(-j phi)`.
fn delay(phi: f32) -> Complex {
    Complex { re: sine(phi + FRAC_PI_2), im: -sine(phi) }
}

/// Returns the sine of an angle in rad, right to 1e-5, relatively so for small ones. `core` has none.
fn sine(angle: f32) -> f32 {
    let turns = angle / TAU;
    let whole = (turns + if turns < 0.0 { -0.5 } else { 0.5 }) as i32;
    let within = angle - whole as f32 * TAU;
    let x = if within > FRAC_PI_2 {
        PI - within
    } else if within < -FRAC_PI_2 {
        -PI - within
    } else {
        within
    };
    let square = x * x;
    // Its series.
    x * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0))))
}

/// Returns the square root of a number that is not negative, by Newton's method. `core` has none.
fn root(square: f32) -> f32 {
    if !(square > 0.0 && square.is_finite()) {
        return 0.0;
    }
    // Half of the exponent is near enough to begin with.
    let mut root = f32::from_bits((square.to_bits() >> 1) + 0x1FC0_0000);
    for _ in 0..3 {
        root = (root + square / root) / 2.0;
    }
    root
}

/// Returns two to this power, from -126 to 127.
const fn two_to(power: i32) -> f32 {
    f32::from_bits(((127 + power) as u32) << 23)
}

/// A complex number.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Complex {
    re: f32,
    im: f32,
}

impl Complex {
    const ONE: Self = Self { re: 1.0, im: 0.0 };

    const fn square(self) -> f32 {
        self.re * self.re + self.im * self.im
    }
}

impl Add for Complex {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { re: self.re + other.re, im: self.im + other.im }
    }
}

impl Sub for Complex {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self { re: self.re - other.re, im: self.im - other.im }
    }
}

impl Mul for Complex {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self {
            re: self.re * other.re - self.im * other.im,
            im: self.re * other.im + self.im * other.re,
        }
    }
}

impl Mul<f32> for Complex {
    type Output = Self;
    fn mul(self, factor: f32) -> Self {
        Self { re: self.re * factor, im: self.im * factor }
    }
}

impl Div for Complex {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let conjugate = Self { re: other.re, im: -other.im };
        self * conjugate * (1.0 / other.square())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn margins(change: impl FnOnce(&mut Settings)) -> Margins {
        let mut settings = Settings::DEFAULT;
        change(&mut settings);
        Margins::of(&settings, true)
    }

    fn position(position_bandwidth: f32, tracker_bandwidth: f32) -> f32 {
        margins(|it| {
            it.position_bandwidth = position_bandwidth;
            it.tracker_bandwidth = tracker_bandwidth;
        })
        .position
    }

    #[test]
    fn loops_that_held_a_rotor_still_have_margin_and_those_that_cooked_a_motor_have_none() {
        for (position_hz, tracker_hz) in [(20.0, 80.0), (20.0, 125.0), (20.0, 300.0), (35.0, 125.0)]
        {
            let margin = position(position_hz, tracker_hz);
            assert!(margin >= LEAST_MARGIN, "{position_hz} {tracker_hz}: {margin}");
        }
        for (position_hz, tracker_hz) in [(20.0, 40.0), (45.0, 125.0), (50.0, 125.0)] {
            let margin = position(position_hz, tracker_hz);
            assert!(margin < 0.0, "{position_hz} {tracker_hz}: {margin}");
        }
    }

    #[test]
    fn the_margin_falls_with_the_position_bandwidth_and_with_every_delay() {
        for position_hz in 2..60 {
            let (slower, quicker) = (position_hz as f32, position_hz as f32 + 1.0);
            assert!(position(slower, 125.0) > position(quicker, 125.0), "{position_hz}");
        }
        let with = |latency: f32, bandwidth: f32| {
            margins(|it| {
                it.encoder_latency = latency;
                it.current_bandwidth = bandwidth;
            })
            .position
        };
        assert!(with(0.0, 700.0) > with(1_000.0, 700.0));
        assert!(with(1_000.0, 700.0) > with(3_000.0, 700.0));
        assert!(with(0.0, 700.0) > with(0.0, 100.0));
    }

    #[test]
    fn current_loops_are_judged_with_the_delay_of_the_bridges_and_not_in_voltage_mode() {
        let slow = |it: &mut Settings| {
            it.current_bandwidth = 1_500.0;
            it.actuation_delay = 400.0;
        };
        assert!(margins(|_| {}).current.is_some_and(|margin| margin > 0.5));
        assert!(margins(slow).current.is_some_and(|margin| margin < 0.0));
        let mut settings = Settings::DEFAULT;
        slow(&mut settings);
        assert!(matches!(judge(&settings, true), Err(Refusal::UnstableCurrent { .. })));
        assert_eq!(Margins::of(&settings, false).current, None);
    }

    #[test]
    fn a_refusal_names_the_partners_and_a_bandwidth_that_is_accepted() {
        let settings =
            Settings { position_bandwidth: 50.0, tracker_bandwidth: 110.0, ..Settings::DEFAULT };
        let refusal = judge(&settings, true).unwrap_err();
        let sentence = std::string::ToString::to_string(&refusal);
        for name in ["position_bandwidth 50 Hz", "tracker_bandwidth 110 Hz", "encoder_latency 0 us"]
        {
            assert!(sentence.contains(name), "{sentence}");
        }
        let Refusal::UnstablePosition { position_bandwidth_instead: instead, .. } = refusal else {
            panic!("{refusal:?}")
        };
        let with = |position_bandwidth: f32| Settings { position_bandwidth, ..settings };
        assert_eq!(judge(&with(instead), true), Ok(()));
        assert!(judge(&with(instead + 1.0), true).is_err());
    }

    #[test]
    fn every_setting_has_a_margin_and_none_panics() {
        let mut settings = Settings::DEFAULT;
        for ends in 0..1_u32 << 10 {
            let names = [
                "position_bandwidth",
                "tracker_bandwidth",
                "current_bandwidth",
                "encoder_latency",
                "actuation_delay",
                "top_phase_resistance",
                "top_phase_inductance",
                "top_flux_linkage",
                "pole_pairs",
                "rotor_inertia",
            ];
            for (bit, name) in names.into_iter().enumerate() {
                let setting = crate::settings::TABLE.iter().find(|it| it.name == name).unwrap();
                let value = if ends >> bit & 1 == 0 { setting.minimum } else { setting.maximum };
                settings.set(name, value).unwrap();
            }
            for measures_current in [false, true] {
                let Margins { position, current } = Margins::of(&settings, measures_current);
                assert!(position.is_finite(), "{settings:?}");
                assert!(current.is_none_or(f32::is_finite), "{settings:?}");
            }
        }
    }

    #[test]
    fn sines_and_roots_are_right() {
        for step in -2_000..2_000_i16 {
            let angle = f32::from(step) * 0.02;
            let wrong = (sine(angle) - angle.sin()).abs();
            assert!(wrong < 2e-5, "{angle}: {wrong}");
        }
        assert!((sine(1e-4) - 1e-4).abs() < 1e-9);
        for power in -20..20 {
            let square = 1.7 * two_to(power);
            assert!((root(square) * root(square) / square - 1.0).abs() < 1e-5, "{square}");
        }
    }
}
