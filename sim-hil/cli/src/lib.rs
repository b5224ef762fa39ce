#![forbid(unsafe_code)]
//! The `flix-sim` command line: one file a subcommand, each with `Args` and `run`.
//!
//! Exit codes: 0 done and within all limits, 1 a figure is outside its limit or the run failed, 2 usage. With
//! `--json` standard output carries JSON alone; progress goes to standard error, and only to a terminal.

pub mod accuracy;
pub mod adversary;
pub mod arguments;
pub mod commission;
pub mod completions;
pub mod conditions;
mod console;
pub mod demo;
pub mod eigenmodes;
mod error;
pub mod export_mjcf;
pub mod export_urdf;
pub mod faults;
pub mod home;
pub mod identify;
pub mod learn;
pub mod leg;
mod live;
pub mod man;
pub(crate) mod output;
pub mod rest;
pub mod serve;
pub mod shake;
pub mod shiver;
pub mod soak;
pub mod study;
pub mod track;
pub mod validate;
pub mod walk;

use std::process::ExitCode;

use clap::{CommandFactory as _, Parser, Subcommand};

pub use self::error::{Error, ServeError};

/// A simulated Flix-Walker under the robot's own software.
#[derive(Debug, Parser)]
#[command(name = "flix-sim", version, after_help = "Without a command, `demo` runs.")]
pub struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Shake through the paper's five walking modes, then walk a figure eight: figures, plot, replay
    Demo(demo::Args),
    /// Serve a simulated robot on the network, in real time
    Serve(serve::Args),
    /// Measure how well f and theta are held over their whole range
    Accuracy(accuracy::Args),
    /// Let robots with unknown motors find their own values, and check these
    Commission(commission::Args),
    /// Draw settings, judge them by the robot's stability margin, and run those nearest its border
    Shiver(shiver::Args),
    /// Inject every fault in every walking mode at every onset and report what the robot does
    Faults(faults::Args),
    /// Attack live robots over their link and count what the attack achieves
    Adversary(adversary::Args),
    /// Run robots through hours of random commands, faults and link trouble, in virtual time
    Soak(soak::Args),
    /// Walk at one f and theta: mean speeds over several seeds, a picture of the track, a replay
    Walk(walk::Args),
    /// Drop the robot from 20 mm, wait until it rests, and weigh it
    Rest(rest::Args),
    /// Load the tip of one clamped leg, release it and measure how it rings
    Leg(leg::Args),
    /// List natural frequencies, damping ratios and shapes of small motions
    #[command(alias = "modes")]
    Eigenmodes(eigenmodes::Args),
    /// Report the amplitudes of the shaker's forces and of the body's motion
    Shake(shake::Args),
    /// Compute every figure of the reference table, or others, and check whether they agree
    Validate(validate::Args),
    /// Write the model as MJCF for MuJoCo
    ExportMjcf(export_mjcf::Args),
    /// Write the model as URDF for Foxglove, Lichtblick, Rerun or RViz
    ExportUrdf(export_urdf::Args),
    /// Follow a path with the whole simulated robot, in virtual time
    Track(track::Args),
    /// Return to the origin after pushes, in virtual time
    Home(home::Args),
    /// Identify the walking modes of a simulated robot and write its mode table, in virtual time
    Identify(identify::Args),
    Learn(learn::Args),
    /// Repeat the paper's studies, one command each
    Study(study::Args),
    /// Print the completion script of a shell
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
    outcome.unwrap_or_else(|error| {
        output::complain(&error);
        if error.is_usage() { ExitCode::from(2) } else { ExitCode::FAILURE }
    })
}
