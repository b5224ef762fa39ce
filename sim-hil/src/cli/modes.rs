//! `flix-sim modes`: natural frequencies, damping and shapes.

use std::process::ExitCode;

use anstream::{print, println};
use clap::ValueEnum;

use super::Error;
use super::arguments::{ModelArgs, parse_leg};
use crate::experiment::probe::{self, Clamp, Modes};

/// List the natural frequencies, damping ratios and shapes of small motions.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim modes --clamp feet\n  flix-sim modes --clamp leg --leg fl --model A --json"
)]
pub struct Args {
    /// What is held: one leg at its root, or the ends of each foot's long edge; nothing unless told
    #[arg(long, value_enum)]
    clamp: Option<Held>,
    /// Which leg, with --clamp leg: fl, fr, rl, rr
    #[arg(long, default_value = "fl", value_parser = parse_leg)]
    leg: usize,
    #[command(flatten)]
    model: ModelArgs,
    /// Write JSON, and nothing else
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

/// # Errors
/// When the model is refused or has no legs.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    let clamp = match args.clamp {
        None => Clamp::None,
        Some(Held::Leg) => Clamp::Leg(args.leg),
        Some(Held::Feet) => Clamp::Feet,
    };
    let found = probe::modes(&model, clamp)?;
    if args.json {
        println!("{}", serde_json::to_string(&found)?);
    } else {
        print!("{}", report(&model.name, &found));
    }
    Ok(ExitCode::SUCCESS)
}

/// Share of the largest entry from which a coordinate is named.
const NAMED: f64 = 0.35;

fn report(model: &str, found: &Modes) -> String {
    let mut text = format!(
        "Model {model}: {} modes, {} motions that no spring resists\n\n  f (Hz)   damping ratio   moves most\n",
        found.modes.len(),
        found.rigid_motions
    );
    for mode in &found.modes {
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
        text += &format!(
            "{:>8.2} {:>15.4}   {}\n",
            mode.frequency_hz,
            mode.damping_ratio,
            names.join(", ")
        );
    }
    text
}
