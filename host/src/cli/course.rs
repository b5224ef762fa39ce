//! What is to be walked, as options: shared by every program that navigates.

use std::collections::BTreeMap;
use std::path::PathBuf;

use super::Error;
use crate::nav::{
    ControllerKind, Fence, ModeTable, Navigator, PAPER_PAIRS, Path, PathError, Settings, Task,
};

/// A path and how it is followed.
#[derive(Debug, Clone, clap::Args)]
pub struct CourseArgs {
    /// `figure8`, `circle`, `square`, or a file of waypoints (one x,y a line, metres).
    #[arg(value_name = "PATH")]
    pub path: String,
    /// Laps of a closed path.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..))]
    pub laps: u32,
    /// Width of the figure eight, m.
    #[arg(long, value_name = "M", default_value_t = 1.6)]
    pub width: f64,
    /// Height of the figure eight, m.
    #[arg(long, value_name = "M", default_value_t = 0.8)]
    pub height: f64,
    /// Radius of the circle, m.
    #[arg(long, value_name = "M", default_value_t = 0.4)]
    pub radius: f64,
    /// Side of the square, m.
    #[arg(long, value_name = "M", default_value_t = 0.8)]
    pub side: f64,
    /// Where the middle of the path (the origin of a file) is, m.
    #[arg(long, value_name = "X,Y", default_value = "0,0", allow_hyphen_values = true, value_parser = point)]
    pub at: (f64, f64),
    /// Turns the path to the left by so many degrees.
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    pub turned: f64,
    /// Farther off the path than this the run ends, mm.
    #[arg(long, value_name = "MM", default_value_t = 400.0)]
    pub error_limit: f64,
    /// How it is steered.
    #[command(flatten)]
    pub steering: SteeringArgs,
}

/// Who steers, and where the robot may be.
#[derive(Debug, Clone, clap::Args)]
pub struct SteeringArgs {
    /// `predictive` chooses among all modes; `two-state` is the paper's.
    #[arg(long, default_value = "predictive")]
    pub controller: ControllerKind,
    /// Outside west,south,east,north (m) the run ends; half a metre around the path unless told.
    #[arg(long, value_name = "W,S,E,N", allow_hyphen_values = true)]
    pub fence: Option<Fence>,
}

/// Reads `x,y`.
///
/// # Errors
/// When it is not two numbers.
pub fn point(text: &str) -> Result<(f64, f64), String> {
    let number = |part: &str| part.trim().parse::<f64>().ok().filter(|n| n.is_finite());
    text.split_once(',')
        .and_then(|(x, y)| number(x).zip(number(y)))
        .ok_or_else(|| format!("\"{text}\" is not a point: write x,y in metres, such as 0.5,-0.2"))
}

impl From<PathError> for Error {
    fn from(error: PathError) -> Self {
        Self::usage(error)
    }
}

impl CourseArgs {
    /// The path as asked for.
    ///
    /// # Errors
    /// When a size is none, or the file is no list of waypoints.
    pub fn task(&self) -> Result<Task, Error> {
        let path = match self.path.as_str() {
            "figure8" => Path::figure_eight(self.width, self.height)?,
            "circle" => Path::circle(self.radius)?,
            "square" => Path::square(self.side)?,
            file => read_path(file)?,
        };
        let path = path.placed(self.at, self.turned.to_radians());
        Ok(Task::Follow { path, laps: self.laps })
    }

    /// The settings as asked for.
    ///
    /// # Errors
    /// When the error limit is none.
    pub fn settings(&self, task: &Task) -> Result<Settings, Error> {
        if !(self.error_limit > 0.0 && self.error_limit.is_finite()) {
            return Err(Error::usage(format_args!(
                "an error limit of {} mm lets the robot nowhere: give a number above 0",
                self.error_limit
            )));
        }
        Ok(Settings { error_limit: self.error_limit * 1e-3, ..self.steering.settings(task) })
    }
}

impl SteeringArgs {
    /// Settings for a task.
    #[must_use]
    pub fn settings(&self, task: &Task) -> Settings {
        let settings = Settings::for_task(task);
        let fence = self.fence.unwrap_or(settings.fence);
        Settings { controller: self.controller, fence, ..settings }
    }
}

fn read_path(file: &str) -> Result<Path, Error> {
    let text = std::fs::read_to_string(file).map_err(|error| {
        Error::usage(format_args!(
            "cannot read the waypoints {file}: {error}; a path is figure8, circle, square, or a file"
        ))
    })?;
    let name = PathBuf::from(file)
        .file_stem()
        .map_or_else(|| file.to_owned(), |s| s.to_string_lossy().into_owned());
    Ok(Path::from_text(&name, &text)?)
}

/// The settings as facts of a record.
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

/// What a finished run of a path shows, as numbers.
#[must_use]
pub fn results(navigator: &Navigator, seconds: f64) -> BTreeMap<String, String> {
    let progress = navigator.progress();
    BTreeMap::from([
        ("path_error_rms_mm".into(), format!("{:.1}", progress.error_rms * 1e3)),
        ("path_error_peak_mm".into(), format!("{:.1}", progress.error_peak * 1e3)),
        ("laps".into(), format!("{:.2}", progress.laps)),
        ("seconds".into(), format!("{seconds:.1}")),
        ("mode_switches".into(), progress.switches.to_string()),
    ])
}

/// Names of a table's modes, in its order.
#[must_use]
pub fn names(table: &ModeTable) -> Vec<String> {
    table.modes().iter().map(|mode| mode.name.clone()).collect()
}

/// The pairs of the paper, or those of them that are named.
///
/// # Errors
/// When a name is not one of the paper's modes.
pub fn pairs(wanted: &[String]) -> Result<Vec<(String, flix_protocol::message::Setpoint)>, Error> {
    use flix_protocol::message::Setpoint;
    use flix_protocol::units::{Degrees, Hertz};
    let known = PAPER_PAIRS.map(|(name, ..)| name);
    if let Some(stranger) = wanted.iter().find(|name| !known.contains(&name.as_str())) {
        return Err(Error::usage(format_args!(
            "there is no mode \"{stranger}\": choose from {}",
            known.join(", ")
        )));
    }
    PAPER_PAIRS
        .iter()
        .filter(|(name, ..)| wanted.is_empty() || wanted.iter().any(|w| w == name))
        .map(|(name, f, theta)| {
            Setpoint::new(Hertz::saturating(*f), Degrees::saturating(*theta))
                .map(|setpoint| ((*name).to_owned(), setpoint))
                .map_err(Error::usage)
        })
        .collect()
}
