//! The robot on four scales, level and tilted: its mass and its centre of mass.
//!
//! Each foot stands with the middle of its sole on a point of its own scale; the four scales lie in one plane, which is
//! tilted by `pitch` (nose down positive) and then `roll` (left side up positive). The rotors point forward. A scale
//! reads the force across that plane. How far the legs give way under the weight is part of the moments. How the load
//! divides between the two diagonals is a matter of tenths of a millimetre and no property of the robot: each weighing has
//! an unknown of its own for it.

use nalgebra::{DMatrix, DVector, Rotation3, Vector3};

use super::fit::{Experiment, GAIN, Place, Sensor};
use super::table::{Column, Table};
use super::unknowns::Kind;
use flix_sim::experiment::probe::ProbeError;
use flix_sim::model::{GRAVITY, RobotModel};
use flix_sim::plant::Plant;

/// What the file is made of.
pub const TABLE: Table<6> = Table {
    name: "scales",
    columns: [
        Column::new("roll_deg", -45.0, 45.0),
        Column::new("pitch_deg", -45.0, 45.0),
        Column::new("fl_g", -50.0, 2000.0),
        Column::new("fr_g", -50.0, 2000.0),
        Column::new("rl_g", -50.0, 2000.0),
        Column::new("rr_g", -50.0, 2000.0),
    ],
    fewest: 3,
};

/// Roll and pitch of the usual weighings, degrees, each twice.
pub const USUAL: [[f64; 2]; 10] = [
    [0.0, 0.0],
    [15.0, 0.0],
    [-15.0, 0.0],
    [0.0, 15.0],
    [0.0, -15.0],
    [0.0, 0.0],
    [15.0, 0.0],
    [-15.0, 0.0],
    [0.0, 15.0],
    [0.0, -15.0],
];

/// Bias of a scale, g.
const BIAS: f64 = 0.3;
/// Noise of a reading, g.
const NOISE: f64 = 0.2;
/// What the diagonals may take from each other, g.
const WARP: f64 = 15.0;

/// Weighings.
#[derive(Debug, Clone)]
pub struct Scales {
    /// Of each weighing; none of planned ones.
    lines: Vec<u64>,
    tilts: Vec<[f64; 2]>,
    measured: Vec<f64>,
}

impl Scales {
    /// Takes the rows of a file.
    #[must_use]
    pub fn read(rows: &[(u64, [f64; 6])]) -> Self {
        let (lines, rows): (_, Vec<_>) = rows.iter().copied().unzip();
        Self { lines, ..Self::new(&rows) }
    }

    /// Takes rows that stand in no file.
    #[must_use]
    pub fn new(rows: &[[f64; 6]]) -> Self {
        Self {
            lines: Vec::new(),
            tilts: rows.iter().map(|row| [row[0], row[1]]).collect(),
            measured: rows.iter().flat_map(|row| row[2..].to_vec()).collect(),
        }
    }
}

impl Experiment for Scales {
    fn name(&self) -> &'static str {
        TABLE.name
    }

    fn shows(&self, kind: Kind) -> bool {
        matches!(kind, Kind::Mass | Kind::Stiffness)
    }

    fn simulate(&self, model: &RobotModel) -> Result<Vec<f64>, ProbeError> {
        let plant = Plant::new(model)?;
        let legs = model.legs.as_ref();
        let legs = legs.ok_or_else(|| ProbeError::NoLegs { name: model.name.clone() })?;
        let points = core::array::from_fn(|leg| model.foot_center(legs, leg));
        let done = Stand::new(&plant, points).and_then(|stand| {
            let each = self.tilts.iter().map(|tilt| stand.loads(*tilt));
            let loads = each.collect::<Option<Vec<[f64; 4]>>>()?.concat();
            Some([loads.as_slice(), &stand.warp].concat())
        });
        done.ok_or_else(|| ProbeError::Singular { name: model.name.clone() })
    }

    fn sensors(&self) -> Vec<Sensor> {
        let gain = |name| Sensor { name, spread: GAIN };
        let bias = |name| Sensor { name, spread: BIAS };
        let mut all = vec![
            gain("gain of scale fl"),
            gain("gain of scale fr"),
            gain("gain of scale rl"),
            gain("gain of scale rr"),
            bias("bias of scale fl"),
            bias("bias of scale fr"),
            bias("bias of scale rl"),
            bias("bias of scale rr"),
        ];
        all.resize(8 + self.tilts.len(), Sensor { name: "load of the diagonals", spread: WARP });
        all
    }

    fn observe(&self, done: &[f64], sensors: &[f64]) -> Vec<f64> {
        let (loads, warp) = done.split_at(done.len() - 4);
        let reading = |(i, load): (usize, &f64)| {
            let (scale, load) = (i % 4, load + sensors[8 + i / 4] * warp[i % 4]);
            load * (1.0 + sensors[scale]) + sensors[4 + scale]
        };
        loads.iter().enumerate().map(reading).collect()
    }

    fn measured(&self) -> &[f64] {
        &self.measured
    }

    fn noise(&self) -> Vec<f64> {
        vec![NOISE]
    }

    fn kind_of(&self, _: usize) -> usize {
        0
    }

    fn place(&self, reading: usize) -> Option<Place> {
        let column = TABLE.columns[2 + reading % 4].name;
        Some(Place { line: *self.lines.get(reading / 4)?, column, unit: 1.0 })
    }
}

