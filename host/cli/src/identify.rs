//! `flix identify`: measures the motion of each mode.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use flix_protocol::message::Setpoint;
use flix_protocol::units::{Degrees, Hertz};

use super::address::RobotArgs;
use super::drive;
use super::experiment::Experimenter;
use super::run::{FileArgs, PoseArgs, Run, unrecorded, verdict};
use flix_host::experiment::grid::{self, Grid};
use flix_host::experiment::{Sheet, walks};
use flix_host::nav::{Identification, IdentificationSettings, ModeTable};
use flix_host::pilot::{Pilot, Recorded};
use flix_shell::identification::{IdentificationArgs, save};
use flix_shell::number::within;
use flix_shell::output::print;
use flix_shell::{Error, Exit};

/// Options of a grid.
#[derive(Debug, clap::Args)]
struct GridArgs {
    /// Walk a grid of pairs instead, and append the mean motion of each walk to this CSV, which
    /// `flix-sim study calibrate --measured` reads. The same command goes on where it ended.
    #[arg(long, value_name = "CSV", conflicts_with = "only")]
    grid: Option<PathBuf>,
    /// Frequencies of the grid, Hz [default: -35,-30,-20,-10,10,20,30,35].
    #[arg(long, value_name = "HZ", value_delimiter = ',', allow_hyphen_values = true, value_parser = frequency, requires = "grid")]
    frequencies: Vec<f32>,
    /// Directions of the grid, degrees [default: -90,-60,-30,0,30,60,90].
    #[arg(long, value_name = "DEG", value_delimiter = ',', allow_hyphen_values = true, value_parser = direction, requires = "grid")]
    directions: Vec<f32>,
    /// Voltage of the resting robot's battery below which the grid ends, V, where the board measures it [default: the
    /// robot's setting `battery_low`].
    #[arg(long, value_name = "V", value_parser = volts, requires = "grid")]
    least_battery: Option<f32>,
}

/// Frequencies of the usual grid, Hz: a choice of ours, as the paper names none.
const FREQUENCIES: [f32; 8] = [-35.0, -30.0, -20.0, -10.0, 10.0, 20.0, 30.0, 35.0];
/// Directions of the usual grid, degrees.
const DIRECTIONS: [f32; 7] = [-90.0, -60.0, -30.0, 0.0, 30.0, 60.0, 90.0];

fn frequency(text: &str) -> Result<f32, String> {
    drive::frequency(text).map(Hertz::get)
}

fn direction(text: &str) -> Result<f32, String> {
    drive::direction(text).map(Degrees::get)
}

fn volts(text: &str) -> Result<f32, String> {
    within(0.0..=60.0, "voltage", " V")(text).map(|volts| volts as f32)
}

impl GridArgs {
    /// Returns the grid, each pair once.
    fn pairs(&self, walks: u32) -> Grid {
        let or = |given: &[f32], usual: &[f32]| {
            if given.is_empty() { usual.to_vec() } else { given.to_vec() }
        };
        let directions = or(&self.directions, &DIRECTIONS);
        let mut pairs: Vec<Setpoint> = Vec::new();
        for f in or(&self.frequencies, &FREQUENCIES) {
            for theta in &directions {
                let pair = Setpoint::saturating(f, *theta);
                if !pairs.contains(&pair) {
                    pairs.push(pair);
                }
            }
        }
        Grid { pairs, walks: walks as usize }
    }
}

