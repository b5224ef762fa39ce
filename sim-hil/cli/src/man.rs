//! `flix-sim man`: writes the manual pages.

use std::process::ExitCode;

pub use flix_shell::man::Args;

use super::error::Error;

/// Writes the pages of `flix-sim`.
pub fn run(args: &Args, program: clap::Command) -> Result<ExitCode, Error> {
    flix_shell::man::write(program, &args.folder)?;
    Ok(ExitCode::SUCCESS)
}
