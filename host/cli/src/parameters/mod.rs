//! `flix parameters`: reads, changes and stores the settings of the robot.

mod file;
mod unknown;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Subcommand;
use flix_protocol::message::{Command, Mark, Name, Outcome, Parameter, ParameterCommand, Refusal};
use flix_protocol::settings::description;

use super::address::{RobotArgs, key_file};
use file::Change;
use flix_host::link::keys::KEY_FILE_VARIABLE;
use flix_host::link::udp::Connection;
use flix_host::link::{LinkError, RobotLink};
use flix_host::system::interrupt::Interrupt;
use flix_host::teleop::settings::{Described, read_value};
use flix_shell::number::in_unit;
use flix_shell::output::{complain, headings, print, print_json, read_text, table, write_text};
use flix_shell::{Error, Exit};
use unknown::no_setting;

/// Read, change and store the settings of the robot.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix parameters list walker-3f2c
  flix parameters get walker-3f2c current_limit
  flix parameters set walker-3f2c current_limit 1.5 --save
  flix parameters accept walker-3f2c --save
  flix parameters export walker-3f2c walker-3f2c.toml
  flix parameters import walker-3f2c walker-3f2c.toml --save")]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// List all settings with unit, range, default and purpose.
    List {
        #[command(flatten)]
        robot: RobotArgs,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Show one setting.
    #[command(allow_missing_positional = true)]
    Get {
        #[command(flatten)]
        robot: RobotArgs,
        /// Name of the setting.
        name: String,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Change one setting, until power-off unless saved.
    #[command(override_usage = "flix parameters set [OPTIONS] [ROBOT] <NAME> <VALUE>")]
    Set {
        /// Robot as for the other commands, name of the setting, new value in the unit of the setting.
        #[arg(value_name = "[ROBOT] NAME VALUE", required = true, num_args = 2..=3)]
        words: Vec<String>,
        /// Key file; `-` is standard input [default: the robot's key in your keyring].
        #[arg(long, value_name = "FILE", env = KEY_FILE_VARIABLE, value_parser = key_file())]
        key: Option<PathBuf>,
        /// Save all settings, so that they survive power-off.
        #[arg(long)]
        save: bool,
    },
    /// Accept every value that is assumed, as if it had been entered.
    ///
    /// A robot does not arm on assumed values; `flix parameters list` marks them with ?. `flix commission` measures what
    /// the motors are like; this command is for motors that are known to be those of the defaults. A board that measures
    /// no phase currents does not accept the resistance and the flux linkage of a motor: set them.
    Accept {
        #[command(flatten)]
        robot: RobotArgs,
        /// Save all settings, so that they survive power-off.
        #[arg(long)]
        save: bool,
    },
    /// Save all settings, so that they survive power-off.
    Save {
        #[command(flatten)]
        robot: RobotArgs,
    },
    /// Reset all settings to their defaults: what the motors are like is assumed then.
    Reset {
        #[command(flatten)]
        robot: RobotArgs,
        /// Save the defaults, so that they survive power-off.
        #[arg(long)]
        save: bool,
    },
    /// Export all settings to a TOML file.
    Export {
        #[command(flatten)]
        robot: RobotArgs,
        /// File to write; `-` is standard output.
        #[arg(default_value = "-")]
        file: PathBuf,
    },
    /// Import settings from a TOML file. The whole file is checked before anything is changed.
    #[command(allow_missing_positional = true)]
    Import {
        #[command(flatten)]
        robot: RobotArgs,
        /// File, as `export` writes it; `-` is standard input. Settings that it does not contain stay
        /// unchanged.
        file: PathBuf,
        /// Save all settings, so that they survive power-off.
        #[arg(long)]
        save: bool,
    },
}

/// Reads a value in the unit and the range that the robot states for the setting.
fn value_of(connection: &mut Connection, name: &Name, text: &str) -> Result<f32, Error> {
    let found = connection.parameter(name.clone());
    let parameter = found.map_err(|error| named(connection, name, error))?;
    read_value(&parameter, text).map_err(Error::usage)
}

/// Refuses what is no number in any unit, before a robot is asked.
fn check_value(name: &str, text: &str) -> Result<(), Error> {
    let is_like_one = match text.trim().parse::<f32>() {
        Ok(number) => number.is_finite(),
        Err(_) => in_unit(text, "1").is_ok() || text.contains(|it: char| it.is_ascii_digit()),
    };
    let why = || Error::usage(format_args!("{name}: `{text}` is not a number, on or off"));
    if is_like_one { Ok(()) } else { Err(why()) }
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let robot = args.action.robot();
    match &args.action {
        Action::List { json, .. } => {
            let parameters = list(&mut robot.connect(&interrupt)?)?;
            show(&parameters, *json)?;
        }
        Action::Get { name, json, .. } => {
            let name = wire_name(name)?;
            let mut connection = robot.connect(&interrupt)?;
            let parameter = connection
                .parameter(name.clone())
                .map_err(|error| named(&mut connection, &name, error))?;
            if *json {
                print_json(&Described::from(&parameter))?;
            } else {
                print(&format!("{}\n", with_unit(parameter.value, &parameter.unit)))?;
            }
        }
        Action::Set { words, save, .. } => {
            let [.., name, value] = &words[..] else {
                return Err(Error::usage("name a setting and its value"));
            };
            check_value(name, value)?;
            let name = wire_name(name)?;
            let mut connection = robot.connect(&interrupt)?;
            let value = value_of(&mut connection, &name, value)?;
            connection.set(name, value)?;
            save_if(&mut connection, *save)?;
            warn(&mut connection)?;
        }
        Action::Accept { save, .. } => {
            let mut connection = robot.connect(&interrupt)?;
            accept(&mut connection)?;
            save_if(&mut connection, *save)?;
        }
        Action::Save { .. } => save_if(&mut robot.connect(&interrupt)?, true)?,
        Action::Reset { save, .. } => {
            let mut connection = robot.connect(&interrupt)?;
            connection.ask(Command::Parameter(ParameterCommand::Reset))?;
            save_if(&mut connection, *save)?;
        }
        Action::Export { file, .. } => {
            let mut connection = robot.connect(&interrupt)?;
            let text = file::write(&super::status::ask(&mut connection)?, &list(&mut connection)?);
            write_text(file, &text)?;
        }
        Action::Import { file, save, .. } => {
            let text = read_text(file).map_err(|error| cannot_use(file, &error))?;
            let wanted = file::read(file, &text).map_err(Error::usage)?;
            let mut connection = robot.connect(&interrupt)?;
            let changed = import(&mut connection, file, &wanted)?;
            save_if(&mut connection, *save)?;
            print(&format!("{changed} of {} settings changed\n", wanted.len()))?;
            warn(&mut connection)?;
        }
    }
    Ok(Exit::Done.into())
}

impl Action {
    fn robot(&self) -> RobotArgs {
        match self {
            Self::Set { words, key, .. } => {
                RobotArgs::new((words.len() > 2).then(|| words[0].clone()), key.clone())
            }
            Self::List { robot, .. }
            | Self::Get { robot, .. }
            | Self::Accept { robot, .. }
            | Self::Save { robot }
            | Self::Reset { robot, .. }
            | Self::Export { robot, .. }
            | Self::Import { robot, .. } => robot.clone(),
        }
    }
}

fn cannot_use(path: &Path, error: &std::io::Error) -> Error {
    Error::usage(format_args!("{}: {error}", path.display()))
}

fn wire_name(name: &str) -> Result<Name, Error> {
    name.try_into().map_err(|_| Error::usage(no_setting(name, std::iter::empty())))
}

/// Returns all settings, in the order of the robot.
fn list(connection: &mut Connection) -> Result<Vec<Parameter>, LinkError> {
    let mut parameters = Vec::new();
    loop {
        let first = u16::try_from(parameters.len()).unwrap_or(u16::MAX);
        let command = Command::Parameter(ParameterCommand::List(first));
        let Outcome::Parameters { total, entries } = connection.ask(command)? else {
            return Err(LinkError::OtherAnswer);
        };
        if entries.is_empty() {
            return Ok(parameters);
        }
        parameters.extend(entries);
        if parameters.len() >= usize::from(total) {
            return Ok(parameters);
        }
    }
}

/// Warns of settings that would be refused for what they are together when the robot is armed.
fn warn(connection: &mut Connection) -> Result<(), Error> {
    match connection.ask(Command::Parameter(ParameterCommand::Check)) {
        Err(LinkError::Refused(
            refusal @ (Refusal::OutOfRange { .. }
            | Refusal::UnstablePosition { .. }
            | Refusal::UnstableCurrent { .. }),
        )) => {
            complain(format_args!("set, but the robot does not arm so: {refusal}"));
            Ok(())
        }
        // What is assumed is shown by the list, and by the refusal to arm.
        Ok(_) | Err(LinkError::Refused(_)) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

/// Accepts what is assumed, and shows it.
fn accept(connection: &mut Connection) -> Result<(), Error> {
    let mut parameters = list(connection)?;
    parameters.retain(|parameter| parameter.mark == Some(Mark::Assumed));
    if parameters.is_empty() {
        return print("No value is assumed.\n");
    }
    connection.ask(Command::Parameter(ParameterCommand::Accept))?;
    let mut rows = vec![headings("setting|value|unit")];
    rows.extend(parameters.iter().map(|Parameter { name, value, unit, .. }| {
        let unit = if unit == "1" { "" } else { unit };
        vec![name.to_string(), value.to_string(), unit.into()]
    }));
    print(&format!("{}Accepted as they are.\n", table(&rows)))
}

/// Adds the nearest name to a refusal of a name that the robot does not know.
fn named(connection: &mut Connection, name: &Name, error: LinkError) -> Error {
    let LinkError::Refused(Refusal::UnknownParameter) = error else { return error.into() };
    let known = list(connection).unwrap_or_default();
    Error::usage(no_setting(name, known.iter().map(|it| it.name.as_str())))
}

fn save_if(connection: &mut Connection, wanted: bool) -> Result<(), LinkError> {
    if wanted {
        connection.ask(Command::Parameter(ParameterCommand::Save))?;
    }
    Ok(())
}

/// Sets what differs, and returns how many settings. All are set or, as long as the robot can be
/// reached, none.
fn import(
    connection: &mut Connection,
    path: &Path,
    wanted: &[(String, f32)],
) -> Result<usize, Error> {
    let present = list(connection)?;
    let mut left = file::check(path, wanted, &present).map_err(Error::usage)?;
    let count = left.len();
    let mut done = Vec::new();
    // Some settings bound each other, so the order matters and is unknown: repeat as long as a round
    // changes something.
    while !left.is_empty() {
        let before = done.len();
        let mut refusal = None;
        for change in std::mem::take(&mut left) {
            match connection.set(change.name.clone(), change.new) {
                Ok(_) => done.push(change),
                Err(error @ LinkError::Refused(_)) => {
                    refusal = Some(error);
                    left.push(change);
                }
                Err(error) => return Err(error.into()),
            }
        }
        if let Some(error) = refusal.filter(|_| done.len() == before) {
            undo(connection, &done, &present);
            return Err(error.into());
        }
    }
    Ok(count)
}

/// Restores the old values, newest first, so that every intermediate state was once in force; then what else they changed:
/// how a value is known, and what follows from it.
fn undo(connection: &mut Connection, done: &[Change], present: &[Parameter]) {
    // The error that led here is reported; another one adds nothing.
    for change in done.iter().rev() {
        let _ = connection.set_marked(change.name.clone(), change.old, Mark::Measured);
    }
    let now = list(connection).unwrap_or_default();
    for (before, now) in present.iter().zip(&now) {
        if (before.value, before.mark) != (now.value, now.mark) {
            let mark = before.mark.unwrap_or(Mark::Measured);
            let _ = connection.set_marked(before.name.clone(), before.value, mark);
        }
    }
}

fn with_unit(value: f32, unit: &str) -> String {
    if unit == "1" { value.to_string() } else { format!("{value} {unit}") }
}

fn show(parameters: &[Parameter], json: bool) -> Result<(), Error> {
    if json {
        return print_json(&parameters.iter().map(Described::from).collect::<Vec<_>>());
    }
    let mut rows = vec![headings("setting||value|unit|minimum|maximum|default")];
    rows.extend(parameters.iter().map(|parameter| {
        let Parameter { name, unit, value, default, minimum, maximum, mark, .. } = parameter;
        let mark = match mark {
            Some(Mark::Assumed) => "?",
            _ if value == default => "",
            _ => "*",
        };
        let unit = if unit == "1" { "" } else { unit };
        let [value, minimum, maximum, default] =
            [value, minimum, maximum, default].map(f32::to_string);
        vec![name.to_string(), mark.into(), value, unit.into(), minimum, maximum, default]
    }));
    let mut text = String::new();
    let purposes = parameters.iter().map(|parameter| description(&parameter.name));
    for (line, purpose) in table(&rows).lines().zip(std::iter::once(None).chain(purposes)) {
        text += &format!("{line}\n");
        if let Some(purpose) = purpose {
            text += &format!("    {purpose}\n");
        }
    }
    let legend = if parameters.iter().any(|parameter| parameter.mark == Some(Mark::Assumed)) {
        "? assumed: the robot does not arm on it; `flix commission` measures, `flix parameters set` enters it\n"
    } else {
        ""
    };
    print(&format!("{text}* differs from the default\n{legend}"))
}
