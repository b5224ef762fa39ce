//! Walks of several variants of a robot over several pairs (f, theta) and seeds: what mobility and sensitivity
//! are made of.
//!
//! One cell is one walk. A table of a sweep explains itself ([`cells`] needs nothing else), so that figures are
//! drawn alike from one run and from merged shards.

use flix_host::nav::Twist;
use serde_json::json;

use flix_sim::experiment::walk::{
    Shaking, Spread, Start, Walk, WalkDrive, WalkError, Walked, walk,
};
use flix_sim::experiment::walks::{OneOfMany, TOGETHER, walks};
use flix_sim::model::{RobotModel, scattered};
use flix_sim::rig::bench::{DIRECTIONS, FREQUENCIES};
use flix_sim::study::{Column, Row, Study, Table};

/// Time that the paper walks, s.
pub const SECONDS: f64 = 8.0;
/// Walks by the firmware that are computed together: few enough to lose little, enough to write seldom.
const BATCH: usize = 4;

/// A robot, or a changed one.
#[derive(Debug, Clone)]
pub struct Variant {
    /// What is changed, for people.
    pub name: String,
    /// The robot.
    pub model: RobotModel,
}

/// The walks.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// Of the study.
    pub name: &'static str,
    /// The first is the reference.
    pub variants: Vec<Variant>,
    /// f in Hz and theta in degrees.
    pub pairs: Vec<(f64, f64)>,
    /// Walks of each pair, each with its start disturbed.
    pub seeds: u64,
    /// The first of their seeds.
    pub first_seed: u64,
    /// Time of a walk, s.
    pub seconds: f64,
    /// Step of the ideal drive, s.
    pub step: f64,
    /// What turns the rotors.
    pub drive: WalkDrive,
    /// How far every number of the model is scattered, anew for every seed, as a share; 0 for not at all.
    pub scatter: f64,
    /// Read f and theta as the paper's equations say it with y to the left (both negated) instead of as its
    /// text does.
    pub mirrored: bool,
}

/// Returns all pairs of the usual grid.
#[must_use]
pub fn grid() -> Vec<(f64, f64)> {
    grid_of(&FREQUENCIES, &DIRECTIONS)
}

/// Returns all pairs of these frequencies (Hz) and directions (degrees), in rising order, each once.
#[must_use]
pub fn grid_of(frequencies: &[f64], directions: &[f64]) -> Vec<(f64, f64)> {
    let axis = |values: &[f64]| {
        let mut values = values.to_vec();
        values.sort_by(f64::total_cmp);
        values.dedup();
        values
    };
    let directions = axis(directions);
    axis(frequencies).iter().flat_map(|f| directions.iter().map(|theta| (*f, *theta))).collect()
}

/// The means and spreads of one pair of one variant.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Name of the variant.
    pub variant: String,
    /// Hz.
    pub f_hz: f64,
    /// Degrees.
    pub theta_deg: f64,
    /// The walks, a seed each.
    pub walks: Vec<Twist>,
}

impl Cell {
    /// Returns the mean and spread of forward, lateral and yaw speed (m/s, m/s, rad/s).
    #[must_use]
    pub fn spreads(&self) -> [Spread; 3] {
        let of =
            |pick: fn(&Twist) -> f64| Spread::of(&self.walks.iter().map(pick).collect::<Vec<_>>());
        [of(|w| w.forward), of(|w| w.lateral), of(|w| w.yaw)]
    }

    /// Returns the mean motion.
    #[must_use]
    pub fn mean(&self) -> Twist {
        let [forward, lateral, yaw] = self.spreads().map(|spread| spread.mean);
        Twist { forward, lateral, yaw }
    }
}

/// Pairs of all variants, in order, from the table of a sweep.
#[must_use]
pub fn cells(table: &Table) -> Vec<Cell> {
    let variants = table.texts("variant");
    let [f, theta, forward, lateral, yaw] =
        ["f_hz", "theta_deg", "forward_m_s", "lateral_m_s", "yaw_rad_s"]
            .map(|name| table.numbers(name));
    let mut cells: Vec<Cell> = Vec::new();
    for i in 0..variants.len() {
        let motion = Twist { forward: forward[i], lateral: lateral[i], yaw: yaw[i] };
        match cells.last_mut() {
            Some(cell)
                if cell.variant == variants[i]
                    && (cell.f_hz, cell.theta_deg) == (f[i], theta[i]) =>
            {
                cell.walks.push(motion);
            }
            _ => cells.push(Cell {
                variant: variants[i].to_owned(),
                f_hz: f[i],
                theta_deg: theta[i],
                walks: vec![motion],
            }),
        }
    }
    cells
}

