//! `flix experiment air`: how a robot swings that hangs and is shaken.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use flix_protocol::message::Setpoint;

use super::experimenter::{Experimenter, Pair};
use crate::address::RobotArgs;
use crate::run::{PoseArgs, RecordArgs, Run};
use flix_host::experiment::Sheet;
use flix_host::experiment::air::{Air, AirSettings, COLUMNS, SHAKES, SLOWEST};
use flix_shell::Error;
use flix_shell::identification::POSE_PATIENCE;
use flix_shell::number::whole;
use flix_shell::time::duration;

/// Shake a robot that hangs on cords; append what motion capture sees to DIR/air.csv.
///
/// Hang the robot on soft cords, clear of the floor: its swing on them has to be slower than once a second. The
/// experiment ends when it leaves its place by 0.3 m.
#[derive(Debug, clap::Args)]
#[command(
    allow_missing_positional = true,
    after_help = "\
Examples:
  flix experiment air walker-3f2c lab --natnet-server 192.168.1.5
  flix experiment air walker-3f2c lab --pairs 20:0,20:90 --repeat 3
  flix experiment air lab       (against flix-sim serve --natnet --hang)"
)]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    /// Folder of the experiments.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Pairs of f in Hz, 5 or more either way, and theta in degrees [default: 20, 28 and 35 Hz at 0 and 90 degrees].
    #[arg(long, value_name = "F:THETA", value_delimiter = ',', allow_hyphen_values = true, value_parser = shake)]
    pairs: Vec<Pair>,
    /// Number of shakes at each pair; the pairs take turns.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = whole::<u32>(1..=100))]
    repeat: u32,
    /// Time that is recorded of each shake, 0.5 to 10 s.
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = recorded)]
    seconds: Duration,
    #[command(flatten)]
    poses: PoseArgs,
    #[command(flatten)]
    record: RecordArgs,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

fn shake(text: &str) -> Result<Pair, String> {
    let pair: Pair = text.parse()?;
    let f = pair.0.frequency().get();
    if f.abs() >= SLOWEST {
        Ok(pair)
    } else {
        Err(format!(
            "{text:?}: {f} Hz is too slow in the air: f is {SLOWEST} Hz or more either way"
        ))
    }
}

fn recorded(text: &str) -> Result<Duration, String> {
    let time = duration(text)?;
    if (Duration::from_millis(500)..=Duration::from_secs(10)).contains(&time) {
        Ok(time)
    } else {
        Err(format!("a shake of {} s is outside 0.5 to 10 s", time.as_secs_f64()))
    }
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let usual = SHAKES.map(|(f, theta)| Pair(Setpoint::saturating(f as f32, theta as f32)));
    let pairs = if args.pairs.is_empty() { &usual } else { args.pairs.as_slice() };
    let pairs: Vec<Pair> = (0..args.repeat).flat_map(|_| pairs.iter().copied()).collect();
    let names = pairs.iter().map(Pair::name).collect();
    let helm = Air::new(AirSettings {
        shakes: pairs.iter().map(|pair| pair.0).collect(),
        time: args.seconds,
        pose_patience: POSE_PATIENCE,
    });
    let sheet = Sheet::open(&args.folder, "air", &COLUMNS)?.of_robot(&args.robot.robot)?;
    let run = Run::open(&args.robot, &args.poses)?.above_the_floor();
    let (robot, record) = (args.robot.robot.as_str(), &args.record);
    let experimenter = Experimenter { name: "air", robot, record, sheet, json: args.json };
    experimenter.run(
        run,
        (helm, names),
        |helm: &Air| (helm.shakes().len(), helm.total()),
        |helm, last| (helm.shakes().len(), helm.rows(last)),
    )
}