/// Measure the motion of each mode, and write the mode table that `flix track` needs.
///
/// Put the robot in the middle of its field: it stays within a metre of where it begins, and comes back
/// there. With --grid it walks any grid of pairs, for a calibration; it comes back once it knows four modes.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix identify daisy --natnet-server 192.168.1.5 --modes daisy.modes.toml
  flix identify --rounds 1 --seconds 4s      (against flix-sim serve --natnet)
  flix identify walker-3f2c --grid speeds.csv --frequencies=-30,30 --rounds 3
  flix-sim study calibrate --measured speeds.csv")]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    #[command(flatten)]
    identification: IdentificationArgs,
    #[command(flatten)]
    grid: GridArgs,
    #[command(flatten)]
    poses: PoseArgs,
    #[command(flatten)]
    files: FileArgs,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    if let Some(file) = &args.grid.grid {
        return walk_grid(args, file);
    }
    let (identification, names) = args.identification.identification()?;
    ModeTable::check_writable(&args.files.modes)?;
    let mut run = Run::open(&args.robot, &args.poses)?;
    let facts = BTreeMap::from([("identification".into(), args.identification.source())]);
    let recorder = run.record(&args.files.record, "identify", facts)?;
    let mut pilot = Pilot::new(identification, names, Some(recorder))
        .driving_unrecorded(args.files.record.unrecorded);
    let (ending, _) = run.drive(&mut pilot, |pilot| {
        let (done, all) = pilot.helm().progress();
        format!("{:<24} stretch {} of {all}", pilot.doing(), (done + 1).min(all))
    })?;
    let stop = run.leave();
    let (identification, Recorded { file, error }) = pilot.finish(BTreeMap::new());
    verdict(&ending, stop, file.as_ref())?;
    let source = args.identification.source();
    let modes = identification.table(&args.robot.robot, &source)?;
    let assumed = match args.identification.rounds {
        1 => "\u{b1}: assumed, 30 % of the mean; two rounds or more measure it\n",
        _ => "",
    };
    save(&modes, assumed, &args.files.modes)?;
    unrecorded(error, args.files.record.unrecorded)?;
    Ok(Exit::Done.into())
}

/// Walks what the file lacks of the grid, round by round.
fn walk_grid(args: &Args, file: &Path) -> Result<ExitCode, Error> {
    let grid = args.grid.pairs(args.identification.rounds);
    let is_csv = file.extension().is_some_and(|extension| extension == "csv") && !file.is_dir();
    let (folder, Some(name), true) =
        (file.parent().unwrap_or(Path::new("")), file.file_stem(), is_csv)
    else {
        return Err(Error::usage(format_args!(
            "--grid {}: give the name of a CSV file, for example speeds.csv",
            file.display()
        )));
    };
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let robot = args.robot.robot.as_str();
    let open = || Sheet::open(folder, &name.to_string_lossy(), &walks::COLUMNS)?.of_robot(robot);
    for _ in 0..grid.walks {
        let sheet = open()?;
        let round = grid.next_round(sheet.rows());
        if round.is_empty() {
            break;
        }
        let pairs = round.iter().map(|pair| (grid::name(pair), *pair)).collect::<Vec<_>>();
        let names = pairs.iter().map(|(name, _)| name.clone());
        let names = names.chain(["back".to_owned()]).collect();
        let mut run = Run::open(&args.robot, &args.poses)?;
        let least_battery = match args.grid.least_battery {
            None => run.battery_low()?,
            given => given,
        };
        let helm = Identification::new(IdentificationSettings {
            rounds: 1,
            least_battery,
            known: grid.modes(sheet.rows()),
            ..args.identification.settings(pairs)
        });
        let record = &args.files.record;
        Experimenter { name: "grid", robot, record, sheet, json: false }.walk(run, helm, names)?;
    }
    let missing = grid.next_round(open()?.rows());
    if missing.is_empty() {
        let (pairs, walks) = (grid.pairs.len(), grid.walks);
        print(&format!("the grid is whole: {pairs} pairs, {walks} walks of each\n"))?;
        return Ok(Exit::Done.into());
    }
    let missing: Vec<String> = missing.iter().map(grid::name).collect();
    Err(Error::new(
        Exit::NotNow,
        format_args!("walks are missing at {}: run the same command again", missing.join(", ")),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_has_each_pair_once_and_refuses_what_the_robot_cannot_shake() {
        let args = GridArgs {
            grid: None,
            frequencies: vec![30.0, -30.0, 30.0],
            directions: vec![0.0, 90.0],
            least_battery: None,
        };
        let names: Vec<String> = args.pairs(1).pairs.iter().map(grid::name).collect();
        assert_eq!(names, ["30:0", "30:90", "-30:0", "-30:90"]);
        assert!(frequency("36").unwrap_err().contains("36"));
        assert!(frequency("fast").unwrap_err().contains("fast"));
        assert!(direction("91").unwrap_err().contains("91"));
    }
}
