//! `flix-sim shiver`: settings near the border of what the robot arms with, and whether a rotor shivers at rest.

use std::process::ExitCode;

use flix_shell::number::whole;

use super::error::Error;
use super::measure::{MeasureArgs, measure};
use flix_sim::reliability::shiver::shivers;

/// Draw settings, judge them by the robot's stability margin, and run those nearest its border
///
/// Bandwidths, delays, limits and ramps are drawn, the motors are as their settings say. Each set that is run is driven at 5 Hz
/// and then rests for 5 s: the robot refuses to arm with it, both motors together stay below 0.5 W, or a fault names what is
/// wrong. 300 sets take ten seconds.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim shiver\n  flix-sim shiver --sets 10000 --nearest 10000 --first-seed 7000 --json"
)]
pub struct Args {
    /// How many sets are drawn and judged
    #[arg(long, value_name = "COUNT", default_value_t = 10_000, value_parser = whole::<usize>(1..=1_000_000))]
    sets: usize,
    /// How many of them are run, those nearest the border
    #[arg(long, value_name = "COUNT", default_value_t = 300, value_parser = whole::<usize>(1..=1_000_000))]
    nearest: usize,
    /// Seed of the first set; the others follow
    #[arg(long, value_name = "SEED", default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    first_seed: u64,
    #[command(flatten)]
    measure: MeasureArgs,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let study = shivers(args.sets, args.nearest, args.first_seed)?;
    measure("shiver", &[&study], &args.measure)
}
