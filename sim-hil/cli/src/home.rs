//! `flix-sim home`: return to the origin after pushes, in virtual time.

use std::f64::consts::{PI, TAU};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, SystemTime};

use flix_host::nav::{Navigator, PlanarPose, Position, Task};
use flix_host::pilot::steering::names;
use flix_host::pilot::{Ending, Pilot};
use flix_host::record::Recorder;
use flix_protocol::units::Instant;
use flix_shell::course::{SteeringArgs, facts, results};
use flix_shell::number::whole;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::Serialize;

use super::arguments::parse_time;
use super::conditions::{LoopArgs, description};
use super::error::Error;
use super::output::{path_as_text, print_report, progress};
use flix_sim::experiment::course::Course;
use flix_sim::rig::motion_capture::POSE_PERIOD;

/// Farthest push, m.
const FARTHEST: f64 = 0.5;
/// Duration of a push, s: a shove, and a hand that leads the robot.
const PUSH_S: [f64; 2] = [0.3, 1.0];
/// From a push to one on the way home: the robot walks then.
const ON_THE_WAY: Duration = Duration::from_secs(3);
/// A robot that rests nearer than this has come home, mm.
const HOME_WITHIN_MM: f64 = 50.0;
/// It has to rest for so long.
const REST: Duration = Duration::from_secs(1);

/// Return to the origin after pushes, in virtual time
///
/// Somebody pushes the whole simulated robot away, by up to half a metre in 0.3 to 1 s, and turns it to any heading; every other
/// time also on its way home.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix-sim home --pushes 20
  flix-sim home --pushes 20 --seed 7 --loss 0.2 --latency 100ms --json")]
