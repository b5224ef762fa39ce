//! Calibration of the whole robot (paper, section II-D): the open choices and the error set X, fitted to measured
//! speeds or to the modes of Tables III and IV.
//!
//! What is minimised is an **expectation**: each generation draws new samples, each with its own start and with
//! every number of the model scattered, at each of the steps in turn; all candidates of a generation meet the
//! same samples. So neither a lucky seed nor a knife-edge nor a step size is fitted, and the result is the
//! middle of the final distribution, not the luckiest candidate.
//!
//! - Given measured speeds, the loss of a walk is its squared error (equation 3), yaw rates times [`LEVER`].
//! - Given modes, it is `ln(1 + exp((m0 - m)/s))` of the margin `m` ([`PaperMode::margin`]): nothing is gained
//!   by exceeding a mode that is safe, and the worst mode weighs most. A mode that has to advance costs the same again
//!   for the margin of its forward speed over [`LEAST_SPEED`].

mod unknowns;

pub use unknowns::{Fit, Unknown, WIDEST, apply, point, unknowns, values};

use std::fs::File;
use std::path::{Path, PathBuf};

use flix_host::nav::Twist;
use flix_host::system::file::is_held_elsewhere;
use flix_host::system::interrupt::Interrupt;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::iter::ParallelIterator as _;
use rayon::slice::ParallelSlice as _;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::cmaes::{Cmaes, inside};
use super::measured::Measured;
use super::modes::{LEVER, PaperMode, lead};
use super::selection::LEAST_SPEED;
use super::write_whole;
use flix_sim::experiment::walks::{TOGETHER, ideal_motions};
use flix_sim::model::{RobotModel, scattered};

/// Margin from which a mode counts as safe, as a share.
const SAFE_MARGIN: f64 = 0.15;
/// Softness of the loss around it.
const SOFTNESS: f64 = 0.1;
/// Of the samples that a start is chosen by.
const NO_GENERATION: u64 = 0xFFFF_FFFF;

/// What to fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub enum Goal {
    /// A mode of a table, with conditions beside being a hit.
    Mode(PaperMode, Also),
    /// Speeds of a prototype.
    Measured(Measured),
}

/// Conditions on a mode beside being a hit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Also {
    /// Advance at [`LEAST_SPEED`] or more, as the paper steers with turns alone.
    pub advances: bool,
    /// Be a strict hit and, as a translation, keep its heading ([`modes`](crate::modes)).
    pub strict: bool,
}

impl Goal {
    /// Returns Hz and degrees.
    #[must_use]
    pub const fn pair(&self) -> (f64, f64) {
        match self {
            Self::Mode(mode, _) => (mode.f_hz, mode.theta_deg),
            Self::Measured(row) => (row.f_hz, row.theta_deg),
        }
    }

    /// Returns how badly a walk fits, 0 or more.
    #[must_use]
    pub fn loss(&self, motion: Twist) -> f64 {
        match self {
            Self::Mode(mode, also) => {
                let ahead = also.advances.then(|| lead(motion.forward, LEAST_SPEED));
                let strict = also.strict.then(|| mode.strict_margins(motion));
                let margins = ahead.into_iter().chain(strict.into_iter().flatten());
                shortfall(mode.margin(motion)) + margins.map(shortfall).sum::<f64>()
            }
            Self::Measured(row) => row.square_error(motion),
        }
    }

    /// The loss of a walk that did not come about.
    fn worst(&self) -> f64 {
        match self {
            Self::Mode(mode, also) => {
                let strict = also.strict.then(|| mode.strict_margins(Twist::default()).count());
                let margins = 1 + usize::from(also.advances) + strict.unwrap_or(0);
                margins as f64 * (SAFE_MARGIN + 1.0) / SOFTNESS
            }
            Self::Measured(_) => 1.0,
        }
    }
}

/// Returns what a margin costs, as a share of the speeds involved: nothing where it is safe.
fn shortfall(margin: f64) -> f64 {
    ((SAFE_MARGIN - margin) / SOFTNESS).exp().ln_1p()
}

/// Where a search begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
pub enum Start {
    /// At the model.
    Model,
    /// Anywhere in the ranges, by the seed: at the best of as many random robots as are tried.
    Anywhere,
}

