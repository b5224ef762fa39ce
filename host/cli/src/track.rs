//! `flix track`: follows a path.

use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use super::address::RobotArgs;
use super::run::{FileArgs, PoseArgs, Run, unrecorded, verdict};
use flix_host::pilot::steering::names;
use flix_host::pilot::{Pilot, Recorded};
use flix_shell::course::{CourseArgs, describe, facts, results, row, table_for};
use flix_shell::output::{print, print_json};
use flix_shell::time::positive_duration;
use flix_shell::{Error, Exit};

/// Longest time for an answer of a controller process: well within the command deadline of 250 ms.
const ANSWER_PATIENCE: Duration = Duration::from_millis(100);

/// Follow a path, with poses from motion capture.
///
/// The robot is armed, driven, and disarmed. Lost poses, the fence, a large path error, Ctrl-C,
/// SIGTERM and a closed terminal stop it.
#[derive(Debug, clap::Args)]
#[command(
    allow_missing_positional = true,
    after_help = "\
Examples:
  flix track daisy figure8 --modes daisy.toml --natnet-server 192.168.1.5
  flix track circle --radius 0.3 --laps 1    (against flix-sim serve --natnet)
  flix track walker-3f2c room.csv --at 0.5,0.2 --turned 90"
)]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    #[command(flatten)]
    course: CourseArgs,
    #[command(flatten)]
    poses: PoseArgs,
    #[command(flatten)]
    files: FileArgs,
    /// Time of driving after which the run is given up.
    #[arg(long, value_name = "TIME", default_value = "1h", value_parser = positive_duration)]
    patience: Duration,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let path = args.course.path()?;
    let name = format!("track-{}", path.name());
    let task = args.course.task(&path)?;
    let settings = args.course.settings(&task)?;
    let repertoire = args.course.steering.repertoire(|| -> Result<_, Error> {
        Ok(table_for(&args.robot.robot, &args.files.modes)?)
    })?;
    let table = repertoire.table();
    let mut setup = facts(&settings);
    setup.insert("controller".into(), args.course.controller());
    let steering = args.course.steering(task.clone(), repertoire, settings, ANSWER_PATIENCE)?;
    let mut run = Run::open(&args.robot, &args.poses)?;
    let mut recorder = run.record(&args.files.record, &name, setup)?;
    recorder.path_to_follow(run.now(), &path)?;
    recorder.attach(run.now(), "modes.toml", "application/toml", table.to_toml().as_bytes())?;
    let mut pilot = Pilot::new(steering, names(&table), Some(recorder))
        .driving_unrecorded(args.files.record.unrecorded)
        .within(args.patience);
    let (ending, seconds) = run.drive(&mut pilot, |pilot| {
        let progress = pilot.helm().navigator().progress();
        format!(
            "{:<24} {:.2} laps, error {:>4.0} mm now, {:.0} mm RMS",
            pilot.doing(),
            progress.laps,
            progress.error * 1e3,
            progress.error_rms * 1e3
        )
    })?;
    let stop = run.leave();
    let (walked, controller) = (name.trim_start_matches("track-"), args.course.controller());
    let numbers = results(pilot.helm().navigator(), seconds);
    let (_, Recorded { file, error }) = pilot.finish(numbers.clone());
    verdict(&ending, stop, file.as_ref())?;
    if args.json {
        let mut report = serde_json::Map::new();
        for (key, value) in &numbers {
            report.insert(
                key.clone(),
                value.parse::<f64>().map_or_else(|_| value.clone().into(), Into::into),
            );
        }
        report.insert("path".into(), walked.into());
        report.insert("controller".into(), controller.into());
        report.insert("finished".into(), true.into());
        report.insert("ending".into(), ending.to_string().into());
        report.insert("record".into(), file.as_deref().map(Path::to_string_lossy).into());
        print_json(&report)?;
    } else {
        let mut text = format!("{walked} ({controller} controller): {ending}\n");
        text += &describe(&numbers);
        if let Some(file) = file {
            text += &row("record", format_args!("{} (MCAP)", file.display()));
        }
        print(&text)?;
    }
    unrecorded(error, args.files.record.unrecorded)?;
    Ok(Exit::Done.into())
}
