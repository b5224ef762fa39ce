//! `flix experiment`: records what `flix-sim study sysid` identifies a robot from.

mod air;
mod drops;
mod experimenter;
mod walks;

use std::process::ExitCode;

pub(super) use self::experimenter::Experimenter;
use flix_shell::Error;

/// Record experiments with motion capture, from which `flix-sim study sysid` identifies a robot.
///
/// Each appends whole tests to a CSV file of its name in DIR. Ctrl-C stops the robot and keeps the tests that are
/// whole.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix experiment walks walker-3f2c lab --natnet-server 192.168.1.5
  flix experiment air daisy lab         (hung on cords, clear of the floor)
  flix experiment drops walker-3f2c lab --height 20
  flix-sim study sysid lab")]
pub struct Args {
    #[command(subcommand)]
    experiment: Experiment,
}

#[derive(Debug, clap::Subcommand)]
enum Experiment {
    Walks(walks::Args),
    Air(air::Args),
    Drops(drops::Args),
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    match &args.experiment {
        Experiment::Walks(args) => walks::run(args),
        Experiment::Air(args) => air::run(args),
        Experiment::Drops(args) => drops::run(args),
    }
}
