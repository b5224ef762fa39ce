//! `flix-sim shake`: what the shaker does to the body.

use std::process::ExitCode;
use std::time::Duration;

use super::arguments::{ModelArgs, SetpointArgs, parse_step};
use super::error::Error;
use super::output::{print_figures, row, table};
use flix_sim::experiment::probe::{self, ShakeBase, Shaken};
use flix_sim::experiment::walk::DEFAULT_STEP;

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

/// Runs the command.
///
/// # Errors
/// When f or theta is out of range, or the model is refused.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    let step = args.step.map_or(DEFAULT_STEP, |step| step.as_secs_f64());
    let found = probe::shake(&model, args.setpoint.check()?, args.base, step)?;
    print_figures(&found, true, args.json, || text(&found))
}

fn text(found: &Shaken) -> String {
    let row = |name: &str, [x, y, z]: [f64; 3], unit: &str| {
        row![name, format!("{x:.5}"), format!("{y:.5}"), format!("{z:.5}"), unit]
    };
    format!(
        "{}\npeak force along theta {:.4} N, across it {:.6} N\n",
        table(&[
            row!["amplitude", "x", "y", "z"],
            row("force of the rotors", found.force_n, "N"),
            row("torque of the rotors", found.torque_nm, "N m"),
            row("displacement of the body", found.displacement_mm, "mm"),
            row("rotation of the body", found.rotation_deg, "deg"),
        ]),
        found.peak_force_along_n,
        found.peak_force_across_n
    )
}
