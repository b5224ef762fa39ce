//! What the shaker does to the body that it is bolted to (paper, figures 3d and 3e): force and torque over one
//! turn, the body held.
//!
//! One cell is one moment: f, theta and the phase of the turn. Directions are counted like theta, from forward,
//! positive to the right, -180 to 180 degrees; both magnitudes are those in the plane. The torque is about the
//! shaker's middle and includes the rotors' weight (equation 7).

use serde_json::json;

use flix_sim::model::{Base, RobotModel};
use flix_sim::plant::{Drive, Mechanics, Plant};
use flix_sim::study::{Column, Row, Study};

/// Frequencies of figure 3d, Hz: every one up to the highest.
const HIGHEST: usize = 35;
/// Pairs of figure 3e: Hz, degrees.
pub const CYCLES: [(f64, f64); 6] =
    [(10.0, -45.0), (10.0, 0.0), (10.0, 45.0), (-10.0, -45.0), (-10.0, 0.0), (-10.0, 45.0)];
/// Moments of a turn.
const PHASES: usize = 72;

/// The shaker of a robot.
#[derive(Debug, Clone)]
pub struct Actuation {
    model: RobotModel,
}

impl Actuation {
    /// Creates the shaker of this robot, its body held.
    #[must_use]
    pub fn new(model: &RobotModel) -> Self {
        Self { model: RobotModel { base: Base::Fixed {}, legs: None, ..model.clone() } }
    }

    fn pairs() -> Vec<(f64, f64)> {
        let frequencies = (1..=HIGHEST).map(|f| (f as f64, 0.0)).filter(|p| !CYCLES.contains(p));
        frequencies.chain(CYCLES).collect()
    }

    /// Returns f in Hz, theta in degrees and the phase, 0 to 1, of a cell.
    fn cell(cell: usize) -> (f64, f64, f64) {
        let (f, theta) = Self::pairs()[cell / PHASES];
        (f, theta, (cell % PHASES) as f64 / PHASES as f64)
    }

    fn moment(&self, cell: usize) -> Result<Row, String> {
        let (f, theta, phase) = Self::cell(cell);
        let step = 1.0 / (PHASES as f64 * f.abs());
        let mut plant = Plant::new(&self.model).map_err(|error| error.to_string())?;
        // Wrenches are those of the middle of a step: begin half a step early, where the rotors stand.
        let lead = core::f64::consts::TAU * (phase - 0.5 / PHASES as f64);
        plant.set_drive(Drive::Ideal { frequency_hz: f, theta_rad: theta.to_radians() });
        plant.advance_phase(f.signum() * lead);
        plant.step([0.0; 2], step).map_err(|error| error.to_string())?;
        let wrench = plant.shaker_wrench();
        let plane = |v: [f64; 3]| (v[0].hypot(v[1]), (-v[1]).atan2(v[0]).to_degrees());
        let ((force, heading), (torque, axis)) = (plane(wrench.force), plane(wrench.torque));
        Ok([force, heading, torque, axis].map(Into::into).to_vec())
    }
}

impl Study for Actuation {
    fn name(&self) -> &'static str {
        "actuation"
    }

    fn label(&self) -> String {
        self.model.name.clone()
    }

    fn parameters(&self) -> serde_json::Value {
        json!({ "model": self.model })
    }

    fn columns(&self) -> Vec<Column> {
        [
            "f_hz",
            "theta_deg",
            "phase_deg",
            "force_n",
            "force_direction_deg",
            "torque_nm",
            "torque_direction_deg",
        ]
        .map(Column::number)
        .to_vec()
    }

    fn cells(&self) -> usize {
        Self::pairs().len() * PHASES
    }

    fn batch(&self) -> usize {
        PHASES
    }

    fn asked(&self, cell: usize) -> Row {
        let (f, theta, phase) = Self::cell(cell);
        [f, theta, 360.0 * phase].map(Into::into).to_vec()
    }

    fn compute(&self, cells: &[usize]) -> Vec<Result<Row, String>> {
        cells.iter().map(|cell| self.moment(*cell)).collect()
    }
}

#[cfg(test)]
mod tests {
    use core::f64::consts::TAU;

    use super::*;

    /// Rows of one pair: phase, force, its direction, torque, its direction.
    fn turn(f: f64, theta: f64) -> Vec<[f64; 5]> {
        let study = Actuation::new(&RobotModel::named("W").unwrap());
        let cells: Vec<usize> = (0..study.cells()).collect();
        let rows = cells.iter().zip(study.compute(&cells)).map(|(cell, row)| {
            let row = [study.asked(*cell), row.unwrap()].concat();
            let n: Vec<f64> = row.iter().filter_map(flix_sim::study::Value::number).collect();
            ([n[0], n[1]], [n[2], n[3], n[4], n[5], n[6]])
        });
        rows.filter(|(pair, _)| *pair == [f, theta]).map(|(_, row)| row).collect()
    }

    #[test]
    fn force_and_torque_follow_equations_6_and_7() {
        let (m, l, h, g) = (0.012, 0.028, 0.028, 9.81);
        let omega = TAU * 10.0;
        for [phase, force, _, torque, _] in turn(10.0, 45.0) {
            let (sin, cos) = phase.to_radians().sin_cos();
            let expected = 2.0 * m * omega * omega * l * cos;
            assert!((force - expected.abs()).abs() < 1e-3 * 2.65, "{phase}: {force}");
            let expected = (h * m * omega * omega * l * sin).hypot(2.0 * m * g * l * cos);
            assert!((torque - expected).abs() < 1e-3 * 0.037, "{phase}: {torque} {expected}");
        }
    }

    #[test]
    fn force_points_along_theta_or_against_it() {
        for theta in [-45.0, 0.0, 45.0] {
            for [phase, force, direction, ..] in turn(-10.0, theta) {
                let off = (direction - theta).rem_euclid(180.0);
                assert!(force < 1e-6 || off.min(180.0 - off) < 0.01, "{phase}: {direction}");
            }
        }
    }
}
