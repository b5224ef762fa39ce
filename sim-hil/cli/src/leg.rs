//! `flix-sim leg`: bend one leg and let it ring.

use std::process::ExitCode;

use super::arguments::{ModelArgs, Vector, parse_leg};
use super::error::Error;
use super::output::{print_figures, row, table};
use flix_sim::experiment::probe::{self, LegProbe};
use flix_sim::experiment::walk::DEFAULT_STEP;
use flix_sim::model::LEGS;
use flix_sim::plant::Wrench;

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

/// Runs the command.
///
/// # Errors
/// When the model is refused, has no legs, or the leg cannot bear the load.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    let load = Wrench { force: args.force.0, torque: args.torque.0 };
    let found = probe::leg(&model, args.leg, load, DEFAULT_STEP)?;
    print_figures(&found, true, args.json, || text(args, &model.name, &found))
}

fn text(args: &Args, model: &str, found: &LegProbe) -> String {
    let row = |name: &str, [x, y, z]: [f64; 3], unit: &str| {
        row![name, format!("{x:.4}"), format!("{y:.4}"), format!("{z:.4}"), unit]
    };
    let ring = found.ring_down.map_or_else(
        || "no single eigenmode rings: read them below".to_owned(),
        |ring| {
            format!(
                "rings at {:.2} Hz (natural {:.2} Hz), damping ratio {:.4}",
                ring.damped_frequency_hz, ring.frequency_hz, ring.damping_ratio
            )
        },
    );
    let mut eigenmodes = vec![row!["eigenmode", "natural (Hz)", "damping ratio"]];
    eigenmodes.extend(found.eigenmodes.iter().enumerate().map(|(index, mode)| {
        row![index + 1, format!("{:.2}", mode.frequency_hz), format!("{:.4}", mode.damping_ratio)]
    }));
    format!(
        "Leg {} of model {model}, clamped at its root\n\n{}\n\
         released: {ring}\n\n{}",
        LEGS[args.leg],
        table(&[
            row!["", "x", "y", "z"],
            row("force on the tip", args.force.0, "N"),
            row("torque on the tip", args.torque.0, "N m"),
            row("displacement", found.displacement_mm, "mm"),
            row("rotation", found.rotation_deg, "deg"),
        ]),
        table(&eigenmodes),
    )
}
