//! `flix-sim man`: writes the manual pages.

use std::process::ExitCode;

pub use flix_shell::man::Args;

use super::{Cli, Error};

/// Writes the pages of `flix-sim`.
///
/// # Errors
/// When they cannot be written.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    flix_shell::man::write(Cli::description(), &args.folder)?;
    Ok(ExitCode::SUCCESS)
}
