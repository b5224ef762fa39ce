//! Natural frequencies, damping ratios and shapes of small motions.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::{ProbeError, require_legs};
use crate::model::RobotModel;
use crate::plant::{Linear, Plant};

/// What is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clamp {
    /// Nothing: the robot floats.
    None,
    /// One leg at its root, in the order of [`crate::model::LEGS`]; its foot is free.
    Leg(usize),
    /// The ends of each foot's long edge.
    Feet,
}

/// One eigenmode of small motions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Eigenmode {
    /// Natural (undamped) frequency, Hz.
    pub frequency_hz: f64,
    /// Share of critical damping; 1 and more does not swing.
    pub damping_ratio: f64,
    /// Undamped shape in the coordinates of [`Eigenmodes::coordinates`], largest entry 1.
    pub shape: Vec<f64>,
}

/// All eigenmodes of a robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Eigenmodes {
    /// Eigenmodes in rising frequency, without the rigid motions.
    #[serde(rename = "modes")]
    pub eigenmodes: Vec<Eigenmode>,
    /// Motions that no spring resists.
    pub rigid_motions: usize,
    /// Names of the coordinates of the shapes.
    pub coordinates: Vec<String>,
}

/// Below this share of the largest pivot a pin holds nothing that others do not hold.
const HELD: f64 = 1e-9;
/// Below this share of the highest eigenvalue a motion has no spring.
const RIGID: f64 = 1e-9;

/// Linearises the model as it stands (legs straight, no contact) and finds its eigenmodes.
///
/// # Errors
/// When the model is refused or has no legs.
pub fn eigenmodes(model: &RobotModel, clamp: Clamp) -> Result<Eigenmodes, ProbeError> {
    require_legs(model)?;
    let linear = Plant::new(model)?.linearise();
    let names = coordinates();
    let basis = allowed(&linear, clamp);
    let reduce = |rows: &[Vec<f64>]| basis.transpose() * matrix(rows) * &basis;
    let (mass, stiffness, damping) =
        (reduce(&linear.mass), reduce(&linear.stiffness), reduce(&linear.damping));
    let singular = || ProbeError::Singular { name: model.name.clone() };

    // M = L L^T; in the coordinates L^T q the problem is symmetric.
    let factor = mass.cholesky().ok_or_else(singular)?.l();
    let inverse = factor.clone().try_inverse().ok_or_else(singular)?;
    let eigen = (&inverse * stiffness * inverse.transpose()).symmetric_eigen();
    let largest = eigen.eigenvalues.max();
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let dissipation = &inverse * damping * inverse.transpose();

    let elastic: Vec<usize> =
        order.iter().copied().filter(|i| eigen.eigenvalues[*i] > RIGID * largest).collect();
    // Damping couples the undamped eigenmodes: the damped ones are eigenvalues of the whole.
    let pairs = damped(&eigen.eigenvalues, &eigen.eigenvectors, &dissipation, &elastic);
    let eigenmodes = elastic
        .iter()
        .zip(pairs)
        .map(|(index, (natural, ratio))| {
            let vector = &basis * (inverse.transpose() * eigen.eigenvectors.column(*index));
            Eigenmode {
                frequency_hz: natural / core::f64::consts::TAU,
                damping_ratio: ratio,
                shape: normalised(&vector),
            }
        })
        .collect();
    Ok(Eigenmodes { eigenmodes, rigid_motions: order.len() - elastic.len(), coordinates: names })
}

