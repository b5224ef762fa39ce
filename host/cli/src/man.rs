//! `flix man`: writes the manual pages.

use std::process::ExitCode;

pub use flix_shell::man::Args;

use super::{Cli, Error, Exit};

/// Writes the pages of `flix`.
///
/// # Errors
/// When they cannot be written.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    flix_shell::man::write(Cli::description(), &args.folder)?;
    Ok(Exit::Done.into())
}
