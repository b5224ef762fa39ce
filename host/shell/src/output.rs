//! Output of the commands: texts, JSON, tables and progress bars.

use std::fmt;
use std::io::{self, IsTerminal as _};
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

use comfy_table::{CellAlignment, ContentArrangement, Table, presets};
use indicatif::{ProgressBar, ProgressStyle};
use serde::{Serialize, Serializer};
use terminal_size::{Width, terminal_size};

use crate::Error;
use crate::outlet::{PATIENCE, drawn, stderr, stdout};
use flix_host::system::file::{self, STANDARD_STREAM};
use flix_host::system::program;
use flix_host::system::text::{printable, printable_lines};

/// Prints a text on stdout, as far as it is one ([`printable_lines`]). A reader that has closed the pipe (`| head`) is not an error.
///
/// # Errors
/// When stdout cannot be written, or is a terminal that takes nothing.
pub fn print(text: &str) -> Result<(), Error> {
    // What was complained of before stands before it.
    let _ = stderr().wait(Some(PATIENCE));
    stdout().put(printable_lines(text).as_bytes());
    match stdout().wait(None) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(Error::usage(format_args!("stdout cannot be written: {error}")))
        }
        _ => Ok(()),
    }
}

/// Prints a sentence on stderr. The terminal may be closed: then it is lost.
pub fn complain(sentence: impl fmt::Display) {
    say("flix", sentence);
}

/// Prints what a program has to say on stderr, as [`complain`] does.
pub fn say(program: &str, sentence: impl fmt::Display) {
    stderr().put(format!("{program}: {}\n", printable_lines(&sentence.to_string())).as_bytes());
}

/// Reads a text file; `-` is standard input.
///
/// # Errors
/// As for [`file::read_text`].
pub fn read_text(file: &Path) -> io::Result<String> {
    match file == Path::new(STANDARD_STREAM) {
        true => file::text(file::standard_input()?),
        false => file::read_text(file),
    }
}

/// Writes a text file as [`file::overwrite`] does, and prints the text where it cannot be written; `-` is standard output.
///
/// # Errors
/// When it cannot be written.
pub fn write_text(path: &Path, text: &str) -> Result<(), Error> {
    if path == Path::new(STANDARD_STREAM) {
        return print(text);
    }
    // Opening a pipe waits for its reader, whatever signal comes.
    match file::kind(path) {
        Ok(Some("a pipe")) => Err(io::Error::other("it is a pipe: `-` is standard output")),
        _ => file::overwrite(path, text.as_bytes(), || {
            // Of two errors that of the file is reported.
            let _ = print(text);
        }),
    }
    .map_err(|error| Error::usage(format_args!("{}: {error}", path.display())))
}

/// Serializes a path as text, which JSON has alone: bytes that are none are replaced.
///
/// # Errors
/// Those of the serializer.
pub fn path_as_text<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    path.to_string_lossy().serialize(serializer)
}

/// Serializes a path that may be missing as [`path_as_text`] does.
///
/// # Errors
/// Those of the serializer.
pub fn optional_path_as_text<S: Serializer>(
    path: &Option<PathBuf>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    path.as_deref().map(Path::to_string_lossy).serialize(serializer)
}

/// An object with the program that made it.
#[derive(Serialize)]
struct Made<'a, T> {
    #[serde(flatten)]
    value: &'a T,
    program: &'static str,
}

/// Prints a value as one JSON document on stdout; an object with the program that made it, as its last key.
///
/// # Errors
/// As for [`print()`].
pub fn print_json(value: &impl Serialize) -> Result<(), Error> {
    print(&(json(value).map_err(Error::usage)? + "\n"))
}

fn json(value: &impl Serialize) -> serde_json::Result<String> {
    let made = Made { value, program: program::get() };
    // A list or a number has no keys.
    serde_json::to_string_pretty(&made).or_else(|_| serde_json::to_string_pretty(value))
}

/// Lays rows out in columns without borders, the headings first. Columns with a number in them are
/// aligned to the right.
#[must_use]
pub fn table(rows: &[Vec<String>]) -> String {
    lay_out(Table::new(), rows)
}

/// Lays rows out as [`table`] does. At a terminal, long cells are broken to its width.
#[must_use]
pub fn table_for_terminal(rows: &[Vec<String>]) -> String {
    let mut table = Table::new();
    if io::stdout().is_terminal()
        && let Some((Width(columns), _)) = terminal_size()
    {
        table.set_content_arrangement(ContentArrangement::Dynamic).set_width(columns);
    }
    lay_out(table, rows)
}

fn lay_out(mut table: Table, rows: &[Vec<String>]) -> String {
    let cells = |row: &Vec<String>| row.iter().map(|it| printable(it).into_owned()).collect();
    table
        .load_style(presets::NOTHING)
        .add_rows(rows.iter().map(cells).collect::<Vec<Vec<String>>>());
    for (index, column) in table.column_iter_mut().enumerate() {
        let mut cells = rows.iter().skip(1).filter_map(|row| row.get(index));
        if cells.any(|cell| cell.starts_with(|c: char| c.is_ascii_digit() || "+-".contains(c))) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        column.set_padding((0, 2));
    }
    table.trim_fmt() + "\n"
}

/// Returns the first row of a [`table`] from its headings with bars between.
#[must_use]
pub fn headings(names: &str) -> Vec<String> {
    names.split('|').map(str::to_owned).collect()
}

/// Returns a bar on stderr that fills in `duration`; hidden when stderr is not a terminal.
#[must_use]
pub fn progress(duration: Duration) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:40} {elapsed} of {msg}");
    let bar = drawn(ProgressBar::new(u64::try_from(duration.as_millis()).unwrap_or(u64::MAX)));
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_message(format!("{} s", duration.as_secs_f32()));
    bar
}

/// A wait that lasts longer is explained.
const UNEXPLAINED: Duration = Duration::from_secs(1);

/// Waits, and prints on stderr what for where it takes longer than a second.
pub fn waiting<T>(for_what: impl fmt::Display, wait: impl FnOnce() -> T) -> T {
    let for_what = for_what.to_string();
    std::thread::scope(|scope| {
        let (is_waiting, waits) = mpsc::channel::<()>();
        scope.spawn(move || {
            if waits.recv_timeout(UNEXPLAINED) == Err(mpsc::RecvTimeoutError::Timeout) {
                complain(format_args!("waiting for {for_what}"));
            }
        });
        let _until_then = is_waiting;
        wait()
    })
}

/// Returns milliseconds with a fraction.
#[must_use]
pub fn milliseconds(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    #[test]
    fn an_object_names_the_program_that_made_it_last() {
        #[derive(serde::Serialize)]
        struct Report {
            b: f64,
            a: Option<u8>,
        }
        let text = super::json(&Report { b: 0.1, a: None }).unwrap();
        let program = flix_host::system::program::get();
        assert!(text.ends_with(&format!("\"program\": \"{program}\"\n}}")), "{text}");
        assert!(text.find("\"b\": 0.1").unwrap() < text.find("\"a\": null").unwrap());
        for list in [json!([1, 2]), json!(3)] {
            let text = super::json(&list).unwrap();
            assert_eq!(serde_json::from_str::<Value>(&text).unwrap(), list);
        }
    }
}
