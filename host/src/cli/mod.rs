//! The `flix` command line: one file per command, each with `Args` and `run`.
//!
//! # Exit codes
//!
//! | code | meaning |
//! |---|---|
//! | 0 | done |
//! | 2 | usage: an option, a file or a value is wrong |
//! | 10 | no answer from the robot |
//! | 20 | the robot refused: other key, other version, or another operator holds it |
//! | 30 | the robot has a fault, or is in a state that does not allow the command |
//! | 40 | interrupted; the robot was stopped first |
//!
//! A failure is one sentence on stderr that says what to do. With `--json`, stdout carries JSON only.

pub mod by_hand;
pub mod clear;
#[cfg(feature = "live")]
pub mod cockpit;
pub mod commission;
pub mod completions;
pub mod course;
pub mod crash;
pub mod discover;
pub mod doctor;
pub mod drive;
pub mod experiment;
pub mod home;
pub mod identify;
pub mod keygen;
pub mod link_test;
pub mod man;
mod moved;
pub mod number;
pub mod output;
pub mod parameters;
pub mod provision;
pub mod robot;
pub mod runs;
pub mod scope;
pub mod status;
pub mod stop;
pub mod stream;
mod stretch;
pub mod teleop;
pub mod time;
pub mod track;
pub mod walk;

use std::fmt;
use std::io::{self, Write};
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use flix_protocol::message::Refusal;
use flix_protocol::session::ConnectError;

use crate::keys::KeyError;
use crate::link::udp::LinkError;

/// Exit code of a command: a contract with scripts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// The command is done.
    Done = 0,
    /// An option, a file or a value is wrong.
    Usage = 2,
    /// The robot did not answer, or fell silent.
    NoAnswer = 10,
    /// The robot refused this operator.
    Refused = 20,
    /// The robot has a fault or cannot do this in its state.
    RobotFault = 30,
    /// A signal, or a closed terminal.
    Interrupted = 40,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// Why a command failed: an exit code for scripts, a sentence for people.
#[derive(Debug)]
pub struct Error {
    /// Exit code for scripts.
    pub exit: Exit,
    /// Sentence for people.
    pub sentence: String,
}

impl Error {
    /// Makes an error from an exit code and a sentence.
    pub fn new(exit: Exit, sentence: impl fmt::Display) -> Self {
        Self { exit, sentence: sentence.to_string() }
    }

    /// Makes an error about a wrong option, file or value.
    pub fn usage(sentence: impl fmt::Display) -> Self {
        Self::new(Exit::Usage, sentence)
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.sentence)
    }
}

impl std::error::Error for Error {}

impl From<LinkError> for Error {
    fn from(error: LinkError) -> Self {
        let exit = match &error {
            LinkError::Network(_)
            | LinkError::Random(_)
            | LinkError::Connect(ConnectError::NoAnswer)
            | LinkError::Silent
            | LinkError::Back
            | LinkError::Left
            | LinkError::Unanswered
            | LinkError::Lapsed
            | LinkError::Refused(Refusal::LinkUnproven | Refusal::Late { .. }) => Exit::NoAnswer,
            LinkError::Connect(_) | LinkError::Revoked | LinkError::Refused(Refusal::Malformed) => {
                Exit::Refused
            }
            LinkError::Refused(
                Refusal::OutOfRange { .. } | Refusal::NotWhole { .. } | Refusal::UnknownParameter,
            ) => Exit::Usage,
            LinkError::Refused(_)
            | LinkError::Faulted { .. }
            | LinkError::State { .. }
            | LinkError::StoppedBy(_)
            | LinkError::StillStopped => Exit::RobotFault,
            LinkError::Interrupted => Exit::Interrupted,
        };
        Self::new(exit, error)
    }
}

impl From<KeyError> for Error {
    fn from(error: KeyError) -> Self {
        Self::usage(error)
    }
}

/// Drive, watch and record a Flix-Walker
#[derive(Debug, Parser)]
#[command(
    name = "flix",
    version,
    propagate_version = true,
    subcommand_required = true,
    arg_required_else_help = true,
    after_help = EXAMPLES
)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
Examples:
  flix teleop 127.0.0.1                      drive with the keyboard
  flix cockpit 127.0.0.1                     drive in the browser
  flix drive walker-1 --frequency -30 --direction 30 --for 5s
  flix status walker-1 --json | jq .state
  flix stop walker-1

