//! `flix clear`: clears a latched stop, and faults whose cause is gone.

use std::process::ExitCode;
use std::time::Instant;

use super::address::RobotArgs;
use flix_host::system::interrupt::Interrupt;
use flix_shell::output::{print, waiting};
use flix_shell::{Error, Exit};

/// Clear a latched stop, and faults whose cause is gone.
///
/// Nothing moves: the next command must arm the robot.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
}

/// Clears, and waits until the robot reports it.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let asked = Instant::now();
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let mut connection = args.robot.connect(&interrupt)?;
    waiting("the robot to be ready again", || connection.clear(asked))?;
    print("ready\n")?;
    Ok(Exit::Done.into())
}
