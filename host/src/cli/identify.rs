//! `flix identify`: learn how each mode moves this robot.

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::time::Duration;

use super::course::pairs;
use super::output::print;
use super::robot::FieldRobotArgs;
use super::walk::{FileArgs, PoseArgs, Walk, record, verdict};
use super::{Error, Exit};
use crate::nav::{Fence, ModeTable, Survey, SurveySettings};
use crate::pilot::Pilot;

/// How long and how often modes are driven.
#[derive(Debug, Clone, clap::Args)]
pub struct SurveyArgs {
    /// How long each stretch lasts; its first second is not counted.
    #[arg(long, value_name = "TIME", default_value = "8s", value_parser = stretch)]
    pub seconds: Duration,
    /// Stretches of each mode; their scatter becomes the spread.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub rounds: u32,
    /// Only these modes, by name.
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Outside west,south,east,north (m) the survey ends.
    #[arg(long, value_name = "W,S,E,N", default_value = "-2,-2,2,2", allow_hyphen_values = true)]
    pub fence: Fence,
}

fn stretch(text: &str) -> Result<Duration, String> {
    let seconds = text.parse::<f64>().ok().filter(|s| s.is_finite() && *s >= 0.0);
    let time = match seconds {
        Some(seconds) => Duration::try_from_secs_f64(seconds).map_err(|e| e.to_string())?,
        None => humantime::parse_duration(text).map_err(|e| e.to_string())?,
    };
    if (Duration::from_secs(2)..=Duration::from_secs(120)).contains(&time) {
        Ok(time)
    } else {
        Err(format!("a stretch of {} s is outside 2 to 120 s", time.as_secs_f64()))
    }
}

impl SurveyArgs {
    /// A survey as asked for.
    ///
    /// # Errors
    /// When a mode's name is not known.
    pub fn survey(&self) -> Result<(Survey, Vec<String>), Error> {
        let pairs = pairs(&self.only)?;
        let names = pairs.iter().map(|(name, _)| name.clone()).collect();
        let survey = Survey::new(SurveySettings {
            pairs,
            stretch: self.seconds,
            rounds: self.rounds,
            fence: self.fence,
            pose_deadline: Duration::from_millis(100),
            pose_patience: Duration::from_secs(5),
        });
        Ok((survey, names))
    }

    /// How a table came about, in a few words.
    #[must_use]
    pub fn source(&self) -> String {
        format!("identified: {} stretches of {} s a mode", self.rounds, self.seconds.as_secs_f64())
    }
}

/// Drive every mode for some seconds and write the mode table that `flix track` needs.
///
/// Put the robot in the middle of its field: it walks up to a metre.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix identify walker-1 --natnet-server 192.168.1.5 --modes walker-1.modes.toml
  flix identify --rounds 1 --seconds 4s                    (against flix-sim serve --natnet)")]
pub struct Args {
    #[command(flatten)]
    robot: FieldRobotArgs,
    #[command(flatten)]
    survey: SurveyArgs,
    #[command(flatten)]
    poses: PoseArgs,
    #[command(flatten)]
    files: FileArgs,
}

/// A table for people.
#[must_use]
pub fn describe(table: &ModeTable) -> String {
    let mut text = format!(
        "{:<14} {:>6} {:>6}  {:>17}  {:>17}  {:>15}\n",
        "mode", "f/Hz", "theta", "forward m/s", "lateral m/s", "yaw rad/s"
    );
    for mode in table.modes() {
        let speed = |s: crate::nav::Spread, digits: usize| {
            format!("{:.*} \u{b1} {:.*}", digits, s.mean, digits, s.spread)
        };
        text.push_str(&format!(
            "{:<14} {:>6} {:>6}  {:>17}  {:>17}  {:>15}\n",
            mode.name,
            mode.setpoint.frequency().get(),
            mode.setpoint.direction().get(),
            speed(mode.forward, 4),
            speed(mode.lateral, 4),
            speed(mode.yaw, 3),
        ));
    }
    text
}

/// Learns the modes.
///
/// # Errors
/// When something is missing, or the run ended early; the sentence says why.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let (survey, names) = args.survey.survey()?;
    let mut walk = Walk::open(&args.robot.robot(), &args.poses)?;
    let facts = BTreeMap::from([("survey".into(), args.survey.source())]);
    let recorder = record(&args.files.out, &mut walk, "identify", facts)?;
    let mut pilot = Pilot::new(survey, names, Some(recorder));
    let (ending, _) = walk.drive(&mut pilot, |pilot| {
        let (done, all) = pilot.helm().progress();
        format!("{:<24} stretch {} of {all}", pilot.doing(), (done + 1).min(all))
    })?;
    walk.leave();
    let (survey, file) = pilot.finish(BTreeMap::new())?;
    verdict(&ending, file.as_ref())?;
    let table = survey.table(&args.robot.robot().robot, &args.survey.source())?;
    table.save(&args.files.modes)?;
    print(&format!("{}\nwritten to {}\n", describe(&table), args.files.modes.display()))?;
    Ok(Exit::Done.into())
}
