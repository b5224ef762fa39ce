//! Settings as a TOML file, and the check whether a robot accepts them.

use std::path::{Path, PathBuf};

use super::unknown::no_setting;
use flix_protocol::message::{Mark, Name, Parameter};

use crate::status::Status;

/// The table that holds the settings.
const TABLE: &str = "settings";

/// Why a file cannot be imported. Nothing was changed.
#[derive(Debug, thiserror::Error)]
pub(super) enum FileError {
    /// The file is not TOML.
    #[error("{}: {source}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Line, column and error.
        source: toml::de::Error,
    },
    /// The file is TOML, but not settings.
    #[error("{}: {problem}; `flix parameters export` writes such a file", path.display())]
    Shape {
        /// The file.
        path: PathBuf,
        /// The problem.
        problem: String,
    },
    /// The settings do not fit this robot.
    #[error("{}: nothing was changed: {}", path.display(), problems.join("; "))]
    Unfit {
        /// The file.
        path: PathBuf,
        /// All problems.
        problems: Vec<String>,
    },
}

/// A change of a setting.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Change {
    pub(super) name: Name,
    pub(super) old: f32,
    pub(super) new: f32,
}

/// Returns all settings as TOML, each with unit, range and default.
pub(super) fn write(status: &Status, parameters: &[Parameter]) -> String {
    let mut text = format!("# Settings of {}\n\n[{TABLE}]\n", status.robot_line());
    text.extend(parameters.iter().map(lines));
    text
}

/// Returns the lines of one setting. What is assumed is a comment: an import is not to enter it.
fn lines(parameter: &Parameter) -> String {
    let Parameter { name, unit, value, default, minimum, maximum, mark, .. } = parameter;
    let unit = if unit == "1" { String::new() } else { format!("{unit}, ") };
    let known = mark.map_or_else(String::new, |mark| format!(", {mark}"));
    let comment = if *mark == Some(Mark::Assumed) { "# " } else { "" };
    format!(
        "# {unit}{minimum} to {maximum}, default {default}{known}\n{comment}{name} = {value:?}\n"
    )
}

/// Returns names and values of the file. Every value is a finite number.
pub(super) fn read(path: &Path, text: &str) -> Result<Vec<(String, f32)>, FileError> {
    let shape = |problem: String| FileError::Shape { path: path.to_owned(), problem };
    let document: toml::Table =
        text.parse().map_err(|source| FileError::Syntax { path: path.to_owned(), source })?;
    if let Some(other) = document.keys().find(|key| *key != TABLE) {
        return Err(shape(format!("`{other}` does not belong here, only a table [{TABLE}]")));
    }
    let Some(toml::Value::Table(settings)) = document.get(TABLE) else {
        return Err(shape(format!("there is no table [{TABLE}]")));
    };
    if settings.is_empty() {
        return Err(shape(format!("the table [{TABLE}] is empty")));
    }
    settings
        .iter()
        .map(|(name, value)| {
            let number = match value {
                toml::Value::Float(value) => *value as f32,
                toml::Value::Integer(value) => *value as f32,
                _ => f32::NAN,
            };
            if number.is_finite() {
                Ok((name.clone(), number))
            } else {
                Err(shape(format!("`{name} = {value}` is not a number")))
            }
        })
        .collect()
}

/// Returns the changes for a robot with these settings. Reports everything that the robot would
/// refuse.
pub(super) fn check(
    path: &Path,
    wanted: &[(String, f32)],
    present: &[Parameter],
) -> Result<Vec<Change>, FileError> {
    let mut problems = Vec::new();
    let mut changes = Vec::new();
    for (name, new) in wanted {
        let Some(parameter) = present.iter().find(|parameter| parameter.name == name.as_str())
        else {
            problems.push(no_setting(name, present.iter().map(|it| it.name.as_str())));
            continue;
        };
        let minimum = bound(parameter, parameter.minimum, wanted, present);
        let maximum = bound(parameter, parameter.maximum, wanted, present);
        if !(minimum..=maximum).contains(new) {
            problems.push(format!("{name} = {new} is outside {minimum} to {maximum}"));
        } else if *new != parameter.value || parameter.mark == Some(Mark::Assumed) {
            changes.push(Change { name: parameter.name.clone(), old: parameter.value, new: *new });
        }
    }
    if problems.is_empty() {
        Ok(changes)
    } else {
        Err(FileError::Unfit { path: path.to_owned(), problems })
    }
}

