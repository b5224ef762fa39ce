//! The robot's settings on a screen: reads all of them, changes and saves them over the running link.

use flix_protocol::message::{Command, Name, Outcome, Parameter, ParameterCommand, Refusal};
use flix_protocol::settings::description;
use flix_protocol::units::Instant;
use serde::Serialize;

use crate::link::Client;
use crate::system::number::in_unit;

/// Reads a value as a person writes it: a number within the range that the robot states, in the unit of the setting or with
/// another one behind it, or the position of a switch.
///
/// # Errors
/// With a sentence that names the setting, when the text is no such value.
pub fn read_value(parameter: &Parameter, text: &str) -> Result<f32, String> {
    let Parameter { name, unit, minimum, maximum, .. } = parameter;
    let is_switch = (*minimum, *maximum) == (0.0, 1.0);
    let is_word = !text.contains(|it: char| it.is_ascii_digit());
    let value = match in_unit(text, unit) {
        Ok(value) if is_switch || !is_word => value as f32,
        Ok(_) => return Err(format!("{name}: `{text}` is not a number")),
        Err(why) => return Err(format!("{name}: {why}")),
    };
    if (*minimum..=*maximum).contains(&value) {
        return Ok(value);
    }
    let unit = if unit == "1" { String::new() } else { format!(" {unit}") };
    let refusal = Refusal::OutOfRange { name: name.clone(), minimum: *minimum, maximum: *maximum };
    Err(format!("{refusal}{unit}, not {value}"))
}

/// The settings of a robot, as far as they were asked for.
#[derive(Debug, Clone, Default)]
pub struct Settings {
    entries: Vec<Parameter>,
    revision: u32,
    /// Entries of a reading that is under way.
    arriving: Vec<Parameter>,
    reading: Option<u32>,
    changing: Vec<(u32, Name)>,
    /// The change that was refused last, and why.
    refused: Option<(Name, String)>,
    saving: Option<u32>,
}

/// Subject of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answered {
    /// A part of the list, or the list as a whole.
    List,
    /// A change, done or refused.
    Change,
    /// All settings are stored, or that was refused.
    Save,
}

impl Settings {
    /// Returns the settings in the order of the robot; none before they were read.
    #[must_use]
    pub fn entries(&self) -> &[Parameter] {
        &self.entries
    }

    /// Returns a number that grows whenever the settings were read as a whole, or a change of one was asked for.
    #[must_use]
    pub const fn revision(&self) -> u32 {
        self.revision
    }

    /// Returns the value of a setting, if it was read.
    #[must_use]
    pub fn value(&self, name: &str) -> Option<f32> {
        self.entries.iter().find(|entry| entry.name == name).map(|entry| entry.value)
    }

    /// Reads all settings, unless that is under way.
    pub fn read(&mut self, client: &mut Client, now: Instant) {
        if self.reading.is_none() {
            self.read_on(client, now);
        }
    }

    /// Begins anew after a connection was lost: its answers do not come any more.
    pub(crate) fn reconnected(&mut self, client: &mut Client, now: Instant) {
        let was_asked_for = self.reading.is_some() || !self.entries.is_empty();
        self.arriving.clear();
        self.changing.clear();
        (self.reading, self.saving) = (None, None);
        if was_asked_for {
            self.read(client, now);
        }
    }

    /// Returns why this setting was not changed, if its change was the last one that was refused.
    #[must_use]
    pub fn refusal(&self, name: &str) -> Option<&str> {
        self.refused.as_ref().filter(|(refused, _)| refused == name).map(|(_, why)| why.as_str())
    }

    /// Changes one setting until power-off to a written value ([`read_value`]), and reads all again, because one setting may bound
    /// others.
    ///
    /// # Errors
    /// With a sentence when the text is refused; nothing is sent then.
    pub fn set(
        &mut self,
        name: Name,
        text: &str,
        client: &mut Client,
        now: Instant,
    ) -> Result<(), String> {
        let known = self.entries.iter().find(|entry| entry.name == name);
        let read = known.ok_or_else(|| format!("{name}: it is not read yet"));
        let value = read.and_then(|parameter| read_value(parameter, text));
        let why = value.as_ref().err().cloned();
        self.refused = why.map(|why| (name.clone(), why));
        self.revision += 1;
        let command = Command::Parameter(ParameterCommand::Set(name.clone(), value?));
        self.changing.push((client.request(now, command), name));
        Ok(())
    }

    /// Stores all settings in the robot's flash.
    pub fn save(&mut self, client: &mut Client, now: Instant) {
        self.saving = Some(client.request(now, Command::Parameter(ParameterCommand::Save)));
    }

    /// Takes the answer to a request; `None` when it was not of these settings.
    pub fn answered(
        &mut self,
        request: u32,
        outcome: &Outcome,
        client: &mut Client,
        now: Instant,
    ) -> Option<Answered> {
        if self.saving.take_if(|it| *it == request).is_some() {
            return Some(Answered::Save);
        }
        if let Some(index) = self.changing.iter().position(|(it, _)| *it == request) {
            let (_, name) = self.changing.remove(index);
            if let Outcome::Refused(refusal) = outcome {
                self.refused = Some((name, refusal.to_string()));
            }
            self.arriving.clear();
            self.read_on(client, now);
            return Some(Answered::Change);
        }
        self.reading.take_if(|it| *it == request)?;
        if let Outcome::Parameters { total, entries } = outcome {
            self.arriving.extend(entries.iter().cloned());
            if entries.is_empty() || self.arriving.len() >= usize::from(*total) {
                self.entries = core::mem::take(&mut self.arriving);
                self.revision += 1;
            } else {
                self.read_on(client, now);
            }
        } else {
            self.arriving.clear();
        }
        Some(Answered::List)
    }

    /// Takes that a request was not answered.
    pub fn unanswered(&mut self, request: u32) {
        self.changing.retain(|(it, _)| *it != request);
        self.saving.take_if(|it| *it == request);
        if self.reading.take_if(|it| *it == request).is_some() {
            self.arriving.clear();
        }
    }

    fn read_on(&mut self, client: &mut Client, now: Instant) {
        let first = u16::try_from(self.arriving.len()).unwrap_or(u16::MAX);
        let command = Command::Parameter(ParameterCommand::List(first));
        self.reading = Some(client.request(now, command));
    }
}

/// A setting with its purpose, as programs read it.
#[derive(Debug, Serialize)]
pub struct Described<'a> {
    /// Its name.
    pub name: &'a str,
    /// Symbol of its unit; `1` for plain numbers and switches.
    pub unit: &'a str,
    /// Its present value.
    pub value: f32,
    /// The value of a new robot.
    pub default: f32,
    /// Smallest accepted value.
    pub minimum: f32,
    /// Largest accepted value.
    pub maximum: f32,
    /// How the value is known: "assumed", "entered" or "measured"; `None` where that needs no word.
    pub mark: Option<String>,
    /// Purpose; `None` for a setting that this program does not know.
    pub description: Option<&'static str>,
}

impl<'a> From<&'a Parameter> for Described<'a> {
    fn from(parameter: &'a Parameter) -> Self {
        Self {
            name: &parameter.name,
            unit: &parameter.unit,
            value: parameter.value,
            default: parameter.default,
            minimum: parameter.minimum,
            maximum: parameter.maximum,
            mark: parameter.mark.map(|mark| mark.to_string()),
            description: description(&parameter.name),
        }
    }
}
