//! Each foot dragged over the floor under a known load: its friction, and whether it has a direction.

use super::fit::{Experiment, GAIN, Place, Sensor};
use super::table::{Column, Table};
use super::unknowns::Kind;
use flix_sim::experiment::probe::ProbeError;
use flix_sim::model::RobotModel;

/// What the file is made of.
pub const TABLE: Table<4> = Table {
    name: "drag",
    columns: [
        Column::LEG,
        Column::new("direction_deg", -360.0, 360.0),
        Column::new("load_n", 0.05, 50.0),
        Column::new("drag_n", -1.0, 100.0),
    ],
    fewest: 2,
};

/// Directions, degrees, and loads, N, of the usual test of a foot.
pub const USUAL: ([f64; 6], [f64; 2]) = ([0.0, 60.0, 120.0, 180.0, 240.0, 300.0], [1.0, 2.0]);

/// Bias of the force, N.
const BIAS: f64 = 0.01;
/// Noise of a drag, as a share of it: a foot sticks and slips.
const NOISE: f64 = 0.03;

/// Drags.
#[derive(Debug, Clone)]
pub struct Drag {
    /// Of each drag; none of planned ones.
    lines: Vec<u64>,
    /// Leg and load, N.
    loads: Vec<(usize, f64)>,
    /// Drag over load.
    measured: Vec<f64>,
}

impl Drag {
    /// Takes the rows of a file.
    #[must_use]
    pub fn read(rows: &[(u64, [f64; 4])]) -> Self {
        let (lines, rows): (_, Vec<_>) = rows.iter().copied().unzip();
        Self { lines, ..Self::new(&rows) }
    }

    /// Takes rows that stand in no file.
    #[must_use]
    pub fn new(rows: &[[f64; 4]]) -> Self {
        Self {
            lines: Vec::new(),
            loads: rows.iter().map(|row| (row[0] as usize, row[2])).collect(),
            measured: rows.iter().map(|row| row[3] / row[2]).collect(),
        }
    }
}

impl Experiment for Drag {
    fn name(&self) -> &'static str {
        TABLE.name
    }

    fn shows(&self, kind: Kind) -> bool {
        kind == Kind::Friction
    }

    fn simulate(&self, model: &RobotModel) -> Result<Vec<f64>, ProbeError> {
        let legs = model.legs.as_ref();
        let legs = legs.ok_or_else(|| ProbeError::NoLegs { name: model.name.clone() })?.each();
        // A foot that slides resists with its friction times its load, whichever way it goes.
        Ok(self.loads.iter().map(|(leg, _)| legs[*leg].friction).collect())
    }

    fn sensors(&self) -> Vec<Sensor> {
        vec![
            Sensor { name: "gain of the drag", spread: GAIN },
            Sensor { name: "bias of the drag", spread: BIAS },
        ]
    }

    fn observe(&self, done: &[f64], sensors: &[f64]) -> Vec<f64> {
        let reading = |(friction, (_, load)): (&f64, &(usize, f64))| {
            friction * (1.0 + sensors[0]) + sensors[1] / load
        };
        done.iter().zip(&self.loads).map(reading).collect()
    }

    fn measured(&self) -> &[f64] {
        &self.measured
    }

    fn noise(&self) -> Vec<f64> {
        vec![NOISE * 0.6]
    }

    fn kind_of(&self, _: usize) -> usize {
        0
    }

    fn place(&self, reading: usize) -> Option<Place> {
        let unit = self.loads[reading].1.recip();
        Some(Place { line: *self.lines.get(reading)?, column: TABLE.columns[3].name, unit })
    }
}
