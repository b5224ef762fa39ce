//! `flix completions`: prints a completion script for a shell.

use std::process::ExitCode;

use flix_shell::completions::{self, Shell};
use flix_shell::{Error, Exit};

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
pub fn run(args: &Args, program: clap::Command) -> Result<ExitCode, Error> {
    completions::write(args.shell, program)?;
    Ok(Exit::Done.into())
}
