#![forbid(unsafe_code)]
//! The `flix-sim` command line: one file a subcommand, each with `Args` and `run`.
//!
//! Exit codes: 0 done and within all limits, 1 a figure is outside its limit or the run failed, 2 usage. With
//! `--json` standard output carries JSON alone; progress goes to standard error, and only to a terminal.

mod accuracy;
mod adversary;
mod arguments;
mod commission;
mod completions;
mod conditions;
mod console;
mod demo;
mod eigenmodes;
mod error;
mod export_mjcf;
mod export_urdf;
mod faults;
mod home;
mod identify;
mod learn;
mod leg;
mod live;
mod man;
mod measure;
mod output;
mod rest;
pub mod serve;
mod shake;
mod shiver;
mod soak;
mod study;
mod track;
mod validate;
mod walk;

use std::process::ExitCode;

use clap::{CommandFactory as _, Parser, Subcommand};

pub use self::error::Error;

/// A simulated Flix-Walker under the robot's own software.
#[derive(Debug, Parser)]
#[command(name = "flix-sim", version = env!("FLIX_VERSION"), after_help = "Without a command, `demo` runs.")]
pub struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Args),
    Serve(serve::Args),
    Accuracy(accuracy::Args),
    Commission(commission::Args),
    Shiver(shiver::Args),
    Faults(faults::Args),
    Adversary(adversary::Args),
    Soak(soak::Args),
    Walk(walk::Args),
    Rest(rest::Args),
    Leg(leg::Args),
    #[command(alias = "modes")]
    Eigenmodes(eigenmodes::Args),
    Shake(shake::Args),
    Validate(validate::Args),
    ExportMjcf(export_mjcf::Args),
    ExportUrdf(export_urdf::Args),
    Track(track::Args),
    Home(home::Args),
    Identify(identify::Args),
    Learn(learn::Args),
    Study(study::Args),
    Completions(completions::Args),
    /// Write the manual pages into a folder
    #[command(after_help = "Example:\n  flix-sim man ~/.local/share/man/man1")]
    Man(man::Args),
}

impl Cli {
    /// Returns the description of the command line, which reads help, completions and manual pages.
    ///
    /// A negative number is a value wherever a value is expected, so that a refusal names the option and its range.
    #[must_use]
    pub fn description() -> clap::Command {
        flix_shell::numbers_may_be_negative(Self::command())
    }
}

/// Runs what the command line asks for, and prints on standard error why it could not.
#[must_use]
pub fn run(cli: Cli) -> ExitCode {
    flix_host::system::program::set(concat!("flix-sim ", env!("FLIX_VERSION")));
    let outcome = match cli.command.unwrap_or(Command::Demo(demo::Args::default())) {
        Command::Demo(args) => demo::run(&args),
        Command::Track(args) => track::run(&args),
        Command::Home(args) => home::run(&args),
        Command::Identify(args) => identify::run(&args),
        Command::Learn(args) => learn::run(&args),
        Command::Study(args) => study::run(&args),
        Command::Completions(args) => completions::run(&args, Cli::description()),
        Command::Man(args) => man::run(&args, Cli::description()),
        Command::Serve(args) => serve::run(&args),
        Command::Accuracy(args) => accuracy::run(&args),
        Command::Commission(args) => commission::run(&args),
        Command::Shiver(args) => shiver::run(&args),
        Command::Faults(args) => faults::run(&args),
        Command::Adversary(args) => adversary::run(&args),
        Command::Soak(args) => soak::run(&args),
        Command::Walk(args) => walk::run(&args),
        Command::Rest(args) => rest::run(&args),
        Command::Leg(args) => leg::run(&args),
        Command::Eigenmodes(args) => eigenmodes::run(&args),
        Command::Shake(args) => shake::run(&args),
        Command::Validate(args) => validate::run(&args),
        Command::ExportMjcf(args) => export_mjcf::run(&args),
        Command::ExportUrdf(args) => export_urdf::run(&args),
    };
    let code = outcome.unwrap_or_else(|error| {
        output::complain(&error);
        error.exit()
    });
    flix_shell::outlet::finish();
    code
}