/// How to search.
#[derive(Debug, Clone)]
pub struct Settings {
    /// What is not searched.
    pub base: RobotModel,
    /// Where the search begins.
    pub start: Start,
    /// Random robots that a start anywhere is chosen from; 1: fitted to nothing.
    pub tries: usize,
    /// What may be changed.
    pub fit: Fit,
    /// How much wider than usual the ranges are.
    pub widen: f64,
    /// What is fitted.
    pub goals: Vec<Goal>,
    /// First step of the search, as a share of the ranges.
    pub first_step: f64,
    /// Candidates a generation.
    pub population: usize,
    /// Scattered robots that every candidate is tried as, a generation.
    pub samples: usize,
    /// How far their numbers scatter, as a share.
    pub scatter: f64,
    /// Steps of the simulation, s, taken in turn.
    pub steps: Vec<f64>,
    /// Time of a walk, s.
    pub seconds: f64,
    /// Generations in all.
    pub generations: u64,
    /// Of everything random.
    pub seed: u64,
    /// Where the search is kept after each generation.
    pub checkpoint: PathBuf,
    /// Forget what is kept there.
    pub restart: bool,
    /// Ends the search at once; the generation under way is lost.
    pub interrupt: Interrupt,
}

/// A generation that is behind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Generation {
    /// Mean loss of a row at the middle of the distribution.
    pub middle: f64,
    /// The same at the best candidate, on this generation's samples.
    pub best: f64,
    /// Step size as a share of the ranges.
    pub sigma: f64,
}

/// What is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Of the settings.
    fingerprint: String,
    /// One a generation.
    pub history: Vec<Generation>,
    /// The search.
    pub search: Cmaes,
}

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// The checkpoint cannot be kept.
    #[error("cannot keep the search in {}: {source}", path.display())]
    Keep {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The checkpoint is of another search, or damaged.
    #[error(
        "{} does not hold this search ({reason}): choose another folder with --out, or --restart to forget it",
        path.display()
    )]
    Other {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// Another process searches with this checkpoint.
    #[error("another process keeps its search in {}: wait until it has ended, or choose another folder with --out", path.display())]
    Busy {
        /// The file.
        path: PathBuf,
    },
    /// Somebody asked to end. Whole generations are kept.
    #[error("interrupted after {0} generations; run the same command again to go on")]
    Interrupted(u64),
    /// Nothing to walk with.
    #[error("the model {0} has no legs: calibrate one that walks, for example W")]
    NoLegs(String),
}

/// Searches to the end, or goes on with what is kept. `report` is called after every generation.
///
/// # Errors
/// See [`CalibrationError`]; finished generations are kept.
pub fn calibrate(
    settings: &Settings,
    mut report: impl FnMut(&Progress),
) -> Result<(RobotModel, Progress), CalibrationError> {
    if settings.base.legs.is_none() {
        return Err(CalibrationError::NoLegs(settings.base.name.clone()));
    }
    let _alone = lock(settings)?;
    let unknowns = unknowns(settings.fit, settings.widen);
    let mut progress = begin(settings, &unknowns)?;
    report(&progress);
    while progress.search.generation() < settings.generations {
        let points = progress.search.ask();
        let mut tried: Vec<Vec<f64>> = points.iter().map(|point| inside(point)).collect();
        tried.push(progress.search.mean());
        let generation = progress.search.generation();
        let mut losses = losses(settings, &unknowns, &tried, generation);
        if settings.interrupt.is_raised() {
            return Err(CalibrationError::Interrupted(generation));
        }
        let middle = losses.pop().unwrap_or(f64::NAN);
        progress.history.push(Generation {
            middle,
            best: losses.iter().copied().fold(f64::INFINITY, f64::min),
            sigma: progress.search.sigma(),
        });
        progress.search.update(&points, &losses);
        keep(settings, &progress)?;
        report(&progress);
    }
    Ok((apply(&unknowns, &settings.base, &progress.search.mean()), progress))
}

/// How a point does, over the samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Trial {
    /// Mean loss of a row.
    pub loss: f64,
    /// Mean number of modes with the right sign; 0 for measured speeds.
    pub signs: f64,
    /// Mean number of modes that are hits; 0 for measured speeds.
    pub hits: f64,
}

/// Tries points of the unit cube, one coordinate for each of [`unknowns`], on the samples of the first generation: for an
/// optimiser of one's own. All points meet the same samples; another seed has others. Of no use once interrupted.
///
/// # Panics
/// When the model has no legs or a point has too few coordinates.
#[must_use]
pub fn evaluate(settings: &Settings, points: &[Vec<f64>]) -> Vec<Trial> {
    let unknowns = unknowns(settings.fit, settings.widen);
    trials(settings, &unknowns, points, 0)
}