pub struct Args {
    /// Number of pushes
    #[arg(long, default_value_t = 20, value_parser = whole::<u32>(1..=1000))]
    pushes: u32,
    #[command(flatten)]
    steering: SteeringArgs,
    #[command(flatten)]
    conditions: LoopArgs,
    /// Robot's time after which a return is given up
    #[arg(long, value_name = "TIME", default_value = "5m", value_parser = parse_time)]
    patience: Duration,
    /// Folder for the record.
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    pushes: u32,
    arrived: usize,
    final_error_mm: Vec<f64>,
    seconds: Vec<f64>,
    median_seconds: f64,
    seed: u64,
    controller: String,
    ending: String,
    #[serde(serialize_with = "path_as_text")]
    record: PathBuf,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let task = Task::Reach { point: Position::ORIGIN, stay: true };
    let repertoire = args.steering.repertoire(|| args.conditions.table())?;
    let table = repertoire.table();
    let mut settings = args.steering.settings(&task);
    settings.latency = args.conditions.latency;
    let mut setup = facts(&settings);
    setup.extend(args.conditions.facts());
    let navigator = Navigator::new(task, repertoire, settings).map_err(Error::usage)?;
    let mut recorder = Recorder::create(&args.out, SystemTime::now(), &description("home", setup))?;
    recorder.attach(
        Instant::START,
        "modes.toml",
        "application/toml",
        table.to_toml().as_bytes(),
    )?;
    let pilot = Pilot::new(navigator, names(&table), Some(recorder));
    let course = Course::new(&args.conditions.conditions(PlanarPose::default())?, pilot)?;
    let report = push_around(args, course)?;
    print_report(&report, args.json, || text(&report))?;
    let all = report.arrived == report.pushes as usize;
    Ok(if all { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn push_around(args: &Args, mut course: Course<Navigator>) -> Result<Report, Error> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(args.conditions.seed);
    random.jump();
    let bar = progress(u64::from(args.pushes), "pushes");
    let (mut errors, mut seconds) = (Vec::new(), Vec::new());
    let mut ending = wait_for_rest(&mut course, args.patience, |_| {})?.err();
    for _ in 0..args.pushes {
        if ending.is_some() {
            break;
        }
        push(&mut course, FARTHEST, &mut random);
        // Every other push is followed by one on the way home.
        let mut again = random.random::<bool>().then(|| course.now() + ON_THE_WAY);
        let arrived = wait_for_rest(&mut course, args.patience, |course| {
            if again.is_some_and(|at| course.now() >= at) {
                again = None;
                push(course, FARTHEST / 2.0, &mut random);
            }
        });
        match arrived? {
            Ok(taken) => {
                errors.push(course.truth().distance_to(Position::ORIGIN) * 1e3);
                seconds.push(taken);
            }
            Err(reason) => ending = Some(reason),
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let ending = match ending {
        Some(ending) => ending,
        None => conclude(&mut course)?,
    };
    report(args, course, errors, seconds, &ending)
}

type Waited = Result<Result<f64, Ending>, Error>;

/// Pushes the robot in any direction, at most so far, m, and turns it to any heading.
fn push(course: &mut Course<Navigator>, farthest: f64, random: &mut Xoshiro256PlusPlus) {
    let (bearing, distance) =
        (TAU * random.random::<f64>(), farthest * random.random::<f64>().sqrt());
    let turn = TAU * random.random::<f64>() - PI;
    let [shortest, longest] = PUSH_S;
    let lasts = shortest + (longest - shortest) * random.random::<f64>();
    let offset = (distance * bearing.cos(), distance * bearing.sin());
    course.push(offset, turn, Duration::from_secs_f64(lasts));
}

/// Runs until the robot has rested for [`REST`] and no push is under way; the time that it took to come to rest. `meddle` may
/// push the robot.
fn wait_for_rest(
    course: &mut Course<Navigator>,
    patience: Duration,
    mut meddle: impl FnMut(&mut Course<Navigator>),
) -> Waited {
    let begin = course.now();
    let mut rested = Duration::ZERO;
    loop {
        meddle(course);
        if let Some(ending) = course.step()? {
            return Ok(Err(ending));
        }
        let rests = course.pilot().helm().is_resting() && !course.is_pushed();
        rested = if rests { rested + POSE_PERIOD } else { Duration::ZERO };
        let waited = course.now().since(begin);
        if rested >= REST {
            return Ok(Ok(waited.saturating_sub(REST).as_secs_f64()));
        }
        if waited > patience {
            course.end(Ending::OutOfTime(patience));
        }
    }
}

/// Lets the pilot end the run well.
fn conclude(course: &mut Course<Navigator>) -> Result<Ending, Error> {
    course.pilot_mut().helm_mut().conclude();
    loop {
        if let Some(ending) = course.step()? {
            return Ok(ending);
        }
    }
}

fn report(
    args: &Args,
    course: Course<Navigator>,
    errors: Vec<f64>,
    seconds: Vec<f64>,
    ending: &Ending,
) -> Result<Report, Error> {
    let begun = course.pilot().driving_since().unwrap_or(course.now());
    let total = course.now().since(begun).as_secs_f64();
    let pilot = course.into_pilot();
    let controller = pilot.helm().settings().controller.to_string();
    let numbers = results(pilot.helm(), total);
    let (_, record) = pilot.finish(numbers);
    let record = record.complete()?;
    let mut sorted = seconds.clone();
    sorted.sort_by(f64::total_cmp);
    Ok(Report {
        pushes: args.pushes,
        arrived: errors.iter().filter(|e| **e <= HOME_WITHIN_MM).count(),
        final_error_mm: errors,
        median_seconds: sorted.get(sorted.len() / 2).copied().unwrap_or(f64::MAX),
        seconds,
        seed: args.conditions.seed,
        controller,
        ending: ending.to_string(),
        record: record.unwrap_or_default(),
    })
}

fn text(report: &Report) -> String {
    let worst = report.final_error_mm.iter().copied().fold(0.0, f64::max);
    format!(
        "{} of {} pushes ended at home ({})\n  final error  {worst:.1} mm at most\n  \
         time         {:.1} s (median)\n  record       {}\n",
        report.arrived,
        report.pushes,
        report.ending,
        report.median_seconds,
        report.record.display()
    )
}
