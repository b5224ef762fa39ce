//! Driving by hand: what the commands share that differ in their screen alone.

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::time::Duration;

use self::drive::{Drive, DriveError, Ending, Extras};
use super::address::RobotArgs;
use super::run::{PlaceArgs, PoseArgs, record};
use flix_host::link::{RobotLink, StopState};
use flix_host::pose::any::Poses;
use flix_host::system::interrupt::Interrupt;
use flix_shell::output::print;
use flix_shell::stream::StreamArgs;
use flix_shell::{Error, Exit};

pub mod drive;

/// Range of the time after which a robot rests without a sign of its operator.
const SHORTEST_PATIENCE: Duration = Duration::from_secs(1);
const LONGEST_PATIENCE: Duration = Duration::from_secs(3600);

/// Options of driving by hand.
#[derive(Debug, clap::Args)]
pub struct ByHandArgs {
    #[command(flatten)]
    robot: RobotArgs,
    #[command(flatten)]
    poses: PoseArgs,
    /// Walk only while the key or button of a walk is held. `teleop` needs a terminal with kitty's keyboard protocol for it, and
    /// keys that repeat: one that is silent for 0.8 s is held no more.
    #[arg(long)]
    pub hold_to_run: bool,
    /// Rest after so long without a key, touch or stick, 1 s to 1 h.
    #[arg(long, value_name = "TIME", default_value = "30s", value_parser = patience)]
    rest_after: Duration,
    /// Record the drive below OUT/runs; so does --foxglove.
    #[arg(long)]
    record: bool,
    #[command(flatten)]
    place: PlaceArgs,
    #[command(flatten)]
    stream: StreamArgs,
}

/// Reads how long a robot walks without a sign of its operator.
fn patience(text: &str) -> Result<Duration, String> {
    let time = flix_shell::time::duration(text)?;
    if (SHORTEST_PATIENCE..=LONGEST_PATIENCE).contains(&time) {
        Ok(time)
    } else {
        Err("name a time between 1s and 1h".to_owned())
    }
}

impl ByHandArgs {
    /// Connects, lets `operate` drive until the operator leaves, and leaves the robot disarmed or stopped. `name`: of
    /// the command, for the record.
    ///
    /// # Errors
    /// When the robot cannot be reached, `operate` fails, or the program is interrupted.
    pub fn drive(
        &self,
        name: &str,
        operate: impl FnOnce(&mut Drive, &Interrupt) -> Result<Ending, Error>,
    ) -> Result<ExitCode, Error> {
        let interrupt = Interrupt::listen().map_err(Error::usage)?;
        let mut extras = Extras { poses: self.poses.open_if_named()?, ..Extras::default() };
        let mut connection = self.robot.connect(&interrupt)?;
        if self.record || self.stream.is_asked_for() {
            let poses = extras.poses.as_ref().map(Poses::name);
            let mut recorder = record(&self.place, &mut connection, poses, name, BTreeMap::new())?;
            self.stream.start(&mut recorder)?;
            extras.recorder = Some(recorder);
        }
        let mut hand = Drive::new(&mut connection, &self.robot.robot, &mut extras);
        let (cockpit, _, now) = hand.operate();
        cockpit.be_attended(self.rest_after, now);
        let ended = match operate(&mut hand, &interrupt) {
            // A stop may be on its way when the operator leaves.
            Ok(ending)
                if ending == Ending::Interrupted
                    || connection.client().stop_state() == StopState::Sending =>
            {
                Err(super::drive::stop(&mut connection))
            }
            Ok(_) if connection.client().is_driving() => connection.disarm().map_err(Error::from),
            Ok(_) => Ok(()),
            Err(error) => Err(super::drive::give_up(&mut connection, error)),
        };
        let ending = ended.as_ref().map_or_else(ToString::to_string, |()| "finished".to_owned());
        let results = BTreeMap::from([("ending".to_owned(), ending)]);
        let record = extras.recorder.map(|recorder| recorder.conclude(results)).transpose();
        let record = extras.unrecorded.map_or(record, Err);
        if let (Err(ended), Err(record)) = (&ended, &record) {
            return Err(Error::new(ended.exit, format_args!("{ended}; {record}")));
        }
        ended?;
        if let Some(file) = record? {
            print(&format!("record {}\n", file.display()))?;
        }
        Ok(Exit::Done.into())
    }
}

impl From<DriveError> for Error {
    fn from(error: DriveError) -> Self {
        match error {
            DriveError::Link(error) => error.into(),
            DriveError::Pose(error) => error.into(),
            DriveError::Pages(error) => Self::new(Exit::PageLost, error),
        }
    }
}
