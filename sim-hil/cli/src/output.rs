//! What commands print: figures as JSON for programs, tables for people.

use std::path::Path;
use std::process::ExitCode;

use serde::Serialize;

use super::error::Error;
use flix_host::system::file::overwrite;
pub(crate) use flix_shell::output::{
    headings, optional_path_as_text, path_as_text, print, print_json, table,
};
use flix_sim::study::Table;
pub(crate) use flix_study::progress;

/// Prints a sentence on standard error. When nobody can read it there, it is lost.
pub(crate) fn complain(sentence: impl std::fmt::Display) {
    flix_shell::output::say("flix-sim", sentence);
}

/// Writes a text into a file, or prints it where none is named.
pub(crate) fn write_or_print(file: Option<&Path>, text: &str) -> Result<(), Error> {
    match file {
        None => Ok(print(text)?),
        Some(path) => overwrite(path, text.as_bytes(), || {
            // Of two errors that of the file is reported.
            let _ = print(text);
        })
        .map_err(Error::write(path)),
    }
}

/// Prints a report as JSON, or as `text` for people.
pub(crate) fn print_report(
    report: &impl Serialize,
    json: bool,
    text: impl FnOnce() -> String,
) -> Result<(), Error> {
    Ok(if json { print_json(report) } else { print(&text()) }?)
}

/// Prints figures as JSON, or as `text` for people; the exit code states whether all promises were kept.
pub(crate) fn print_figures(
    figures: &impl Serialize,
    pass: bool,
    json: bool,
    text: impl FnOnce() -> String,
) -> Result<ExitCode, Error> {
    print_report(figures, json, text)?;
    Ok(if pass { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The cells of a row of [`table()`], each by its `Display`.
macro_rules! row {
    ($($cell:expr),* $(,)?) => { vec![$($cell.to_string()),*] };
}
pub(crate) use row;

/// Returns the last cell of a row of figures: a mark when they are outside their limits.
pub(crate) const fn mark(passes: bool) -> &'static str {
    if passes { "" } else { "<-- outside" }
}

/// Returns the rows that are outside their limits and the cells that failed, a line each.
pub(crate) fn outside(table: &Table) -> String {
    let mut text = String::new();
    for (row, object) in table.rows.values().zip(table.objects()) {
        if !table.keeps(row) {
            let words = object.iter().map(|(name, value)| format!("{name} {value}"));
            text += &format!("outside: {}\n", words.collect::<Vec<_>>().join(", "));
        }
    }
    text
}

/// Returns the name of a variant in words: `EarlierSession` is `earlier session`.
pub(crate) fn words(variant: &impl core::fmt::Debug) -> String {
    let mut text = String::new();
    for letter in format!("{variant:?}").chars() {
        if letter.is_uppercase() && !text.is_empty() {
            text.push(' ');
        }
        text.extend(letter.to_lowercase());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stand_to_the_right_and_text_to_the_left() {
        let rows = [row!["fault", "safe (s)"], row!["a", 0.25], row!["longer", "never"]];
        assert_eq!(table(&rows), "fault   safe (s)\na           0.25\nlonger     never\n");
    }
}
