//! `flix-sim eigenmodes`: natural frequencies, damping ratios and shapes of small motions.

use std::process::ExitCode;

use clap::ValueEnum;

use super::arguments::{ModelArgs, parse_leg};
use super::error::Error;
use super::output::{print_figures, row, table};
use flix_sim::experiment::probe::{self, Clamp, Eigenmodes};

/// List natural frequencies, damping ratios and shapes of small motions
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim eigenmodes --clamp feet\n  flix-sim eigenmodes --clamp leg --leg fl --model A --json"
)]
pub struct Args {
    /// What is held: one leg at its root, or the ends of each foot's long edge [default: nothing]
    #[arg(long, value_enum)]
    clamp: Option<Held>,
    /// Leg of --clamp leg: fl, fr, rl or rr
    #[arg(long, default_value = "fl", value_parser = parse_leg)]
    leg: usize,
    #[command(flatten)]
    model: ModelArgs,
    /// Print JSON only
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Held {
    /// One leg at its root.
    Leg,
    /// All feet.
    Feet,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    let clamp = match args.clamp {
        None => Clamp::None,
        Some(Held::Leg) => Clamp::Leg(args.leg),
        Some(Held::Feet) => Clamp::Feet,
    };
    let found = probe::eigenmodes(&model, clamp)?;
    print_figures(&found, true, args.json, || text(&model.name, &found))
}

/// Share of the largest entry from which a coordinate is named.
const NAMED: f64 = 0.35;

fn text(model: &str, found: &Eigenmodes) -> String {
    let mut rows = vec![row!["f (Hz)", "damping ratio", "moves most"]];
    for mode in &found.eigenmodes {
        let mut named: Vec<(f64, &str)> = mode
            .shape
            .iter()
            .zip(&found.coordinates)
            .filter(|(share, _)| share.abs() >= NAMED)
            .map(|(share, name)| (*share, name.as_str()))
            .collect();
        named.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
        let names: Vec<String> =
            named.iter().take(4).map(|(share, name)| format!("{name} {share:+.2}")).collect();
        rows.push(row![
            format!("{:.2}", mode.frequency_hz),
            format!("{:.4}", mode.damping_ratio),
            names.join(", ")
        ]);
    }
    format!(
        "Model {model}: {} eigenmodes, {} rigid motions\n\n{}",
        found.eigenmodes.len(),
        found.rigid_motions,
        table(&rows)
    )
}