/// Mean loss of a row for each point, all on the samples of this generation; of no use once interrupted. A point
/// that is no robot (its feet touch) counts as the worst.
fn losses(
    settings: &Settings,
    unknowns: &[Unknown],
    points: &[Vec<f64>],
    generation: u64,
) -> Vec<f64> {
    trials(settings, unknowns, points, generation).iter().map(|trial| trial.loss).collect()
}

fn trials(
    settings: &Settings,
    unknowns: &[Unknown],
    points: &[Vec<f64>],
    generation: u64,
) -> Vec<Trial> {
    let each: Vec<Vec<Trial>> = (0..settings.samples)
        .map(|sample| sampled(settings, unknowns, points, generation, sample))
        .collect();
    (0..points.len())
        .map(|point| {
            let mean = |of: fn(&Trial) -> f64| {
                each.iter().map(|sample| of(&sample[point])).sum::<f64>() / each.len() as f64
            };
            Trial { loss: mean(|s| s.loss), signs: mean(|s| s.signs), hits: mean(|s| s.hits) }
        })
        .collect()
}

/// Seeds of the search's samples are odd multiples of a large number: far from those that people choose to check.
fn sample_seed(seed: u64, generation: u64, sample: usize) -> u64 {
    (seed << 40) ^ (generation << 16) ^ (sample as u64) ^ 0xC0DE_0000_0000_0000
}

/// Tries every point on one sample, all goals of all points side by side.
fn sampled(
    settings: &Settings,
    unknowns: &[Unknown],
    points: &[Vec<f64>],
    generation: u64,
    sample: usize,
) -> Vec<Trial> {
    let seed = sample_seed(settings.seed, generation, sample);
    let step = settings.steps[sample % settings.steps.len()];
    let models: Vec<RobotModel> = points
        .iter()
        .map(|point| scattered(&apply(unknowns, &settings.base, point), settings.scatter, seed))
        .collect();
    let many: Vec<_> = models
        .iter()
        .flat_map(|model| settings.goals.iter().map(move |goal| (model, goal.pair(), seed)))
        .collect();
    let motions: Vec<Option<Twist>> = many
        .par_chunks(TOGETHER)
        .flat_map(|many| {
            if settings.interrupt.is_raised() {
                return vec![None; many.len()];
            }
            ideal_motions(many, settings.seconds, step)
        })
        .collect();
    motions.chunks(settings.goals.len()).map(|motions| scored(settings, motions)).collect()
}

/// Scores the motions of one point, one a goal.
fn scored(settings: &Settings, motions: &[Option<Twist>]) -> Trial {
    let mut sum = Trial { loss: 0.0, signs: 0.0, hits: 0.0 };
    for (goal, motion) in settings.goals.iter().zip(motions.iter().copied()) {
        sum.loss += motion.map_or(goal.worst(), |motion| goal.loss(motion));
        if let (Some(motion), Goal::Mode(mode, _)) = (motion, goal) {
            let score = mode.score(motion);
            sum.signs += f64::from(u8::from(score.sign));
            sum.hits += f64::from(u8::from(score.hit));
        }
    }
    sum.loss /= settings.goals.len() as f64;
    sum
}

/// Everything that the course of a search depends on but its length, as a hash.
fn fingerprint(settings: &Settings, unknowns: &[Unknown]) -> String {
    let ranges: Vec<_> = unknowns.iter().map(|u| (&u.name, u.low, u.high)).collect();
    let identity = serde_json::json!({
        "base": settings.base, "start": settings.start, "tries": settings.tries, "first_step": settings.first_step,
        "goals": settings.goals, "ranges": ranges,
        "samples": settings.samples, "population": settings.population,
        "scatter": settings.scatter, "steps": settings.steps, "seconds": settings.seconds,
        "seed": settings.seed, "version": env!("CARGO_PKG_VERSION"),
    });
    let digest = Sha256::digest(identity.to_string().as_bytes());
    digest.iter().take(8).map(|byte| format!("{byte:02x}")).collect()
}

