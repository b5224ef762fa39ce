//! `flix-sim export-mjcf`: the model for MuJoCo.

use flix_shell::number::within;
use std::path::PathBuf;
use std::process::ExitCode;

use super::arguments::ModelArgs;
use super::error::Error;
use super::output::{complain, write_or_print};
use flix_sim::model::mjcf::{mjcf, too_long};
use flix_sim::plant::mechanics::reference_contact;

/// Write the model as MJCF for MuJoCo
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim export-mjcf --model W > W.xml\n  flix-sim export-mjcf --model my.toml --out out/my.xml"
)]
pub struct Args {
    #[command(flatten)]
    model: ModelArgs,
    /// Step of the simulation in the file, ms, 0.001 to 10
    #[arg(long, value_name = "MS", default_value_t = 0.1, value_parser = within(1e-3..=10.0, "step", " ms"), allow_hyphen_values = true)]
    step_ms: f64,
    /// File to write [default: standard output]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    let contact = reference_contact(&model);
    let step = 1e-3 * args.step_ms;
    if let Some(sentence) = too_long(step, contact) {
        complain(sentence);
    }
    let text = mjcf(&model, step, contact);
    write_or_print(args.out.as_deref(), &text)?;
    Ok(ExitCode::SUCCESS)
}
