//! `flix-sim completions`: prints a completion script for a shell.

use std::process::ExitCode;

use flix_shell::completions::{self, Shell};

use super::error::Error;

/// Print the completion script of a shell
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix-sim completions bash > ~/.local/share/bash-completion/completions/flix-sim
  flix-sim completions zsh > ~/.zfunc/_flix-sim
  flix-sim completions fish > ~/.config/fish/completions/flix-sim.fish")]
pub struct Args {
    /// The shell
    shell: Shell,
}

pub fn run(args: &Args, program: clap::Command) -> Result<ExitCode, Error> {
    completions::write(args.shell, program)?;
    Ok(ExitCode::SUCCESS)
}