fn begin(settings: &Settings, unknowns: &[Unknown]) -> Result<Progress, CalibrationError> {
    let fingerprint = fingerprint(settings, unknowns);
    let path = &settings.checkpoint;
    if path.exists() && !settings.restart {
        let other = |reason: String| CalibrationError::Other { path: path.clone(), reason };
        let text = flix_host::system::file::read_text(path)
            .map_err(|source| CalibrationError::Keep { path: path.clone(), source })?;
        let kept: Progress = toml::from_str(&text).map_err(|error| other(error.to_string()))?;
        if kept.fingerprint != fingerprint {
            return Err(other("other settings or another version".to_owned()));
        }
        return Ok(kept);
    }
    let start = match settings.start {
        Start::Model => point(unknowns, &settings.base),
        Start::Anywhere => anywhere(settings, unknowns)?,
    };
    Ok(Progress {
        fingerprint,
        history: Vec::new(),
        search: Cmaes::new(&start, settings.first_step, settings.seed, settings.population),
    })
}

/// The best of random points on the samples of no generation, or the model's own where there is hardly a robot.
fn anywhere(settings: &Settings, unknowns: &[Unknown]) -> Result<Vec<f64>, CalibrationError> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(settings.seed);
    // Another stream than that of the search.
    random.jump();
    let points: Vec<Vec<f64>> = (0..1_000 * settings.tries)
        .map(|_| unknowns.iter().map(|_| random.random()).collect::<Vec<f64>>())
        .filter(|point| apply(unknowns, &settings.base, point).check().is_ok())
        .take(settings.tries)
        .collect();
    if points.len() < 2 {
        return Ok(points.into_iter().next().unwrap_or_else(|| point(unknowns, &settings.base)));
    }
    let losses = losses(settings, unknowns, &points, NO_GENERATION);
    if settings.interrupt.is_raised() {
        return Err(CalibrationError::Interrupted(0));
    }
    let best = points.into_iter().zip(losses).min_by(|a, b| a.1.total_cmp(&b.1));
    Ok(best.map_or_else(|| point(unknowns, &settings.base), |(point, _)| point))
}

/// Keeps other processes from this checkpoint, until the file is closed.
fn lock(settings: &Settings) -> Result<File, CalibrationError> {
    let path = settings.checkpoint.with_extension("lock");
    let failed = |source| CalibrationError::Keep { path: path.clone(), source };
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    let file = File::options().create(true).append(true).open(&path).map_err(failed)?;
    if is_held_elsewhere(&file) {
        return Err(CalibrationError::Busy { path: settings.checkpoint.clone() });
    }
    Ok(file)
}

fn keep(settings: &Settings, progress: &Progress) -> Result<(), CalibrationError> {
    let failed = |source| CalibrationError::Keep { path: settings.checkpoint.clone(), source };
    let text = toml::to_string(progress).map_err(|e| failed(std::io::Error::other(e)))?;
    write_whole(&settings.checkpoint, text.as_bytes()).map_err(failed)
}

/// Writes a calibrated model with where it comes from above it.
///
/// # Errors
/// When the file cannot be written.
pub fn write_model(path: &Path, model: &RobotModel, origin: &str) -> std::io::Result<()> {
    let comment: String = origin.lines().map(|line| format!("# {line}\n")).collect();
    let text = toml::to_string(model).map_err(std::io::Error::other)?;
    write_whole(path, format!("{comment}{text}").as_bytes())
}

impl Measured {
    /// Squared error of equation 3, in (m/s)^2, yaw rates times [`LEVER`].
    fn square_error(&self, motion: Twist) -> f64 {
        ((self.motion.forward - motion.forward).powi(2)
            + (self.motion.lateral - motion.lateral).powi(2)
            + (LEVER * (self.motion.yaw - motion.yaw)).powi(2))
            / 3.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::modes::paper_modes;

    fn settings(folder: &Path) -> Settings {
        Settings {
            base: RobotModel::named("W").unwrap(),
            start: Start::Model,
            tries: 1,
            fit: Fit::Open,
            widen: 1.0,
            goals: paper_modes()
                .into_iter()
                .take(1)
                .map(|mode| Goal::Mode(mode, Also::default()))
                .collect(),
            first_step: 0.15,
            population: 12,
            samples: 2,
            scatter: 0.02,
            steps: vec![5e-4, 2.5e-4],
            seconds: 0.05,
            generations: 2,
            seed: 1,
            checkpoint: folder.join("search.toml"),
            restart: false,
            interrupt: Interrupt::never(),
        }
    }

    #[test]
    fn a_search_goes_on_from_its_checkpoint_to_the_same_model() {
        let (whole, parts) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let once = calibrate(&settings(whole.path()), |_| {}).unwrap();
        let first = Settings { generations: 1, ..settings(parts.path()) };
        calibrate(&first, |_| {}).unwrap();
        let again = calibrate(&settings(parts.path()), |_| {}).unwrap();
        assert_eq!(once, again);
    }

    #[test]
    fn a_search_that_another_process_keeps_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let settings = settings(folder.path());
        let other = lock(&settings).unwrap();
        let refused = calibrate(&settings, |_| ());
        assert!(matches!(refused, Err(CalibrationError::Busy { .. })));
        assert!(!settings.checkpoint.exists());
        drop(other);
        assert!(lock(&settings).is_ok());
    }

