//! Why the robot last started.

use core::fmt::{self, Write};

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{NAME_LENGTH, Name};

/// Why the robot last started.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, Schema)]
pub enum ResetReason {
    /// Power came.
    #[default]
    PowerOn,
    /// The supply sagged.
    BrownOut,
    /// The robot's program asked for it, after provisioning.
    Requested,
    /// The fast loop stood still: its watchdog restarted the robot.
    FastLoop,
    /// The tasks stood still: their watchdog restarted the robot.
    Tasks,
    /// The robot's program panicked at this place: end of the file's name, and line.
    Panic(Name),
    /// Something else, for example the reset button.
    Other,
}

impl ResetReason {
    /// Names the place of a panic: as much of the end of the file's name as there is room for, and the line.
    #[must_use]
    pub fn panic(file: &str, line: u32) -> Self {
        let mut end = heapless::String::<11>::new();
        // The longest number of a line has ten digits.
        let _ = write!(end, ":{line}");
        let room = NAME_LENGTH - end.len();
        let from = (file.len().saturating_sub(room)..=file.len())
            .find(|index| file.is_char_boundary(*index))
            .unwrap_or(file.len());
        let mut place = Name::new();
        // Both fit.
        let _ = place.push_str(&file[from..]);
        let _ = place.push_str(&end);
        Self::Panic(place)
    }

    /// Returns whether the robot should not have started: something went wrong before.
    #[must_use]
    pub const fn is_accident(&self) -> bool {
        matches!(self, Self::BrownOut | Self::FastLoop | Self::Tasks | Self::Panic(_))
    }
}

impl fmt::Display for ResetReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::PowerOn => "power-on",
            Self::BrownOut => "a brown-out",
            Self::Requested => "its own request",
            Self::FastLoop => "a fast loop that hung",
            Self::Tasks => "tasks that hung",
            Self::Panic(place) => return write!(f, "a panic at {place}"),
            Self::Other => "another reset",
        })
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::string::ToString;

    use super::*;

    #[test]
    fn a_panics_place_is_the_files_end_and_the_line() {
        let place = |file: &str, line| ResetReason::panic(file, line).to_string();
        assert_eq!(place("src/link.rs", 12), "a panic at src/link.rs:12");
        assert_eq!(place("", u32::MAX), "a panic at :4294967295");
        let file = "/registry/src/embassy-net-0.9.1/src/lib.rs";
        assert_eq!(place(file, 7), "a panic at c/embassy-net-0.9.1/src/lib.rs:7");
        // A letter of several bytes is not cut in two.
        let rest = "a".repeat(29);
        assert_eq!(place(&std::format!("ä{rest}"), 1), std::format!("a panic at {rest}:1"));
    }
}