/// Natural frequency (rad/s) and damping ratio of each eigenmode, in rising frequency.
fn damped(
    eigenvalues: &DVector<f64>,
    vectors: &DMatrix<f64>,
    damping: &DMatrix<f64>,
    elastic: &[usize],
) -> Vec<(f64, f64)> {
    let n = elastic.len();
    let shapes = DMatrix::from_columns(
        &elastic.iter().map(|i| vectors.column(*i).into_owned()).collect::<Vec<_>>(),
    );
    let modal = shapes.transpose() * damping * &shapes;
    let mut state = DMatrix::zeros(2 * n, 2 * n);
    for i in 0..n {
        state[(i, n + i)] = 1.0;
        state[(n + i, i)] = -eigenvalues[elastic[i]];
        for j in 0..n {
            state[(n + i, n + j)] = -modal[(i, j)];
        }
    }
    let roots = state.complex_eigenvalues();
    let mut pairs: Vec<(f64, f64)> = roots
        .iter()
        .filter(|root| root.im > 0.0)
        .map(|root| (root.norm(), -root.re / root.norm()))
        .collect();
    // Overdamped eigenmodes are two real roots each: the geometric mean is the natural frequency.
    let mut real: Vec<f64> = roots.iter().filter(|root| root.im == 0.0).map(|r| -r.re).collect();
    real.sort_by(f64::total_cmp);
    let half = real.len() / 2;
    for (slow, fast) in real[..half].iter().zip(real[half..].iter().rev()) {
        let natural = (slow * fast).abs().sqrt();
        pairs.push((natural, 0.5 * (slow + fast) / natural));
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    pairs
}

/// A basis of the motions that the clamp allows.
fn allowed(linear: &Linear, clamp: Clamp) -> DMatrix<f64> {
    let n = linear.mass.len();
    let unit = DMatrix::<f64>::identity(n, n);
    match clamp {
        Clamp::None => unit,
        Clamp::Leg(leg) => unit.columns(8 + 6 * leg, 6).into_owned(),
        Clamp::Feet => {
            // Pinned points' velocities = (Q R)^T q: the first columns of Q span what the pins
            // hold, the others, once Q is square, what they leave free.
            let pinned = matrix(&linear.sole_ends).transpose();
            let held = pinned.resize_horizontally(n.max(linear.sole_ends.len()), 0.0).col_piv_qr();
            let pivots = held.r().diagonal();
            let rank = pivots.iter().filter(|pivot| pivot.abs() > HELD * pivots[0].abs()).count();
            held.q().columns(rank, n - rank).into_owned()
        }
    }
}

fn matrix(rows: &[Vec<f64>]) -> DMatrix<f64> {
    let columns = rows.first().map_or(0, Vec::len);
    DMatrix::from_fn(rows.len(), columns, |i, j| rows[i][j])
}

fn normalised(vector: &DVector<f64>) -> Vec<f64> {
    let largest =
        vector.iter().copied().fold(0.0, |m: f64, c| if c.abs() > m.abs() { c } else { m });
    vector.iter().map(|c| c / largest).collect()
}

fn coordinates() -> Vec<String> {
    let body = ["roll", "pitch", "yaw", "x", "y", "z", "top rotor", "bottom rotor"];
    let hinges = ["bend 1", "twist 1", "bend 2", "twist 2", "bend 3", "twist 3"];
    let legs = crate::model::LEGS
        .into_iter()
        .flat_map(|leg| hinges.into_iter().map(move |hinge| format!("{leg} {hinge}")));
    body.into_iter().map(str::to_owned).chain(legs).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_eigenmode_of_a_clamped_leg_is_that_of_the_reference() {
        // The reference's foot lies along the body.
        let mut model = RobotModel::named("A").unwrap();
        if let Some(legs) = &mut model.legs {
            legs.foot.axis = crate::model::FootAxis::Along;
        }
        let first = &eigenmodes(&model, Clamp::Leg(0)).unwrap().eigenmodes[0];
        assert!((first.frequency_hz / 43.0 - 1.0).abs() < 0.01, "{first:?}");
        assert!((first.damping_ratio / 0.305 - 1.0).abs() < 0.03, "{first:?}");
    }

    #[test]
    fn a_floating_robot_has_six_rigid_motions_and_two_free_rotors() {
        let model = RobotModel::named("A").unwrap();
        let all = eigenmodes(&model, Clamp::None).unwrap();
        assert_eq!((all.rigid_motions, all.eigenmodes.len()), (8, 24));
    }

    #[test]
    fn pinned_feet_leave_no_rigid_motion_but_the_rotors() {
        // 24 velocities are held, but the ends of an edge keep their distance by themselves (4), and
        // four straight legs hold heave, roll and pitch of one plate (1): 32 - 19 are left.
        for name in ["A", "W"] {
            let all = eigenmodes(&RobotModel::named(name).unwrap(), Clamp::Feet).unwrap();
            assert_eq!((all.rigid_motions, all.eigenmodes.len()), (2, 11), "{name}");
        }
    }
}
