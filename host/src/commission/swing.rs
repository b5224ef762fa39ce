//! What a shown ampere is worth, roughly and before anything runs by it: from a rotor that swings to a standing field.
//!
//! Its magnets are found at the electrical angle `e`. Torque and friction are all that speeds it up:
//!
//! ```text
//! J/p e'' = 3/2 p lambda (i_beta cos e - i_alpha sin e) / scale - friction sign e' - cogging
//! ```
//!
//! The amplifiers of another board show another current, a rotor without its mass takes less: a robot that ran by such values
//! would oscillate. Readings of the angle are late by some time that is searched for.

use super::circuit::TICK;
use super::least_squares::solve;
use super::turning_field::{Rotor, unwrapped};

/// Ticks either way over which a mean is taken, twice.
const REACH: usize = 10;
/// A rotor slower than this share of its fastest stands.
const STANDS: f64 = 0.05;
/// Longest delay of readings that is tried, and the steps, ticks.
const LATEST: usize = 30;
const LATER: usize = 2;

/// Share of the square acceleration that may be left over: friction may hold a weak motor more than it is driven.
const MOST_LEFT: f64 = 0.9;

/// A capture of a rotor that swings after a field that jumps.
#[derive(Debug, Clone, PartialEq)]
pub struct Swing {
    /// Currents of phases A and B, A.
    pub currents: [Vec<f64>; 2],
    /// Angle of the rotor, degrees, within half a turn of forward.
    pub angles: Vec<f64>,
}

/// Returns what is shown over what flows, if the rotor has this inertia, kg m^2; `None` where it does not swing.
#[must_use]
pub fn scale(swing: &Swing, rotor: &Rotor, inertia: f64) -> Option<f64> {
    let pairs = rotor.ratio.round();
    let start = swing.angles.first()?;
    let electrical: Vec<f64> = unwrapped(&swing.angles)
        .iter()
        .map(|angle| pairs * (angle + start).to_radians() + rotor.offset)
        .collect();
    let rows = electrical.len().checked_sub(LATEST)?;
    let best = (0..=LATEST)
        .step_by(LATER)
        .filter_map(|late| torque_per_acceleration(swing, &electrical[late..late + rows], rotor))
        .min_by(|one, other| one.1.total_cmp(&other.1))?;
    Some(pairs.abs() * best.0 / inertia).filter(|scale| scale.is_finite())
}

/// Returns the inertia that the shown currents speed up, over the number of pole pairs, and which share of the square
/// acceleration is left over.
fn torque_per_acceleration(swing: &Swing, electrical: &[f64], rotor: &Rotor) -> Option<(f64, f64)> {
    let torque: Vec<f64> = (0..electrical.len())
        .map(|row| {
            let (a, b) = (swing.currents[0][row], swing.currents[1][row]);
            let (alpha, beta) = (a, (a + 2.0 * b) / 3.0_f64.sqrt());
            let (sin, cos) = electrical[row].sin_cos();
            1.5 * rotor.ratio.round().abs() * rotor.flux_linkage * (beta * cos - alpha * sin)
        })
        .collect();
    // All are averaged alike.
    let speed = slope(electrical);
    let acceleration = slope(&speed);
    let (speed, torque) = (mean(&speed), mean(&mean(&torque)));
    let fastest = speed.iter().fold(0.0, |most: f64, it| most.max(it.abs()));
    let moving: Vec<usize> =
        (0..speed.len()).filter(|row| speed[*row].abs() > STANDS * fastest).collect();
    let of = |column: &[f64]| -> Vec<f64> { moving.iter().map(|row| column[*row]).collect() };
    let [torque, speed, acceleration] = [&torque, &speed, &acceleration].map(|it| of(it));
    let friction: Vec<f64> = speed.iter().map(|speed| speed.signum()).collect();
    let found = solve([&torque, &friction, &speed], &acceleration)?;
    let left = (0..moving.len()).map(|row| {
        let fitted = found[0] * torque[row] + found[1] * friction[row] + found[2] * speed[row];
        (acceleration[row] - fitted).powi(2)
    });
    let left = left.sum::<f64>() / acceleration.iter().map(|it| it.powi(2)).sum::<f64>();
    (found[0] > 0.0 && left < MOST_LEFT).then(|| (1.0 / found[0], left))
}

/// Returns how fast a column changes, by the ends of its windows.
fn slope(column: &[f64]) -> Vec<f64> {
    let seconds = 2.0 * REACH as f64 * TICK;
    column.windows(2 * REACH + 1).map(|it| (it[2 * REACH] - it[0]) / seconds).collect()
}

/// Returns the means of a column's windows, between the same ends.
fn mean(column: &[f64]) -> Vec<f64> {
    let ends = |it: &[f64]| (it[0] + it[2 * REACH]) / 2.0;
    column
        .windows(2 * REACH + 1)
        .map(|it| (it.iter().sum::<f64>() - ends(it)) / (2 * REACH) as f64)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const INERTIA: f64 = 2e-6;
    const ROTOR: Rotor = Rotor {
        ratio: -6.96,
        flux_linkage: 2e-3,
        travel: 170.0,
        other_travel: 0.1,
        slip: 2.0,
        offset: 0.4,
    };

    /// A rotor of so much inertia that swings after 0.5 A, of which this share more is shown, against friction (N m).
    fn swing(inertia: f64, shown: f64, friction: f64) -> Swing {
        let pairs = ROTOR.ratio.round();
        let (mut electrical, mut speed) = (0.3_f64, 0.0_f64);
        let mut swing = Swing { currents: Default::default(), angles: Vec::new() };
        let mut late = std::collections::VecDeque::from([(0.3 - ROTOR.offset) / pairs; 12]);
        for tick in 0..2_700 {
            let field = if tick / 600 % 2 == 1 { 2.094 } else { 0.0_f64 };
            late.push_back((electrical - ROTOR.offset) / pairs);
            swing.angles.push(late.pop_front().unwrap().to_degrees());
            for (phase, currents) in swing.currents.iter_mut().enumerate() {
                currents.push(shown * 0.5 * (field - phase as f64 * 2.094).cos());
            }
            for _ in 0..10 {
                let torque =
                    1.5 * pairs.abs() * ROTOR.flux_linkage * 0.5 * (field - electrical).sin();
                let held = friction * speed.clamp(-1.0, 1.0);
                speed += TICK / 10.0 * pairs.abs() / inertia * (torque - held);
                electrical += TICK / 10.0 * speed;
            }
        }
        swing
    }

    #[test]
    fn another_boards_amplifiers_and_a_rotor_without_its_mass_show() {
        for (inertia, shown) in [(1.0, 1.0), (1.0, 2.0), (0.3, 1.0), (1.0, 0.6)] {
            let found = scale(&swing(inertia * INERTIA, shown, 1e-3), &ROTOR, INERTIA).unwrap();
            assert!((found / (inertia * shown) - 1.0).abs() < 0.1, "{inertia} {shown}: {found}");
        }
    }

    #[test]
    fn a_rotor_that_friction_holds_says_nothing() {
        assert_eq!(scale(&swing(INERTIA, 1.0, 1.0), &ROTOR, INERTIA), None);
    }
}
