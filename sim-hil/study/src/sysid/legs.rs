//! Each leg clamped at its root, pulled and twisted at its tip: stiffness in bending and in twisting.
//!
//! A row is one load and where the tip came to rest, measured from its unloaded rest, in axes of the body. A load is a
//! pull or a torque, not both: twist shows under a torque alone.

use std::path::Path;

use super::fit::{Experiment, GAIN, Place, Sensor};
use super::table::{Column, Table};
use super::unknowns::Kind;
use crate::measured::MeasuredError;
use flix_sim::experiment::probe::{ProbeError, bend};
use flix_sim::model::RobotModel;
use flix_sim::plant::Wrench;

/// What the file is made of.
pub const TABLE: Table<13> = Table {
    name: "legs",
    columns: [
        Column::LEG,
        Column::new("fx_n", -50.0, 50.0),
        Column::new("fy_n", -50.0, 50.0),
        Column::new("fz_n", -50.0, 50.0),
        Column::new("tx_n_m", -2.0, 2.0),
        Column::new("ty_n_m", -2.0, 2.0),
        Column::new("tz_n_m", -2.0, 2.0),
        Column::new("x_mm", -50.0, 50.0),
        Column::new("y_mm", -50.0, 50.0),
        Column::new("z_mm", -50.0, 50.0),
        Column::new("rx_deg", -90.0, 90.0),
        Column::new("ry_deg", -90.0, 90.0),
        Column::new("rz_deg", -90.0, 90.0),
    ],
    fewest: 2,
};

/// Loads of the usual test of a leg: pulls along x and y and torques about the beam, N and N m, each both ways.
pub const USUAL: [[f64; 6]; 12] = [
    [2.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [-2.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, 2.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, -2.0, 0.0, 0.0, 0.0, 0.0],
    [4.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [-4.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.1],
    [0.0, 0.0, 0.0, 0.0, 0.0, -0.1],
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.2],
    [0.0, 0.0, 0.0, 0.0, 0.0, -0.2],
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.2],
    [0.0, 0.0, 0.0, 0.0, 0.0, -0.2],
];

/// Bias of force (N), torque (N m), displacement (m) and rotation (rad).
const BIAS: [f64; 4] = [0.02, 0.001, 5e-5, 1.7e-3];
/// Noise of a displacement, m, and of a rotation, rad.
const NOISE: [f64; 2] = [5e-5, 3.5e-3];
/// Step of the simulation that lets a leg come to rest, s.
const STEP: f64 = 5e-4;

/// Bend and torque tests.
#[derive(Debug, Clone)]
pub struct Legs {
    /// Of each test; none of planned ones.
    lines: Vec<u64>,
    /// The leg, and its load, N and N m.
    loads: Vec<(usize, [f64; 6])>,
    measured: Vec<f64>,
}

impl Legs {
    /// Reads the file, if it is there.
    ///
    /// # Errors
    /// When it is refused, or a row has no load or two.
    pub fn read(folder: &Path) -> Result<Option<Self>, MeasuredError> {
        let Some(lines) = TABLE.read_with(folder, &[])? else { return Ok(None) };
        for (line, row) in &lines.rows {
            let pulls = row[1..4].iter().any(|f| *f != 0.0);
            let twists = row[4..7].iter().any(|t| *t != 0.0);
            if pulls == twists {
                return Err(MeasuredError::Place {
                    path: folder.join("legs.csv"),
                    line: *line,
                    column: 2,
                    reason: "a row is a pull (fx_n, fy_n, fz_n) or a torque (tx_n_m, ty_n_m, tz_n_m), the \
                             others 0"
                        .to_owned(),
                });
            }
        }
        let (lines, rows): (_, Vec<_>) = lines.rows.into_iter().unzip();
        Ok(Some(Self { lines, ..Self::new(&rows) }))
    }

