//! Controllers against robots that they have never seen.
//!
//! Every controller follows the same figure eight with every stranger ([`stranger`]), through the whole loop: cameras,
//! link, the robot's software, its plant. A run goes on however far the robot strays, until its laps are walked or the
//! patience ends, so that controllers are compared by what they took and not by when they gave up.

use std::sync::Arc;
use std::time::Duration;

use flix_host::nav::{
    ControllerKind, Experience, ModeTable, Navigator, Path, Repertoire, Settings, Task,
};
use flix_host::pilot::steering::names;
use flix_host::pilot::{Ending, Pilot};
use flix_protocol::units::Instant;
use serde::Serialize;
use serde_json::json;

use flix_sim::experiment::course::{Conditions, Course};
use flix_sim::model::{RobotModel, stranger};
use flix_sim::study::{Column, Row, Study, Table};

/// Sides of the figure eight, m, and its laps.
const EIGHT: [f64; 2] = [1.6, 0.8];
const LAPS: u32 = 2;
/// Robot's time after which a run is given up.
const PATIENCE: Duration = Duration::from_secs(900);
/// Farther than a run takes anybody, m.
const FAR: f64 = 100.0;
/// Latency of the link, each way, and the share of datagrams that it loses.
const LATENCY: Duration = Duration::from_millis(20);
const LOSS: f64 = 0.05;
/// The controllers that are compared: the present one, and the one that is to be better.
pub const CONTROLLERS: [ControllerKind; 2] = [ControllerKind::Predictive, ControllerKind::Learned];
/// Largest RMS error of the learned controller on any robot, mm.
const LARGEST_RMS_MM: f64 = 20.0;
/// Largest share of the present controller's time and energy, in the worst third of the robots.
const LARGEST_SHARE: f64 = 0.7;

/// The runs.
#[derive(Debug, Clone)]
pub struct Controllers {
    /// The robot that the strangers are changed from.
    pub model: RobotModel,
    /// Its mode table, for the present controller.
    pub table: ModeTable,
    /// For the learned one.
    pub experience: Arc<Experience>,
    /// Number of strangers.
    pub robots: u64,
    /// Seed of the first.
    pub first_seed: u64,
}

/// What a controller took, robot by robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Taken {
    /// Root mean square of the distance from the path, mm.
    pub rms_mm: Vec<f64>,
    /// Robot's time from arming to the end, s.
    pub seconds: Vec<f64>,
    /// Given by the battery, J.
    pub energy_j: Vec<f64>,
    /// Whether both laps were walked within the patience.
    pub finished: Vec<bool>,
}

impl Controllers {
    fn cell(&self, cell: usize) -> (ControllerKind, u64) {
        let count = CONTROLLERS.len();
        (CONTROLLERS[cell % count], self.first_seed.wrapping_add((cell / count) as u64))
    }

    fn follow(&self, controller: ControllerKind, seed: u64) -> Result<Row, String> {
        let sentence =
            |error: &dyn std::fmt::Display| format!("{controller}, seed {seed}: {error}");
        let path = Path::figure_eight(EIGHT[0], EIGHT[1]).map_err(|error| sentence(&error))?;
        let start = path.start();
        let task = Task::Follow { path, laps: LAPS };
        let usual = Settings::for_task(&task);
        let fence = usual.fence.widened(FAR);
        let settings = Settings { latency: LATENCY, fence, error_limit: FAR, ..usual };
        let repertoire = match controller {
            ControllerKind::Learned => Repertoire::Experience(Arc::clone(&self.experience)),
            _ => Repertoire::from(&self.table),
        };
        let modes = names(&repertoire.table());
        let navigator = Navigator::new(task, repertoire, settings.steered_by(controller))
            .map_err(|error| sentence(&error))?;
        let model = stranger(&self.model, seed);
        let conditions = Conditions { model, seed, latency: LATENCY, loss: LOSS, start };
        let mut course = Course::new(&conditions, Pilot::new(navigator, modes, None))
            .map_err(|error| sentence(&error))?;
        let ending = loop {
            if let Some(ending) = course.step().map_err(|error| sentence(&error))? {
                break ending;
            }
            if course.now().since(Instant::START) > PATIENCE {
                course.end(Ending::OutOfTime(PATIENCE));
            }
        };
        if !matches!(ending, Ending::Finished | Ending::OutOfTime(_) | Ending::Stopped(_)) {
            return Err(sentence(&ending));
        }
        let begun = course.pilot().driving_since().unwrap_or(course.now());
        let progress = course.pilot().helm().progress();
        Ok(vec![
            (progress.error_rms * 1e3).into(),
            course.now().since(begun).as_secs_f64().into(),
            course.energy().into(),
            f64::from(ending == Ending::Finished).into(),
            ending.to_string().as_str().into(),
        ])
    }
}

