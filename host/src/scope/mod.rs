//! The scope of the robot's fast loop: what an operator asks of it, and what comes back.
//!
//! [`Capture`] is plain data; [`files`] makes tables, pictures and records of it. `flix scope` fetches it.

#[cfg(not(target_family = "wasm"))]
pub mod files;

use flix_protocol::message::{
    Channel, Command, Outcome, Quantity, SCOPE_CHANNELS, SCOPE_RATE_HZ, ScopeCommand, ScopeRows,
    ScopeStatus, Trigger,
};

use crate::link::{LinkError, RobotLink};
use crate::system::number::in_unit;

/// A text names no channels, or no trigger.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WishError {
    /// No such channel.
    #[error("there is no channel `{name}`; choose from {}", every_channel())]
    Channel {
        /// What was written.
        name: String,
    },
    /// Channels without commas between them.
    #[error("put commas between the channels: \"{}\"", .names.join(","))]
    NoComma {
        /// What was written.
        names: Vec<String>,
    },
    /// More than fit.
    #[error("these are {0} channels; the robot captures {SCOPE_CHANNELS} at once")]
    TooMany(usize),
    /// No such trigger.
    #[error(
        "`{text}` is no trigger: write now, fault, or a level such as \"top_iq>0.8\" or \"theta_error<-5\", with its double quotes"
    )]
    Trigger {
        /// What was written.
        text: String,
    },
    /// A level that the channel cannot have.
    #[error("{channel} can be {low:.0} to {high:.0} {unit}, and never crosses {level}")]
    Level {
        /// The channel.
        channel: Channel,
        /// What was written.
        level: f64,
        /// Smallest value.
        low: f64,
        /// Largest value.
        high: f64,
        /// Unit of all three.
        unit: &'static str,
    },
}

fn every_channel() -> String {
    Channel::ALL.map(|channel| channel.to_string()).join(", ")
}

/// Parses names of channels with commas between them. A name without `top_` or `bottom_` stands for both motors
/// where there is one for each: `iq` is `top_iq,bottom_iq`.
///
/// # Errors
/// When a name is none, or there are more channels than the robot captures.
pub fn channels(text: &str) -> Result<Vec<Channel>, WishError> {
    let mut chosen: Vec<Channel> = Vec::new();
    for name in text.split(',').map(str::trim).filter(|name| !name.is_empty()) {
        let named = named(name);
        if named.is_empty() {
            let names: Vec<String> = name
                .split([' ', ';', '\t'])
                .filter(|it| !it.is_empty())
                .map(str::to_owned)
                .collect();
            return Err(if names.len() > 1 && names.iter().all(|it| !self::named(it).is_empty()) {
                WishError::NoComma { names }
            } else {
                WishError::Channel { name: name.to_owned() }
            });
        }
        chosen.extend(
            named.into_iter().filter(|channel| !chosen.contains(channel)).collect::<Vec<_>>(),
        );
    }
    if chosen.is_empty() {
        return Err(WishError::Channel { name: text.to_owned() });
    }
    if chosen.len() > SCOPE_CHANNELS {
        return Err(WishError::TooMany(chosen.len()));
    }
    Ok(chosen)
}

fn named(name: &str) -> Vec<Channel> {
    let is = |channel: &Channel, name: &str| channel.to_string() == name;
    let of_both = ["top_", "bottom_"].map(|motor| format!("{motor}{name}"));
    Channel::ALL
        .into_iter()
        .filter(|channel| is(channel, name) || of_both.iter().any(|name| is(channel, name)))
        .collect()
}

/// Parses a trigger: `now`, `fault`, or a channel, `>` or `<`, and a level in its unit. A channel that is not captured
/// yet is added to `channels`; one of both motors stands for the top one.
///
/// # Errors
/// When it is none, or its channel finds no place or never has this level.
pub fn trigger(text: &str, channels: &mut Vec<Channel>) -> Result<Trigger, WishError> {
    match text.trim() {
        "now" => return Ok(Trigger::Now),
        "fault" => return Ok(Trigger::Fault),
        _ => {}
    }
    let unknown = || WishError::Trigger { text: text.to_owned() };
    let (rising, (name, level)) = match (text.split_once('>'), text.split_once('<')) {
        (Some(parts), None) => (true, parts),
        (None, Some(parts)) => (false, parts),
        _ => return Err(unknown()),
    };
    let name = name.trim();
    let channel = *named(name).first().ok_or(WishError::Channel { name: name.to_owned() })?;
    let quantity = channel.quantity();
    let level = in_unit(level, quantity.unit()).map_err(|_| unknown())?;
    let counts = level / quantity.count();
    if !(f64::from(i16::MIN + 1)..=f64::from(i16::MAX)).contains(&counts) {
        let bound = |count: i16| f64::from(count) * quantity.count();
        let (low, high) = (bound(i16::MIN), bound(i16::MAX));
        return Err(WishError::Level { channel, level, low, high, unit: quantity.unit() });
    }
    let position = match channels.iter().position(|one| *one == channel) {
        Some(position) => position,
        None if channels.len() == SCOPE_CHANNELS => {
            return Err(WishError::TooMany(SCOPE_CHANNELS + 1));
        }
        None => {
            channels.push(channel);
            channels.len() - 1
        }
    };
    Ok(Trigger::Level { channel: position as u8, level: counts.round() as i16, rising })
}