impl Sweep {
    /// Returns the variant, f in Hz, theta in degrees and seed of a cell.
    fn cell(&self, cell: usize) -> (&Variant, f64, f64, u64) {
        let per_variant = self.pairs.len() * self.seeds as usize;
        let (f, theta) = self.pairs[cell % per_variant / self.seeds as usize];
        let seed = self.first_seed.wrapping_add((cell % self.seeds as usize) as u64);
        (&self.variants[cell / per_variant], f, theta, seed)
    }

    fn failed(&self, cell: usize, error: &dyn std::fmt::Display) -> String {
        let (variant, f, theta, seed) = self.cell(cell);
        format!("{} at {f} Hz, {theta} degrees, seed {seed}: {error}", variant.name)
    }

    fn prepare(&self, cell: usize) -> Result<OneOfMany, String> {
        let (variant, f, theta, seed) = self.cell(cell);
        let sign = if self.mirrored { -1.0 } else { 1.0 };
        Ok(OneOfMany {
            model: scattered(&variant.model, self.scatter, seed),
            shaking: Shaking::new(sign * f, sign * theta)
                .map_err(|error| self.failed(cell, &error))?,
            start: Start { seed, heading: None },
        })
    }

    fn walk(&self, many: &[OneOfMany]) -> Vec<Result<Walked, WalkError>> {
        match self.drive {
            WalkDrive::Ideal => walks(many, self.seconds, self.step),
            drive @ WalkDrive::Firmware => {
                let (seconds, step) = (self.seconds, self.step);
                let each = many.iter().map(|OneOfMany { model, shaking, start }| {
                    let heading = start.heading;
                    let what = Walk { shaking: *shaking, seconds, drive, step, heading };
                    walk(model, &what, start.seed, |_| {})
                });
                each.collect()
            }
        }
    }
}

impl Study for Sweep {
    fn name(&self) -> &'static str {
        self.name
    }

    fn label(&self) -> String {
        let model = self.variants.first().map_or("", |variant| &variant.model.name);
        format!("{model}-{}x{}s", self.seeds, self.seconds)
    }

    fn parameters(&self) -> serde_json::Value {
        let variants: Vec<_> =
            self.variants.iter().map(|v| json!({ "name": v.name, "model": v.model })).collect();
        json!({
            "model": self.variants.first().map(|v| v.model.name.clone()),
            "variants": variants,
            "pairs": self.pairs,
            "seeds": self.seeds,
            "first_seed": self.first_seed,
            "seconds": self.seconds,
            "step_s": self.step,
            "drive": self.drive,
            // Results of the two precisions are never mixed.
            "precision": if self.drive == WalkDrive::Ideal { "single" } else { "double" },
            "scatter": self.scatter,
            "mirrored": self.mirrored,
        })
    }

    fn columns(&self) -> Vec<Column> {
        vec![
            Column::text("variant"),
            Column::number("f_hz"),
            Column::number("theta_deg"),
            Column::whole("seed"),
            Column::number("forward_m_s"),
            Column::number("lateral_m_s"),
            Column::number("yaw_rad_s"),
            Column::number("path_m_s"),
            Column::number("cost_of_transport"),
        ]
    }

    fn cells(&self) -> usize {
        self.variants.len() * self.pairs.len() * self.seeds as usize
    }

    fn batch(&self) -> usize {
        match self.drive {
            WalkDrive::Ideal => TOGETHER,
            WalkDrive::Firmware => BATCH,
        }
    }

    fn asked(&self, cell: usize) -> Row {
        let (variant, f, theta, seed) = self.cell(cell);
        vec![variant.name.as_str().into(), f.into(), theta.into(), seed.into()]
    }

    fn compute(&self, cells: &[usize]) -> Vec<Result<Row, String>> {
        let prepared: Vec<_> = cells.iter().map(|cell| self.prepare(*cell)).collect();
        let many: Vec<_> = prepared.iter().flatten().cloned().collect();
        let mut walks = self.walk(&many).into_iter();
        let rows = cells.iter().zip(prepared).map(|(cell, prepared)| {
            prepared?;
            let walked = walks.next().ok_or("it was not walked")?;
            let walked = walked.map_err(|error| self.failed(*cell, &error))?;
            Ok(vec![
                walked.forward_m_s.into(),
                walked.lateral_m_s.into(),
                walked.yaw_rad_s.into(),
                (walked.path_m / self.seconds).into(),
                walked.cost_of_transport.into(),
            ])
        });
        rows.collect()
    }
}

#[cfg(test)]
mod tests {
    use flix_host::system::interrupt::Interrupt;

    use super::*;
    use crate::{Earlier, Options, merge, run};
    use flix_sim::study::Shard;

