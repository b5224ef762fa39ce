//! `flix teleop`: drives by hand.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;

use super::output::print;
use super::robot::RobotArgs;
use super::walk::{PoseArgs, record};
use super::{Error, Exit, drive};
use crate::interrupt::Interrupt;
use crate::pose::any::Poses;
use crate::teleop::screen::{self, Ending, Extras, ScreenError};

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
With poses (--pose natnet or --pose udp:PORT), which also show a map:
  h              hold the present heading while walking, or end that")]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    #[command(flatten)]
    poses: PoseArgs,
    /// Record the drive below OUT/runs.
    #[arg(long)]
    record: bool,
    /// Folder for the record.
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
}

/// Drives until the operator leaves.
///
/// # Errors
/// When there is no terminal, the robot cannot be reached, or the program is interrupted.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let mut extras = Extras { poses: args.poses.open_if_named()?, ..Extras::default() };
    let mut connection = args.robot.connect(&interrupt)?;
    if args.record {
        let poses = extras.poses.as_ref().map(Poses::name);
        extras.recorder =
            Some(record(&args.out, &mut connection, poses, "teleop", BTreeMap::new())?);
    }
    let ending = screen::run(&mut connection, &args.robot.robot, &mut extras, &interrupt);
    let ended = match ending {
        Ok(Ending::Interrupted) => Err(drive::stop(&mut connection)),
        Ok(Ending::Quit) if connection.client().is_driving() => {
            connection.disarm().map_err(Error::from)
        }
        Ok(Ending::Quit) => Ok(()),
        Err(error) => Err(drive::give_up(&mut connection, error.into())),
    };
    let ending = ended.as_ref().map_or_else(ToString::to_string, |()| "finished".to_owned());
    let results = BTreeMap::from([("ending".to_owned(), ending)]);
    let record = extras.recorder.map(|recorder| recorder.conclude(results)).transpose();
    ended?;
    if let Some(file) = record? {
        print(&format!("record {}\n", file.display()))?;
    }
    Ok(Exit::Done.into())
}

impl From<ScreenError> for Error {
    fn from(error: ScreenError) -> Self {
        match error {
            ScreenError::Link(error) => error.into(),
            ScreenError::Pose(error) => error.into(),
            ScreenError::NoTerminal | ScreenError::Terminal(_) => Self::usage(error),
        }
    }
}
