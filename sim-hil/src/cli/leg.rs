//! `flix-sim leg`: bend one leg and let it ring.

use std::process::ExitCode;

use anstream::{print, println};

use super::Error;
use super::arguments::{ModelArgs, Vector, parse_leg};
use crate::experiment::probe::{self, LegProbe};
use crate::experiment::walk::DEFAULT_STEP;
use crate::model::LEGS;
use crate::plant::Wrench;

/// Load the tip of one clamped leg, then let go and watch it ring.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Axes: x forward, y left, z up. The tip is the end of the beam; the foot stays on.\n\nExamples:\n  flix-sim leg --force 0.2,0,0 --model A\n  flix-sim leg --leg rr --torque 0,0,0.01 --json"
)]
pub struct Args {
    /// Which leg: fl, fr, rl, rr
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
    /// Write JSON, and nothing else
    #[arg(long)]
    json: bool,
}

/// # Errors
/// When the model is refused, has no legs, or the leg cannot bear the load.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    let load = Wrench { force: args.force.0, torque: args.torque.0 };
    let found = probe::leg(&model, args.leg, load, DEFAULT_STEP)?;
    if args.json {
        println!("{}", serde_json::to_string(&found)?);
    } else {
        print!("{}", report(args, &model.name, &found));
    }
    Ok(ExitCode::SUCCESS)
}

fn report(args: &Args, model: &str, found: &LegProbe) -> String {
    let row = |name: &str, v: [f64; 3], unit: &str| {
        format!("{name:24}{:>10.4}{:>10.4}{:>10.4} {unit}\n", v[0], v[1], v[2])
    };
    let ring = found.ring_down;
    format!("Leg {} of model {model}, clamped at its root\n\n", LEGS[args.leg])
        + &format!("{:24}{:>10}{:>10}{:>10}\n", "", "x", "y", "z")
        + &row("force on the tip", args.force.0, "N")
        + &row("torque on the tip", args.torque.0, "N m")
        + &row("displacement", found.displacement_mm, "mm")
        + &row("rotation", found.rotation_deg, "deg")
        + &format!(
            "\nlet go: rings at {:.2} Hz (natural {:.2} Hz), damping ratio {:.4}\n",
            ring.damped_frequency_hz, ring.frequency_hz, ring.damping_ratio
        )
}