/// Rows of a capture, as they arrive.
#[derive(Debug, Clone, PartialEq)]
pub struct Capture {
    status: ScopeStatus,
    values: Vec<i16>,
}

/// The smallest, largest and mean value of a channel.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Extent {
    /// Smallest.
    pub minimum: f64,
    /// Largest.
    pub maximum: f64,
    /// Mean.
    pub mean: f64,
}

impl Capture {
    /// Begins to take the rows of a complete capture.
    #[must_use]
    pub fn new(status: ScopeStatus) -> Self {
        Self { status, values: Vec::new() }
    }

    /// Returns the next row to ask for; `None` when all are here.
    #[must_use]
    pub fn wanted(&self) -> Option<u16> {
        let here = self.rows();
        (here < usize::from(self.status.rows)).then_some(here as u16)
    }

    /// Takes rows; returns whether they were the next ones.
    pub fn take(&mut self, rows: &ScopeRows) -> bool {
        let width = self.channels().len();
        let is_next = usize::from(rows.first) == self.rows()
            && !rows.values.is_empty()
            && rows.values.len().is_multiple_of(2 * width.max(1));
        if is_next {
            let values = rows.values.as_chunks().0.iter().map(|bytes| i16::from_le_bytes(*bytes));
            self.values.extend(values);
            self.values.truncate(width * usize::from(self.status.rows));
        }
        is_next
    }

    /// Returns the channels, in the order of their columns.
    #[must_use]
    pub fn channels(&self) -> &[Channel] {
        &self.status.plan.channels
    }

    /// Returns how many rows are here.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.values.len() / self.channels().len().max(1)
    }

    /// Returns what the robot said of the capture.
    #[must_use]
    pub const fn status(&self) -> &ScopeStatus {
        &self.status
    }

    /// Returns the time of a row since the trigger, s.
    #[must_use]
    pub fn time(&self, row: usize) -> f64 {
        (row as f64 - f64::from(self.status.trigger_row)) / f64::from(SCOPE_RATE_HZ)
    }

    /// Returns the time of a row on the robot's clock, ns since it started.
    #[must_use]
    pub fn nanos(&self, row: usize) -> u64 {
        let since = (row as i64 - i64::from(self.status.trigger_row))
            * (1_000_000_000 / i64::from(SCOPE_RATE_HZ));
        (self.status.trigger_time_us * 1_000).saturating_add_signed(since)
    }

    /// Returns the values of a row in the units of their channels.
    pub fn row(&self, row: usize) -> impl Iterator<Item = f64> {
        let channels = self.channels();
        let counts = self.values.iter().skip(row * channels.len());
        channels
            .iter()
            .zip(counts)
            .map(|(channel, count)| channel.quantity().count() * f64::from(*count))
    }

    /// Returns time and value of every row of a column.
    pub fn column(&self, column: usize) -> impl Iterator<Item = (f64, f64)> {
        (0..self.rows()).filter_map(move |row| Some((self.time(row), self.row(row).nth(column)?)))
    }

    /// Returns the extent of a column; `None` without rows.
    #[must_use]
    pub fn extent(&self, column: usize) -> Option<Extent> {
        let values: Vec<f64> = self.column(column).map(|(_, value)| value).collect();
        (!values.is_empty()).then(|| Extent {
            minimum: values.iter().copied().fold(f64::INFINITY, f64::min),
            maximum: values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            mean: values.iter().sum::<f64>() / values.len() as f64,
        })
    }
}

/// Asks the scope of a robot for something; returns how far its capture is.
///
/// # Errors
/// As for [`RobotLink::ask`].
pub fn ask<L: RobotLink>(robot: &mut L, command: ScopeCommand) -> Result<ScopeStatus, L::Error> {
    match robot.ask(Command::Scope(command))? {
        Outcome::Scope(status) => Ok(status),
        _ => Err(LinkError::OtherAnswer.into()),
    }
}

/// Fetches the next rows of a capture; returns whether any were left.
///
/// # Errors
/// As for [`RobotLink::ask`].
pub fn fetch<L: RobotLink>(robot: &mut L, capture: &mut Capture) -> Result<bool, L::Error> {
    let Some(first) = capture.wanted() else { return Ok(false) };
    match robot.ask(Command::Scope(ScopeCommand::Read(first)))? {
        Outcome::ScopeRows(rows) if capture.take(&rows) => Ok(true),
        _ => Err(LinkError::OtherAnswer.into()),
    }
}

