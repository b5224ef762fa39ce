//! `flix teleop`: drives by hand.

pub mod gamepad;
pub mod keyboard;
mod multiplexer;
pub mod screen;
pub mod sequences;
pub(crate) mod terminal;
pub mod view;

use std::process::ExitCode;
use std::time::Duration;

use self::screen::ScreenError;
use super::by_hand::ByHandArgs;
use flix_shell::Error;

/// Range of the time after which a robot rests without a key.
const SHORTEST_PATIENCE: Duration = Duration::from_secs(1);
const LONGEST_PATIENCE: Duration = Duration::from_secs(3600);

/// Drive with the keyboard, and show the state of the robot.
///
/// Works over SSH, in a terminal of at least 80 by 24 characters. Ctrl-C, a signal and a closed
/// terminal stop the robot first. It rests when the terminal loses the focus, when nobody is attached to
/// tmux or screen, and after --rest-after without a key. The mouse, pasted text and other keys that come
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
turn, shoulder buttons strafe, B stops, Start arms, Select disarms, Y clears.
With poses (--pose natnet or --pose udp:PORT), which also show a map:
  h              hold the present heading while walking, or end that")]
pub struct Args {
    #[command(flatten)]
    by_hand: ByHandArgs,
    /// Rest after so long without a key, 1 s to 1 h.
    #[arg(long, value_name = "TIME", default_value = "30s", value_parser = patience)]
    rest_after: Duration,
}

/// Reads how long a robot walks without a key.
fn patience(text: &str) -> Result<Duration, String> {
    let time = flix_shell::time::duration(text)?;
    if (SHORTEST_PATIENCE..=LONGEST_PATIENCE).contains(&time) {
        Ok(time)
    } else {
        Err("name a time between 1s and 1h".to_owned())
    }
}

/// Drives until the operator leaves.
///
/// # Errors
/// When there is no terminal, the robot cannot be reached, or the program is interrupted.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let holds = args.by_hand.hold_to_run;
    args.by_hand.drive("teleop", |drive, interrupt| {
        Ok(screen::run(drive, interrupt, args.rest_after, holds)?)
    })
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
