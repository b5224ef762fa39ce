//! `flix home`: walks to a point, and stays there on request.

use std::process::ExitCode;

use super::address::RobotArgs;
use super::run::{FileArgs, PoseArgs, Run, unrecorded, verdict};
use flix_host::nav::{Navigator, Position, Task};
use flix_host::pilot::steering::names;
use flix_host::pilot::{Pilot, Recorded};
use flix_shell::course::{SteeringArgs, describe, facts, results, row, table_for};
use flix_shell::output::print;
use flix_shell::{Error, Exit};

/// Walk to a point and rest there.
///
/// With --stay the robot returns whenever it is pushed away, until you press Ctrl-C.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix home daisy --modes daisy.modes.toml --natnet-server 192.168.1.5
  flix home walker-3f2c --to 0.5,0 --stay")]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    /// Position to walk to, m.
    #[arg(long, value_name = "X,Y", default_value = "0,0", allow_hyphen_values = true)]
    to: Position,
    /// Stay at the point until interrupted.
    #[arg(long)]
    stay: bool,
    #[command(flatten)]
    steering: SteeringArgs,
    #[command(flatten)]
    poses: PoseArgs,
    #[command(flatten)]
    files: FileArgs,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let task = Task::Reach { point: args.to, stay: args.stay };
    let settings = args.steering.settings(&task);
    let repertoire = args.steering.repertoire(|| -> Result<_, Error> {
        Ok(table_for(&args.robot.robot, &args.files.modes)?)
    })?;
    let table = repertoire.table();
    let setup = facts(&settings);
    let navigator = Navigator::new(task, repertoire, settings).map_err(Error::usage)?;
    let mut run = Run::open(&args.robot, &args.poses)?;
    let mut recorder = run.record(&args.files.record, "home", setup)?;
    recorder.attach(run.now(), "modes.toml", "application/toml", table.to_toml().as_bytes())?;
    let mut pilot = Pilot::new(navigator, names(&table), Some(recorder))
        .driving_unrecorded(args.files.record.unrecorded);
    let (ending, seconds) = run.drive(&mut pilot, |pilot| {
        format!("{:<24} {:>4.0} mm away", pilot.doing(), pilot.helm().progress().error * 1e3)
    })?;
    let stop = run.leave();
    let numbers = results(pilot.helm(), seconds);
    let (_, Recorded { file, error: record_error }) = pilot.finish(numbers.clone());
    verdict(&ending, stop, file.as_ref())?;
    let mut text = format!("arrived: {ending}\n{}", describe(&numbers));
    if let Some(file) = file {
        text += &row("record", format_args!("{} (MCAP)", file.display()));
    }
    print(&text)?;
    unrecorded(record_error, args.files.record.unrecorded)?;
    Ok(Exit::Done.into())
}
