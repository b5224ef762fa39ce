//! `flix experiment drops`: how a robot lands that somebody drops.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use flix_protocol::units::Instant;
use indicatif::{ProgressBar, ProgressStyle};

use super::experimenter::{Report, comment};
use crate::address::RobotArgs;
use crate::run::PoseArgs;
use flix_host::experiment::Sheet;
use flix_host::experiment::drops::{COLUMNS, Drops, HEIGHT, HEIGHTS, NoDrop};
use flix_host::nav::EndReason;
use flix_host::pose::PoseSource;
use flix_host::pose::any::Poses;
use flix_host::system::interrupt::Interrupt;
use flix_shell::identification::POSE_PATIENCE;
use flix_shell::number::{whole, within};
use flix_shell::outlet::drawn;
use flix_shell::output::complain;
use flix_shell::{Error, Exit};

/// Time between two looks for poses.
const SLICE: Duration = Duration::from_millis(1);

/// Watch how the robot lands that you drop; append each drop to DIR/drops.csv.
///
/// Leave the robot disarmed; nothing is sent to it. Hold it level over the floor, with its soles at the height, still for
/// half a second, and release it at once. The cameras have to take 500 pictures a second.
#[derive(Debug, clap::Args)]
#[command(
    allow_missing_positional = true,
    after_help = "\
Examples:
  flix experiment drops walker-3f2c lab --natnet-server 192.168.1.5
  flix experiment drops lab --repeat 3
              (against flix-sim serve --natnet --pose-rate 1000, where you
              type `drop`)"
)]
pub struct Args {
    /// Name of the robot, for the file.
    #[arg(value_name = "ROBOT")]
    robot: Option<String>,
    /// Folder of the experiments.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Height of the soles over the floor before the drop, 5 to 100 mm.
    #[arg(long, value_name = "MM", default_value_t = HEIGHT, value_parser = within(HEIGHTS, "height", " mm"))]
    height: f64,
    /// Number of drops.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = whole::<u32>(1..=100))]
    repeat: u32,
    #[command(flatten)]
    poses: PoseArgs,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let robot = RobotArgs::new(args.robot.clone(), None).robot;
    let mut sheet = Sheet::open(&args.folder, "drops", &COLUMNS)?.of_robot(&robot)?;
    let source = args.poses.open()?;
    let mut drops = Drops::new(args.height);
    let watched = watch(args, source, &interrupt, &mut drops);
    let rows = drops.rows(sheet.last());
    sheet.append(&comment(&robot), &rows)?;
    sheet.sync()?;
    let ending = watched.as_ref().map_or_else(ToString::to_string, |()| "finished".to_owned());
    let (file, tests) = (sheet.path().to_owned(), drops.count());
    Report { file, tests, rows: rows.len(), ending, record: None }.show(args.json)?;
    watched.map(|()| Exit::Done.into())
}

/// Watches until all drops are made.
fn watch(
    args: &Args,
    mut source: Poses,
    interrupt: &Interrupt,
    drops: &mut Drops,
) -> Result<(), Error> {
    let start = std::time::Instant::now();
    let mut newest = Instant::START;
    let bar = drawn(ProgressBar::new_spinner());
    if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed} {msg}") {
        bar.set_style(style);
    }
    while drops.count() < args.repeat as usize {
        if interrupt.is_raised() {
            return Err(Error::new(Exit::Interrupted, "interrupted"));
        }
        let now = Instant::START + start.elapsed();
        while let Some(sample) = source.poll(now)? {
            if sample.trusted().is_some() {
                newest = now;
            }
            match drops.observe(&sample) {
                None => {}
                Some(Ok(())) => bar.suspend(|| complain(format_args!("drop {}", drops.count()))),
                Some(Err(NoDrop::NoTimes)) => return Err(Error::usage(NoDrop::NoTimes)),
                Some(Err(trouble)) => bar.suspend(|| complain(trouble)),
            }
        }
        // Hands cover markers, but not for long.
        let waited = now.since(newest);
        if newest == Instant::START && waited > POSE_PATIENCE {
            return Err(Error::new(Exit::NoAnswer, EndReason::PoseLost { waited }));
        }
        let state = if drops.is_held() { "held: release it" } else { "hold it still" };
        bar.set_message(format!("{state:<24} drop {} of {}", drops.count() + 1, args.repeat));
        bar.tick();
        std::thread::sleep(SLICE);
    }
    bar.finish_and_clear();
    Ok(())
}
