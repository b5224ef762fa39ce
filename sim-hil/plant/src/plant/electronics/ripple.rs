//! The ripple of the phase currents within a PWM period, and where in it they are sampled.
//!
//! Pulses are centred: phase x is at the bus, `U`, for the share `d_x` of the period `T` around the period's beginning. The
//! circuits are solved for the mean voltages of a sub-step; on top of that the currents of a star with inductance `L` swing by
//!
//! ```text
//! i_x(p) = U T / L (g_x(p) - mean of g_a, g_b, g_c),   g_x(p) = integral from 0 to p of (s_x - d_x)
//! ```
//!
//! where `p` is the share of the period that has passed and `s_x` is 1 while the phase is at the bus. Resistance is left out: a
//! period is short against `L / R`. At `p` = 0 and 1/2 the ripple is zero for all duties: there a sample is the mean. A tick of a
//! whole number of periods keeps every sample at its place; otherwise the place moves from tick to tick, from where chance put
//! it at the start.
//!
//! Four currents are converted one after the other, at 1/2 in the middle. None of them is there itself, but the ripple is odd
//! about 1/2: where the order is reversed from tick to tick, what it adds in one tick it takes away in the next, and only
//! the turning of the field in between remains. With the assumed motors at 11.1 V and the duties of 30 Hz, RMS of what the
//! ripple adds to a sample and to the mean of two ticks, which is what the current loops (700 Hz) follow:
//!
//! | PWM | conversions | a sample, mA | mean of two ticks, mA |
//! |---|---|---:|---:|
//! | 20 kHz | tied around 1/2, forwards and backwards | 11.3 | 2.1 |
//! | 20 kHz | tied around 1/2, always forwards | 11.3 | 11.1 |
//! | 25 kHz | not tied, always forwards, mean of all starts | 9.8 | 5.1 |

use flix_firmware::hardware::TICK_RATE_HZ;
use rand::{Rng, RngExt};

/// From one conversion to the next, s: 200,000 a second at most (ESP32 data sheet, ADC characteristics, RTC controller).
const CONVERSION: f64 = 5e-6;
/// Where in the period the middle of all conversions lies when ticks and PWM are tied: all phases are low.
const TIED: f64 = 0.5;

/// When the phase currents are sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sampling {
    /// PWM frequency, Hz.
    frequency: f64,
    /// Share of the PWM period at which the middle of the first tick's conversions lies.
    first: f64,
    /// Whether every other tick converts from the last to the first.
    reverses: bool,
}

impl Sampling {
    /// Creates the sampling of a board with this PWM frequency in Hz: tied, forwards and backwards, when a tick takes a
    /// whole number of periods; otherwise forwards, from wherever chance starts it.
    #[must_use]
    pub fn of(pwm_frequency_hz: u32, random: &mut impl Rng) -> Self {
        let is_tied = pwm_frequency_hz.is_multiple_of(TICK_RATE_HZ);
        let first = if is_tied { TIED } else { random.random() };
        Self { frequency: pwm_frequency_hz.into(), first, reverses: is_tied }
    }

    /// Returns the share of the PWM period at which a tick's conversion is: of phases A and B of the top, then of the
    /// bottom motor: conversions 0 to 3.
    #[must_use]
    pub fn phase(&self, tick: u64, conversion: usize) -> f64 {
        let periods = tick as f64 * self.frequency / f64::from(TICK_RATE_HZ);
        let order = if self.reverses && tick % 2 == 1 { 3 - conversion } else { conversion };
        let after = (order as f64 - 1.5) * CONVERSION * self.frequency;
        (self.first + periods.fract() + after).rem_euclid(1.0)
    }

    /// Returns the PWM period, s.
    #[must_use]
    pub fn period(&self) -> f64 {
        1.0 / self.frequency
    }
}

