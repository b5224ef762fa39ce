//! `flix-sim study mobility`: which motion each f and theta gives.

use std::process::ExitCode;

use flix_host::nav::Position;
use flix_plot::{Figure, Series, Track, colour};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use serde::Serialize;

use super::options::{SweepArgs, show};
use crate::error::Error;
use crate::output::{headings, print, print_figures, row, table};
use flix_sim::experiment::walk::{Shaking, Spread, Walk, walk};
use flix_study::figure::axis;
use flix_study::front::{Gait, front, gaits};
use flix_study::modes::{ModeRow, classify, paper_modes, score_modes, strict_hits};
use flix_study::sweep::{Cell, Sweep, Variant, cells};

/// Interval of the points of a track, s: smooth over the shaking.
const TRACK_INTERVAL: f64 = 0.1;

/// Walk over the grid of f and theta: maps of the three speeds, tracks of the paper's walking modes and their scores
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A mode counts as a sign when the paper's component has its sign, and as a hit when it is also the largest of |forward|, |lateral| and 0.1 m x |yaw rate| and exceeds 0.01 m/s.\n\nExamples:\n  flix-sim study mobility\n  flix-sim study mobility --table3 --model W --seeds 8 --first-seed 100 --json\n  flix-sim study mobility --frequencies 40,60,80,100 --json    # beyond the robot's motors: the ideal drive alone\n  flix-sim study mobility --shard 1/8 --seeds 64 --out /shared/mobility"
)]
pub struct Args {
    #[command(flatten)]
    sweep: SweepArgs,
    /// Walk the nine modes of table III only (Right Strafing from table IV)
    #[arg(long, conflicts_with_all = ["frequencies", "directions"])]
    table3: bool,
    /// Print JSON only; draw no figure
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    model: String,
    seeds: u64,
    first_seed: u64,
    seconds: f64,
    step_s: f64,
    scatter: f64,
    rows: Vec<ModeRow>,
    /// Every pair that was walked.
    pairs: Vec<PairRow>,
    /// Pairs that no other beats in speed and cost of transport, from the slowest.
    front: Vec<Gait>,
    /// Modes with the right sign, on average over the seeds.
    mean_signs: f64,
    /// Modes that are hits, on average over the seeds.
    mean_hits: f64,
    /// Modes whose mean is a strict hit.
    strict_hits: usize,
    /// Translations among them that keep their heading.
    headings_kept: usize,
}

/// What a pair does.
#[derive(Debug, Serialize)]
struct PairRow {
    f_hz: f64,
    theta_deg: f64,
    /// The component that dominates, or `still`.
    motion: &'static str,
    forward_m_s: Spread,
    lateral_m_s: Spread,
    yaw_rad_s: Spread,
}

