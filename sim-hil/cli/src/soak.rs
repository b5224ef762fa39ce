//! `flix-sim soak`: hours of random commands, faults and link trouble, in virtual time.

use std::process::ExitCode;
use std::time::Duration;

use flix_shell::number::{whole, within};

use super::error::Error;
use super::measure::{MeasureArgs, measure};
use flix_sim::reliability::soak::soak;

/// Run robots through hours of random commands, faults and link trouble, in virtual time
///
/// In every tick: no current above its limit, nothing spinning while disarmed, never two operators, no late tick, no
/// stuck state. Now and then all is mended, and the robot has to shake as commanded.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim soak --hours 0.167\n  flix-sim soak --hours 24 --seed 7 --json"
)]
pub struct Args {
    /// Virtual time of all robots together, hours; a minute to a year
    #[arg(long, default_value_t = 1.0, value_parser = within(0.0167..=8_760.0, "number of hours", ""))]
    hours: f64,
    /// Seed of the robots and of what happens to them
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    seed: u64,
    #[command(flatten)]
    measure: MeasureArgs,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let total = Duration::from_secs_f64(3_600.0 * args.hours);
    measure("soak", &[&soak(args.seed, total)], &args.measure)
}