/// Returns what is drawn together: the quantities of a capture with their columns.
#[must_use]
pub fn panels(capture: &Capture) -> Vec<(Quantity, Vec<usize>)> {
    [Quantity::Current, Quantity::Voltage, Quantity::Speed, Quantity::Angle]
        .into_iter()
        .map(|quantity| {
            let is_one = |column: &usize| capture.channels()[*column].quantity() == quantity;
            (quantity, (0..capture.channels().len()).filter(is_one).collect::<Vec<_>>())
        })
        .filter(|(_, columns)| !columns.is_empty())
        .collect()
}

#[cfg(test)]
mod tests {
    use flix_protocol::message::{ScopePlan, ScopeState};

    use super::*;

    #[test]
    fn a_short_name_is_that_of_both_motors() {
        let both = [Channel::TopCurrentQ, Channel::BottomCurrentQ, Channel::ThetaError];
        assert_eq!(channels("iq, theta_error").unwrap(), both);
        assert_eq!(channels("top_iq,iq,iq").unwrap(), both[..2]);
        assert_eq!(channels("id,iq,iq_wanted,vd").unwrap().len(), SCOPE_CHANNELS);
        assert_eq!(channels("id,iq,iq_wanted,vd,f"), Err(WishError::TooMany(9)));
        let unknown = |name: &str| Err(WishError::Channel { name: name.to_owned() });
        assert_eq!(channels("f,amps"), unknown("amps"));
        assert_eq!(channels(" , "), unknown(" , "));
        for channel in Channel::ALL {
            assert_eq!(channels(&channel.to_string()).unwrap(), [channel]);
        }
    }

    #[test]
    fn a_level_is_in_the_unit_of_its_channel() {
        let mut chosen = channels("f,bus").unwrap();
        let level = |channel, level, rising| Ok(Trigger::Level { channel, level, rising });
        assert_eq!(trigger("bus<10.5", &mut chosen), level(1, 5_376, false));
        assert_eq!(trigger(" iq > 0.5 ", &mut chosen), level(2, 1_024, true));
        assert_eq!(chosen[2], Channel::TopCurrentQ);
        assert_eq!(trigger("now", &mut chosen), Ok(Trigger::Now));
        assert_eq!(trigger("fault", &mut chosen), Ok(Trigger::Fault));
        for text in ["", "soon", "bus", "bus<", "bus<a", "bus<1>2", "bus>nan"] {
            assert!(trigger(text, &mut chosen).is_err(), "{text}");
        }
        let error = trigger("iq>17", &mut chosen).unwrap_err();
        assert_eq!(error.to_string(), "top_iq can be -16 to 16 A, and never crosses 17");
        let mut full = channels("id,iq,iq_wanted,vd").unwrap();
        assert_eq!(trigger("f>3", &mut full), Err(WishError::TooMany(9)));
    }

    /// Three rows of f and bus, the second that of the trigger.
    fn capture() -> Capture {
        let plan = ScopePlan {
            channels: [Channel::Frequency, Channel::Bus].into_iter().collect(),
            ..ScopePlan::watch()
        };
        Capture::new(ScopeStatus {
            plan,
            state: ScopeState::Complete,
            rows: 3,
            trigger_row: 1,
            trigger_time_us: 5_000,
        })
    }

    fn rows(first: u16, values: &[i16]) -> ScopeRows {
        ScopeRows { first, values: values.iter().flat_map(|it| it.to_le_bytes()).collect() }
    }

    #[test]
    fn rows_are_taken_in_order_and_have_units_and_times() {
        let mut capture = capture();
        assert!(!capture.take(&rows(1, &[1, 2])), "not the first");
        assert!(!capture.take(&rows(0, &[])), "nothing");
        assert!(!capture.take(&rows(0, &[1, 2, 3])), "no whole row");
        assert!(capture.take(&rows(0, &[-6_291, 6_144, 0, 6_144])));
        assert_eq!(capture.wanted(), Some(2));
        assert!(capture.take(&rows(2, &[6_291, 5_632, 7, 7])));
        assert_eq!((capture.wanted(), capture.rows()), (None, 3));
        assert_eq!(
            capture.column(1).collect::<Vec<_>>(),
            [(-1e-4, 12.0), (0.0, 12.0), (1e-4, 11.0)]
        );
        assert!((capture.row(0).next().unwrap() + 30.0).abs() < 0.003);
        assert_eq!([0, 1, 2].map(|row| capture.nanos(row)), [4_900_000, 5_000_000, 5_100_000]);
        let extent = capture.extent(1).unwrap();
        assert_eq!((extent.minimum, extent.maximum), (11.0, 12.0));
        assert!((extent.mean - 35.0 / 3.0).abs() < 1e-12);
    }
}
