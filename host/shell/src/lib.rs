#![forbid(unsafe_code)]
#![doc = include_str!("../README.md")]
//!
//! | module | what it does |
//! |---|---|
//! | [`Exit`], [`Error`] | exit codes for scripts, sentences for people |
//! | [`number`], [`time`] | read numbers and durations within their limits |
//! | [`output`] | prints texts, JSON, tables and progress bars |
//! | [`outlet`] | standard output and error, which hold up nobody |
//! | [`course`], [`identification`] | options of a path, of steering, of an identification |
//! | [`stream`] | `--foxglove` |
//! | [`suggestion`] | what may have been meant |
//! | [`completions`], [`man`] | completion scripts, manual pages |

pub mod completions;
pub mod course;
mod exit;
#[cfg_attr(not(feature = "foxglove"), path = "no_foxglove.rs")]
pub mod foxglove;
#[cfg(feature = "foxglove")]
mod foxglove_front;
pub mod identification;
pub mod man;
pub mod number;
pub mod outlet;
pub mod output;
pub mod stream;
pub mod suggestion;
pub mod time;

use std::borrow::Cow;
use std::ffi::OsString;
use std::io::{self, Write as _};
use std::process::ExitCode;

use clap::FromArgMatches;
use flix_host::system::interrupt::Interrupt;
use flix_host::system::text::{printable, printable_lines};

pub use exit::{Error, Exit};

/// Lets every option take `-5` as its value, so that its own check refuses it with the range.
#[must_use]
pub fn numbers_may_be_negative(command: clap::Command) -> clap::Command {
    command
        .mut_args(|argument| {
            if !argument.get_action().takes_values() {
                return argument;
            }
            let is_time = argument
                .get_value_names()
                .is_some_and(|names| names.iter().any(|name| name.as_str() == "TIME"));
            let argument = argument.allow_negative_numbers(true);
            if is_time { argument.allow_hyphen_values(true) } else { argument }
        })
        .mut_subcommands(numbers_may_be_negative)
}

/// Returns the options of a command and its subcommands whose value is a list with commas, as they are typed.
fn lists(command: &clap::Command) -> Vec<String> {
    let is_list = |it: &&clap::Arg| it.get_value_delimiter() == Some(',');
    let own = command.get_arguments().filter(is_list).filter_map(clap::Arg::get_long);
    let own = own.map(|name| format!("--{name}"));
    own.chain(command.get_subcommands().flat_map(lists)).collect()
}

/// Adds how to write a list to an error about a word too many, where one was begun before it: PowerShell makes several words of a list.
fn with_commas(
    mut error: clap::Error,
    lists: &[String],
    mut words: impl Iterator<Item = String>,
) -> clap::Error {
    use clap::error::{ContextKind, ContextValue, ErrorKind};
    let is_word = matches!(
        error.get(ContextKind::InvalidArg),
        Some(ContextValue::String(word)) if !word.starts_with('-')
    );
    if error.kind() == ErrorKind::UnknownArgument
        && is_word
        && let Some(list) = words.find(|word| lists.contains(word))
    {
        let advice =
            format!("{list} takes a list with commas, between double quotes in PowerShell");
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![advice.into()]));
    }
    error
}

/// Prints help, the version, or what is wrong: in colours, unless a word that was typed could steer the terminal.
fn show(error: &clap::Error) -> io::Result<()> {
    let is_plain = |word: OsString| {
        word.to_str().is_some_and(|word| matches!(printable(word), Cow::Borrowed(_)))
    };
    if !error.use_stderr() || std::env::args_os().all(is_plain) {
        return error.print();
    }
    io::stderr().write_all(printable_lines(&error.render().to_string()).as_bytes())
}

/// Parses the command line of a program, first thing in it. Prints help, the version, or what is wrong.
///
/// # Errors
/// With the exit code of a program that ends with that.
pub fn parse<C: FromArgMatches>(description: clap::Command) -> Result<C, ExitCode> {
    // Where it is refused a signal ends the program, as it ends others.
    let _ = Interrupt::let_writes_fail();
    let name = description.get_name().to_owned();
    let lists = lists(&description);
    let parsed = description.try_get_matches().and_then(|matches| C::from_arg_matches(&matches));
    parsed.map_err(|error| with_commas(error, &lists, std::env::args())).map_err(
        |error| match show(&error) {
            // Help that was asked for has to be printed; a reader that has closed the pipe has enough.
            Err(lost) if !error.use_stderr() && lost.kind() != io::ErrorKind::BrokenPipe => {
                let _ = writeln!(io::stderr(), "{name}: stdout cannot be written: {lost}");
                Exit::Usage.into()
            }
            _ => u8::try_from(error.exit_code()).map_or(ExitCode::FAILURE, ExitCode::from),
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_that_has_lost_its_commas_is_named() {
        let channels = clap::Arg::new("channels").long("channels").value_delimiter(',');
        let capture = clap::Command::new("scope").arg(channels).arg(clap::Arg::new("robot"));
        let command = clap::Command::new("flix").subcommand(capture);
        let error = |line: &str| {
            let words = || line.split(' ').map(str::to_owned);
            let error = command.clone().try_get_matches_from(words()).unwrap_err();
            with_commas(error, &lists(&command), words()).to_string()
        };
        let lost = error("flix scope walker-3f2c --channels ia ib angle");
        assert!(lost.contains("--channels takes a list with commas"), "{lost}");
        for other in
            ["flix scope walker-3f2c ib", "flix scope walker-3f2c --channels ia,ib --angle"]
        {
            assert!(!error(other).contains("commas"), "{other}");
        }
    }
}
