//! `flix-sim shake`: what the shaker does to the body.

use std::process::ExitCode;

use anstream::{print, println};
use clap::ValueEnum;

use super::Error;
use super::arguments::{ModelArgs, SetpointArgs, parse_seconds};
use crate::experiment::probe::{self, ShakeBase, Shaken};
use crate::experiment::walk::DEFAULT_STEP;

/// Turn the rotors steadily and tell the amplitudes of forces and of the body's motion.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim shake --frequency 30 --direction 0 --base fixed\n  flix-sim shake --frequency -30 --direction 45 --base air --model A --json"
)]
pub struct Args {
    #[command(flatten)]
    setpoint: SetpointArgs,
    /// What the body stands on: a test stand, nothing, or its own feet
    #[arg(long, value_enum, default_value_t = On::Fixed)]
    base: On,
    /// Step of the simulation
    #[arg(long, value_name = "TIME", value_parser = parse_seconds)]
    step: Option<f64>,
    #[command(flatten)]
    model: ModelArgs,
    /// Write JSON, and nothing else
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum On {
    /// The body is held; forces are those on a test stand.
    Fixed,
    /// The body floats.
    Air,
    /// The body stands on its feet.
    Floor,
}

/// # Errors
/// When f or theta is out of range, or the model is refused.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    let base = match args.base {
        On::Fixed => ShakeBase::Fixed,
        On::Air => ShakeBase::Air,
        On::Floor => ShakeBase::Floor,
    };
    let step = args.step.unwrap_or(DEFAULT_STEP);
    let found = probe::shake(&model, args.setpoint.check()?, base, step)?;
    if args.json {
        println!("{}", serde_json::to_string(&found)?);
    } else {
        print!("{}", report(&found));
    }
    Ok(ExitCode::SUCCESS)
}

fn report(found: &Shaken) -> String {
    let row = |name: &str, v: [f64; 3], unit: &str| {
        format!("{name:28}{:>11.5}{:>11.5}{:>11.5} {unit}\n", v[0], v[1], v[2])
    };
    format!("{:28}{:>11}{:>11}{:>11}\n", "amplitude", "x", "y", "z")
        + &row("force of the rotors", found.force_n, "N")
        + &row("torque of the rotors", found.torque_nm, "N m")
        + &row("displacement of the body", found.displacement_mm, "mm")
        + &row("rotation of the body", found.rotation_deg, "deg")
        + &format!(
            "\npeak force along theta {:.4} N, across it {:.6} N\n",
            found.peak_force_along_n, found.peak_force_across_n
        )
}
