//! `flix-sim study calibrate`: the robot that fits.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use flix_plot::{Chart, Figure, Panel, Series};
use flix_shell::number::{whole, within};
use flix_shell::output::print_json;
use serde::Serialize;

use super::options::{judged, listen};
use crate::arguments::{ModelArgs, parse_step, parse_time};
use crate::error::Error;
use crate::output::{print, progress, row, table};
use flix_sim::experiment::walk::WalkDrive;
use flix_sim::model::RobotModel;
use flix_sim::study::Shard;
use flix_study::calibrate::{
    self, Also, CalibrationError, Fit, Generation, Goal, Progress, Settings, Start, Trial, Unknown,
    WIDEST, unknowns, values, write_model,
};
use flix_study::cmaes::usual_population;
use flix_study::figure::overlay;
use flix_study::measured::{self, Measured};
use flix_study::modes::{
    Component, PaperMode, paper_modes, score_modes, shuffled_modes, strict_hits,
};
use flix_study::sweep::{Cell, SECONDS, Sweep, Variant, cells};
use flix_study::{Earlier, Options};

/// First seed of the walks that judge the result: none of the search's.
const FRESH_SEED: u64 = 1_000_001;

/// Fit the open choices, the paper's error set, or both; judge the result with fresh seeds
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Each generation tries every candidate on the same, new samples: scattered robots, disturbed starts, each step in turn. The result is the middle of the final distribution. Interrupted, the same command goes on.\n\nA laboratory's speeds are a CSV with the columns f_hz,theta_deg,forward_m_s,lateral_m_s,yaw_rad_s.\n\nExamples:\n  flix-sim study calibrate --generations 60\n  flix-sim study calibrate --measured speeds.csv --fit both --hold-out 3,7\n  flix-sim study calibrate --model flix --fit unpublished --advance    # the paper's friction and S* as given\n  flix-sim study calibrate --fit unpublished --points points.csv    # a number of 0 to 1 for each unknown; an empty file lists them\n  flix-sim study calibrate --start anywhere --widen 3 --shuffle 1    # what chance reaches on an invented table"
)]
pub struct Args {
    #[command(flatten)]
    model: ModelArgs,
    /// Mean speeds of a prototype; without it the modes of tables III and IV are fitted
    #[arg(long, value_name = "CSV")]
    measured: Option<PathBuf>,
    /// Where the search begins
    #[arg(long, value_enum, default_value = "model")]
    start: Start,
    /// Random robots of which the best is where a search from anywhere begins
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = whole::<u16>(1..=10_000))]
    tries: u16,
    /// Fit an invented table instead: the same motions dealt to the pairs at random
    #[arg(long, value_name = "SEED", conflicts_with = "measured")]
    shuffle: Option<u64>,
    /// Ask both turns of table IV to advance at 0.05 m/s or more, too
    #[arg(long, conflicts_with = "measured")]
    advance: bool,
    /// Ask each mode for a strict hit, and each translation to keep its heading, too
    #[arg(long, conflicts_with = "measured")]
    strict: bool,
    /// Rows to leave out of the fit and to report, counted from 1
    #[arg(long, value_name = "ROWS", value_delimiter = ',')]
    hold_out: Vec<usize>,
    /// What the search may change [default: open for modes, both for measured speeds]
    #[arg(long, value_enum)]
    fit: Option<Fit>,
    /// How much wider than usual the searched ranges are, about their middles
    #[arg(long, value_name = "TIMES", default_value_t = 1.0, value_parser = within(1.0..=WIDEST, "number", ""))]
    widen: f64,
    /// Number of generations
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = whole::<u64>(1..=100_000))]
    generations: u64,
    /// First step of the search, as a share of the ranges
    #[arg(long, value_name = "SHARE", default_value_t = 0.15, value_parser = within(0.001..=0.5, "share", ""))]
    first_step: f64,
    /// Candidates a generation, at least 4 [default: as many as the method takes for the number of unknowns]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(4..=1000))]
    population: Option<u16>,
    /// Scattered robots that each candidate is tried as
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = whole::<u16>(1..=1000))]
    samples: u16,
    /// How far every number of the model scatters, as a share
    #[arg(long, value_name = "SHARE", default_value_t = 0.02, value_parser = within(0.0..=0.2, "share", ""))]
    scatter: f64,
    /// Steps of the simulation, taken in turn
    #[arg(long, value_name = "TIMES", value_delimiter = ',', default_values = ["0.1ms", "0.05ms"], value_parser = parse_step)]
    step: Vec<Duration>,
    /// Time of each walk of the search
    #[arg(long, value_name = "TIME", default_value = "8s", value_parser = parse_time)]
    seconds: Duration,
    /// Walks of each row that judge the result
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = whole::<u64>(1..=1000))]
    fresh_seeds: u64,
    /// Seed of everything random in the search
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=1_000_000))]
    seed: u64,
    /// Take a first look: short, coarse walks and few generations
    #[arg(long)]
    quick: bool,
    /// Folder for the search, the model and the figure
    #[arg(long, value_name = "DIR", default_value = "out/study/calibrate")]
    out: PathBuf,
    /// Forget what an earlier search left there
    #[arg(long)]
    restart: bool,
    /// Search nothing, but try the points of this CSV and print JSON: for an optimiser of your own. A row is a point, a column an
    /// unknown, each a share of its range
    #[arg(long, value_name = "CSV", conflicts_with_all = ["hold_out", "quick", "restart"])]
    points: Option<PathBuf>,
}