impl PairRow {
    fn of(cell: &Cell) -> Self {
        let [forward_m_s, lateral_m_s, yaw_rad_s] = cell.spreads();
        let motion = classify(cell.mean());
        Self {
            f_hz: cell.f_hz,
            theta_deg: cell.theta_deg,
            motion,
            forward_m_s,
            lateral_m_s,
            yaw_rad_s,
        }
    }
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.sweep.model()?;
    let variants = vec![Variant { name: "baseline".to_owned(), model }];
    let pairs = if args.table3 {
        paper_modes().iter().map(|mode| (mode.f_hz, mode.theta_deg)).collect()
    } else {
        args.sweep.grid()
    };
    let name = if args.table3 { "table3" } else { "mobility" };
    let sweep = args.sweep.sweep(name, variants, pairs);
    let Some(table) = args.sweep.run.run(&sweep)? else { return Ok(ExitCode::SUCCESS) };
    let cells = cells(&table);
    let report = report(&sweep, &cells, front(&gaits(&table)));
    if args.json {
        return print_figures(&report, true, true, String::new);
    }
    if !args.table3 {
        print(&(found_modes(&cells) + "\n"))?;
    }
    if !report.rows.is_empty() {
        print(&(text(&report) + "\n"))?;
    }
    print(&(best(&report.front) + "\n"))?;
    let folder = args.sweep.run.folder(&sweep);
    show(&table, &folder)?;
    if !args.table3 && !report.rows.is_empty() {
        print(&format!("figure  {}\n", tracks(&sweep)?.write(&folder, "tracks")?.png.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn report(sweep: &Sweep, cells: &[Cell], front: Vec<Gait>) -> Report {
    let rows = score_modes(&paper_modes(), cells);
    let mean =
        |of: fn(&ModeRow) -> usize| rows.iter().map(of).sum::<usize>() as f64 / sweep.seeds as f64;
    let (strict_hits, headings_kept) = strict_hits(&rows);
    Report {
        model: sweep.variants[0].model.name.clone(),
        seeds: sweep.seeds,
        first_seed: sweep.first_seed,
        seconds: sweep.seconds,
        step_s: sweep.step,
        scatter: sweep.scatter,
        mean_signs: mean(|row| row.signs),
        mean_hits: mean(|row| row.hits),
        strict_hits,
        headings_kept,
        rows,
        pairs: cells.iter().map(PairRow::of).collect(),
        front,
    }
}

fn text(report: &Report) -> String {
    let mut rows = vec![headings(
        "mode|f (Hz)|theta (deg)|signs|hits|strict|heading kept|forward (m/s)|lateral (m/s)|yaw (rad/s)",
    )];
    rows.extend(report.rows.iter().map(|it| {
        let [forward, lateral, yaw] =
            [it.forward_m_s, it.lateral_m_s, it.yaw_rad_s].map(|speed| format!("{speed:.4}"));
        let word = |kept: bool| if kept { "yes" } else { "no" };
        let (strict, kept) = (word(it.strict), it.keeps_heading.map_or("-", word));
        let (f, theta) = (it.f_hz, it.theta_deg);
        row![it.mode, f, theta, it.signs, it.hits, strict, kept, forward, lateral, yaw]
    }));
    format!(
        "Model {}, {} walks of {} s at {} ms (seeds from {}), scatter {} %\n\n{}\n\
         of {} modes, on average {:.2} have the right sign and {:.2} are hits; by their means {} are strict hits \
         (what should be minimal is at most half), and {} of {} translations keep their heading within 45 degrees in 8 s\n",
        report.model,
        report.seeds,
        report.seconds,
        1e3 * report.step_s,
        report.first_seed,
        100.0 * report.scatter,
        table(&rows),
        report.rows.len(),
        report.mean_signs,
        report.mean_hits,
        report.strict_hits,
        report.headings_kept,
        report.rows.iter().filter(|row| row.keeps_heading.is_some()).count()
    )
}

/// Returns the pairs that no other beats in both.
fn best(front: &[Gait]) -> String {
    let mut rows = vec![headings("f (Hz)|theta (deg)|speed (m/s)|cost of transport|yaw (rad/s)")];
    rows.extend(front.iter().map(|gait| {
        let [speed, cost, yaw] = [gait.speed_m_s, gait.cost_of_transport, gait.yaw_rad_s];
        row![
            gait.f_hz,
            gait.theta_deg,
            format!("{speed:.4}"),
            format!("{cost:.2}"),
            format!("{yaw:.2}")
        ]
    }));
    format!("Pairs that no other beats in speed and cost of transport\n\n{}", table(&rows))
}

/// Returns the grid with the word for each pair's mean motion.
fn found_modes(cells: &[Cell]) -> String {
    let (frequencies, directions) = (axis(cells, |c| c.f_hz), axis(cells, |c| c.theta_deg));
    let heads = directions.iter().map(|theta| format!("{theta}\u{b0}"));
    let mut rows = vec![row![""].into_iter().chain(heads).collect::<Vec<_>>()];
    rows.extend(frequencies.iter().rev().map(|f| {
        let words = directions.iter().map(|theta| {
            let cell = cells.iter().find(|cell| (cell.f_hz, cell.theta_deg) == (*f, *theta));
            cell.map_or("", |cell| classify(cell.mean())).to_owned()
        });
        row![format!("{f} Hz")].into_iter().chain(words).collect()
    }));
    table(&rows)
}

/// Figure 4a: the way of each of the paper's modes, all from one place.
fn tracks(sweep: &Sweep) -> Result<Track, Error> {
    let model = &sweep.variants[0].model;
    let ways: Vec<(String, Vec<Position>)> = paper_modes()
        .par_iter()
        .map(|mode| {
            let what = Walk {
                shaking: Shaking::new(mode.f_hz, mode.theta_deg).map_err(Error::usage)?,
                seconds: sweep.seconds,
                drive: sweep.drive,
                step: sweep.step,
                heading: Some(0.0),
            };
            let mut way = Vec::new();
            let mut next = 0.0;
            walk(model, &what, sweep.first_seed, |plant| {
                if plant.time() >= next {
                    let [x, y, _] = plant.body().position;
                    way.push(Position::new(x, y));
                    next = plant.time() + TRACK_INTERVAL;
                }
            })?;
            Ok((mode.name.clone(), way))
        })
        .collect::<Result<_, Error>>()?;
    let figure = Track::new(format!("Ways of model {}", model.name), "m").subtitle(format!(
        "the modes of table III, {} s each, seed {}; forward is to the right at the start",
        sweep.seconds, sweep.first_seed
    ));
    Ok(ways.into_iter().enumerate().fold(figure, |figure, (number, (name, way))| {
        let end = way.last().copied().unwrap_or_default();
        let shade = colour::CYCLE[number % colour::CYCLE.len()];
        figure.series(Series::line("", way).colour(shade)).mark(end, name, shade)
    }))
}