    #[test]
    fn a_checkpoint_of_other_settings_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        calibrate(&settings(folder.path()), |_| {}).unwrap();
        let other = Settings { scatter: 0.05, ..settings(folder.path()) };
        assert!(matches!(calibrate(&other, |_| {}), Err(CalibrationError::Other { .. })));
    }

    #[test]
    fn a_search_from_anywhere_knows_nothing_of_what_it_changes_in_the_model() {
        let from = |seed, shaker_z_mm| {
            let folder = tempfile::tempdir().unwrap();
            let mut settings =
                Settings { start: Start::Anywhere, widen: WIDEST, seed, ..settings(folder.path()) };
            settings.base.shaker.z_mm = shaker_z_mm;
            calibrate(&settings, |_| {}).unwrap().0
        };
        assert_eq!(from(1, 16.0), from(1, 21.0));
        assert_ne!(from(1, 16.0), from(2, 16.0));
    }

    #[test]
    fn a_point_from_outside_is_tried_as_the_search_tries_its_first_middle() {
        let folder = tempfile::tempdir().unwrap();
        let settings = Settings { generations: 1, ..settings(folder.path()) };
        let (_, progress) = calibrate(&settings, |_| {}).unwrap();
        let unknowns = unknowns(settings.fit, settings.widen);
        let trial = evaluate(&settings, &[point(&unknowns, &settings.base)])[0];
        assert_eq!(trial.loss, progress.history[0].middle);
        assert!(trial.hits <= trial.signs && trial.signs <= 1.0, "{trial:?}");
    }

    #[test]
    fn a_start_anywhere_is_the_best_of_the_robots_that_are_tried() {
        let folder = tempfile::tempdir().unwrap();
        let begun = |tries| {
            let settings = Settings { start: Start::Anywhere, tries, ..settings(folder.path()) };
            let unknowns = unknowns(settings.fit, settings.widen);
            let start = anywhere(&settings, &unknowns).unwrap();
            losses(&settings, &unknowns, &[start], NO_GENERATION)[0]
        };
        assert!(begun(12) < begun(1));
    }

    #[test]
    fn a_mode_that_is_missed_costs_more_than_one_that_is_just_met() {
        let goal = Goal::Mode(paper_modes().remove(0), Also::default());
        let walks = [0.2, 0.012, 0.0, -0.1]
            .map(|forward| goal.loss(Twist { forward, lateral: 0.0, yaw: 0.0 }));
        assert!(walks.is_sorted() && walks[0] < 0.01 && walks[3] > 5.0, "{walks:?}");
    }

    #[test]
    fn a_turn_that_backs_up_costs_more_than_one_that_advances() {
        let turn = Goal::Mode(paper_modes().remove(2), Also { advances: true, strict: false });
        let walks =
            [0.08, 0.04, -0.04].map(|forward| turn.loss(Twist { forward, lateral: 0.0, yaw: 1.9 }));
        assert!(walks.is_sorted() && walks[0] < 1.0 && walks[2] > 10.0, "{walks:?}");
    }

    #[test]
    fn a_strict_search_pays_for_what_is_not_minimal_and_for_a_heading_that_turns() {
        let forward = Goal::Mode(paper_modes().remove(0), Also { advances: false, strict: true });
        let loss = |lateral, yaw| forward.loss(Twist { forward: 0.06, lateral, yaw });
        let walks = [loss(0.0, 0.02), loss(0.0, 0.12), loss(0.0, 0.35), loss(0.055, 0.35)];
        assert!(walks.is_sorted() && walks[0] < 0.1 && walks[2] > 5.0, "{walks:?}");
        assert!(walks.iter().all(|loss| *loss < forward.worst()));
    }

    #[test]
    fn a_written_model_reads_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("models/w.toml");
        let model = RobotModel::named("W").unwrap();
        write_model(&path, &model, "two\nlines").unwrap();
        assert_eq!(RobotModel::named(path.to_str().unwrap()).unwrap(), model);
    }
}
