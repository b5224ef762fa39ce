//! `flix-sim track`: follow a path, in virtual time.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, SystemTime};

use clap::{Args as _, FromArgMatches as _};
use flix_host::nav::{Path, PlanarPose, Task};
use flix_host::pilot::steering::Steering;
use flix_host::pilot::steering::names;
use flix_host::pilot::{Ending, Pilot};
use flix_host::record::{Recorder, Run};
use flix_plot::Figure;
use flix_shell::course::{CourseArgs, describe, facts, results, row};
use flix_shell::number::within;
use serde::Serialize;

use super::arguments::parse_time;
use super::conditions::{LoopArgs, description};
use super::error::Error;
use super::output::{optional_path_as_text, path_as_text, print_report, progress};
use flix_sim::experiment::course::Course;
use flix_sim::rig::motion_capture::POSE_PERIOD;
use flix_sim::view::Film;

/// Longest real time for an answer of a controller process.
const ANSWER_PATIENCE: Duration = Duration::from_secs(2);

/// Follow a path with the whole simulated robot, in virtual time
///
/// The host's navigation drives the robot's software and its plant over the real protocol.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix-sim track figure8
  flix-sim track figure8 --controller two-state --json
  flix-sim track figure8 --heading 135
  flix-sim track circle --radius 0.3 --loss 0.2 --latency 100ms")]
pub struct Args {
    #[command(flatten)]
    course: CourseArgs,
    #[command(flatten)]
    conditions: LoopArgs,
    /// Heading at the start, degrees to the left of the path
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_negative_numbers = true, value_parser = within(-360.0..=360.0, "heading", " degrees"))]
    heading: f64,
    /// Robot's time of driving after which the run is given up
    #[arg(long, value_name = "TIME", default_value = "1h", value_parser = parse_time)]
    patience: Duration,
    /// Folder for record, pictures and replay.
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Print JSON only; write no replay
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Composes `flix-sim track PATH --seed SEED --out OUT`.
    pub(super) fn of(path: &str, seed: u64, out: &std::path::Path) -> Self {
        let command = Self::augment_args(clap::Command::new("track"));
        let mut args = Self::from_arg_matches(&command.get_matches_from(["track", path]))
            .expect("every option but the path has a default");
        args.conditions.seed = seed;
        args.out = out.to_owned();
        args
    }
}

