//! `flix-sim export-mjcf`: the model for MuJoCo.

use std::path::PathBuf;
use std::process::ExitCode;

use anstream::print;

use super::Error;
use crate::model::RobotModel;
use crate::model::mjcf::mjcf;

/// Write the model as MJCF, so that MuJoCo can check it or go on with it.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim export-mjcf --model W > W.xml\n  flix-sim export-mjcf --model my.toml --out out/my.xml"
)]
pub struct Args {
    /// Model: a TOML file or a shipped name
    #[arg(long, default_value = "W")]
    model: String,
    /// Step that the file asks for, ms
    #[arg(long, default_value_t = 0.1)]
    step_ms: f64,
    /// File to write; standard output unless given
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// # Errors
/// When the model is refused or the file cannot be written.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let text = mjcf(&RobotModel::named(&args.model)?, 1e-3 * args.step_ms);
    match &args.out {
        None => print!("{text}"),
        Some(path) => std::fs::write(path, text)
            .map_err(|error| Error::Write { path: path.clone(), error })?,
    }
    Ok(ExitCode::SUCCESS)
}