/// Returns a bound of a setting after the import. A robot reports its present ranges, and some
/// settings bound each other (a limit below its trip). A bound that equals the present value of
/// another setting in the same unit is assumed to follow that setting. Where this assumption is
/// wrong, the robot refuses.
fn bound(
    parameter: &Parameter,
    reported: f32,
    wanted: &[(String, f32)],
    present: &[Parameter],
) -> f32 {
    present
        .iter()
        .filter(|other| {
            other.name != parameter.name && other.unit == parameter.unit && other.value == reported
        })
        .find_map(|other| wanted.iter().find(|(name, _)| *name == other.name.as_str()))
        .map_or(reported, |(_, value)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameter(name: &str, value: f32, minimum: f32, maximum: f32) -> Parameter {
        Parameter {
            index: 0,
            name: name.try_into().unwrap(),
            unit: "A".try_into().unwrap(),
            value,
            default: value,
            minimum,
            maximum,
            mark: None,
        }
    }

    fn bounded_pair() -> [Parameter; 2] {
        [parameter("current_limit", 2.0, 0.1, 2.6), parameter("over_current", 2.6, 2.0, 30.0)]
    }

    fn wanted(values: &[(&str, f32)]) -> Vec<(String, f32)> {
        values.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect()
    }

    fn check(values: &[(&str, f32)]) -> Result<Vec<Change>, String> {
        super::check(Path::new("x.toml"), &wanted(values), &bounded_pair())
            .map_err(|error| error.to_string())
    }

    #[test]
    fn an_assumed_value_is_entered_even_as_it_is_and_is_not_exported_as_if_it_were_known() {
        let present =
            [Parameter { mark: Some(Mark::Assumed), ..parameter("pole_pairs", 7.0, 1.0, 32.0) }];
        let changes = super::check(Path::new("x.toml"), &wanted(&[("pole_pairs", 7.0)]), &present);
        assert_eq!(changes.unwrap().len(), 1);
        assert!(lines(&present[0]).ends_with("default 7, assumed\n# pole_pairs = 7.0\n"));
    }

    #[test]
    fn only_what_differs_is_changed() {
        let changes = check(&[("current_limit", 1.5), ("over_current", 2.6)]).unwrap();
        assert_eq!(changes.len(), 1);
        assert_eq!((changes[0].old, changes[0].new), (2.0, 1.5));
    }

    #[test]
    fn all_problems_are_reported_at_once() {
        let sentence =
            check(&[("current_limit", 9.0), ("over_current", 50.0), ("colour", 1.0)]).unwrap_err();
        assert!(sentence.contains("`colour`") && sentence.contains("30"), "{sentence}");
    }

    #[test]
    fn settings_that_bound_each_other_can_move_together() {
        assert!(check(&[("current_limit", 3.0), ("over_current", 4.0)]).is_ok());
        assert!(check(&[("current_limit", 1.0), ("over_current", 1.5)]).is_ok());
        let sentence = check(&[("current_limit", 3.0)]).unwrap_err();
        assert!(sentence.contains("2.6"), "{sentence}");
        assert!(check(&[("current_limit", 3.0), ("over_current", 2.8)]).is_err());
    }

    #[test]
    fn files_that_are_not_settings_are_refused_with_what_is_wrong() {
        for (text, part) in [
            ("[settings", "line 1"),
            ("", "[settings]"),
            ("[settings]\n", "empty"),
            ("current_limit = 1.0", "current_limit"),
            ("[settings]\ncurrent_limit = \"1 A\"", "not a number"),
            ("[settings]\ncurrent_limit = nan", "not a number"),
            ("[settings]\ncurrent_limit = -inf", "not a number"),
            ("[settings]\ncurrent_limit = 1e300", "not a number"),
            ("[settings]\na = 1\na = 2", "duplicate"),
        ] {
            let sentence = read(Path::new("x.toml"), text).unwrap_err().to_string();
            assert!(sentence.contains(part), "{text:?}: {sentence}");
        }
    }
}
