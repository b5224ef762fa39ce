//! `flix-sim commission`: robots whose motors nobody knows find their own values.

use std::process::ExitCode;

use flix_shell::number::{whole, within};

use super::error::Error;
use super::measure::{MeasureArgs, measure};
use flix_sim::reliability::commission::{motors, voltage_mode, wiring_faults};

/// Let robots with unknown motors find their own values, and check these
///
/// Each robot is drawn: phase resistance 0.1 to 10 ohm, inductance 20 uH to 5 mH, flux linkage 0.5 to 10 mWb, 4 to 14 pole
/// pairs, encoders up to 2.5 ms late, current amplifiers wrong by up to 20 %, with and without a battery divider. It is
/// commissioned over its link as `flix commission` does it; on a board without current sense it must refuse until the
/// motors are entered, to 3 %, and then find how late its encoders are; with each of 23 wiring faults it must name the fault with its
/// motor and phase. 100 robots take eight minutes.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim commission\n  flix-sim commission --seeds 100 --first-seed 7000 --json\n  \
                  flix-sim commission --loss 0.3"
)]
pub struct Args {
    /// How many robots
    #[arg(long, value_name = "COUNT", default_value_t = 20, value_parser = whole::<usize>(1..=100_000))]
    seeds: usize,
    /// Seed of the first robot; the others follow
    #[arg(long, value_name = "SEED", default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    first_seed: u64,
    /// Share of datagrams lost, each way, 0 to 0.9, but while wiring faults are searched
    #[arg(long, value_name = "SHARE", default_value_t = 0.01, value_parser = within(0.0..=0.9, "share", ""))]
    loss: f64,
    #[command(flatten)]
    measure: MeasureArgs,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let seeds = (0..args.seeds as u64).map(|count| args.first_seed.wrapping_add(count));
    let seeds: Vec<u64> = seeds.collect();
    let parts = (motors(&seeds, args.loss), voltage_mode(&seeds, args.loss), wiring_faults(&seeds));
    measure("commission", &[&parts.0, &parts.1, &parts.2], &args.measure)
}
