//! `flix identify`: measures the motion of each mode.

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::time::Duration;

use flix_protocol::message::Setpoint;

use super::course::pairs;
use super::number::whole;
use super::output::{headings, print, table};
use super::robot::RobotArgs;
use super::time::duration;
use super::walk::{FileArgs, PoseArgs, Walk, unrecorded, verdict};
use super::{Error, Exit};
use crate::nav::{Area, Identification, IdentificationSettings, ModeTable};
use crate::pilot::{Pilot, Recorded};

/// Without trusted poses a measurement ends after this time.
pub(super) const POSE_PATIENCE: Duration = Duration::from_secs(5);

/// Options of an identification.
#[derive(Debug, Clone, clap::Args)]
pub struct IdentificationArgs {
    /// Duration of each stretch, 2 to 120 s; its first second does not count.
    #[arg(long, value_name = "TIME", default_value = "8s", value_parser = stretch)]
    pub seconds: Duration,
    /// Number of stretches of each mode; their scatter becomes the spread.
    #[arg(long, default_value_t = 2, value_parser = whole::<u32>(1..=100))]
    pub rounds: u32,
    /// Names of the modes to identify [default: all of the paper].
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Fence, m: outside it the identification ends.
    #[arg(long, value_name = "W,S,E,N", default_value = "-2,-2,2,2", allow_hyphen_values = true)]
    pub fence: Area,
}

pub(super) fn stretch(text: &str) -> Result<Duration, String> {
    let time = duration(text)?;
    if (Duration::from_secs(2)..=Duration::from_secs(120)).contains(&time) {
        Ok(time)
    } else {
        Err(format!("a stretch of {} s is outside 2 to 120 s", time.as_secs_f64()))
    }
}

impl IdentificationArgs {
    /// Returns an identification with these options, and the names of its modes.
    ///
    /// # Errors
    /// When the name of a mode is unknown.
    pub fn identification(&self) -> Result<(Identification, Vec<String>), Error> {
        let pairs = pairs(&self.only)?;
        let names = pairs.iter().map(|(name, _)| name.clone()).collect();
        Ok((identification(pairs, self.seconds, self.rounds, self.fence, None), names))
    }

    /// Returns how the table is made, in a few words.
    #[must_use]
    pub fn source(&self) -> String {
        let seconds = self.seconds.as_secs_f64();
        match self.rounds {
            1 => format!("identified: 1 stretch of {seconds} s a mode; the spread is assumed"),
            rounds => format!("identified: {rounds} stretches of {seconds} s a mode"),
        }
    }
}

/// Returns an identification of these pairs, as every command makes it.
pub(super) fn identification(
    pairs: Vec<(String, Setpoint)>,
    stretch: Duration,
    rounds: u32,
    fence: Area,
    known: Option<ModeTable>,
) -> Identification {
    Identification::new(IdentificationSettings {
        pairs,
        stretch,
        rounds,
        fence,
        pose_deadline: Duration::from_millis(100),
        pose_patience: POSE_PATIENCE,
        known,
    })
}

/// Measure the motion of each mode, and write the mode table that `flix track` needs.
///
/// Put the robot in the middle of its field: it stays within a metre of where it begins, and comes back
/// there.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix identify walker-1 --natnet-server 192.168.1.5 --modes walker-1.modes.toml
  flix identify --rounds 1 --seconds 4s      (against flix-sim serve --natnet)")]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    #[command(flatten)]
    identification: IdentificationArgs,
    #[command(flatten)]
    poses: PoseArgs,
    #[command(flatten)]
    files: FileArgs,
}

/// Returns the table as text.
#[must_use]
pub fn describe(modes: &ModeTable) -> String {
    let speed = |s: crate::nav::Spread, digits: usize| {
        format!("{:.*} \u{b1} {:.*}", digits, s.mean, digits, s.spread)
    };
    let mut rows = vec![headings("mode|f/Hz|theta/deg|forward m/s|lateral m/s|yaw rad/s")];
    rows.extend(modes.modes().iter().map(|mode| {
        vec![
            mode.name.clone(),
            mode.setpoint.frequency().get().to_string(),
            mode.setpoint.direction().get().to_string(),
            speed(mode.forward, 4),
            speed(mode.lateral, 4),
            speed(mode.yaw, 3),
        ]
    }));
    table(&rows)
}

/// Runs the command.
///
/// # Errors
/// When something is missing, or the run ended early.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let (identification, names) = args.identification.identification()?;
    ModeTable::check_writable(&args.files.modes)?;
    let mut walk = Walk::open(&args.robot, &args.poses)?;
    let facts = BTreeMap::from([("identification".into(), args.identification.source())]);
    let recorder = walk.record(&args.files.record.out, "identify", facts)?;
    let mut pilot = Pilot::new(identification, names, Some(recorder))
        .driving_unrecorded(args.files.record.unrecorded);
    let (ending, _) = walk.drive(&mut pilot, |pilot| {
        let (done, all) = pilot.helm().progress();
        format!("{:<24} stretch {} of {all}", pilot.doing(), (done + 1).min(all))
    })?;
    walk.leave();
    let (identification, Recorded { file, error }) = pilot.finish(BTreeMap::new());
    verdict(&ending, file.as_ref())?;
    let source = args.identification.source();
    let modes = identification.table(&args.robot.robot, &source)?;
    modes.save(&args.files.modes)?;
    let assumed = match args.identification.rounds {
        1 => "\u{b1}: assumed, 30 % of the mean; two rounds or more measure it\n",
        _ => "",
    };
    let (table, file) = (describe(&modes), args.files.modes.display());
    print(&format!("{table}{assumed}\nwritten to {file}\n"))?;
    unrecorded(error, args.files.record.unrecorded)?;
    Ok(Exit::Done.into())
}
