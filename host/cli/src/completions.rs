//! `flix completions`: prints a completion script for a shell.

use std::process::ExitCode;

use clap_complete::Shell;

use super::{Cli, Error, Exit};
use flix_shell::output::print;

/// Print the completion script of a shell.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix completions bash > ~/.local/share/bash-completion/completions/flix
  flix completions zsh > ~/.zfunc/_flix
  flix completions fish > ~/.config/fish/completions/flix.fish")]
pub struct Args {
    /// The shell.
    shell: Shell,
}

/// Prints the script.
///
/// # Errors
/// When stdout cannot be written.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::description(), "flix", &mut script);
    print(&String::from_utf8_lossy(&script))?;
    Ok(Exit::Done.into())
}
