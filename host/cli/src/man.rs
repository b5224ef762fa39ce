//! `flix man`: writes the manual pages.

use std::process::ExitCode;

pub use flix_shell::man::Args;

use flix_shell::{Error, Exit};

/// Writes the pages of `flix`.
pub fn run(args: &Args, program: clap::Command) -> Result<ExitCode, Error> {
    flix_shell::man::write(program, &args.folder)?;
    Ok(Exit::Done.into())
}
