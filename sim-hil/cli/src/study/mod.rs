//! `flix-sim study`: the paper's studies, one command each.

mod actuation;
mod all;
mod calibrate;
mod controllers;
mod leg;
mod merge;
mod mobility;
mod options;
mod select;
mod sensitivity;
mod sysid;

use std::process::ExitCode;

use clap::Subcommand;

pub(crate) use self::options::RunArgs;
use super::error::Error;

/// Repeat the paper's studies, one command each
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Compute force and torque of the shaker (figures 3d and 3e)
    Actuation(actuation::Args),
    /// Identify stiffness and damping of a leg from release tests (section II-C, figure 3a).
    Leg(leg::Args),
    /// Map f and theta to motion (figures 3b and 4), score the modes of table III.
    Mobility(mobility::Args),
    /// Change mass or friction and compare the walks (figures 5a to 5e)
    Sensitivity(sensitivity::Args),
    /// Choose robust pairs (figure 5f, table IV); check the claims of section III-B.
    Select(select::Args),
    /// Fit the robot to measured speeds, or to the modes of tables III and IV (section II-D).
    Calibrate(calibrate::Args),
    /// Identify a real robot from experiments, with error bars (section II, generalised).
    Sysid(sysid::Args),
    /// Follow a path with robots that no controller has seen: the learned one against the predictive one.
    Controllers(controllers::Args),
    /// Join the slices of a study.
    Merge(merge::Args),
    /// Run every study.
    All(all::Args),
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    run_command(&args.command)
}

fn run_command(command: &Command) -> Result<ExitCode, Error> {
    match command {
        Command::Actuation(args) => actuation::run(args),
        Command::Leg(args) => leg::run(args),
        Command::Mobility(args) => mobility::run(args),
        Command::Sensitivity(args) => sensitivity::run(args),
        Command::Select(args) => select::run(args),
        Command::Calibrate(args) => calibrate::run(args),
        Command::Sysid(args) => sysid::run(args),
        Command::Controllers(args) => controllers::run(args),
        Command::Merge(args) => merge::run(args),
        Command::All(args) => all::run(args, |command: &Command| run_command(command)),
    }
}