    /// Takes rows that stand in no file.
    #[must_use]
    pub fn new(rows: &[Vec<f64>]) -> Self {
        let si = |(i, value): (usize, &f64)| unit(i) * value;
        Self {
            lines: Vec::new(),
            loads: rows
                .iter()
                .map(|row| (row[0] as usize, core::array::from_fn(|i| row[1 + i])))
                .collect(),
            measured: rows
                .iter()
                .flat_map(|row| row[7..].iter().enumerate().map(si).collect::<Vec<_>>())
                .collect(),
        }
    }
}

/// Metres or radians in the unit of a reading's column.
fn unit(reading: usize) -> f64 {
    if reading % 6 < 3 { 1e-3 } else { 1f64.to_radians() }
}

impl Experiment for Legs {
    fn name(&self) -> &'static str {
        TABLE.name
    }

    fn shows(&self, kind: Kind) -> bool {
        kind == Kind::Stiffness
    }

    fn simulate(&self, model: &RobotModel) -> Result<Vec<f64>, ProbeError> {
        // The legs do not feel each other: one load on each is simulated at a time.
        let mut waiting: [Vec<usize>; 4] = Default::default();
        for (row, (leg, _)) in self.loads.iter().enumerate().rev() {
            waiting[*leg].push(row);
        }
        let mut found = vec![0.0; self.measured.len()];
        loop {
            let next: [Option<usize>; 4] = core::array::from_fn(|leg| waiting[leg].pop());
            if next.iter().all(Option::is_none) {
                return Ok(found);
            }
            let wrench = |[fx, fy, fz, tx, ty, tz]: [f64; 6]| Wrench {
                force: [fx, fy, fz],
                torque: [tx, ty, tz],
            };
            let loads =
                next.map(|row| row.map_or_else(Wrench::default, |r| wrench(self.loads[r].1)));
            let bent = bend(model, loads, STEP)?;
            for (row, tip) in next.into_iter().zip(bent) {
                if let Some(row) = row {
                    found[6 * row..6 * row + 3].copy_from_slice(&tip.position);
                    found[6 * row + 3..6 * row + 6].copy_from_slice(&tip.rotation);
                }
            }
        }
    }

    fn sensors(&self) -> Vec<Sensor> {
        let [force, torque, position, rotation] = BIAS;
        let sensor = |name, spread| Sensor { name, spread };
        vec![
            sensor("gain of the force", GAIN),
            sensor("gain of the torque", GAIN),
            sensor("gain of the displacement", GAIN),
            sensor("gain of the rotation", GAIN),
            sensor("bias of the force", force),
            sensor("bias of the torque", torque),
            sensor("bias of the displacement x", position),
            sensor("bias of the displacement y", position),
            sensor("bias of the displacement z", position),
            sensor("bias of the rotation x", rotation),
            sensor("bias of the rotation y", rotation),
            sensor("bias of the rotation z", rotation),
        ]
    }

    fn observe(&self, done: &[f64], sensors: &[f64]) -> Vec<f64> {
        let reading = |(i, moved): (usize, &f64)| {
            let load = self.loads[i / 6].1;
            let size = load.iter().map(|c| c * c).sum::<f64>().sqrt();
            let twists = usize::from(load[3..].iter().any(|c| *c != 0.0));
            // The cell shows more than there is: what moves is less than its reading says.
            let cell = sensors[twists] + sensors[4 + twists] / size;
            let gauge = sensors[2 + usize::from(i % 6 >= 3)];
            moved * (1.0 - cell) * (1.0 + gauge) + sensors[6 + i % 6]
        };
        done.iter().enumerate().map(reading).collect()
    }

    fn measured(&self) -> &[f64] {
        &self.measured
    }

    fn noise(&self) -> Vec<f64> {
        NOISE.to_vec()
    }

    fn kind_of(&self, reading: usize) -> usize {
        usize::from(reading % 6 >= 3)
    }

    fn place(&self, reading: usize) -> Option<Place> {
        let column = TABLE.columns[7 + reading % 6].name;
        Some(Place { line: *self.lines.get(reading / 6)?, column, unit: unit(reading) })
    }
}
