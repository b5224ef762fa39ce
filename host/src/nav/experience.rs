//! What is known of a kind of robot before one of them is met.
//!
//! No two robots walk alike: feet wear, loads shift, floors fall. But they differ in few ways, and on a slope all slide.
//! From the walks of many robots of a kind, each with its own friction, load, legs and slope, `flix-sim learn` finds for
//! each pair (f, theta)
//!
//! ```text
//! motion = mean + slide * w(heading) + sum over k of (factor_k + slide_k * w(heading)) * z_k + own * e + noise
//! ```
//!
//! with w the slope (sine of its angle, downhill, in body axes), the same w and z for all pairs of one robot, and z and
//! e of unit spread. A [`Belief`](super::Belief) finds w, z and e of the robot at hand while it walks.

use flix_protocol::message::Setpoint;
use serde::{Deserialize, Serialize};

use super::modes::{Mode, ModeTable, ModeTableError, Spread};
use crate::pose::geometry::Twist;

/// The experience that comes with the program: of 350 g robots like the simulator's model W.
const SHIPPED: &str = include_str!("experience.toml");

/// The motions that one pair has caused in many robots.
#[derive(Debug, Clone, PartialEq)]
pub struct Walks {
    /// The pair.
    pub setpoint: Setpoint,
    /// Mean over the robots, on a level floor.
    pub mean: Twist,
    /// Change of the motion where the floor falls forward, and where it falls to the left, per sine of the slope.
    pub slide: [Twist; 2],
    /// How robots differ, per unit of each of the ways that all pairs share.
    pub factors: Vec<Factor>,
    /// Spread between robots that these ways leave unexplained.
    pub own: Twist,
    /// Spread between stretches of [`Experience::stretch`] of one robot.
    pub noise: Twist,
}

/// A change of the motion under a pair.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Factor {
    /// On a level floor.
    pub level: Twist,
    /// Of [`Walks::slide`].
    pub slide: [Twist; 2],
}

/// The motions of many robots of a kind; see the module's documentation.
#[derive(Debug, Clone, PartialEq)]
pub struct Experience {
    /// Name of the kind.
    pub robot: String,
    /// How it was gained.
    pub source: String,
    /// Time over which noise was measured, s.
    pub stretch: f64,
    /// Spread of the slope along each axis of the floor, as a sine.
    pub slope: f64,
    /// At least one pair; all have as many factors.
    walks: Vec<Walks>,
}

/// Why an experience was refused.
#[derive(Debug, thiserror::Error)]
pub enum ExperienceError {
    /// Not TOML, or a key is missing, unknown or of another type.
    #[error("the experience cannot be parsed: {0}; gain one with `flix-sim learn`")]
    Syntax(String),
    /// As a mode table it would be refused.
    #[error(transparent)]
    Table(#[from] ModeTableError),
    /// Lists that do not fit together.
    #[error(
        "the experience has {found} numbers in {key} of the pair {pair}, not {expected}; gain it anew with `flix-sim learn`"
    )]
    Length {
        /// The key.
        key: &'static str,
        /// The pair.
        pair: String,
        /// Numbers found.
        found: usize,
        /// Numbers expected.
        expected: usize,
    },
    /// A number that is none, or a spread below zero.
    #[error(
        "the experience has a {key} of {value}, which none can have; gain it anew with `flix-sim learn`"
    )]
    Value {
        /// The key.
        key: &'static str,
        /// The refused value.
        value: f64,
    },
}

impl Experience {
    /// Makes an experience of these walks.
    ///
    /// # Errors
    /// When a number is not finite, a spread is not positive, a speed is not credible, or factors are missing.
    pub fn new(
        robot: &str,
        source: &str,
        [stretch, slope]: [f64; 2],
        walks: Vec<Walks>,
    ) -> Result<Self, ExperienceError> {
        let expected = walks.first().map_or(0, |walks| walks.factors.len());
        let positive = |key, value: f64| {
            let credible = value > 0.0 && value.is_finite();
            if credible { Ok(()) } else { Err(ExperienceError::Value { key, value }) }
        };
        positive("stretch_s", stretch)?;
        positive("slope", slope)?;
        for one in &walks {
            let found = one.factors.len();
            if found != expected {
                let (key, pair) = ("factors", one.name());
                return Err(ExperienceError::Length { key, pair, found, expected });
            }
            for value in numbers(one.own) {
                positive("own", value)?;
            }
            for value in numbers(one.noise) {
                positive("noise", value)?;
            }
            let factors = one.factors.iter().flat_map(|f| [f.level, f.slide[0], f.slide[1]]);
            for twist in one.slide.into_iter().chain(factors) {
                if let Some(value) = numbers(twist).into_iter().find(|v| !v.is_finite()) {
                    return Err(ExperienceError::Value { key: "slide or factors", value });
                }
            }
        }
        let experience =
            Self { robot: robot.to_owned(), source: source.to_owned(), stretch, slope, walks };
        experience.checked_table()?;
        Ok(experience)
    }

