//! Options of a path and of steering, shared by every program that navigates.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use flix_protocol::message::Setpoint;

use crate::Error;
use crate::number::{in_unit, whole, within};
use crate::output::{complain, read_text};
use crate::suggestion::nearest;
use flix_host::nav::{
    Approach, Area, ControllerKind, Experience, ModeTable, ModeTableError, Navigator, PAPER_PAIRS,
    Path, PathError, PlanarPose, Position, Repertoire, Settings, Task,
};
use flix_host::pilot::steering::{ControllerProcess, Steering};
use flix_host::system::text::fixed;

/// Size of the figure eight when none is given, m.
const WIDTH: f64 = 1.6;
/// Its other size, m.
const HEIGHT: f64 = 0.8;
/// Radius of the circle when none is given, m.
const RADIUS: f64 = 0.4;
/// Side of the square when none is given, m.
const SIDE: f64 = 0.8;

/// Laps of a closed path when none are given.
const LAPS: u32 = 2;
/// Distance between the ends of an open path below which a loop may be meant, m: the robot's length.
const NEARLY_CLOSED: f64 = 0.23;

/// Options of a path, and of how it is followed.
#[derive(Debug, Clone, clap::Args)]
pub struct CourseArgs {
    /// `figure8`, `circle`, `square`, or a file of waypoints (one x,y per line, metres; `-` is standard
    /// input).
    #[arg(value_name = "PATH")]
    pub path: String,
    /// Number of laps of a closed path [default: 2].
    #[arg(long, value_parser = whole::<u32>(1..=1_000_000))]
    pub laps: Option<u32>,
    /// Width of the figure eight, m [default: 1.6].
    #[arg(long, value_name = "M", value_parser = metres)]
    pub width: Option<f64>,
    /// Height of the figure eight, m [default: 0.8].
    #[arg(long, value_name = "M", value_parser = metres)]
    pub height: Option<f64>,
    /// Radius of the circle, m [default: 0.4].
    #[arg(long, value_name = "M", value_parser = metres)]
    pub radius: Option<f64>,
    /// Side of the square, m [default: 0.8].
    #[arg(long, value_name = "M", value_parser = metres)]
    pub side: Option<f64>,
    /// Position of the middle of the path (of the origin of a file), m.
    #[arg(long, value_name = "X,Y", default_value = "0,0", allow_hyphen_values = true)]
    pub at: Position,
    /// Angle by which the path is turned to the left, degrees.
    #[arg(long, value_name = "DEG", default_value_t = 0.0, value_parser = within(-360.0..=360.0, "angle", " degrees"))]
    pub turned: f64,
    /// Distance from the path at which the run ends, mm.
    #[arg(long, value_name = "MM", default_value_t = 400.0, value_parser = error_limit)]
    pub error_limit: f64,
    /// Walk to the path also from outside the fence. A robot inside the fence walks to it anyway.
    #[arg(long)]
    pub approach: bool,
    /// Begin only when the robot stands on the path, within 50 mm.
    #[arg(long, conflicts_with = "approach")]
    pub no_approach: bool,
    /// Options of steering.
    #[command(flatten)]
    pub steering: SteeringArgs,
    /// Controller of your own: a command that reads poses and writes f and theta, as lines of JSON.
    #[arg(long, value_name = "COMMAND", conflicts_with = "controller")]
    pub controller_process: Option<String>,
}

fn metres(text: &str) -> Result<f64, String> {
    in_unit(text, "m")
}

fn error_limit(text: &str) -> Result<f64, String> {
    in_unit(text, "mm").map_err(|why| format!("the error limit: {why}"))
}

/// Options of steering.
#[derive(Debug, Clone, clap::Args)]
pub struct SteeringArgs {
    /// Controller: `predictive` chooses among the modes of the table, `learned` among many more by experience, and learns
    /// this robot while it walks; `two-state` is the paper's.
    #[arg(long, default_value = "predictive")]
    pub controller: ControllerKind,
    /// Experience of the learned controller, which `flix-sim learn` writes [default: of robots like the simulator's W].
    #[arg(long, value_name = "FILE")]
    pub experience: Option<PathBuf>,
    /// Fence, m: outside it the run ends [default: 0.5 m around the path, 1.5 m around a point].
    #[arg(long, value_name = "W,S,E,N", allow_hyphen_values = true)]
    pub fence: Option<Area>,
}

impl From<PathError> for Error {
    fn from(error: PathError) -> Self {
        Self::usage(error)
    }
}

impl CourseArgs {
    /// Returns the path of these options, where it is placed.
    ///
    /// # Errors
    /// When a size is out of range, or the file is not a list of waypoints.
    pub fn path(&self) -> Result<Path, Error> {
        self.refuse_other_sizes()?;
        let path = match self.path.as_str() {
            "figure8" => {
                Path::figure_eight(self.width.unwrap_or(WIDTH), self.height.unwrap_or(HEIGHT))?
            }
            "circle" => Path::circle(self.radius.unwrap_or(RADIUS))?,
            "square" => Path::square(self.side.unwrap_or(SIDE))?,
            file => read_path(file)?,
        };
        Ok(path.placed(PlanarPose::new(self.at, self.turned.to_radians())))
    }

