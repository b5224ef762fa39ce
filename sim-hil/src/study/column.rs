//! What a table of a study is made of: columns, rows, and the hash of what they depend on.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::figure::Limit;

/// Name of the last column of every table: why a cell failed; empty where it did not.
pub const FAILURE: &str = "failure";

/// One column of a study's table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// Name with its unit, for example `forward_m_s`.
    pub name: String,
    /// What its values are.
    pub kind: Kind,
    /// What each of its values must keep.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<Limit>,
    /// Whether a missing number (NaN) keeps the limit.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub may_be_missing: bool,
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
    /// Yes or no.
    Flag,
}

impl Kind {
    /// Returns the value of a cell that failed.
    pub(super) const fn nothing(self) -> Value {
        match self {
            Self::Number => Value::Number(f64::NAN),
            Self::Whole => Value::Whole(0),
            Self::Text => Value::Text(String::new()),
            Self::Flag => Value::Flag(false),
        }
    }
}

impl Column {
    fn new(name: impl Into<String>, kind: Kind) -> Self {
        Self { name: name.into(), kind, limit: None, may_be_missing: false }
    }

    /// Creates a column of numbers.
    pub fn number(name: impl Into<String>) -> Self {
        Self::new(name, Kind::Number)
    }

    /// Creates a column of whole numbers, which are kept to the last digit.
    pub fn whole(name: impl Into<String>) -> Self {
        Self::new(name, Kind::Whole)
    }

    /// Creates a column of words.
    pub fn text(name: impl Into<String>) -> Self {
        Self::new(name, Kind::Text)
    }

    /// Creates a column that states whether a promise was kept, by more than the column's own value.
    pub fn promise(name: impl Into<String>) -> Self {
        Self::new(name, Kind::Flag).limited(Limit::Exactly(1.0))
    }

    /// Gives the column a limit.
    #[must_use]
    pub fn limited(self, limit: Limit) -> Self {
        Self { limit: Some(limit), ..self }
    }

    /// Lets a missing number keep the limit.
    #[must_use]
    pub fn or_missing(self) -> Self {
        Self { may_be_missing: true, ..self }
    }

    /// Returns whether a value keeps the limit, if there is one.
    #[must_use]
    pub fn holds(&self, value: &Value) -> bool {
        let number = value.number().unwrap_or(f64::NAN);
        let keeps = |limit: Limit| self.may_be_missing && number.is_nan() || limit.holds(number);
        self.limit.is_none_or(keeps)
    }
}

/// Returns whether all values of a row keep the limits of their columns.
#[must_use]
pub fn keeps(columns: &[Column], row: &[Value]) -> bool {
    columns.iter().zip(row).all(|(column, value)| column.holds(value))
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
    /// For a column of flags.
    Flag(bool),
}

impl From<f64> for Value {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl From<Option<f64>> for Value {
    /// NaN where there is none.
    fn from(number: Option<f64>) -> Self {
        Self::Number(number.unwrap_or(f64::NAN))
    }
}

impl From<u64> for Value {
    fn from(whole: u64) -> Self {
        Self::Whole(whole)
    }
}

impl From<bool> for Value {
    fn from(flag: bool) -> Self {
        Self::Flag(flag)
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Value {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl Value {
    /// Returns the name of a variant, as JSON has it.
    ///
    /// # Panics
    /// When the JSON is no text.
    pub fn word(variant: &impl Serialize) -> Self {
        let json = serde_json::to_value(variant).ok();
        let word = json.as_ref().and_then(serde_json::Value::as_str);
        Self::from(word.expect("a variant without fields is its name"))
    }

    /// Returns the number, if it is one; a whole one beyond 2^53 is rounded, a flag is 1 or 0.
    #[must_use]
    pub const fn number(&self) -> Option<f64> {
        match self {
            Self::Number(number) => Some(*number),
            Self::Whole(whole) => Some(*whole as f64),
            Self::Flag(flag) => Some(if *flag { 1.0 } else { 0.0 }),
            Self::Text(_) => None,
        }
    }

    /// Returns the whole number, if it is one.
    #[must_use]
    pub const fn whole(&self) -> Option<u64> {
        match self {
            Self::Whole(whole) => Some(*whole),
            Self::Number(_) | Self::Text(_) | Self::Flag(_) => None,
        }
    }

    /// Returns the text, if it is one.
    #[must_use]
    pub fn as_text(&self) -> Option<&str> {
        match self {
            Self::Number(_) | Self::Whole(_) | Self::Flag(_) => None,
            Self::Text(text) => Some(text),
        }
    }

    /// Returns the flag, if it is one.
    #[must_use]
    pub const fn flag(&self) -> Option<bool> {
        match self {
            Self::Flag(flag) => Some(*flag),
            Self::Number(_) | Self::Whole(_) | Self::Text(_) => None,
        }
    }

    /// Returns the value for JSON; a missing number and an empty text are null.
    fn json(&self) -> serde_json::Value {
        match self {
            Self::Number(number) => (*number).into(),
            Self::Whole(whole) => (*whole).into(),
            Self::Text(text) if text.is_empty() => serde_json::Value::Null,
            Self::Text(text) => text.as_str().into(),
            Self::Flag(flag) => (*flag).into(),
        }
    }
}

/// One row: a value a column.
pub type Row = Vec<Value>;

/// Returns a row as a JSON object.
pub(super) fn object<'a>(
    cells: impl Iterator<Item = (&'a Column, &'a Value)>,
) -> serde_json::Map<String, serde_json::Value> {
    cells.map(|(column, value)| (column.name.clone(), value.json())).collect()
}

/// What all results of a table depend on: a hash of the study with its parameters, and one of the program.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fingerprint(String);

impl Fingerprint {
    /// Joins both hashes.
    #[must_use]
    pub fn new(parameters: &str, program: &str) -> Self {
        Self(format!("{parameters}-{program}"))
    }

    /// Takes the text of a fingerprint.
    #[must_use]
    pub const fn parse(text: String) -> Self {
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
