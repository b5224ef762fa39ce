//! `flix stop`: stops the robot until it is cleared.

use std::process::ExitCode;

use super::address::RobotArgs;
use flix_host::system::interrupt::Interrupt;
use flix_shell::output::print;
use flix_shell::{Error, Exit};

/// Stop the robot, in every state, whoever drives it.
///
/// Stop is repeated until the robot acknowledges it, for 3 s. It needs no session: it works while another
/// operator, or a program that hangs, holds the robot. Both rotors ramp down together, and the robot
/// stays stopped until `flix clear`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
}

/// Stops, and waits until the rotors are at rest.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    args.robot.stop(&interrupt)?;
    print("stopped; `flix clear` makes it ready again\n")?;
    Ok(Exit::Done.into())
}
