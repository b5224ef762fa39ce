//! Fits of curves: Gauss-Newton with steps that are halved until they help.

use nalgebra::{DMatrix, DVector};

/// Share of a parameter by which it is nudged to see what changes.
const NUDGE: f64 = 1e-5;
/// Most steps.
const MOST_STEPS: usize = 60;
/// Halvings of a step that does not better the fit.
const HALVINGS: usize = 12;
/// A step that betters the sum of squares by less than this share ends the search.
const SETTLED: f64 = 1e-9;

/// Returns the parameters, near `start`, for which the sum of squares of `residuals` is least. None of `start` may be zero:
/// its size is the scale of the parameter.
pub(super) fn fit<const N: usize>(
    start: [f64; N],
    residuals: impl Fn(&[f64; N]) -> Vec<f64>,
) -> [f64; N] {
    let square = |all: &[f64]| all.iter().map(|one| one * one).sum::<f64>();
    let (mut best, mut rest) = (start, residuals(&start));
    for _ in 0..MOST_STEPS {
        let columns: Vec<DVector<f64>> = (0..N)
            .map(|index| {
                let mut nudged = best;
                let step = NUDGE * start[index].abs();
                nudged[index] += step;
                let changed = residuals(&nudged);
                DVector::from_iterator(
                    rest.len(),
                    changed.iter().zip(&rest).map(|(new, old)| (new - old) / NUDGE),
                )
            })
            .collect();
        // The decomposition never ends with anything else.
        if !columns.iter().flatten().chain(&rest).all(|value| value.is_finite()) {
            break;
        }
        let jacobian = DMatrix::from_columns(&columns);
        let target = DVector::from_column_slice(&rest);
        let Ok(step) = jacobian.svd(true, true).solve(&target, 1e-12) else { break };
        let before = square(&rest);
        let mut share = 1.0;
        let bettered = (0..HALVINGS).find_map(|_| {
            let mut tried = best;
            for (index, value) in tried.iter_mut().enumerate() {
                *value -= share * step[index] * start[index].abs();
            }
            share /= 2.0;
            let left = residuals(&tried);
            (square(&left) < before).then_some((tried, left))
        });
        let Some((tried, left)) = bettered else { break };
        let gain = before - square(&left);
        (best, rest) = (tried, left);
        if gain <= SETTLED * before {
            break;
        }
    }
    best
}

/// Returns the coefficients with which `columns` add up to `target` best; `None` where a value is not finite. All must be of one
/// length.
pub(super) fn solve<const N: usize>(columns: [&[f64]; N], target: &[f64]) -> Option<[f64; N]> {
    if !columns.iter().copied().flatten().chain(target).all(|value| value.is_finite()) {
        return None;
    }
    let columns = columns.map(DVector::from_column_slice);
    let matrix = DMatrix::from_columns(&columns);
    // Columns of one size, so that small ones count as well.
    let scales: Vec<f64> = columns.iter().map(|column| column.norm().max(1e-300)).collect();
    let scaled =
        DMatrix::from_fn(matrix.nrows(), N, |row, column| matrix[(row, column)] / scales[column]);
    let solution = scaled.svd(true, true).solve(&DVector::from_column_slice(target), 1e-12).ok()?;
    let mut coefficients = [0.0; N];
    for (index, coefficient) in coefficients.iter_mut().enumerate() {
        *coefficient = solution[index] / scales[index];
    }
    Some(coefficients)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exponential_is_found_from_afar() {
        let times: Vec<f64> = (0..50).map(|tick| f64::from(tick) * 0.1).collect();
        let curve = |[size, rate]: &[f64; 2], time: f64| size * (-rate * time).exp();
        let measured: Vec<f64> = times.iter().map(|time| curve(&[3.0, 2.0], *time)).collect();
        let found = fit([1.0, 0.5], |parameters| {
            times
                .iter()
                .zip(&measured)
                .map(|(time, value)| curve(parameters, *time) - value)
                .collect()
        });
        assert!((found[0] - 3.0).abs() < 1e-6 && (found[1] - 2.0).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn what_is_not_finite_ends_at_once() {
        assert_eq!(solve([&[1.0, f64::NAN]], &[1.0, 2.0]), None);
        assert_eq!(solve([&[1.0, 2.0]], &[f64::INFINITY, 2.0]), None);
        assert_eq!(fit([2.0], |_| vec![f64::NAN; 3]), [2.0]);
    }

    #[test]
    fn coefficients_of_columns_of_any_size_are_found() {
        let small: Vec<f64> = (0..20).map(|row| 1e-9 * f64::from(row)).collect();
        let large = vec![1e6; 20];
        let target: Vec<f64> = small.iter().map(|one| 5e8 * one + 2.0).collect();
        let found = solve([&small, &large], &target).unwrap();
        assert!((found[0] / 5e8 - 1.0).abs() < 1e-9 && (found[1] / 2e-6 - 1.0).abs() < 1e-9);
    }
}
