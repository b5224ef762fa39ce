//! The mode table: the commands of a robot, and its motion under each.
//!
//! A robot of this kind is steered by the choice of a pair (f, theta). `flix identify` measures the
//! motion that each pair causes, and stores it as TOML:
//!
//! ```toml
//! robot = "flix-1"
//! source = "identified over 8 s a mode"
//!
//! [[mode]]
//! name = "forward"
//! frequency_hz = -30.0
//! direction_deg = 30.0
//! forward_m_s = { mean = 0.084, spread = 0.012 }
//! lateral_m_s = { mean = 0.002, spread = 0.008 }
//! yaw_rad_s = { mean = 0.36, spread = 0.12 }
//! ```
//!
//! Speeds are in the body frame FLU (lateral and yaw positive to the left).

use std::path::{Path, PathBuf};

use flix_protocol::message::Setpoint;
use flix_protocol::units::OutOfRange;
use serde::{Deserialize, Serialize};

use crate::pose::geometry::Twist;

/// The pairs of Tables III and IV (Right Strafing from Table IV) by name, with f in Hz and theta in
/// degrees. A new robot is identified with these.
pub const PAPER_PAIRS: [(&str, f32, f32); 9] = [
    ("forward", -30.0, 30.0),
    ("forward-2", -35.0, 30.0),
    ("left", -30.0, 90.0),
    ("left-2", -30.0, 60.0),
    ("right", 30.0, 90.0),
    ("right-2", -35.0, -30.0),
    ("strafe-left", 30.0, 30.0),
    ("strafe-left-2", 35.0, 0.0),
    ("strafe-right", -30.0, -60.0),
];

/// Spread of a mode from a single run, as a share of its mean: one run has none of its own.
const ASSUMED_SPREAD: f64 = 0.3;

/// A measured quantity: its mean over several runs and the standard deviation between them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation of one run's mean; of a single run an assumed one.
    pub spread: f64,
}

impl Spread {
    /// Returns mean and sample standard deviation of at least one value; of a single one, 30 % of it is assumed.
    #[must_use]
    pub fn of(values: &[f64]) -> Self {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let square = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        let assumed = ASSUMED_SPREAD * mean.abs();
        let spread = if values.len() > 1 { (square / (count - 1.0)).sqrt() } else { assumed };
        Self { mean, spread }
    }
}

/// A pair (f, theta) and the motion that it causes.
#[derive(Debug, Clone, PartialEq)]
pub struct Mode {
    /// A short name, unique in its table.
    pub name: String,
    /// The commanded pair.
    pub setpoint: Setpoint,
    /// Speed along the body's x, m/s.
    pub forward: Spread,
    /// Speed along the body's y (left), m/s.
    pub lateral: Spread,
    /// Yaw rate (left), rad/s.
    pub yaw: Spread,
}

/// All modes of one robot.
#[derive(Debug, Clone, PartialEq)]
pub struct ModeTable {
    /// Name of the robot.
    pub robot: String,
    /// How the table was made.
    pub source: String,
    /// At least one mode.
    modes: Vec<Mode>,
}

/// Why a mode table was refused.
#[derive(Debug, thiserror::Error)]
pub enum ModeTableError {
    /// The file cannot be read.
    #[error("cannot read the mode table {}: {source}; make one with `flix identify`", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write the mode table {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file holds no mode table.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why its content was refused.
        source: Box<ModeTableError>,
    },
    /// Not TOML, or a key is missing, unknown or of another type.
    #[error("the mode table cannot be parsed: {0}")]
    Syntax(String),
    /// A pair out of range.
    #[error("mode \"{mode}\": {source}")]
    Pair {
        /// Name of the mode.
        mode: String,
        /// The range.
        source: OutOfRange,
    },
    /// A speed that no robot of this kind has.
    #[error(
        "mode \"{mode}\": {key} of {value} is outside {minimum} to {maximum}; speeds are in m/s and rad/s"
    )]
    Speed {
        /// Name of the mode.
        mode: String,
        /// Key of the speed.
        key: &'static str,
        /// The refused value.
        value: f64,
        /// Smallest accepted value.
        minimum: f64,
        /// Largest accepted value.
        maximum: f64,
    },
    /// Two modes with one name.
    #[error("two modes are called \"{0}\": give each its own name")]
    Twice(String),
    /// No mode.
    #[error("the mode table has no modes: identify them with `flix identify`")]
    Empty,
}

