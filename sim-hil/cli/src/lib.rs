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

/// Why a command failed: one sentence for people.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A simulated robot could not be brought to run.
    #[error(transparent)]
    Bench(#[from] flix_sim::rig::bench::BenchError),
    /// The simulation did not go on.
    #[error(transparent)]
    Operation(#[from] flix_sim::rig::operation::OperationError),
    /// A model is damaged.
    #[error(transparent)]
    Model(#[from] flix_sim::model::ModelError),
    /// A figure was not drawn.
    #[error(transparent)]
    Plot(#[from] flix_plot::PlotError),
    /// A key could not be made or read.
    #[error(transparent)]
    Key(#[from] flix_host::link::keys::KeyError),
    /// The robot cannot be on the network.
    #[error(transparent)]
    Serve(#[from] serve::ServeError),
    /// f or theta cannot be asked for.
    #[error("{0}; the robot takes -35 to 35 Hz and -90 to 90 degrees")]
    Setpoint(#[from] flix_protocol::units::OutOfRange),
    /// The robot did not walk.
    #[error(transparent)]
    Walk(#[from] flix_sim::experiment::walk::WalkError),
    /// The mechanics gave no answer.
    #[error(transparent)]
    Probe(#[from] flix_sim::experiment::probe::ProbeError),
    /// A replay was not written.
    #[error(transparent)]
    Recording(#[from] flix_sim::view::RecordingError),
    /// A file was not written.
    #[error("cannot write {}: {error}", path.display())]
    Write {
        /// Names the folder or file.
        path: std::path::PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
    /// JSON was not written.
    #[error("cannot write JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// What was asked for cannot be done, or did not come about.
    #[error("{0}")]
    Refused(String),
    /// As the host's programs say it.
    #[error(transparent)]
    Host(#[from] flix_shell::Error),
    /// A study did not end.
    #[error(transparent)]
    Study(#[from] flix_study::StudyError),
    /// A table of a study was not read, written or merged.
    #[error(transparent)]
    Table(#[from] flix_study::TableError),
    /// A calibration did not end.
    #[error(transparent)]
    Calibration(#[from] flix_study::calibrate::CalibrationError),
    /// A laboratory's table is refused.
    #[error(transparent)]
    Measured(#[from] flix_study::measured::MeasuredError),
    /// A robot was not identified.
    #[error(transparent)]
    Sysid(#[from] flix_study::sysid::SysidError),
    /// The record was not written.
    #[error(transparent)]
    Record(#[from] flix_host::record::RecordError),
    /// The record could not be read back.
    #[error(transparent)]
    Read(#[from] flix_host::record::ReadError),
}

impl Error {
    /// Creates a refusal from something that has its own words.
    pub fn refused(sentence: impl std::fmt::Display) -> Self {
        Self::Refused(sentence.to_string())
    }

    /// Returns whether the command line, or a file that it names, is wrong.
    fn is_usage(&self) -> bool {
        use flix_sim::experiment::probe::ProbeError;
        use flix_sim::experiment::walk::WalkError;
        use flix_study::calibrate::CalibrationError;
        use flix_study::sysid::SysidError;
        use flix_study::{StudyError, TableError};
        matches!(
            self,
            Self::Setpoint(_)
                | Self::Host(_)
                | Self::Refused(_)
                | Self::Model(_)
                | Self::Measured(_)
                | Self::Calibration(CalibrationError::NoLegs(_) | CalibrationError::Other { .. })
                | Self::Sysid(
                    SysidError::Measured(_)
                        | SysidError::Plan(_)
                        | SysidError::NoFolder(_)
                        | SysidError::Empty(_)
                        | SysidError::Write { .. }
                )
                | Self::Study(StudyError::Journal(_) | StudyError::Table(TableError::File { .. }),)
                | Self::Table(_)
                | Self::Key(_)
                | Self::Serve(
                    serve::ServeError::Listen { .. }
                        | serve::ServeError::Operators { .. }
                        | serve::ServeError::OneKey { .. }
                )
                | Self::Write { .. }
                | Self::Record(_)
                | Self::Read(_)
                | Self::Plot(flix_plot::PlotError::Write { .. })
                | Self::Recording(flix_sim::view::RecordingError::Write { .. })
                | Self::Probe(
                    ProbeError::Model(_)
                        | ProbeError::Setpoint(_)
                        | ProbeError::NoLegs { .. }
                        | ProbeError::Overloaded
                        | ProbeError::Still
                )
                | Self::Walk(WalkError::Model(_))
        )
    }
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

impl From<flix_sim::plant::Diverged> for Error {
    fn from(error: flix_sim::plant::Diverged) -> Self {
        Self::Operation(error.into())
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
        Command::Completions(args) => completions::run(&args),
        Command::Man(args) => man::run(&args),
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
