//! `flix teleop`: drives by hand.

use std::process::ExitCode;

use super::robot::RobotArgs;
use super::{Error, Exit, drive};
use crate::interrupt::Interrupt;
use crate::teleop::screen::{self, Ending, ScreenError};

/// Drive with the keyboard, and show the state of the robot.
///
/// Works over SSH, in a terminal of at least 80 by 24 characters. Ctrl-C, a signal and a closed
/// terminal stop the robot first.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Keys:
  space          stop, in every state; latched until c
  Enter          arm           Backspace   disarm           c   clear stop and faults
  w              forward       a / d       turn left / right
  q / e          strafe left / right       s   rest, and stay armed
  up / down      f by 1 Hz, with shift by 0.1 Hz
  left / right   theta by 5 degrees, with shift by 1 degree
  Esc            disarm and leave")]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
}

/// Drives until the operator leaves.
///
/// # Errors
/// When there is no terminal, the robot cannot be reached, or the program is interrupted.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let mut connection = args.robot.connect(&interrupt)?;
    match screen::run(&mut connection, &args.robot.robot, &interrupt)? {
        Ending::Interrupted => Err(drive::stop(&mut connection)),
        Ending::Quit => {
            if connection.client().is_driving() {
                connection.disarm()?;
            }
            Ok(Exit::Done.into())
        }
    }
}

impl From<ScreenError> for Error {
    fn from(error: ScreenError) -> Self {
        match error {
            ScreenError::Link(error) => error.into(),
            ScreenError::NoTerminal | ScreenError::Terminal(_) => Self::usage(error),
        }
    }
}
