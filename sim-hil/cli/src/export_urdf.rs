//! `flix-sim export-urdf`: the model for programs that show robots.

use std::path::PathBuf;
use std::process::ExitCode;

use super::arguments::ModelArgs;
use super::error::Error;
use super::output::write_or_print;
use flix_sim::model::links::links;
use flix_sim::model::urdf::urdf;

/// Write the model as URDF for Foxglove, Lichtblick, Rerun or RViz
///
/// `flix-sim serve --foxglove` streams how its links stand. URDF has no springs and no law of contact: for another
/// simulator, take export-mjcf.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim export-urdf > flix.urdf\n  flix-sim export-urdf --model my.toml --out out/my.urdf"
)]
pub struct Args {
    #[command(flatten)]
    model: ModelArgs,
    /// File to write [default: standard output]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    write_or_print(args.out.as_deref(), &urdf(&model.name, &links(&model)))?;
    Ok(ExitCode::SUCCESS)
}
