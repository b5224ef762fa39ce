//! `flix-sim faults`: what the robot does when something goes wrong.

use std::process::ExitCode;

use flix_shell::number::whole;

use super::error::Error;
use super::measure::{MeasureArgs, measure};
use flix_sim::reliability::fault_cases::{CASES, Case};
use flix_sim::reliability::fault_matrix::matrix;

/// Inject every fault in every walking mode at every onset and report what the robot does
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim faults\n  flix-sim faults --only partition --seed 7 --json"
)]
pub struct Args {
    /// Seed of the robot: its motors, wiring, sensor errors and noise
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    seed: u64,
    /// Inject only the faults with this in their name
    #[arg(long, value_name = "NAME", default_value = "")]
    only: String,
    #[command(flatten)]
    measure: MeasureArgs,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let wanted = |case: &Case| case.name.contains(&args.only);
    if !CASES.iter().any(wanted) {
        let names = CASES.map(|case| case.name).join(", ");
        return Err(Error::usage(format!(
            "--only {}: there is no such fault among {names}",
            args.only
        )));
    }
    measure("faults", &[&matrix(args.seed, wanted)], &args.measure)
}
