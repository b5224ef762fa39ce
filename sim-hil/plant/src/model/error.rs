//! Why a model is refused, and how its lists are read.

use serde::de::Error as _;
use serde::{Deserialize as _, Deserializer};

use super::shipped::NAMES;

/// Why a model is refused.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// Not TOML, an unknown key, a missing one or one of the wrong type.
    #[error("the model does not read: {0}")]
    Syntax(#[from] toml::de::Error),
    /// A value outside its range.
    #[error(
        "{key} = {value} is outside {low} .. {high}: give it in the unit that its name ends in"
    )]
    OutOfRange {
        /// Path of the key in the file.
        key: String,
        /// What was given.
        value: f64,
        /// Lowest allowed.
        low: f64,
        /// Highest allowed.
        high: f64,
    },
    /// Values that cannot be true together.
    #[error("{key} = {value}: {reason}")]
    Impossible {
        /// Path of the key in the file.
        key: String,
        /// What was given.
        value: f64,
        /// What it contradicts.
        reason: String,
    },
    /// A setting of the robot's software that it would refuse.
    #[error("{key} = {value}: {reason}; `flix parameters list` shows all with their ranges")]
    Setting {
        /// Path of the key in the file.
        key: String,
        /// What was given.
        value: f64,
        /// What the software says.
        reason: String,
    },
    /// A file whose model is refused.
    #[error("{file}: {error}")]
    File {
        /// Names the file.
        file: String,
        /// Why.
        error: Box<ModelError>,
    },
    /// Asked to walk.
    #[error(
        "the model {name} has no legs or does not stand free: choose one that can walk, for example A or W"
    )]
    NoWalker {
        /// Name of the model.
        name: String,
    },
    /// No such file and no such name.
    #[error("cannot read the model {name}: {error}; give a TOML file or one of {}, random-SEED, stranger-SEED", NAMES.join(", "))]
    NotFound {
        /// What was asked for.
        name: String,
        /// What the system said.
        error: std::io::Error,
    },
}

/// Reads exactly `COUNT` numbers: a longer list has another meaning than the one it is read with.
pub(super) fn exactly<'de, D: Deserializer<'de>, const COUNT: usize>(
    deserializer: D,
) -> Result<[f64; COUNT], D::Error> {
    let numbers = Vec::<f64>::deserialize(deserializer)?;
    let given = numbers.len();
    numbers
        .try_into()
        .map_err(|_| D::Error::custom(format!("{given} numbers where {COUNT} are meant")))
}