    /// Returns the task of these options: to follow this path, an open one once.
    ///
    /// # Errors
    /// When laps of an open path are asked for.
    pub fn task(&self, path: &Path) -> Result<Task, Error> {
        match (path.gap(), self.laps) {
            (Some(gap), Some(laps)) if laps > 1 => Err(Error::usage(format_args!(
                "--laps {laps}: the path is open, its ends are {:.0} mm apart; write its first point once more at its end, \
                 or leave --laps out",
                gap * 1e3
            ))),
            (Some(gap), _) if gap < NEARLY_CLOSED => {
                complain(format_args!(
                    "the path is open and walked once: its ends are {:.0} mm apart; write its first point once more at its \
                     end to close it",
                    gap * 1e3
                ));
                Ok(Task::Follow { path: path.clone(), laps: 1 })
            }
            (gap, laps) => {
                let usual = if gap.is_some() { 1 } else { LAPS };
                Ok(Task::Follow { path: path.clone(), laps: laps.unwrap_or(usual) })
            }
        }
    }

    /// Refuses the size of another path: it would change nothing.
    fn refuse_other_sizes(&self) -> Result<(), Error> {
        let own: &[&str] = match self.path.as_str() {
            "figure8" => &["--width", "--height"],
            "circle" => &["--radius"],
            "square" => &["--side"],
            _ => &[],
        };
        let given = [
            ("--width", self.width),
            ("--height", self.height),
            ("--radius", self.radius),
            ("--side", self.side),
        ];
        match given.iter().find(|(option, size)| size.is_some() && !own.contains(option)) {
            Some((option, _)) if own.is_empty() => Err(Error::usage(format_args!(
                "{option} is the size of another path: that of {} is in its file",
                self.path
            ))),
            Some((option, _)) => Err(Error::usage(format_args!(
                "{option} is the size of another path: {} has {}",
                self.path,
                own.join(" and ")
            ))),
            None => Ok(()),
        }
    }

    /// Returns the settings of these options.
    ///
    /// # Errors
    /// When the error limit is not positive.
    pub fn settings(&self, task: &Task) -> Result<Settings, Error> {
        if !(self.error_limit > 0.0 && self.error_limit.is_finite()) {
            return Err(Error::usage(format_args!(
                "an error limit of {} mm is out of range: give a number above 0",
                self.error_limit
            )));
        }
        Ok(Settings {
            error_limit: self.error_limit * 1e-3,
            approach: match (self.approach, self.no_approach) {
                (true, _) => Approach::Anywhere,
                (_, true) => Approach::Off,
                _ => Approach::Inside,
            },
            ..self.steering.settings(task)
        })
    }
}

impl CourseArgs {
    /// Returns who steers: the navigator, or the process that is asked for. `patience`: the longest time for an answer
    /// of the process.
    ///
    /// # Errors
    /// When the table lacks a mode that the controller needs, or the process cannot be started.
    pub fn steering(
        &self,
        task: Task,
        repertoire: Repertoire,
        settings: Settings,
        patience: Duration,
    ) -> Result<Steering, Error> {
        let start = |command: &String| {
            ControllerProcess::start(command, &task, patience).map_err(|error| {
                Error::usage(format_args!("--controller-process {command}: {error}"))
            })
        };
        let process = self.controller_process.as_ref().map(start).transpose()?;
        let modes = repertoire.table().modes().len();
        let navigator = Navigator::new(task, repertoire, settings).map_err(Error::usage)?;
        Ok(Steering::new(navigator, process, modes))
    }

    /// Returns the name of the controller.
    #[must_use]
    pub fn controller(&self) -> String {
        self.controller_process.clone().unwrap_or_else(|| self.steering.controller.to_string())
    }
}

/// Reads an experience, or takes the one that comes with the program.
///
/// # Errors
/// When the file cannot be read or holds none.
pub fn load_experience(file: Option<&std::path::Path>) -> Result<Experience, Error> {
    let Some(file) = file else { return Ok(Experience::shipped()) };
    let refused = |error: &dyn std::fmt::Display| {
        Error::usage(format_args!("--experience {}: {error}", file.display()))
    };
    let text = read_text(file).map_err(|error| refused(&error))?;
    Experience::from_toml(&text).map_err(|error| refused(&error))
}

impl SteeringArgs {
    /// Returns what the controller may command: the experience of the learned one, or else the mode table.
    ///
    /// # Errors
    /// When the experience cannot be used or is for another controller, or as `table` says.
    pub fn repertoire<E: From<Error>>(
        &self,
        table: impl FnOnce() -> Result<ModeTable, E>,
    ) -> Result<Repertoire, E> {
        if self.controller == ControllerKind::Learned {
            let experience = load_experience(self.experience.as_deref())?;
            return Ok(Repertoire::Experience(Arc::new(experience)));
        }
        if self.experience.is_some() {
            let error = Error::usage("--experience is for --controller learned: add it");
            return Err(error.into());
        }
        Ok(Repertoire::Table(table()?))
    }