    /// Returns the experience that comes with the program.
    ///
    /// # Panics
    /// Never: it is tested.
    #[must_use]
    pub fn shipped() -> Self {
        Self::from_toml(SHIPPED).unwrap_or_else(|error| unreachable!("{error}"))
    }

    /// Returns the walks, one for each pair.
    #[must_use]
    pub fn walks(&self) -> &[Walks] {
        &self.walks
    }

    /// Returns the number of factors.
    #[must_use]
    pub fn factors(&self) -> usize {
        self.walks.first().map_or(0, |walks| walks.factors.len())
    }

    /// Returns the means as a mode table, with the spreads between robots.
    ///
    /// # Panics
    /// Never: an experience is checked when it is made.
    #[must_use]
    pub fn table(&self) -> ModeTable {
        self.checked_table().unwrap_or_else(|error| unreachable!("{error}"))
    }

    fn checked_table(&self) -> Result<ModeTable, ModeTableError> {
        let modes = self.walks.iter().map(|walks| {
            let spread = |of: fn(&Twist) -> f64| Spread {
                mean: of(&walks.mean),
                spread: walks.factors.iter().fold(of(&walks.own), |sum, f| sum.hypot(of(&f.level))),
            };
            Mode {
                name: walks.name(),
                setpoint: walks.setpoint,
                forward: spread(|t| t.forward),
                lateral: spread(|t| t.lateral),
                yaw: spread(|t| t.yaw),
            }
        });
        ModeTable::new(&self.robot, &self.source, modes.collect())
    }

    /// Parses an experience from TOML.
    ///
    /// # Errors
    /// When it is none; the message names the key.
    pub fn from_toml(text: &str) -> Result<Self, ExperienceError> {
        let file: File =
            toml::from_str(text).map_err(|error| ExperienceError::Syntax(error.to_string()))?;
        let walks = file.pair.into_iter().map(Walks::try_from).collect::<Result<_, _>>()?;
        Self::new(&file.robot, &file.source, [file.stretch_s, file.slope], walks)
    }

    /// Returns the experience as TOML, which [`Experience::from_toml`] reads back.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let file = File {
            robot: self.robot.clone(),
            source: self.source.clone(),
            stretch_s: self.stretch,
            slope: self.slope,
            pair: self.walks.iter().map(Pair::from).collect(),
        };
        // Plain strings and numbers always have a TOML form.
        toml::to_string(&file).unwrap_or_default()
    }
}

impl Walks {
    fn name(&self) -> String {
        let (f, theta) = (self.setpoint.frequency().get(), self.setpoint.direction().get());
        format!("{f:+} Hz {theta} deg")
    }
}

/// Returns the three speeds, m/s, m/s, rad/s.
#[must_use]
pub(crate) fn numbers(twist: Twist) -> [f64; 3] {
    [twist.forward, twist.lateral, twist.yaw]
}

fn twist([forward, lateral, yaw]: [f64; 3]) -> Twist {
    Twist { forward, lateral, yaw }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    robot: String,
    source: String,
    stretch_s: f64,
    slope: f64,
    pair: Vec<Pair>,
}

/// Speeds are forward and left in m/s and yaw in rad/s.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Pair {
    frequency_hz: f32,
    direction_deg: f32,
    mean: [f64; 3],
    slide: [[f64; 3]; 2],
    own: [f64; 3],
    noise: [f64; 3],
    /// On a level floor, and where it falls forward and to the left.
    factors: Vec<[[f64; 3]; 3]>,
}

