//! `flix teleop`: drives by hand.

pub mod drive;
pub mod gamepad;
pub mod keyboard;
pub mod screen;
pub mod view;

use std::process::ExitCode;

use self::screen::ScreenError;
use super::Error;
use super::by_hand::ByHandArgs;

/// Drive with the keyboard, and show the state of the robot.
///
/// Works over SSH, in a terminal of at least 80 by 24 characters. Ctrl-C, a signal and a closed
/// terminal stop the robot first.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Keys:
  space          stop, in every state; latched until c
  Enter          arm       Backspace   disarm       c   clear stop and faults
  w              forward       a / d       turn left / right
  q / e          strafe left / right       s   rest, and stay armed
  up / down      f by 1 Hz, with shift by 0.1 Hz
  left / right   theta by 5 degrees, with shift by 1 degree
  Esc            disarm and leave
Gamepad, where built with the feature `gamepad`: stick or arrows walk and
turn, shoulder buttons strafe, B stops, Start arms, Select disarms, Y clears.
With poses (--pose natnet or --pose udp:PORT), which also show a map:
  h              hold the present heading while walking, or end that")]
pub struct Args {
    #[command(flatten)]
    by_hand: ByHandArgs,
}

/// Drives until the operator leaves.
///
/// # Errors
/// When there is no terminal, the robot cannot be reached, or the program is interrupted.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    args.by_hand.drive("teleop", |drive, interrupt| Ok(screen::run(drive, interrupt)?))
}

impl From<ScreenError> for Error {
    fn from(error: ScreenError) -> Self {
        match error {
            ScreenError::Drive(error) => error.into(),
            ScreenError::NoTerminal | ScreenError::Terminal(_) => Self::usage(error),
        }
    }
}