    fn short(seeds: u64) -> Sweep {
        let model = RobotModel::named("W").unwrap();
        Sweep {
            name: "mobility",
            variants: vec![Variant { name: "baseline".to_owned(), model }],
            pairs: vec![(30.0, 0.0), (-30.0, 90.0)],
            seeds,
            first_seed: 5,
            seconds: 0.05,
            step: 5e-4,
            drive: WalkDrive::Ideal,
            scatter: 0.02,
            mirrored: false,
        }
    }

    #[test]
    fn slices_of_walks_merged_equal_one_run_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let options = |shard: &str| Options {
            folder: folder.path().to_owned(),
            shard: shard.parse().unwrap(),
            earlier: Earlier::Unfinished,
            interrupt: Interrupt::never(),
        };
        let whole = run(&short(3), &options("1/1")).unwrap();
        let slices: Vec<_> = (1..=4)
            .map(|index| {
                run(&short(3), &options(&format!("{index}/4"))).unwrap();
                folder.path().join(format!("results-{index}-of-4.parquet"))
            })
            .collect();
        assert_eq!(merge(&slices, false).unwrap(), whole);
    }

    #[test]
    fn a_slice_of_other_walks_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let options = |name: &str, shard: &str| Options {
            folder: folder.path().join(name),
            shard: shard.parse().unwrap(),
            earlier: Earlier::Unfinished,
            interrupt: Interrupt::never(),
        };
        run(&short(3), &options("a", "1/2")).unwrap();
        run(&short(2), &options("b", "2/2")).unwrap();
        let files = [
            folder.path().join("a/results-1-of-2.parquet"),
            folder.path().join("b/results-2-of-2.parquet"),
        ];
        assert!(merge(&files, false).unwrap_err().to_string().contains("is a shard of"));
    }

    #[test]
    fn a_grid_has_every_pair_once_in_rising_order() {
        let pairs = [(40.0, -30.0), (40.0, 0.0), (100.0, -30.0), (100.0, 0.0)];
        assert_eq!(grid_of(&[100.0, 40.0, 100.0], &[0.0, -30.0]), pairs);
    }

    #[test]
    fn walks_of_a_pair_are_told_apart_by_their_seeds() {
        let sweep = short(2);
        let rows = sweep.compute(&[0, 1]);
        let seed = |cell| sweep.asked(cell)[3].whole();
        assert_eq!((seed(0), seed(1)), (Some(5), Some(6)));
        assert_ne!(rows[0], rows[1]);
        assert_eq!(sweep.asked(2)[1].number(), Some(-30.0));
    }

    #[test]
    fn a_walk_that_fails_is_a_row_that_says_why_and_the_others_are_whole() {
        let folder = tempfile::tempdir().unwrap();
        let options = || Options {
            folder: folder.path().to_owned(),
            shard: Shard::WHOLE,
            earlier: Earlier::Unfinished,
            interrupt: Interrupt::never(),
        };
        // Faster than anything shakes; a model that has no legs.
        let bench = RobotModel::named("bench-fixed").unwrap();
        let mut bad = Sweep { first_seed: u64::MAX - 1, ..short(1) };
        bad.variants.push(Variant { name: "bench".to_owned(), model: bench });
        bad.pairs.insert(1, (1000.0, 0.0));
        let table = run(&bad, &options()).unwrap();
        let (whole, failures) = table.succeeded();
        assert_eq!((table.rows.len(), whole.rows.len(), failures.len()), (6, 2, 4));
        assert!(failures[0].contains("1000 Hz") && failures[1].contains("legs"), "{failures:?}");
        assert!(table.numbers("forward_m_s")[1].is_nan() && table.numbers("f_hz")[1] == 1000.0);
        assert!(whole.numbers("forward_m_s").iter().all(|speed| speed.is_finite()));
        let good = run(
            &Sweep { first_seed: u64::MAX - 1, ..short(1) },
            &Options { folder: folder.path().join("good"), ..options() },
        )
        .unwrap();
        let rows = |table: &Table| table.rows.values().cloned().collect::<Vec<_>>();
        assert_eq!(rows(&good), rows(&whole));
        // As it was written, and on the next run.
        let text = format!("{table:?}");
        assert_eq!(
            format!("{:?}", crate::read(&folder.path().join("results.parquet")).unwrap()),
            text
        );
        assert_eq!(format!("{:?}", run(&bad, &options()).unwrap()), text);
        assert!(text.contains("Whole(18446744073709551614)"));
    }

    #[test]
    fn the_mirrored_reading_negates_f_and_theta() {
        let (text, equations) = (short(1), Sweep { mirrored: true, ..short(1) });
        let swapped = Sweep { pairs: vec![(-30.0, 0.0), (30.0, -90.0)], ..short(1) };
        let speeds = |sweep: &Sweep| sweep.compute(&[1]).remove(0).unwrap();
        assert_eq!(speeds(&equations), speeds(&swapped));
        assert_ne!(speeds(&equations), speeds(&text));
    }
}