    /// Returns the settings for a task.
    #[must_use]
    pub fn settings(&self, task: &Task) -> Settings {
        let settings = Settings::for_task(task);
        let fence = self.fence.unwrap_or(settings.fence);
        Settings { fence, ..settings }.steered_by(self.controller)
    }
}

fn read_path(file: &str) -> Result<Path, Error> {
    let text = read_text(file.as_ref()).map_err(|error| {
        Error::usage(format_args!(
            "cannot read the waypoints {file}: {error}; a path is figure8, circle, square, or a file"
        ))
    })?;
    let name = PathBuf::from(file)
        .file_stem()
        .map_or_else(|| file.to_owned(), |s| s.to_string_lossy().into_owned());
    Path::from_text(&name, &text).map_err(|error| Error::usage(format_args!("{file}: {error}")))
}

/// Returns the settings as facts of a record.
#[must_use]
pub fn facts(settings: &Settings) -> BTreeMap<String, String> {
    BTreeMap::from([
        ("controller".into(), settings.controller.to_string()),
        ("latency_ms".into(), (settings.latency.as_secs_f64() * 1e3).to_string()),
        ("fence".into(), settings.fence.to_string()),
        ("error_limit_mm".into(), (settings.error_limit * 1e3).to_string()),
        ("minimum_dwell_ms".into(), settings.minimum_dwell.as_millis().to_string()),
        ("pose_deadline_ms".into(), settings.pose_deadline.as_millis().to_string()),
    ])
}

/// Returns the results of a run.
#[must_use]
pub fn results(navigator: &Navigator, seconds: f64) -> BTreeMap<String, String> {
    let progress = navigator.progress();
    let millimetres = |metres: f64| format!("{:.1}", metres * 1e3);
    let mut results = BTreeMap::from([
        ("seconds".into(), format!("{seconds:.1}")),
        ("mode_switches".into(), progress.switches.to_string()),
    ]);
    // A run that ended before its first pose on the way has no error.
    results.extend(match navigator.task() {
        _ if progress.error == 0.0 && progress.error_peak == 0.0 => vec![],
        Task::Follow { .. } => vec![
            ("path_error_rms_mm".into(), millimetres(progress.error_rms)),
            ("path_error_mean_mm".into(), millimetres(progress.error_mean)),
            ("path_error_peak_mm".into(), millimetres(progress.error_peak)),
            ("laps".into(), fixed(progress.laps, 2)),
        ],
        // Nobody walks a push: there is no path to be away from.
        Task::Reach { .. } => vec![("final_error_mm".into(), millimetres(progress.error))],
    });
    results
}

/// Returns the [`results`] of a run as rows for people, the same for a robot and a simulated one.
#[must_use]
pub fn describe(results: &BTreeMap<String, String>) -> String {
    let fact = |name| results.get(name).map_or("", String::as_str);
    let mut text = String::new();
    if !fact("path_error_rms_mm").is_empty() {
        let (rms, peak) = (fact("path_error_rms_mm"), fact("path_error_peak_mm"));
        text += &row("path error", format_args!("{rms} mm RMS, {peak} mm at most"));
        text += &row("laps", format_args!("{} in {} s", fact("laps"), fact("seconds")));
    } else if !fact("final_error_mm").is_empty() {
        let (error, seconds) = (fact("final_error_mm"), fact("seconds"));
        text += &row("final error", format_args!("{error} mm after {seconds} s"));
    }
    text + &row("modes", format_args!("changed {} times", fact("mode_switches")))
}

/// Returns a row of what [`describe`] returns.
#[must_use]
pub fn row(name: &str, value: impl std::fmt::Display) -> String {
    format!("  {name:11} {value}\n")
}

/// Reads the mode table, and says when it was measured with another robot.
///
/// # Errors
/// When it cannot be used.
pub fn table_for(robot: &str, file: &std::path::Path) -> Result<ModeTable, ModeTableError> {
    let table = ModeTable::load(file)?;
    if table.robot != robot {
        let (file, measured) = (file.display(), &table.robot);
        complain(format_args!("{file} was measured with {measured:?}, not with {robot:?}"));
    }
    Ok(table)
}

/// Returns the pairs of the paper, or those with these names.
///
/// # Errors
/// When a name is not one of the paper's modes.
pub fn pairs(wanted: &[String]) -> Result<Vec<(String, Setpoint)>, Error> {
    let known = PAPER_PAIRS.map(|(name, ..)| name);
    if let Some(stranger) = wanted.iter().find(|name| !known.contains(&name.as_str())) {
        return Err(Error::usage(format_args!(
            "there is no mode \"{stranger}\"{} from {}",
            nearest(stranger, known.into_iter()).map_or_else(
                || ": choose".to_owned(),
                |it| format!(", did you mean \"{it}\"? Choose")
            ),
            known.join(", ")
        )));
    }
    Ok(PAPER_PAIRS
        .iter()
        .filter(|(name, ..)| wanted.is_empty() || wanted.iter().any(|w| w == name))
        .map(|(name, f, theta)| ((*name).to_owned(), Setpoint::saturating(*f, *theta)))
        .collect())
}
