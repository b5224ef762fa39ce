//! The `flix-sim` command line: one file a subcommand, each with `Args` and `run`.
//!
//! Exit codes: 0 done and within all limits, 1 a figure is outside its limit or the run failed, 2 usage. With
//! `--json` standard output carries JSON alone; progress goes to standard error, and only to a terminal.

pub mod accuracy;
pub mod demo;
pub mod serve;

use std::process::ExitCode;
use std::time::Duration;

use clap::{Parser, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};

/// A simulated Flix-Walker under the robot's own software.
#[derive(Debug, Parser)]
#[command(name = "flix-sim", version, after_help = "Without a command, `demo` runs.")]
pub struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Shake through the paper's five modes and a reversal; tell and plot how well they are held.
    Demo(demo::Args),
    /// Be a robot on the network, in real time.
    Serve(serve::Args),
    /// Measure how well f and theta are held, over all of them.
    Accuracy(accuracy::Args),
}

/// Why a command failed: one sentence for people.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A simulated robot could not be brought to run.
    #[error(transparent)]
    Accuracy(#[from] crate::accuracy::AccuracyError),
    /// The simulation did not go on.
    #[error(transparent)]
    Operation(#[from] crate::operation::OperationError),
    /// A model is damaged.
    #[error(transparent)]
    Model(#[from] crate::model::ModelError),
    /// A figure was not drawn.
    #[error(transparent)]
    Plot(#[from] flix_host::plot::PlotError),
    /// A key could not be made or read.
    #[error(transparent)]
    Key(#[from] flix_host::keys::KeyError),
    /// The robot cannot be on the network.
    #[error(transparent)]
    Serve(#[from] serve::ServeError),
    /// JSON was not written.
    #[error("cannot write JSON: {0}")]
    Json(#[from] serde_json::Error),
}

impl From<crate::plant::Diverged> for Error {
    fn from(error: crate::plant::Diverged) -> Self {
        Self::Operation(error.into())
    }
}

/// Runs what the command line asks for, and tells on standard error why it could not.
#[must_use]
pub fn run(cli: Cli) -> ExitCode {
    let outcome = match cli.command.unwrap_or(Command::Demo(demo::Args::default())) {
        Command::Demo(args) => demo::run(&args),
        Command::Serve(args) => serve::run(&args),
        Command::Accuracy(args) => accuracy::run(&args),
    };
    outcome.unwrap_or_else(|error| {
        eprintln!("flix-sim: {error}");
        ExitCode::FAILURE
    })
}

/// A progress bar on standard error; invisible when that is no terminal.
pub(crate) fn progress(steps: u64, what: &'static str) -> ProgressBar {
    let bar = ProgressBar::new(steps).with_message(what);
    if let Ok(style) =
        ProgressStyle::with_template("{msg} [{bar:40}] {pos}/{len} {elapsed} (left: {eta})")
    {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}
