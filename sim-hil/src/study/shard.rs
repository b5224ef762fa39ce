//! Slices of a study for several machines.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// The `index`-th of `count` slices, counted from 1: every `count`-th cell.
///
/// Neighbouring cells cost alike, so that slices dealt like cards take equally long.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Shard {
    index: usize,
    count: usize,
}

/// A slice was not understood.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("shard {given:?} is not i/n with i from 1 to n, for example 1/8")]
pub struct ShardError {
    /// What was given.
    pub given: String,
}

impl Shard {
    /// All cells.
    pub const WHOLE: Self = Self { index: 1, count: 1 };

    /// Returns whether a cell belongs to it.
    #[must_use]
    pub const fn contains(self, cell: usize) -> bool {
        cell % self.count == self.index - 1
    }

    /// Returns how many slices there are.
    #[must_use]
    pub const fn count(self) -> usize {
        self.count
    }

    /// Returns what file names of this slice end with; empty for the whole.
    #[must_use]
    pub fn suffix(self) -> String {
        if self == Self::WHOLE {
            String::new()
        } else {
            format!("-{}-of-{}", self.index, self.count)
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = ShardError;

    fn from_str(text: &str) -> Result<Self, ShardError> {
        let parsed = text.split_once('/').and_then(|(index, count)| {
            let (index, count) = (index.trim().parse().ok()?, count.trim().parse().ok()?);
            (index >= 1 && index <= count).then_some(Self { index, count })
        });
        parsed.ok_or_else(|| ShardError { given: text.to_owned() })
    }
}