/// Fastest credible walking speed of a 220 mm robot, m/s: some ten times the paper's.
const FASTEST: f64 = 2.0;
/// Fastest credible yaw rate, rad/s.
const FASTEST_TURN: f64 = 30.0;

impl Mode {
    /// Returns the mean motion.
    #[must_use]
    pub fn twist(&self) -> Twist {
        Twist { forward: self.forward.mean, lateral: self.lateral.mean, yaw: self.yaw.mean }
    }
}

impl ModeTable {
    /// Makes a table of checked modes.
    ///
    /// # Errors
    /// When there is no mode, a name occurs twice, or a speed is not credible.
    pub fn new(robot: &str, source: &str, modes: Vec<Mode>) -> Result<Self, ModeTableError> {
        if modes.is_empty() {
            return Err(ModeTableError::Empty);
        }
        for (index, mode) in modes.iter().enumerate() {
            if modes[..index].iter().any(|other| other.name == mode.name) {
                return Err(ModeTableError::Twice(mode.name.clone()));
            }
            for ([mean, spread], speed, limit) in [
                (["forward_m_s", "spread of forward_m_s"], mode.forward, FASTEST),
                (["lateral_m_s", "spread of lateral_m_s"], mode.lateral, FASTEST),
                (["yaw_rad_s", "spread of yaw_rad_s"], mode.yaw, FASTEST_TURN),
            ] {
                credible(mode, mean, speed.mean, -limit, limit)?;
                credible(mode, spread, speed.spread, 0.0, limit)?;
            }
        }
        Ok(Self { robot: robot.to_owned(), source: source.to_owned(), modes })
    }

    /// Parses a table from TOML.
    ///
    /// # Errors
    /// When it is not a mode table; the message names the key.
    pub fn from_toml(text: &str) -> Result<Self, ModeTableError> {
        let file: TableFile =
            toml::from_str(text).map_err(|e| ModeTableError::Syntax(e.to_string()))?;
        let modes = file.mode.into_iter().map(Mode::try_from).collect::<Result<_, _>>()?;
        Self::new(&file.robot, &file.source, modes)
    }

    /// Returns the table as TOML, which [`ModeTable::from_toml`] reads back.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let file = TableFile {
            robot: self.robot.clone(),
            source: self.source.clone(),
            mode: self.modes.iter().map(ModeFile::from).collect(),
        };
        // Plain strings and numbers always have a TOML form.
        toml::to_string(&file).unwrap_or_default()
    }

    /// Reads a file.
    ///
    /// # Errors
    /// When it cannot be read or is not a mode table.
    pub fn load(path: &Path) -> Result<Self, ModeTableError> {
        let text = crate::system::file::read_text(path)
            .map_err(|source| ModeTableError::Read { path: path.to_owned(), source })?;
        Self::from_toml(&text)
            .map_err(|source| ModeTableError::File { path: path.to_owned(), source: source.into() })
    }

    /// Checks that [`ModeTable::save`] will be able to write this file.
    ///
    /// # Errors
    /// When it will not.
    pub fn check_writable(path: &Path) -> Result<(), ModeTableError> {
        crate::system::file::check_writable(path)
            .map_err(|source| ModeTableError::Write { path: path.to_owned(), source })
    }

    /// Writes a file, and creates its folder where needed. A file that is there stays whole until the new one is.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), ModeTableError> {
        let failed = |source| ModeTableError::Write { path: path.to_owned(), source };
        if let Some(folder) = path.parent().filter(|f| !f.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(failed)?;
        }
        crate::system::file::overwrite(path, self.to_toml().as_bytes(), || ()).map_err(failed)
    }

    /// Returns the modes, in the order of the table.
    #[must_use]
    pub fn modes(&self) -> &[Mode] {
        &self.modes
    }
}

