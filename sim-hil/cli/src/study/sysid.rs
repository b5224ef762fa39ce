//! `flix-sim study sysid`: which robot a real one is, with error bars.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use flix_shell::number::whole;
use rayon::iter::{IntoParallelIterator, ParallelIterator};

use crate::arguments::ModelArgs;
use crate::error::Error;
use crate::output::{mark, print, print_figures, progress, row, table};
use flix_study::calibrate::write_model;
use flix_study::sysid::synthetic::{
    self, COVERAGE, HELD_OUT_RATIO, MEDIAN_CENTRE_MM, MEDIAN_SHARE, QUICK_WALKS, Score, Verdict,
    WALKS,
};
use flix_study::sysid::{Data, EXPERIMENTS, SysidError, identify, report};
use flix_study::write_whole;

/// Identify a robot from experiments, with error bars
#[derive(Debug, clap::Args)]
#[command(
    after_help = "DATA_DIR holds the CSV of each experiment that there is: scales.csv, legs.csv, air.csv, drag.csv, drops.csv, walks.csv. sim-hil/docs/sysid.md has their columns, and how each is made. What is missing is reported with what it would bring. --model is the plan that the robot was built by.\n\nExamples:\n  flix-sim study sysid --synthetic 1\n  flix-sim study sysid out/study/sysid/hidden-1 --out out/study/sysid/found\n  flix-sim study sysid --synthetic 100 --json"
)]
pub struct Args {
    #[command(flatten)]
    model: ModelArgs,
    /// Folder of the experiments
    #[arg(value_name = "DATA_DIR", required_unless_present = "synthetic")]
    data: Option<PathBuf>,
    /// Hide so many robots instead, measure them, identify them and compare with the truth
    #[arg(long, value_name = "N", conflicts_with = "data", value_parser = whole::<u64>(1..=10_000))]
    synthetic: Option<u64>,
    /// Seed of the first hidden robot
    #[arg(long, value_name = "S", default_value_t = 1, value_parser = whole::<u64>(0..=1_000_000_000))]
    first_seed: u64,
    /// Seed of the ensembles
    #[arg(long, default_value_t = 1, conflicts_with = "synthetic", value_parser = whole::<u64>(0..=u64::MAX))]
    seed: u64,
    /// Folder for model and report, or for the experiments of the hidden robots [default: DATA_DIR, or out/study/sysid]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Take a first look: short walks of the hidden robots
    #[arg(long, requires = "synthetic")]
    quick: bool,
    /// Print JSON only
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    match &args.data {
        Some(folder) => one(args, folder),
        None => hidden(args, args.synthetic.unwrap_or(1)),
    }
}

fn one(args: &Args, folder: &Path) -> Result<ExitCode, Error> {
    let plan = args.model.load()?;
    let data = Data::read(folder)?;
    let bar = progress(EXPERIMENTS.len() as u64, "identifying");
    let found = identify(&plan, &data, args.seed, true, |_| bar.inc(1))?;
    bar.finish_and_clear();
    let out = args.out.as_deref().unwrap_or(folder);
    let from = folder.display().to_string();
    let (model, page) = (out.join("identified.toml"), out.join("report.html"));
    write_model(&model, &found.model, &report::origin(&found, &args.model.model, &from))
        .map_err(Error::write(&model))?;
    write_whole(&page, report::html(&found, &from).as_bytes()).map_err(Error::write(&page))?;
    if args.json {
        return print_figures(&found, true, true, String::new);
    }
    print(&table(&report::values(&found)))?;
    print(&format!("\n{}", table(&report::stages(&found))))?;
    print(&format!("\n{}", table(&report::proposals(&found))))?;
    print(&format!("\n{}\n", report::remarks(&found).join("\n")))?;
    print(&format!("\nmodel   {}\nreport  {}\n", model.display(), page.display()))?;
    Ok(ExitCode::SUCCESS)
}

fn hidden(args: &Args, robots: u64) -> Result<ExitCode, Error> {
    let plan = args.model.load()?;
    let out = args.out.clone().unwrap_or_else(|| PathBuf::from("out/study/sysid"));
    let walks = if args.quick { QUICK_WALKS } else { WALKS };
    let bar = progress(robots, "identifying");
    let scores: Vec<Score> = (0..robots)
        .into_par_iter()
        .map(|index| {
            let seed = args.first_seed + index;
            let folder = out.join(format!("hidden-{seed}"));
            let score = synthetic::trial(&plan, seed, walks, &folder);
            bar.inc(1);
            score
        })
        .collect::<Result<_, SysidError>>()?;
    bar.finish_and_clear();
    let verdict = synthetic::judge(&scores);
    print_figures(&verdict, verdict.pass, args.json, || text(&verdict))
}

fn text(verdict: &Verdict) -> String {
    let (covered, off) = (verdict.coverage, verdict.median_error);
    let share = |share: f64| format!("{:.2} %", 100.0 * share);
    let kinds = [
        ("stiffness", covered.stiffness, share(off.stiffness), off.stiffness <= MEDIAN_SHARE),
        ("damping", covered.damping, share(off.damping), true),
        ("friction", covered.friction, share(off.friction), off.friction <= MEDIAN_SHARE),
        ("centre", covered.centre, format!("{:.3} mm", off.centre), off.centre <= MEDIAN_CENTRE_MM),
    ];
    let mut rows = vec![row!["", "in 95 % interval", "median error", ""]];
    rows.extend(kinds.map(|(kind, covered, off, near)| {
        let covers = !verdict.has_enough() || COVERAGE.contains(&covered);
        row![kind, share(covered), off, mark(near && covers)]
    }));
    format!(
        "{}\nheld-out walks: {:.3} times the error of the fitted ones {}\n{} hidden robots; coverage and held-out walks are judged from a hundred on\n",
        table(&rows),
        verdict.held_out_ratio,
        mark(!verdict.has_enough() || verdict.held_out_ratio <= HELD_OUT_RATIO),
        verdict.robots
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use flix_study::sysid::synthetic::{ENOUGH, Kinds};

    #[test]
    fn coverage_and_held_out_walks_are_marked_from_a_hundred_robots_on() {
        let of = |each| Kinds { stiffness: each, damping: each, friction: each, centre: each };
        let marks = |robots: usize| {
            let (coverage, median_error) = (of(1.0), of(0.01));
            let robots = robots as u64;
            let verdict =
                Verdict { robots, coverage, median_error, held_out_ratio: 2.0, pass: true };
            text(&verdict).matches(mark(false)).count()
        };
        assert_eq!((marks(ENOUGH - 1), marks(ENOUGH)), (0, 5));
    }
}
