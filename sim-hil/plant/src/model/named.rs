//! Models by their names: shipped, drawn, or from a file.

use super::shipped::{NAMES, SHIPPED};
use super::{ModelError, RobotModel, random, stranger};

/// The model that a stranger is when it is asked for by name.
pub const STRANGERS_PLAN: &str = "W";

impl RobotModel {
    /// Takes a shipped model by name, draws a random one (`random-7`) or a changed W ([`stranger`], `stranger-7`), or
    /// reads a file.
    ///
    /// # Errors
    /// As [`RobotModel::from_toml`] with the name of the file, or that there is no such file.
    pub fn named(name: &str) -> Result<Self, ModelError> {
        if let Some(i) = NAMES.iter().position(|n| *n == name) {
            return Self::from_toml(SHIPPED[i]);
        }
        if let Some(seed) = random::seed_of(name) {
            return Ok(random(seed));
        }
        if let Some(seed) = stranger::seed_of(name) {
            return Ok(stranger(&Self::named(STRANGERS_PLAN)?, seed));
        }
        let text = flix_host::system::file::read_text(name.as_ref())
            .map_err(|error| ModelError::NotFound { name: name.to_owned(), error })?;
        Self::from_toml(&text)
            .map_err(|error| ModelError::File { file: name.to_owned(), error: Box::new(error) })
    }
}