fn credible(
    mode: &Mode,
    key: &'static str,
    value: f64,
    minimum: f64,
    maximum: f64,
) -> Result<(), ModeTableError> {
    if (minimum..=maximum).contains(&value) {
        Ok(())
    } else {
        Err(ModeTableError::Speed { mode: mode.name.clone(), key, value, minimum, maximum })
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TableFile {
    #[serde(default)]
    robot: String,
    #[serde(default)]
    source: String,
    #[serde(default)]
    mode: Vec<ModeFile>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ModeFile {
    name: String,
    frequency_hz: f32,
    direction_deg: f32,
    forward_m_s: Spread,
    lateral_m_s: Spread,
    yaw_rad_s: Spread,
}

impl From<&Mode> for ModeFile {
    fn from(mode: &Mode) -> Self {
        Self {
            name: mode.name.clone(),
            frequency_hz: mode.setpoint.frequency().get(),
            direction_deg: mode.setpoint.direction().get(),
            forward_m_s: mode.forward,
            lateral_m_s: mode.lateral,
            yaw_rad_s: mode.yaw,
        }
    }
}

impl TryFrom<ModeFile> for Mode {
    type Error = ModeTableError;

    fn try_from(file: ModeFile) -> Result<Self, ModeTableError> {
        let setpoint = Setpoint::from_numbers(file.frequency_hz, file.direction_deg)
            .map_err(|source| ModeTableError::Pair { mode: file.name.clone(), source })?;
        Ok(Self {
            name: file.name,
            setpoint,
            forward: file.forward_m_s,
            lateral: file.lateral_m_s,
            yaw: file.yaw_rad_s,
        })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// The modes of walking model W as MuJoCo walks them (mean of seeds), with the scatter of
    /// single runs that its chaos shows.
    pub(in crate::nav) fn model_w() -> ModeTable {
        let speeds = [
            (0.084, 0.002, 0.36),
            (0.081, 0.025, -0.32),
            (-0.013, -0.018, 1.95),
            (0.031, -0.003, 1.49),
            (-0.015, 0.019, -1.94),
            (0.003, 0.001, -0.32),
            (0.013, 0.019, 0.14),
            (-0.004, 0.035, -0.01),
            (0.011, -0.038, 0.19),
        ];
        let modes = PAPER_PAIRS.iter().zip(speeds).map(|((name, f, theta), speed)| Mode {
            name: (*name).to_owned(),
            setpoint: Setpoint::saturating(*f, *theta),
            forward: Spread { mean: speed.0, spread: 0.01 },
            lateral: Spread { mean: speed.1, spread: 0.01 },
            yaw: Spread { mean: speed.2, spread: 0.1 },
        });
        ModeTable::new("W", "MuJoCo at 0.1 ms", modes.collect()).unwrap()
    }

    #[test]
    fn a_table_survives_its_file() {
        let table = model_w();
        assert_eq!(ModeTable::from_toml(&table.to_toml()).unwrap(), table);
    }

    fn refusal(change: impl Fn(String) -> String) -> String {
        ModeTable::from_toml(&change(model_w().to_toml())).unwrap_err().to_string()
    }

    #[test]
    fn a_pair_out_of_range_is_refused_with_its_range() {
        let said = refusal(|t| t.replacen("frequency_hz = -30.0", "frequency_hz = -300.0", 1));
        assert!(said.contains("forward") && said.contains("-35"), "{said}");
    }

    #[test]
    fn speeds_in_millimetres_are_refused() {
        let said = refusal(|t| t.replacen("mean = 0.084", "mean = 84.0", 1));
        assert!(said.contains("forward_m_s") && said.contains("m/s"), "{said}");
    }

    #[test]
    fn unknown_keys_nan_and_double_names_are_refused() {
        assert!(refusal(|t| t.replacen("yaw_rad_s", "yaw_deg_s", 1)).contains("yaw_deg_s"));
        assert!(refusal(|t| t.replacen("mean = 0.084", "mean = nan", 1)).contains("NaN"));
        assert!(refusal(|t| t.replacen("\"left\"", "\"forward\"", 1)).contains("two modes"));
        assert!(refusal(|_| String::new()).contains("no modes"));
    }
}
