//! What can be read off a sampled signal.

use nalgebra::{SMatrix, SVector};

/// The component of a sampled signal at the shaking frequency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Component {
    /// Share of the cosine of the phase.
    pub cos: f64,
    /// Share of the sine of the phase.
    pub sin: f64,
    /// Root mean square of what else is in the samples.
    pub rest: f64,
}

/// Splits off the component that goes with `phases` (rad, one a sample) from signals that are sampled at `times`, after
/// a constant, a steady motion, a steady acceleration and the second harmonic are taken out. None where the samples do
/// not determine these seven.
#[must_use]
pub fn lock_in(times: &[f64], phases: &[f64], signals: &[Vec<f64>]) -> Option<Vec<Component>> {
    let (first, last) = (times.first()?, times.last()?);
    let spread = (last - first).max(f64::MIN_POSITIVE);
    // Time is centred and scaled for a well-conditioned fit.
    let basis: Vec<SVector<f64, 7>> = times
        .iter()
        .zip(phases)
        .map(|(time, phase)| {
            let t = 2.0 * (time - first) / spread - 1.0;
            let ((sin, cos), (sin2, cos2)) = (phase.sin_cos(), (2.0 * phase).sin_cos());
            SVector::from([1.0, t, t * t, cos, sin, cos2, sin2])
        })
        .collect();
    let mut normal = SMatrix::<f64, 7, 7>::zeros();
    basis.iter().for_each(|row| normal += row * row.transpose());
    let factor = normal.cholesky()?;
    let freedoms = basis.len().checked_sub(7).filter(|free| *free > 0)? as f64;
    let component = |signal: &Vec<f64>| {
        let mut right = SVector::<f64, 7>::zeros();
        basis.iter().zip(signal).for_each(|(row, value)| right += row * *value);
        let fit = factor.solve(&right);
        let square = |(row, value): (&SVector<f64, 7>, &f64)| (value - row.dot(&fit)).powi(2);
        let left: f64 = basis.iter().zip(signal).map(square).sum();
        Component { cos: fit[3], sin: fit[4], rest: (left / freedoms).sqrt() }
    };
    Some(signals.iter().map(component).collect())
}

/// Finds maxima and minima of a signal that rings about zero: time in samples and height, interpolated by a
/// parabola through the three highest samples of each swing.
pub(super) fn extremes(samples: &[f64]) -> Vec<(f64, f64)> {
    samples
        .windows(3)
        .enumerate()
        .filter_map(|(index, w)| {
            let (before, at, after) = (w[0], w[1], w[2]);
            let is_extreme = (at > before && at >= after) || (at < before && at <= after);
            let curvature = before - 2.0 * at + after;
            if !is_extreme || curvature == 0.0 {
                return None;
            }
            let shift = 0.5 * (before - after) / curvature;
            Some(((index + 1) as f64 + shift, at - 0.25 * (before - after) * shift))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_oscillation_is_found_under_a_fall() {
        let samples: Vec<f64> = (0..2000)
            .map(|i| {
                let t = f64::from(i) * 1e-4;
                3.0 - 4.9 * t * t
                    + 0.7 * t
                    + 0.002 * (core::f64::consts::TAU * 30.0 * t + 0.4).sin()
            })
            .collect();
        let times: Vec<f64> = (0..2000).map(|i| f64::from(i) * 1e-4).collect();
        let phases: Vec<f64> = times.iter().map(|t| core::f64::consts::TAU * 30.0 * t).collect();
        let found = lock_in(&times, &phases, &[samples]).unwrap()[0];
        assert!((found.cos.hypot(found.sin) - 0.002).abs() < 1e-7 && found.rest < 1e-9);
    }

    #[test]
    fn extremes_of_a_sine_are_between_samples() {
        let samples: Vec<f64> = (0..700).map(|i| (f64::from(i) * 0.05).sin()).collect();
        let found = extremes(&samples);
        assert!((found[0].0 * 0.05 - core::f64::consts::FRAC_PI_2).abs() < 1e-4);
        assert!((found[0].1 - 1.0).abs() < 1e-6);
    }
}