/// How a run went.
#[derive(Debug, Serialize)]
pub struct Report {
    /// What was followed.
    pub path: String,
    /// Who steered.
    pub controller: String,
    /// All chance.
    pub seed: u64,
    /// Whether all laps were walked.
    pub finished: bool,
    /// How the run ended.
    pub ending: String,
    /// Root mean square of the distance from the path, mm.
    pub path_error_rms_mm: f64,
    /// Mean of it, positive to the left of the path, mm.
    pub path_error_mean_mm: f64,
    /// Largest distance from it, mm.
    pub path_error_peak_mm: f64,
    /// Laps walked.
    pub laps: f64,
    /// Robot's time from arming to the end, s.
    pub seconds: f64,
    /// Given by the battery, J.
    pub energy_j: f64,
    /// Changes of mode.
    pub mode_switches: u32,
    /// What the record states of it.
    #[serde(skip)]
    results: BTreeMap<String, String>,
    /// The MCAP.
    #[serde(serialize_with = "path_as_text")]
    pub record: PathBuf,
    /// The picture of the track.
    #[serde(serialize_with = "path_as_text")]
    pub plot: PathBuf,
    /// The page that replays it, unless JSON was asked for.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "optional_path_as_text")]
    pub replay: Option<PathBuf>,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let report = follow(args)?;
    print_report(&report, args.json, || report.to_text())?;
    Ok(if report.finished { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Walks to the end and writes record, pictures and replay.
pub(super) fn follow(args: &Args) -> Result<Report, Error> {
    let path = args.course.path()?;
    let task = args.course.task(&path)?;
    let laps = if let Task::Follow { laps, .. } = &task { *laps } else { 1 };
    let repertoire = args.course.steering.repertoire(|| args.conditions.table())?;
    let table = repertoire.table();
    let mut settings = args.course.settings(&task)?;
    settings.latency = args.conditions.latency;
    let mut setup = facts(&settings);
    setup.extend(args.conditions.facts());
    setup.insert("controller".into(), args.course.controller());
    setup.insert("heading_deg".into(), args.heading.to_string());
    let about = description(&format!("track-{}", path.name()), setup);
    let steering = args.course.steering(task.clone(), repertoire, settings, ANSWER_PATIENCE)?;
    let mut recorder = Recorder::create(&args.out, SystemTime::now(), &about)?;
    let begin = flix_protocol::units::Instant::START;
    recorder.path_to_follow(begin, &path)?;
    recorder.attach(begin, "modes.toml", "application/toml", table.to_toml().as_bytes())?;
    let pilot = Pilot::new(steering, names(&table), Some(recorder)).within(args.patience);
    let along = path.start();
    let start = PlanarPose { heading: along.heading + args.heading.to_radians(), ..along };
    let conditions = args.conditions.conditions(start)?;
    // A frame for every pose: often enough to see which way the rotors turn.
    let mut film = (!args.json).then(|| Film::new(&conditions.model, POSE_PERIOD.as_secs_f64()));
    let mut course = Course::new(&conditions, pilot)?;
    let bar = progress((f64::from(laps) * path.length() * 1e3) as u64, "mm walked");
    let ending = loop {
        if let Some(ending) = course.step()? {
            break ending;
        }
        if let Some(film) = &mut film {
            film.caption(course.plant(), course.pilot().doing());
            film.shoot(course.plant());
        }
        bar.set_position(
            (course.pilot().helm().navigator().progress().arc_length.max(0.0) * 1e3) as u64,
        );
    };
    bar.finish_and_clear();
    finish(args, course, &ending, &path, film)
}

fn finish(
    args: &Args,
    course: Course<Steering>,
    ending: &Ending,
    path: &Path,
    film: Option<Film>,
) -> Result<Report, Error> {
    let begun = course.pilot().driving_since().unwrap_or(course.now());
    let seconds = course.now().since(begun).as_secs_f64();
    let energy = course.energy();
    let pilot = course.into_pilot();
    let numbers = results(pilot.helm().navigator(), seconds);
    let (steering, record) = pilot.finish(numbers.clone());
    let Some(record) = record.complete()? else { return Err(Error::usage(ending)) };
    let run = Run::read(&record)?;
    let stem = record.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let folder = record.parent().map(PathBuf::from).unwrap_or_default();
    let plot = flix_plot::record::track(&run).write(&folder, &format!("{stem}-track"))?;
    flix_plot::record::timeline(&run).write(&folder, &format!("{stem}-timeline"))?;
    let replay = film
        .map(|film| {
            let mut recording = film.into_recording(format!(
                "Model {}: {}",
                args.conditions.model.model,
                path.name()
            ));
            recording.reference = path.points().iter().map(|p| [p.x, p.y]).collect();
            recording.write(&folder.join(format!("{stem}-replay.html")))
        })
        .transpose()?;
    let progress = steering.navigator().progress();
    Ok(Report {
        path: path.name().to_owned(),
        controller: args.course.controller(),
        seed: args.conditions.seed,
        finished: *ending == Ending::Finished,
        ending: ending.to_string(),
        path_error_rms_mm: progress.error_rms * 1e3,
        path_error_mean_mm: progress.error_mean * 1e3,
        path_error_peak_mm: progress.error_peak * 1e3,
        laps: progress.laps,
        seconds,
        energy_j: energy,
        mode_switches: progress.switches,
        results: numbers,
        record,
        plot: plot.png,
        replay,
    })
}

impl Report {
    /// Formats the run for people.
    pub(super) fn to_text(&self) -> String {
        let mut text = format!(
            "{} ({} controller, seed {}): {}\n",
            self.path, self.controller, self.seed, self.ending
        );
        text += &describe(&self.results);
        text += &row("energy", format_args!("{:.0} J from the battery", self.energy_j));
        text += &row("plot", self.plot.display());
        if let Some(replay) = &self.replay {
            text += &row("replay", replay.display());
        }
        text + &row("record", format_args!("{} (MCAP)", self.record.display()))
    }
}
