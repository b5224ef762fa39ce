#![forbid(unsafe_code)]
//! The `flix` command line: one file per command, each with `Args` and `run`.
//!
//! A failure has an exit code ([`Exit::ALL`]) and one sentence on stderr that says what to do. With `--json`, stdout carries JSON only.

mod address;
pub mod by_hand;
mod clear;
pub mod cockpit;
mod commission;
mod completions;
mod crash;
mod discover;
mod doctor;
mod drive;
mod experiment;
mod home;
mod identify;
mod keygen;
mod link_test;
mod man;
mod moved;
mod parameters;
mod provision;
mod run;
mod runs;
mod scope;
mod status;
mod stop;
mod symbols;
pub mod teleop;
mod track;

use std::process::ExitCode;

use clap::{CommandFactory as _, Parser, Subcommand};
use flix_host::system::program;
use flix_shell::{Error, Exit, outlet, output, parse};

/// Drive, watch and record a Flix-Walker
#[derive(Debug, Parser)]
#[command(
    name = "flix",
    version = env!("FLIX_VERSION"),
    propagate_version = true,
    subcommand_required = true,
    arg_required_else_help = true,
    after_help = format!("{EXAMPLES}\n\n{}", Exit::help())
)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
Examples:
  flix teleop 127.0.0.1                      drive with the keyboard
  flix cockpit 127.0.0.1                     drive in the browser
  flix drive walker-3f2c --frequency -30 --direction 30 --for 5s
  flix status walker-3f2c --json | jq .state
  flix stop walker-3f2c";

#[derive(Debug, Subcommand)]
enum Command {
    Teleop(teleop::Args),
    Cockpit(cockpit::Args),
    Drive(drive::Args),
    Status(status::Args),
    Crash(crash::Args),
    Stop(stop::Args),
    Clear(clear::Args),
    Parameters(parameters::Args),
    LinkTest(link_test::Args),
    Discover(discover::Args),
    Provision(provision::Args),
    Keygen(keygen::Args),
    Track(track::Args),
    Home(home::Args),
    Identify(identify::Args),
    Experiment(experiment::Args),
    Doctor(doctor::Args),
    Scope(scope::Args),
    Commission(commission::Args),
    Runs(runs::Args),
    Completions(completions::Args),
    #[command(after_help = "Example:\n  flix man ~/.local/share/man/man1")]
    Man(man::Args),
}

impl Cli {
    /// Runs the command.
    ///
    /// # Errors
    /// When the command fails; with the exit code and the sentence to show.
    pub fn run(&self) -> Result<ExitCode, Error> {
        match &self.command {
            Command::Teleop(args) => teleop::run(args),
            Command::Cockpit(args) => cockpit::run(args),
            Command::Drive(args) => drive::run(args),
            Command::Status(args) => status::run(args),
            Command::Crash(args) => crash::run(args),
            Command::Stop(args) => stop::run(args),
            Command::Clear(args) => clear::run(args),
            Command::Parameters(args) => parameters::run(args),
            Command::LinkTest(args) => link_test::run(args),
            Command::Discover(args) => discover::run(args),
            Command::Provision(args) => provision::run(args),
            Command::Keygen(args) => keygen::run(args),
            Command::Track(args) => track::run(args),
            Command::Home(args) => home::run(args),
            Command::Identify(args) => identify::run(args),
            Command::Experiment(args) => experiment::run(args),
            Command::Doctor(args) => doctor::run(args),
            Command::Scope(args) => scope::run(args),
            Command::Commission(args) => commission::run(args),
            Command::Runs(args) => runs::run(args),
            Command::Completions(args) => completions::run(args, Self::description()),
            Command::Man(args) => man::run(args, Self::description()),
        }
    }

    /// Returns the command line as data, for completions and tests.
    #[must_use]
    pub fn description() -> clap::Command {
        flix_shell::numbers_may_be_negative(Self::command())
    }
}

/// Parses the command line, runs it, and reports an error.
pub fn main() -> ExitCode {
    program::set(concat!("flix ", env!("FLIX_VERSION")));
    let cli: Cli = match parse(Cli::description()) {
        Ok(cli) => cli,
        Err(code) => return code,
    };
    flix_host::system::keep_memory_private();
    let code = cli.run().unwrap_or_else(|error| {
        output::complain(&error);
        error.exit.into()
    });
    outlet::finish();
    code
}

#[cfg(test)]
#[path = "../../tests/support/walked.rs"]
mod walked;

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the examples and tables of help that are wider than a terminal.
    fn wide_lines(command: &clap::Command) -> Vec<String> {
        let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
        let wide = |line: &&str| line.starts_with("  ") && line.chars().count() > 80;
        let own = help.lines().filter(wide).map(str::to_owned);
        own.chain(command.get_subcommands().flat_map(wide_lines)).collect()
    }

    #[test]
    fn help_fits_80_columns() {
        assert_eq!(wide_lines(&Cli::description()), Vec::<String>::new());
    }

    #[test]
    fn the_command_line_is_consistent() {
        Cli::description().debug_assert();
    }
}