Exit codes: 0 done, 2 usage, 10 no answer, 20 refused (key, version or another operator),
30 robot fault, 40 interrupted (the robot was stopped first).";

#[derive(Debug, Subcommand)]
enum Command {
    Teleop(teleop::Args),
    #[cfg(feature = "live")]
    Cockpit(cockpit::Args),
    Drive(drive::Args),
    Status(status::Args),
    Crash(crash::Args),
    Stop(stop::Args),
    Clear(clear::Args),
    Parameters(parameters::Args),
    LinkTest(link_test::Args),
    Discover(discover::Args),
    Provision(provision::Args),
    Keygen(keygen::Args),
    Track(track::Args),
    Home(home::Args),
    Identify(identify::Args),
    Experiment(experiment::Args),
    Doctor(doctor::Args),
    Scope(scope::Args),
    Commission(commission::Args),
    Runs(runs::Args),
    Completions(completions::Args),
    #[command(after_help = "Example:\n  flix man ~/.local/share/man/man1")]
    Man(man::Args),
}

impl Cli {
    /// Runs the command.
    ///
    /// # Errors
    /// When the command fails; with the exit code and the sentence to show.
    pub fn run(&self) -> Result<ExitCode, Error> {
        match &self.command {
            Command::Teleop(args) => teleop::run(args),
            #[cfg(feature = "live")]
            Command::Cockpit(args) => cockpit::run(args),
            Command::Drive(args) => drive::run(args),
            Command::Status(args) => status::run(args),
            Command::Crash(args) => crash::run(args),
            Command::Stop(args) => stop::run(args),
            Command::Clear(args) => clear::run(args),
            Command::Parameters(args) => parameters::run(args),
            Command::LinkTest(args) => link_test::run(args),
            Command::Discover(args) => discover::run(args),
            Command::Provision(args) => provision::run(args),
            Command::Keygen(args) => keygen::run(args),
            Command::Track(args) => track::run(args),
            Command::Home(args) => home::run(args),
            Command::Identify(args) => identify::run(args),
            Command::Experiment(args) => experiment::run(args),
            Command::Doctor(args) => doctor::run(args),
            Command::Scope(args) => scope::run(args),
            Command::Commission(args) => commission::run(args),
            Command::Runs(args) => runs::run(args),
            Command::Completions(args) => completions::run(args),
            Command::Man(args) => man::run(args),
        }
    }

    /// Returns the command line as data, for completions and tests.
    #[must_use]
    pub fn description() -> clap::Command {
        numbers_may_be_negative(Self::command())
    }
}

/// Lets every option take `-5` as its value, so that its own check refuses it with the range.
fn numbers_may_be_negative(command: clap::Command) -> clap::Command {
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

/// Parses the command line of a program. Prints help, the version, or what is wrong.
///
/// # Errors
/// With the exit code of a program that ends with that.
pub fn parse<C: FromArgMatches>(description: clap::Command) -> Result<C, ExitCode> {
    let name = description.get_name().to_owned();
    let parsed = description.try_get_matches().and_then(|matches| C::from_arg_matches(&matches));
    parsed.map_err(|error| match error.print() {
        // Help that was asked for has to be printed; a reader that has closed the pipe has enough.
        Err(lost) if !error.use_stderr() && lost.kind() != io::ErrorKind::BrokenPipe => {
            let _ = writeln!(io::stderr(), "{name}: stdout cannot be written: {lost}");
            Exit::Usage.into()
        }
        _ => u8::try_from(error.exit_code()).map_or(ExitCode::FAILURE, ExitCode::from),
    })
}

/// Parses the command line, runs it, and reports an error.
pub fn main() -> ExitCode {
    let cli: Cli = match parse(Cli::description()) {
        Ok(cli) => cli,
        Err(code) => return code,
    };
    match cli.run() {
        Ok(code) => code,
        Err(error) => {
            output::complain(&error);
            error.exit.into()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the examples and tables of help that are wider than a terminal.
    fn wide_lines(command: &clap::Command) -> Vec<String> {
        let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
        let wide = |line: &&str| line.starts_with("  ") && line.chars().count() > 80;
        let own = help.lines().filter(wide).map(str::to_owned);
        own.chain(command.get_subcommands().flat_map(wide_lines)).collect()
    }

    #[test]
    fn help_fits_80_columns() {
        assert_eq!(wide_lines(&Cli::description()), Vec::<String>::new());
    }

    #[test]
    fn the_command_line_is_consistent() {
        Cli::description().debug_assert();
    }
}