/// Returns the ripple of phases A, B, C at this share of the PWM period, A. `swing` is bus voltage times PWM period over
/// inductance, A; `duties` are shares of the period.
#[must_use]
pub fn ripple(swing: f64, duties: [f64; 3], phase: f64) -> [f64; 3] {
    let swings = duties.map(|duty| {
        let high = phase.min(duty / 2.0) + (phase - (1.0 - duty / 2.0)).max(0.0);
        swing * (high - phase * duty)
    });
    let common = swings.iter().sum::<f64>() / 3.0;
    swings.map(|swing| swing - common)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use rand::SeedableRng;
    use rand_xoshiro::Xoshiro256PlusPlus;

    use super::*;
    use crate::plant::electronics::motor::ASSUMED_MOTOR;

    /// Duties of a motor at 30 Hz with 11.1 V, centred in their range, at an electrical angle.
    fn duties_at(angle: f64) -> [f64; 3] {
        const AMPLITUDE: f64 = 0.43;
        let waves = [0.0, 1.0, 2.0].map(|phase: f64| libm::cos(angle - phase * TAU / 3.0));
        let most = waves.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let least = waves.into_iter().fold(f64::INFINITY, f64::min);
        waves.map(|wave| 0.5 + AMPLITUDE * (wave - (most + least) / 2.0) * 2.0 / 3.0_f64.sqrt())
    }

    /// RMS of what the ripple adds to a sample and to the mean of two ticks, mA, over many starts.
    fn sampled_rms(samplings: &[Sampling]) -> [f64; 2] {
        const TICKS: u64 = 1_000;
        /// Electrical angle of a tick at 30 Hz with 7 pole pairs.
        const TURN: f64 = TAU * 30.0 * 7.0 / 10_000.0;
        let (mut samples, mut means) = (0.0, 0.0);
        for sampling in samplings {
            let swing = 11.1 * sampling.period() / ASSUMED_MOTOR.inductance;
            let mut before = [0.0; 4];
            for tick in 0..TICKS {
                let duties = duties_at(tick as f64 * TURN);
                for (conversion, before) in before.iter_mut().enumerate() {
                    let phase = sampling.phase(tick, conversion);
                    let current = ripple(swing, duties, phase)[conversion % 2];
                    samples += current.powi(2);
                    means += ((current + *before) / 2.0).powi(2);
                    *before = current;
                }
            }
        }
        let count = (4 * TICKS * samplings.len() as u64) as f64;
        [samples, means].map(|sum| 1e3 * f64::sqrt(sum / count))
    }

    fn samplings(pwm_frequency_hz: u32) -> [Sampling; 40] {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
        std::array::from_fn(|_| Sampling::of(pwm_frequency_hz, &mut random))
    }

    #[test]
    fn sampling_tied_to_the_pwm_leaves_less_than_half_the_ripple() {
        let tied = samplings(20_000);
        let forwards = tied.map(|tied| Sampling { reverses: false, ..tied });
        let table = [&tied, &forwards, &samplings(25_000)].map(|rows| sampled_rms(rows));
        let expected = [[11.3, 2.1], [11.3, 11.1], [9.8, 5.1]];
        for (found, expected) in table.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 0.2, "{table:.2?}");
        }
    }

    /// Duties and places in the period by chance.
    fn samples() -> impl Iterator<Item = ([f64; 3], f64)> {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(2);
        (0..100).map(move |_| (random.random(), random.random()))
    }

    #[test]
    fn the_ripple_is_zero_where_all_phases_are_high_or_low() {
        for (duties, _) in samples() {
            for phase in [0.0, 0.5, 1.0] {
                let currents = ripple(1.0, duties, phase);
                assert!(currents.iter().all(|current| current.abs() < 1e-12), "{duties:?}");
            }
        }
    }

    #[test]
    fn the_ripple_is_that_of_the_switched_circuit() {
        const STEPS: usize = 20_000;
        for (duties, phase) in samples() {
            let mut currents = [0.0; 3];
            for step in 0..(phase * STEPS as f64) as usize {
                let at = (step as f64 + 0.5) / STEPS as f64;
                let is_high = |duty: f64| at < duty / 2.0 || at > 1.0 - duty / 2.0;
                let rise = duties.map(|duty| f64::from(is_high(duty)) - duty);
                let star = rise.iter().sum::<f64>() / 3.0;
                for (current, rise) in currents.iter_mut().zip(rise) {
                    *current += (rise - star) / STEPS as f64;
                }
            }
            for (stepped, exact) in currents.into_iter().zip(ripple(1.0, duties, phase)) {
                assert!((stepped - exact).abs() < 3e-4, "{duties:?} at {phase}: {stepped} {exact}");
            }
        }
    }
}