impl From<&Walks> for Pair {
    fn from(walks: &Walks) -> Self {
        /// Digits that mean something, after the point.
        const DIGITS: f64 = 1e4;
        let round = |twist: Twist| numbers(twist).map(|n| (n * DIGITS).round() / DIGITS);
        Self {
            frequency_hz: walks.setpoint.frequency().get(),
            direction_deg: walks.setpoint.direction().get(),
            mean: round(walks.mean),
            slide: walks.slide.map(round),
            own: round(walks.own),
            noise: round(walks.noise),
            factors: walks
                .factors
                .iter()
                .map(|f| [f.level, f.slide[0], f.slide[1]].map(round))
                .collect(),
        }
    }
}

impl TryFrom<Pair> for Walks {
    type Error = ModeTableError;

    fn try_from(pair: Pair) -> Result<Self, ModeTableError> {
        let setpoint =
            Setpoint::from_numbers(pair.frequency_hz, pair.direction_deg).map_err(|source| {
                let mode = format!("{} Hz {} deg", pair.frequency_hz, pair.direction_deg);
                ModeTableError::Pair { mode, source }
            })?;
        Ok(Self {
            setpoint,
            mean: twist(pair.mean),
            slide: pair.slide.map(twist),
            own: twist(pair.own),
            noise: twist(pair.noise),
            factors: pair
                .factors
                .into_iter()
                .map(|[level, ahead, left]| Factor {
                    level: twist(level),
                    slide: [twist(ahead), twist(left)],
                })
                .collect(),
        })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::modes::tests::model_w;
    use super::*;

    /// Robots whose motions are those of model W, all faster or all slower, and that slide alike on a slope.
    pub(in crate::nav) fn quicker_and_slower() -> Experience {
        let table = model_w();
        let walks = table.modes().iter().map(|mode| Walks {
            setpoint: mode.setpoint,
            mean: mode.twist(),
            slide: [twist([1.0, 0.0, 0.0]), twist([0.0, 0.4, 0.0])],
            factors: vec![Factor { level: mode.twist().scaled(0.3), slide: [Twist::REST; 2] }],
            own: twist([0.01, 0.01, 0.1]),
            noise: twist([0.01, 0.01, 0.1]),
        });
        Experience::new("W", "written down", [0.5, 0.03], walks.collect()).unwrap()
    }

    #[test]
    fn an_experience_survives_its_file_to_a_tenth_of_a_millimetre_a_second() {
        let experience = quicker_and_slower();
        let read = Experience::from_toml(&experience.to_toml()).unwrap();
        assert_eq!(read.factors(), 1);
        for (a, b) in experience.walks().iter().zip(read.walks()) {
            assert_eq!((a.setpoint, a.slide, a.own), (b.setpoint, b.slide, b.own));
            assert!((a.factors[0].level.forward - b.factors[0].level.forward).abs() < 1e-4);
        }
        assert_eq!(Experience::from_toml(&read.to_toml()).unwrap(), read);
    }

    #[test]
    fn the_shipped_experience_is_one() {
        let shipped = Experience::shipped();
        assert_eq!((shipped.robot.as_str(), shipped.walks().len()), ("W", 72));
        assert_eq!(shipped.table().modes().len(), 72);
    }

    #[test]
    fn what_is_no_experience_is_refused_by_its_key() {
        let refusal = |from: &str, to: &str| {
            let text = quicker_and_slower().to_toml();
            assert!(text.contains(from), "{text}");
            Experience::from_toml(&text.replacen(from, to, 1)).unwrap_err().to_string()
        };
        assert!(refusal("stretch_s = 0.5", "stretch_s = 0.0").contains("stretch_s of 0"));
        assert!(refusal("own = [0.01", "own = [-0.01").contains("own of -0.01"));
        assert!(refusal("noise = [0.01", "noise = [nan").contains("noise of NaN"));
        assert!(
            refusal(
                "factors = [[[",
                "factors = [[[0.1, 0.1, 0.1], [0.1, 0.1, 0.1], [0.1, 0.1, 0.1]], [["
            )
            .contains("factors")
        );
        assert!(refusal("mean = [0.084", "mean = [84.0").contains("84"));
        assert!(refusal("slope", "steepness").contains("steepness"));
        assert!(Experience::from_toml("").is_err());
    }
}
