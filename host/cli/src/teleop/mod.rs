//! `flix teleop`: drives by hand.

pub mod gamepad;
pub mod keyboard;
mod multiplexer;
pub mod screen;
pub mod sequences;
pub(crate) mod terminal;
pub mod view;

use std::process::ExitCode;

use self::screen::ScreenError;
use super::by_hand::ByHandArgs;
use flix_shell::Error;

/// Drive with the keyboard, and show the state of the robot.
///
/// Works over SSH, in a terminal of at least 80 by 24 characters. Ctrl-C, a signal and a closed
/// terminal stop the robot first. It rests when the terminal loses the focus, when nobody is attached to
/// tmux, screen, zellij or dtach, and after --rest-after without a key (behind mosh, and at a terminal that answers no question, 5 s). The mouse, pasted text and other keys that come
/// in one go do nothing.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Keys:
  space          stop, in every state; latched until c
  Enter          arm       Backspace   disarm       c   clear stop and faults
  w              forward       a / d       turn left / right
  q / e          strafe left / right       s   rest, and stay armed
  up / down      f of a walk by 1 Hz, with shift by 0.1 Hz
  left / right   theta by 5 degrees, with shift by 1 degree
  Esc            disarm and leave
Gamepad, where built with the feature `gamepad`: stick or arrows walk and
turn, shoulder buttons strafe, the right button stops (B on Xbox, A on Nintendo,
circle) and the lower one, too, while it walks; Start arms, Select disarms, the
upper button clears.
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
    let holds = args.by_hand.hold_to_run;
    args.by_hand.drive("teleop", |drive, interrupt| Ok(screen::run(drive, interrupt, holds)?))
}

impl From<ScreenError> for Error {
    fn from(error: ScreenError) -> Self {
        match error {
            ScreenError::Drive(error) => error.into(),
            ScreenError::NoTerminal | ScreenError::NoReleases | ScreenError::Terminal(_) => {
                Self::usage(error)
            }
        }
    }
}
