//! `flix-sim shake`: what the shaker does to the body.

use std::process::ExitCode;
use std::time::Duration;

use super::arguments::{ModelArgs, SetpointArgs, parse_step};
use super::error::Error;
use super::output::print_figures;
use flix_sim::experiment::probe::{self, ShakeBase};
use flix_sim::experiment::walk::DEFAULT_STEP;
use flix_sim::study::lines;

/// Report the amplitudes of the shaker's forces and of the body's motion
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim shake --frequency 30 --direction 0 --base fixed\n  flix-sim shake --frequency -30 --direction 45 --base air --model A --json"
)]
pub struct Args {
    #[command(flatten)]
    setpoint: SetpointArgs,
    /// Base under the body
    #[arg(long, value_enum, default_value_t = ShakeBase::Fixed)]
    base: ShakeBase,
    /// Step of the simulation [default: 0.1ms]
    #[arg(long, value_name = "TIME", value_parser = parse_step)]
    step: Option<Duration>,
    #[command(flatten)]
    model: ModelArgs,
    /// Print JSON only
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    let step = args.step.map_or(DEFAULT_STEP, |step| step.as_secs_f64());
    let found = probe::shake(&model, args.setpoint.check()?, args.base, step)?;
    print_figures(&found, true, args.json, || lines(&found))
}