/// What `--points` prints.
#[derive(Debug, Serialize)]
struct Tried {
    /// What the columns are.
    unknowns: Vec<Range>,
    /// One for each row.
    trials: Vec<Trial>,
}

/// An unknown and its range.
#[derive(Debug, Serialize)]
struct Range {
    name: String,
    low: f64,
    high: f64,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let goals = goals(args)?;
    let (fitted, held) = split(goals, &args.hold_out)?;
    let settings = settings(args, fitted)?;
    if let Some(file) = &args.points {
        return try_points(&settings, file);
    }
    let bar = progress(settings.generations, "calibrating");
    let mut resumed = false;
    let outcome = calibrate::calibrate(&settings, |so_far: &Progress| {
        bar.set_position(so_far.search.generation());
        if !resumed {
            bar.reset_eta();
            resumed = true;
        }
    });
    bar.finish_and_clear();
    let (mut model, so_far) = outcome?;
    model.name = "calibrated".to_owned();
    print(&chosen(&settings, &so_far))?;
    let (judged, walked) = judge(args, &settings, &model, &held)?;
    print(&format!("\n{judged}"))?;
    let path = args.out.join("calibrated.toml");
    write_model(&path, &model, &origin(args, &judged)).map_err(Error::write(&path))?;
    let figure = course(&so_far.history).write(&args.out, "calibration")?;
    print(&format!("\nmodel   {}\nfigure  {}\n", path.display(), figure.png.display()))?;
    let measured: Vec<(Measured, Cell)> = walked
        .into_iter()
        .filter_map(|(goal, cell)| match goal {
            Goal::Measured(row) => Some((row, cell)),
            Goal::Mode(..) => None,
        })
        .collect();
    if !measured.is_empty() {
        let figure = overlay(&model.name, &measured).write(&args.out, "overlay")?;
        print(&format!("figure  {}\n", figure.png.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Tries the points of a file.
fn try_points(settings: &Settings, file: &Path) -> Result<ExitCode, Error> {
    let unknowns = unknowns(settings.fit, settings.widen);
    let points = measured::points(file, unknowns.len())?;
    if settings.base.legs.is_none() {
        return Err(CalibrationError::NoLegs(settings.base.name.clone()).into());
    }
    let trials = calibrate::evaluate(settings, &points);
    if settings.interrupt.is_raised() {
        return Err(CalibrationError::Interrupted(0).into());
    }
    let ranges =
        unknowns.into_iter().map(|Unknown { name, low, high, .. }| Range { name, low, high });
    print_json(&Tried { unknowns: ranges.collect(), trials })?;
    Ok(ExitCode::SUCCESS)
}

fn goals(args: &Args) -> Result<Vec<Goal>, Error> {
    let modes = match (&args.measured, args.shuffle) {
        (Some(path), _) => {
            return Ok(measured::speeds(path)?.into_iter().map(Goal::Measured).collect());
        }
        (None, Some(seed)) => shuffled_modes(seed),
        (None, None) => paper_modes(),
    };
    let steers = |mode: &PaperMode| mode.component == Component::Yaw && mode.theta_deg == 90.0;
    let goal = |mode: PaperMode| {
        let also = Also { advances: args.advance && steers(&mode), strict: args.strict };
        Goal::Mode(mode, also)
    };
    Ok(modes.into_iter().map(goal).collect())
}

/// Rows that are fitted, rows that are held out.
fn split(goals: Vec<Goal>, hold_out: &[usize]) -> Result<(Vec<Goal>, Vec<Goal>), Error> {
    let rows = goals.len();
    if let Some(row) = hold_out.iter().find(|row| !(1..=rows).contains(row)) {
        return Err(Error::usage(format!(
            "there is no row {row} to hold out: rows are 1 to {rows}"
        )));
    }
    let (held, fitted): (Vec<_>, Vec<_>) =
        goals.into_iter().enumerate().partition(|(index, _)| hold_out.contains(&(index + 1)));
    if fitted.is_empty() {
        return Err(Error::usage("all rows are held out: leave some to fit"));
    }
    let goals = |rows: Vec<(usize, Goal)>| rows.into_iter().map(|(_, goal)| goal).collect();
    Ok((goals(fitted), goals(held)))
}

fn settings(args: &Args, goals: Vec<Goal>) -> Result<Settings, Error> {
    let usual = if args.measured.is_some() { Fit::Both } else { Fit::Open };
    let fit = args.fit.unwrap_or(usual);
    let settings = Settings {
        base: args.model.load()?,
        start: args.start,
        tries: usize::from(args.tries),
        first_step: args.first_step,
        fit,
        widen: args.widen,
        goals,
        population: args
            .population
            .map_or_else(|| usual_population(unknowns(fit, args.widen).len()), usize::from),
        samples: usize::from(args.samples),
        scatter: args.scatter,
        steps: args.step.iter().map(Duration::as_secs_f64).collect(),
        seconds: args.seconds.as_secs_f64(),
        generations: args.generations,
        seed: args.seed,
        checkpoint: args.out.join("search.toml"),
        restart: args.restart,
        interrupt: listen()?,
    };
    Ok(if args.quick {
        Settings { samples: 1, steps: vec![5e-4], seconds: 0.5, generations: 2, ..settings }
    } else {
        settings
    })
}

/// What the search chose.
fn chosen(settings: &Settings, so_far: &Progress) -> String {
    let unknowns = unknowns(settings.fit, settings.widen);
    let values = values(&unknowns, &so_far.search.mean());
    let mut rows = vec![row!["unknown", "chosen", "lowest", "highest"]];
    rows.extend(unknowns.iter().zip(values).map(|(unknown, value)| {
        row![unknown.name, format!("{value:.4}"), unknown.low, unknown.high]
    }));
    table(&rows)
}

/// Walks with fresh seeds: at each step, as built and scattered. Returns the verdicts, and each goal with its walks at the first
/// step, as built.
fn judge(
    args: &Args,
    settings: &Settings,
    model: &RobotModel,
    held: &[Goal],
) -> Result<(String, Vec<(Goal, Cell)>), Error> {
    let (mut text, mut walked) = (String::new(), Vec::new());
    let seconds = if args.quick { settings.seconds } else { SECONDS };
    let mut conditions: Vec<(f64, f64)> = settings.steps.iter().map(|step| (*step, 0.0)).collect();
    if settings.scatter > 0.0 {
        conditions.extend(settings.steps.first().map(|step| (*step, settings.scatter)));
    }
    for (number, (step, scatter)) in conditions.into_iter().enumerate() {
        for (kind, goals) in [("fitted", settings.goals.as_slice()), ("held-out", held)] {
            if goals.is_empty() {
                continue;
            }
            let sweep = Sweep {
                name: "judgement",
                variants: vec![Variant { name: "calibrated".to_owned(), model: model.clone() }],
                pairs: each_once(goals.iter().map(Goal::pair)),
                seeds: if args.quick { 1 } else { args.fresh_seeds },
                first_seed: FRESH_SEED,
                seconds,
                step,
                drive: WalkDrive::Ideal,
                scatter,
                mirrored: false,
            };
            let table = flix_study::run(
                &sweep,
                &Options {
                    folder: args.out.join("judgement"),
                    shard: Shard::WHOLE,
                    earlier: Earlier::Forget,
                    interrupt: settings.interrupt.clone(),
                },
            )?;
            let what = format!(
                "{kind} rows, {} fresh seeds, {} ms, scatter {} %",
                sweep.seeds,
                1e3 * step,
                100.0 * scatter
            );
            let cells = cells(&judged(&table)?);
            let own = |goal: &Goal| {
                cells.iter().find(|cell| (cell.f_hz, cell.theta_deg) == goal.pair()).cloned()
            };
            let rows: Vec<(Goal, Cell)> =
                goals.iter().filter_map(|goal| Some((goal.clone(), own(goal)?))).collect();
            text += &verdict(&what, &rows, sweep.seeds);
            if number == 0 {
                walked.extend(rows);
            }
        }
    }
    Ok((text, walked))
}

/// Returns the pairs without those that came before: a laboratory may measure one several times.
fn each_once(pairs: impl Iterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    let mut once = Vec::new();
    for pair in pairs {
        if !once.contains(&pair) {
            once.push(pair);
        }
    }
    once
}

fn verdict(what: &str, walked: &[(Goal, Cell)], seeds: u64) -> String {
    let modes: Vec<PaperMode> = walked
        .iter()
        .filter_map(|(goal, _)| match goal {
            Goal::Mode(mode, _) => Some(mode.clone()),
            Goal::Measured(_) => None,
        })
        .collect();
    if modes.is_empty() {
        let square: f64 = walked.iter().map(|(goal, cell)| goal.loss(cell.mean())).sum();
        return format!("{what}: RMSE {:.4} m/s\n", (square / walked.len() as f64).sqrt());
    }
    let cells: Vec<Cell> = walked.iter().map(|(_, cell)| cell.clone()).collect();
    let rows = score_modes(&modes, &cells);
    let mean = |of: fn(&flix_study::modes::ModeRow) -> usize| {
        rows.iter().map(of).sum::<usize>() as f64 / seeds as f64
    };
    let each: Vec<String> =
        rows.iter().map(|row| format!("{} {}/{}", row.mode, row.hits, row.seeds)).collect();
    let (strict, kept) = strict_hits(&rows);
    format!(
        "{what}: of {} modes {:.2} signs, {:.2} hits ({}), {strict} strict by their means, {kept} with a kept heading\n",
        rows.len(),
        mean(|row| row.signs),
        mean(|row| row.hits),
        each.join(", ")
    )
}

/// Where the model comes from, for the head of its file.
fn origin(args: &Args, judged: &str) -> String {
    let command: Vec<String> = std::env::args().skip(1).collect();
    format!(
        "Calibrated from model {} by\n    flix-sim {}\n{judged}",
        args.model.model,
        command.join(" ")
    )
}

/// Loss over the generations.
fn course(history: &[Generation]) -> Chart {
    let line = |label: &str, of: fn(&Generation) -> f64| {
        Series::line(label, history.iter().enumerate().map(|(i, g)| (i as f64, of(g))))
    };
    Chart::new("Calibration", "generation")
        .subtitle("each generation on its own samples")
        .x_whole()
        .panel(
            Panel::new("mean loss of a row")
                .series(line("middle of the distribution", |g| g.middle))
                .series(line("best candidate", |g| g.best)),
        )
        .panel(Panel::new("step, as a share of the ranges").series(line("", |g| g.sigma)))
}
