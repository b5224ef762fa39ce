//! Output of the commands: texts, JSON, tables and progress bars.

use std::io::{self, Write};
use std::time::Duration;

use comfy_table::{CellAlignment, Table, presets};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::Error;

/// Prints a text on stdout. A reader that has closed the pipe (`| head`) is not an error.
///
/// # Errors
/// When stdout cannot be written.
pub fn print(text: &str) -> Result<(), Error> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(Error::usage(format_args!("stdout cannot be written: {error}")))
        }
        _ => Ok(()),
    }
}

/// Prints a value as one JSON document on stdout.
///
/// # Errors
/// As for [`print()`].
pub fn print_json(value: &impl Serialize) -> Result<(), Error> {
    let mut text = serde_json::to_string_pretty(value).map_err(Error::usage)?;
    text.push('\n');
    print(&text)
}

/// A column of a [`table`].
#[derive(Debug, Clone, Copy)]
pub struct Column(&'static str, CellAlignment);

impl Column {
    /// A column of texts, which begin at one edge.
    #[must_use]
    pub const fn left(heading: &'static str) -> Self {
        Self(heading, CellAlignment::Left)
    }

    /// A column of numbers, which end at one edge.
    #[must_use]
    pub const fn right(heading: &'static str) -> Self {
        Self(heading, CellAlignment::Right)
    }
}

/// Returns a table without lines: each column is as wide as its widest cell, with two spaces
/// between columns. Columns that all have an empty heading give no heading line.
pub fn table<const COLUMNS: usize>(
    columns: [Column; COLUMNS],
    rows: impl IntoIterator<Item = [String; COLUMNS]>,
) -> String {
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    if columns.iter().any(|Column(heading, _)| !heading.is_empty()) {
        table.set_header(columns.map(|Column(heading, _)| heading));
    }
    table.add_rows(rows);
    for (column, Column(_, alignment)) in table.column_iter_mut().zip(columns) {
        column.set_padding((0, 2)).set_cell_alignment(alignment);
    }
    format!("{}\n", table.trim_fmt())
}

/// Returns a bar on stderr that fills in `duration`; hidden when stderr is not a terminal.
#[must_use]
pub fn progress(duration: Duration) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:40} {elapsed} of {msg}");
    let bar = ProgressBar::new(u64::try_from(duration.as_millis()).unwrap_or(u64::MAX));
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_message(format!("{} s", duration.as_secs_f32()));
    bar
}

/// Returns milliseconds with a fraction.
#[must_use]
pub fn milliseconds(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}
