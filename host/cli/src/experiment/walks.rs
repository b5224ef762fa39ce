//! `flix experiment walks`: the mean motion of walks.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use super::experimenter::{Experimenter, Pair};
use crate::address::RobotArgs;
use crate::run::{PoseArgs, RecordArgs, Run};
use flix_host::experiment::Sheet;
use flix_host::experiment::walks::COLUMNS;
use flix_host::nav::{Area, Identification, IdentificationSettings, ModeTable};
use flix_shell::Error;
use flix_shell::course::pairs;
use flix_shell::identification::{settings, stretch};
use flix_shell::number::whole;

/// Walk at several pairs of f and theta; append the mean motion of each walk to DIR/walks.csv.
///
/// Put the robot in the middle of its field: it stays within a metre of where it begins, and comes back there between
/// walks once it knows four modes, as `flix identify` does. A walk ends early at that metre.
#[derive(Debug, clap::Args)]
#[command(
    allow_missing_positional = true,
    after_help = "\
Examples:
  flix experiment walks walker-3f2c lab
  flix experiment walks walker-3f2c lab --pairs -35:30,30:90 --modes modes.toml
  flix experiment walks lab --repeat 1 --seconds 3s
                                (against flix-sim serve --natnet)"
)]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    /// Folder of the experiments.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Pairs of f in Hz and theta in degrees [default: the nine modes of the paper].
    #[arg(long, value_name = "F:THETA", value_delimiter = ',', allow_hyphen_values = true)]
    pairs: Vec<Pair>,
    /// Number of walks at each pair; the pairs take turns.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = whole::<u32>(1..=100))]
    repeat: u32,
    /// Duration of each walk, 2 to 120 s; its first second does not count.
    #[arg(long, value_name = "TIME", default_value = "8s", value_parser = stretch)]
    seconds: Duration,
    /// Mode table of the robot, to walk back in [default: the modes that it has walked].
    #[arg(long, value_name = "FILE")]
    modes: Option<PathBuf>,
    /// Fence, m: outside it the experiment ends.
    #[arg(long, value_name = "W,S,E,N", default_value = "-2,-2,2,2", allow_hyphen_values = true)]
    fence: Area,
    #[command(flatten)]
    poses: PoseArgs,
    #[command(flatten)]
    record: RecordArgs,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let pairs = match args.pairs.as_slice() {
        [] => pairs(&[])?,
        given => given.iter().map(|pair| (pair.name(), pair.0)).collect(),
    };
    let names = pairs.iter().map(|(name, _)| name.clone());
    let names = names.chain(["back".to_owned()]).collect();
    let known = args.modes.as_deref().map(ModeTable::load).transpose()?;
    let settings = settings(pairs, args.seconds, args.repeat, args.fence);
    let helm = Identification::new(IdentificationSettings { known, ..settings });
    let sheet = Sheet::open(&args.folder, "walks", &COLUMNS)?.of_robot(&args.robot.robot)?;
    let run = Run::open(&args.robot, &args.poses)?;
    let (robot, record) = (args.robot.robot.as_str(), &args.record);
    let experimenter = Experimenter { name: "walks", robot, record, sheet, json: args.json };
    experimenter.walk(run, helm, names)
}
