//! What can be read off a sampled signal.

/// Returns the amplitude of the component of `samples` (at `interval` seconds, over whole periods) at `frequency` Hz,
/// after a constant, a steady motion and a steady acceleration are taken out.
pub(super) fn amplitude_at(samples: &[f64], interval: f64, frequency: f64) -> f64 {
    // Least squares on 1, t, t^2, cos, sin; time is centred and scaled for a well-conditioned fit.
    let count = samples.len();
    let omega = core::f64::consts::TAU * frequency * interval;
    let row = |index: usize| {
        let t = 2.0 * index as f64 / count as f64 - 1.0;
        let phase = omega * index as f64;
        [1.0, t, t * t, phase.cos(), phase.sin()]
    };
    let mut normal = nalgebra::SMatrix::<f64, 5, 5>::zeros();
    let mut right = nalgebra::SVector::<f64, 5>::zeros();
    for (index, sample) in samples.iter().enumerate() {
        let basis = nalgebra::SVector::<f64, 5>::from(row(index));
        normal += basis * basis.transpose();
        right += basis * *sample;
    }
    normal.cholesky().map_or(0.0, |factor| {
        let fit = factor.solve(&right);
        fit[3].hypot(fit[4])
    })
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
        assert!((amplitude_at(&samples, 1e-4, 30.0) - 0.002).abs() < 1e-7);
    }

    #[test]
    fn extremes_of_a_sine_are_between_samples() {
        let samples: Vec<f64> = (0..700).map(|i| (f64::from(i) * 0.05).sin()).collect();
        let found = extremes(&samples);
        assert!((found[0].0 * 0.05 - core::f64::consts::FRAC_PI_2).abs() < 1e-4);
        assert!((found[0].1 - 1.0).abs() < 1e-6);
    }
}
