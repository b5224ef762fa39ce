//! `flix-sim study sensitivity`: how far walks change with mass and friction.

use std::process::ExitCode;

use super::options::{SweepArgs, show};
use crate::error::Error;
use flix_sim::model::RobotModel;
use flix_study::sensitivity::{Change, variants};
use flix_study::sweep::Sweep;

/// Walk the grid with 50 g at an edge, or with other friction on the left: speeds and index I
#[derive(Debug, clap::Args)]
#[command(
    after_help = "mass: 50 g at the front, rear, left and right edge, 12 mm inside.\nfriction: left feet by -10, +10, -58 and +58 %; right feet by -10 % (in no index).\n\nExamples:\n  flix-sim study sensitivity mass\n  flix-sim study sensitivity friction --model W --seeds 8\n  flix-sim study sensitivity mass --shard 3/16 --out /shared/mass"
)]
pub struct Args {
    /// What is changed
    #[arg(value_enum)]
    change: Change,
    #[command(flatten)]
    sweep: SweepArgs,
}

/// Returns the walks of one change.
pub fn sweep(args: &SweepArgs, model: &RobotModel, change: Change) -> Sweep {
    let name = match change {
        Change::Mass => "sensitivity-mass",
        Change::Friction => "sensitivity-friction",
    };
    args.sweep(name, variants(model, change), args.grid())
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let sweep = sweep(&args.sweep, &args.sweep.model()?, args.change);
    if let Some(table) = args.sweep.run.run(&sweep)? {
        show(&table, &args.sweep.run.folder(&sweep))?;
    }
    Ok(ExitCode::SUCCESS)
}
