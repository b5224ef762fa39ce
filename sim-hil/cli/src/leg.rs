//! `flix-sim leg`: bend one leg and let it ring.

use std::process::ExitCode;

use super::arguments::{ModelArgs, Vector, parse_leg};
use super::error::Error;
use super::output::print_figures;
use flix_sim::experiment::probe;
use flix_sim::experiment::walk::DEFAULT_STEP;
use flix_sim::plant::Wrench;
use flix_sim::study::lines;

/// Load the tip of one clamped leg, release it and measure how it rings
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Axes: x forward, y left, z up. The tip is the end of the beam; the foot stays on.\n\nExamples:\n  flix-sim leg --force 0.2,0,0 --model A\n  flix-sim leg --leg rr --torque 0,0,0.01 --json"
)]
pub struct Args {
    /// Leg: fl, fr, rl or rr
    #[arg(long, default_value = "fl", value_parser = parse_leg)]
    leg: usize,
    /// Force on the tip, N
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,0", allow_hyphen_values = true)]
    force: Vector,
    /// Torque on the tip, N m
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,0", allow_hyphen_values = true)]
    torque: Vector,
    #[command(flatten)]
    model: ModelArgs,
    /// Print JSON only
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    let load = Wrench { force: args.force.0, torque: args.torque.0 };
    let found = probe::leg(&model, args.leg, load, DEFAULT_STEP)?;
    print_figures(&found, true, args.json, || lines(&found))
}