/// Coordinates of the body (rotation, translation) and of the hinges; the rotors between them are held.
const COORDINATES: usize = 30;

/// A robot on four points, linear about its straight legs.
struct Stand {
    /// Stiffness of all coordinates, bordered by the motion of the four points.
    matrix: nalgebra::LU<f64, nalgebra::Dyn, nalgebra::Dyn>,
    /// Force along each coordinate under unit acceleration along x, y, z.
    weight: DMatrix<f64>,
    mass: f64,
    /// From the body's origin, m.
    centre: Vector3<f64>,
    /// Four loads of least squares from force and moments: pseudo-inverse of (1, x, y).
    share: DMatrix<f64>,
    /// Height of the soles over the body's origin, m.
    sole: f64,
    /// Four loads that have neither force nor moment, the largest 1.
    warp: [f64; 4],
}

impl Stand {
    /// `points`: the centres of the feet from the body's origin.
    fn new(plant: &Plant, points: [[f64; 3]; 4]) -> Option<Self> {
        let linear = plant.linearise();
        let of = |index: usize| if index < 6 { index } else { index + 2 };
        let size = COORDINATES + 12;
        let mut matrix = DMatrix::zeros(size, size);
        for i in 0..COORDINATES {
            for j in 0..COORDINATES {
                matrix[(i, j)] = linear.stiffness[of(i)][of(j)];
            }
            for point in 0..12 {
                // The middle of a sole is half-way between its two ends.
                let (leg, axis) = (point / 3, point % 3);
                let ends = [6 * leg + axis, 6 * leg + 3 + axis];
                let moved: f64 = ends.iter().map(|end| 0.5 * linear.sole_ends[*end][of(i)]).sum();
                matrix[(i, COORDINATES + point)] = moved;
                matrix[(COORDINATES + point, i)] = moved;
            }
        }
        let weight = DMatrix::from_fn(COORDINATES, 3, |i, axis| linear.mass[of(i)][3 + axis]);
        let (mass, centre, _) = plant.mass_properties();
        let origin = Vector3::from(plant.body().position);
        let balance = DMatrix::from_fn(3, 4, |row, leg| match row {
            0 => 1.0,
            row => points[leg][row - 1],
        });
        let share = balance.clone().pseudo_inverse(1e-12).ok()?;
        // What is left of any load after its force and moments are taken out.
        let mut warp = DVector::from_column_slice(&[1.0, -1.0, -1.0, 1.0]);
        warp -= &share * (&balance * &warp);
        warp /= warp.amax();
        let matrix = matrix.lu();
        matrix.is_invertible().then_some(Self {
            matrix,
            weight,
            mass,
            centre: Vector3::from(centre) - origin,
            share,
            sole: -origin.z,
            warp: core::array::from_fn(|leg| warp[leg]),
        })
    }

    /// What the four scales feel under a tilt, but for the diagonals, g.
    fn loads(&self, [roll, pitch]: [f64; 2]) -> Option<[f64; 4]> {
        let turn = Rotation3::from_euler_angles(roll.to_radians(), pitch.to_radians(), 0.0);
        let down = turn.inverse() * Vector3::new(0.0, 0.0, -GRAVITY);
        let mut force = DVector::zeros(COORDINATES + 12);
        force.rows_mut(0, COORDINATES).copy_from(&(&self.weight * down));
        // The body gives way, and its weight pulls beside where it was.
        let given = self.matrix.solve(&force)?;
        let (turned, moved) = (given.fixed_rows::<3>(0), given.fixed_rows::<3>(3));
        let centre = self.centre + moved + turned.cross(&self.centre);
        let arm = centre - Vector3::new(0.0, 0.0, self.sole);
        let [x, y, z] = (self.mass * down).into();
        // Loads N at (x_i, y_i) in the plane of the soles: sum N_i (1, x_i, y_i).
        let balance = DVector::from_vec(vec![-z, arm.z * x - arm.x * z, arm.z * y - arm.y * z]);
        let loads = &self.share * balance;
        Some(core::array::from_fn(|leg| 1e3 * loads[leg] / GRAVITY))
    }
}
