//! `flix-sim rest`: the robot put down and weighed.

use std::process::ExitCode;

use super::arguments::ModelArgs;
use super::error::Error;
use super::output::print_figures;
use flix_sim::experiment::probe;
use flix_sim::experiment::walk::DEFAULT_STEP;
use flix_sim::study::lines;

/// Drop the robot from 20 mm, wait until it rests, and weigh it
///
/// Fails when it does not come to rest within 5 s.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  flix-sim rest\n  flix-sim rest --model A --json")]
pub struct Args {
    #[command(flatten)]
    model: ModelArgs,
    /// Print JSON only
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    let found = probe::rest(&model, DEFAULT_STEP)?;
    print_figures(&found, found.at_rest, args.json, || lines(&found))
}
