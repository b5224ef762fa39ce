//! `flix-sim study actuation`: what the shaker does.

use std::process::ExitCode;

use super::options::{RunArgs, show};
use crate::arguments::ModelArgs;
use crate::error::Error;
use flix_study::actuation::Actuation;

/// Compute force and torque of the shaker over frequency and over one turn, the body held
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim study actuation\n  flix-sim study actuation --model my-robot.toml"
)]
pub struct Args {
    #[command(flatten)]
    model: ModelArgs,
    #[command(flatten)]
    run: RunArgs,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let study = Actuation::new(&args.model.load()?);
    if let Some(table) = args.run.run(&study)? {
        show(&table, &args.run.folder(&study))?;
    }
    Ok(ExitCode::SUCCESS)
}
