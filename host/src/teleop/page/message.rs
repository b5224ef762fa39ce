//! Messages of a page: one short line of JSON each.
//!
//! ```text
//! {"seen":1200}                            sees the snapshot of that stamp, ms
//! {"seen":1200,"do":"attend"}              its operator has touched it since the last message
//! {"seen":1200,"do":"stop","press":7}      stops; said once more, it is the same press of a button
//! {"seen":1200,"do":"arm"}                 stop, arm, disarm, clear, rest, hold_heading, drive
//! {"seen":1200,"do":{"walk":"left turn"}}  a mode by its name
//! {"seen":1200,"do":{"frequency":-1}}      changes f by so much, Hz; `direction`: theta, degrees
//! {"seen":1200,"do":"settings"}          wants to see the settings; "save" stores them
//! {"seen":1200,"do":{"set":["current_limit","1.5"]}}    a value as its operator wrote it
//! {"seen":1200,"do":{"scope":["iq,f","now"]}}    channels, and a trigger or "last"
//! ```

use flix_protocol::message::Name;
use serde::Deserialize;

use crate::teleop::action::{Action, DIRECTION_STEPS, FREQUENCY_STEPS};
use crate::teleop::paper_modes::PaperMode;

/// Longest message, bytes.
pub const LONGEST: usize = 256;

/// A message of a page.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Stamp of the newest snapshot that the page has shown, ms.
    pub seen: u64,
    /// Request of its operator.
    pub request: Option<Request>,
    /// Number of the press that asks for it, chosen by the page.
    pub press: Option<u32>,
}

/// Request of an operator.
#[derive(Debug, Clone, PartialEq)]
pub enum Request {
    /// To become the page that drives.
    Drive,
    /// Nothing: the operator is there.
    Attend,
    /// An action, neither [`Action::Quit`] nor [`Action::Interrupt`].
    Act(Action),
    /// To see the settings.
    Settings,
    /// To change a setting: its name, its new value as the operator wrote it.
    Set(Name, String),
    /// To store the settings.
    Save,
    /// To see inner values of the fast loop: channels, and a trigger or `last`, as the operator wrote them.
    Scope(String, String),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    seen: u64,
    #[serde(rename = "do")]
    request: Option<Word>,
    press: Option<u32>,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Word {
    Stop,
    Arm,
    Disarm,
    Clear,
    Rest,
    HoldHeading,
    Drive,
    Attend,
    Settings,
    Save,
    Set(Name, String),
    Scope(String, String),
    Walk(String),
    Frequency(f32),
    Direction(f32),
}

impl Message {
    /// Parses a message. `None` for anything that a page does not say; never panics.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let line: Line = serde_json::from_str(text).ok().filter(|_| text.len() <= LONGEST)?;
        let request = line.request.map(|word| request(&word).ok_or(())).transpose().ok()?;
        Some(Self { seen: line.seen, request, press: line.press })
    }
}

fn request(word: &Word) -> Option<Request> {
    let within = |step: f32, [coarse, _]: [f32; 2]| (step.abs() <= coarse).then_some(step);
    Some(Request::Act(match word {
        Word::Drive => return Some(Request::Drive),
        Word::Attend => return Some(Request::Attend),
        Word::Settings => return Some(Request::Settings),
        Word::Save => return Some(Request::Save),
        Word::Scope(channels, when) => {
            return Some(Request::Scope(channels.clone(), when.clone()));
        }
        Word::Set(name, value) => {
            return Some(Request::Set(name.clone(), value.clone()));
        }
        Word::Stop => Action::Stop,
        Word::Arm => Action::Arm,
        Word::Disarm => Action::Disarm,
        Word::Clear => Action::Clear,
        Word::Rest => Action::Rest,
        Word::HoldHeading => Action::HoldHeading,
        Word::Walk(name) => {
            Action::Walk(PaperMode::ALL.into_iter().find(|mode| mode.name() == name)?)
        }
        Word::Frequency(step) => Action::Frequency(within(*step, FREQUENCY_STEPS)?),
        Word::Direction(step) => Action::Direction(within(*step, DIRECTION_STEPS)?),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mode_is_named_as_on_the_screen() {
        for mode in PaperMode::ALL {
            let text = format!(r#"{{"seen":7,"do":{{"walk":"{}"}}}}"#, mode.name());
            let request = Some(Request::Act(Action::Walk(mode)));
            assert_eq!(Message::parse(&text), Some(Message { seen: 7, request, press: None }));
        }
    }

    #[test]
    fn a_message_without_a_wish_is_a_sign_of_life() {
        assert_eq!(
            Message::parse(r#"{"seen":0}"#),
            Some(Message { seen: 0, request: None, press: None })
        );
    }

    #[test]
    fn what_no_page_says_is_refused() {
        for text in [
            "",
            "{}",
            "stop",
            r#"{"seen":-1}"#,
            r#"{"seen":1.5}"#,
            r#"{"seen":1,"do":"quit"}"#,
            r#"{"seen":1,"do":"interrupt"}"#,
            r#"{"seen":1,"do":{"walk":"backward"}}"#,
            r#"{"seen":1,"do":{"frequency":1.1}}"#,
            r#"{"seen":1,"do":{"frequency":1e39}}"#,
            r#"{"seen":1,"do":{"direction":-5.5}}"#,
            r#"{"seen":1,"do":{"set":["current_limit"]}}"#,
            r#"{"seen":1,"do":{"set":["current_limit",1.5]}}"#,
            r#"{"seen":1,"do":{"set":["a_name_that_is_longer_than_any_setting_has","1"]}}"#,
            r#"{"seen":1,"more":2}"#,
            &format!(r#"{{"seen":1{}}}"#, " ".repeat(LONGEST)),
        ] {
            assert_eq!(Message::parse(text), None, "{text}");
        }
    }
}
