//! What a table of a study is made of: columns, rows, and the hash of what they depend on.

use std::fmt;

use serde::{Deserialize, Serialize};

/// One column of a study's table.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Column {
    /// Name with its unit, for example `forward_m_s`.
    pub name: String,
    /// What its values are.
    pub kind: Kind,
}

/// What the values of a column are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Kind {
    /// Numbers.
    Number,
    /// Whole numbers from 0 to 2^64 - 1.
    Whole,
    /// Words.
    Text,
}

impl Column {
    /// Creates a column of numbers.
    pub fn number(name: impl Into<String>) -> Self {
        Self { name: name.into(), kind: Kind::Number }
    }

    /// Creates a column of whole numbers, which are kept to the last digit.
    pub fn whole(name: impl Into<String>) -> Self {
        Self { name: name.into(), kind: Kind::Whole }
    }

    /// Creates a column of words.
    pub fn text(name: impl Into<String>) -> Self {
        Self { name: name.into(), kind: Kind::Text }
    }
}

/// One entry of a row.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// For a column of numbers.
    Number(f64),
    /// For a column of whole numbers.
    Whole(u64),
    /// For a column of words.
    Text(String),
}

impl From<f64> for Value {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl From<u64> for Value {
    fn from(whole: u64) -> Self {
        Self::Whole(whole)
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl Value {
    /// Returns the number, if it is one; a whole one beyond 2^53 is rounded.
    #[must_use]
    pub const fn number(&self) -> Option<f64> {
        match self {
            Self::Number(number) => Some(*number),
            Self::Whole(whole) => Some(*whole as f64),
            Self::Text(_) => None,
        }
    }

    /// Returns the whole number, if it is one.
    #[must_use]
    pub const fn whole(&self) -> Option<u64> {
        match self {
            Self::Whole(whole) => Some(*whole),
            Self::Number(_) | Self::Text(_) => None,
        }
    }

    /// Returns the text, if it is one.
    #[must_use]
    pub fn as_text(&self) -> Option<&str> {
        match self {
            Self::Number(_) | Self::Whole(_) => None,
            Self::Text(text) => Some(text),
        }
    }
}

/// One row: a value a column.
pub type Row = Vec<Value>;

/// What all results of a table depend on: a hash of the study with its parameters, and one of the program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fingerprint(String);

impl Fingerprint {
    /// Joins both hashes.
    pub(crate) fn new(parameters: &str, program: &str) -> Self {
        Self(format!("{parameters}-{program}"))
    }

    /// Takes the text of a fingerprint.
    pub(crate) const fn parse(text: String) -> Self {
        Self(text)
    }

    /// Returns the hash of the study with its parameters.
    #[must_use]
    pub fn parameters(&self) -> &str {
        self.0.split('-').next().unwrap_or_default()
    }
}

impl fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}
