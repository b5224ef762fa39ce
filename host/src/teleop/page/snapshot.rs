//! Snapshot that all pages show: one object of JSON, some thirty times a second.

use flix_protocol::message::{Channel, Parameter, SCOPE_RATE_HZ, State, Telemetry};
use flix_protocol::units::Instant;
use serde_json::{Value, json};

use super::pages::Pages;
use crate::link::explain;
use crate::scope::Capture;
use crate::teleop::Cockpit;
use crate::teleop::cockpit::{Line, Link, Sample, Weight};
use crate::teleop::paper_modes::PaperMode;
use crate::teleop::settings::{Described, Settings};

/// Newest lines of the log that are sent.
const LINES: usize = 8;

/// Returns the modes for the buttons of the page: name, f in Hz, theta in degrees.
#[must_use]
pub fn modes() -> Value {
    let mode = |mode: PaperMode| json!({ "name": mode.name(), "pair": mode.pair() });
    PaperMode::ALL.into_iter().map(mode).collect()
}

/// Returns the first message to a page: its number.
#[must_use]
pub fn hello(page: u32) -> String {
    json!({ "you": page }).to_string()
}

/// Names of the parts of a message that pages are sent only after a change.
pub const EXTRAS: [&str; 2] = ["settings", "scope"];

/// Remembers which of the [`EXTRAS`] was shown already.
#[derive(Debug, Clone, Default)]
pub struct News {
    revisions: [u32; EXTRAS.len()],
}

impl News {
    /// Returns the parts that have changed since the last call, each with its position in [`EXTRAS`].
    pub fn of(&mut self, cockpit: &Cockpit) -> Vec<(usize, Value)> {
        let revisions = [cockpit.settings.revision(), cockpit.scope.revision()];
        let old = core::mem::replace(&mut self.revisions, revisions);
        let is_new = |extra: &usize| old[*extra] != revisions[*extra];
        let value = |extra| match extra {
            0 => settings(&cockpit.settings),
            _ => cockpit.scope.newest().map_or(Value::Null, scope),
        };
        (0..EXTRAS.len()).filter(is_new).map(|extra| (extra, value(extra))).collect()
    }
}

/// Returns the settings of the robot, and why the last change was refused.
fn settings(settings: &Settings) -> Value {
    let one = |entry: &Parameter| {
        let mut one = json!(Described::from(entry));
        one["refused"] = json!(settings.refusal(&entry.name));
        one
    };
    settings.entries().iter().map(one).collect()
}

/// Returns a capture of the scope: channels with unit and values, and the times of the first row and from row to row,
/// ms since the trigger.
fn scope(capture: &Capture) -> Value {
    // A ten-thousandth of each unit is enough to draw.
    let short = |value: f64| (value * 1e4).round() / 1e4;
    let channel = |(column, channel): (usize, &Channel)| {
        json!({
            "name": channel.to_string(),
            "unit": channel.quantity().unit(),
            "values": capture.column(column).map(|(_, value)| short(value)).collect::<Vec<_>>(),
        })
    };
    json!({
        "begin_ms": 1e3 * capture.time(0),
        "step_ms": 1e3 / f64::from(SCOPE_RATE_HZ),
        "channels": capture.channels().iter().enumerate().map(channel).collect::<Vec<_>>(),
    })
}

/// Returns the present state. Angles in degrees, positive to the right (clockwise); poses in metres, ENU, turned by a
/// quaternion w, x, y, z.
#[must_use]
pub fn snapshot(cockpit: &Cockpit, pages: &Pages, now: Instant) -> Value {
    let log: Vec<Value> = cockpit
        .log
        .iter()
        .rev()
        .take(LINES)
        .map(line)
        .collect::<Vec<_>>()
        .into_iter()
        .rev()
        .collect();
    json!({
        "stamp": Pages::stamp(now),
        "driver": pages.driver(),
        "pages": pages.count(),
        "robot": cockpit.identity.as_ref().map_or(cockpit.robot.as_str(), |it| it.name.as_str()),
        "link": link(cockpit),
        "wanted": [cockpit.setpoint.frequency().get(), cockpit.setpoint.direction().get()],
        "rests_in_s": cockpit.walks_for().map(|left| left.as_secs() + 1),
        "stopping": cockpit.is_stopping,
        "presses": pages.presses(),
        "is_unrecorded": cockpit.is_unrecorded,
        "current_limit": cockpit.current_limit,
        "rotors": cockpit.shown_rotors(),
        "slow_motion": cockpit.is_slow_motion(),
        "telemetry": cockpit.telemetry.as_ref().map(telemetry),
        "floor": cockpit.floor.as_ref().map(|floor| {
            json!({
                "x": floor.pose.x,
                "y": floor.pose.y,
                "height": floor.body.position.z,
                "turn": floor.body.orientation.components(),
                "held": floor.held(),
            })
        }),
        "log": log,
    })
}

fn link(cockpit: &Cockpit) -> Value {
    let (state, text) = match cockpit.link {
        Link::Connected => ("connected", "connected".to_owned()),
        Link::Silent(time) => ("silent", format!("silent for {:.1} s", time.as_secs_f64())),
        Link::Connecting => ("connecting", "connecting".to_owned()),
        Link::Failed(error) => ("failed", error.to_string()),
    };
    let round_trip = cockpit.round_trip.map(|time| time.as_secs_f64() * 1e3);
    json!({ "state": state, "text": text, "round_trip_ms": round_trip, "loss": cockpit.loss })
}

fn telemetry(telemetry: &Telemetry) -> Value {
    let sample = Sample::of(telemetry);
    let key = match telemetry.state {
        State::Disarmed => "disarmed",
        State::Aligning => "aligning",
        State::Armed => "armed",
        State::Running => "running",
        State::Stopping => "stopping",
        State::Faulted => "faulted",
    };
    let others = telemetry.first_fault.map_or(telemetry.faults, |it| telemetry.faults.without(it));
    let faults: Vec<Value> = telemetry
        .first_fault
        .into_iter()
        .chain(others.iter())
        .map(|fault| json!({ "name": fault.to_string(), "help": explain::fault(fault) }))
        .collect();
    json!({
        "state": key,
        "text": explain::state(telemetry.state),
        "stopped": telemetry.stopped,
        "limited": telemetry.frequency_limited,
        "stopped_by": telemetry.stopped_by.map(|by| by.to_string()),
        "faults": faults,
        "frequency": sample.frequency,
        "direction": sample.direction,
        "currents": sample.currents,
        "battery": sample.battery,
    })
}

fn line(line: &Line) -> Value {
    let weight = match line.weight {
        Weight::Note => "note",
        Weight::Warning => "warning",
        Weight::Alarm => "alarm",
    };
    json!({ "at": line.at.as_secs_f64(), "weight": weight, "text": line.text })
}