impl Study for Controllers {
    fn name(&self) -> &'static str {
        "controllers"
    }

    fn label(&self) -> String {
        format!("{}-{}", self.model.name, self.robots)
    }

    fn parameters(&self) -> serde_json::Value {
        json!({
            "model": self.model,
            "table": self.table.to_toml(),
            "experience": self.experience.to_toml(),
            "robots": self.robots,
            "first_seed": self.first_seed,
        })
    }

    fn columns(&self) -> Vec<Column> {
        vec![
            Column::text("controller"),
            Column::whole("seed"),
            Column::number("rms_mm"),
            Column::number("seconds"),
            Column::number("energy_j"),
            Column::number("finished"),
            Column::text("ending"),
        ]
    }

    fn cells(&self) -> usize {
        self.robots as usize * CONTROLLERS.len()
    }

    fn asked(&self, cell: usize) -> Row {
        let (controller, seed) = self.cell(cell);
        vec![controller.to_string().as_str().into(), seed.into()]
    }

    fn compute(&self, cells: &[usize]) -> Vec<Result<Row, String>> {
        let each = cells.iter().map(|cell| self.cell(*cell));
        each.map(|(controller, seed)| self.follow(controller, seed)).collect()
    }
}

/// Returns what a controller took, in the order of the robots.
#[must_use]
pub fn taken(table: &Table, controller: ControllerKind) -> Taken {
    let name = controller.to_string();
    let own: Vec<bool> = table.texts("controller").iter().map(|text| *text == name).collect();
    let of = |column: &str| -> Vec<f64> {
        let numbers = table.numbers(column).into_iter().zip(&own);
        numbers.filter(|(_, own)| **own).map(|(number, _)| number).collect()
    };
    Taken {
        rms_mm: of("rms_mm"),
        seconds: of("seconds"),
        energy_j: of("energy_j"),
        finished: of("finished").into_iter().map(|finished| finished == 1.0).collect(),
    }
}

/// Returns the mean of the largest third of the values, at least one.
#[must_use]
pub fn worst_third(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(|a, b| b.total_cmp(a));
    sorted.truncate(values.len().div_ceil(3));
    sorted.iter().sum::<f64>() / sorted.len() as f64
}

/// Returns whether the learned controller is better: every robot walks its laps within 20 mm RMS, and the worst third
/// takes at least 30 % less time and energy than with the present one.
#[must_use]
pub fn is_better(learned: &Taken, present: &Taken) -> bool {
    let less = |of: fn(&Taken) -> &Vec<f64>| {
        worst_third(of(learned)) <= LARGEST_SHARE * worst_third(of(present))
    };
    learned.finished.iter().all(|finished| *finished)
        && learned.rms_mm.iter().all(|rms| *rms <= LARGEST_RMS_MM)
        && less(|taken| &taken.seconds)
        && less(|taken| &taken.energy_j)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(rms_mm: f64, seconds: f64) -> Taken {
        Taken {
            rms_mm: vec![rms_mm, 10.0, 10.0],
            seconds: vec![seconds, 90.0, 80.0],
            energy_j: vec![200.0, 2.0 * seconds, 210.0],
            finished: vec![true; 3],
        }
    }

    #[test]
    fn better_is_exact_on_all_and_quicker_where_it_is_worst() {
        let present = taken(30.0, 200.0);
        assert!(is_better(&taken(19.0, 139.0), &present));
        assert!(!is_better(&taken(21.0, 139.0), &present));
        assert!(!is_better(&taken(19.0, 141.0), &present));
        let unfinished = Taken { finished: vec![true, false, true], ..taken(19.0, 139.0) };
        assert!(!is_better(&unfinished, &present));
    }

    #[test]
    fn the_worst_third_is_rounded_up() {
        assert_eq!(worst_third(&[1.0, 4.0, 2.0, 3.0]), 3.5);
        assert_eq!(worst_third(&[7.0]), 7.0);
    }
}
