//! Why a run must end early.

use std::fmt;
use std::time::Duration;

use crate::pose::LATE;
use crate::pose::geometry::{Area, Position};
use crate::pose::rate::{FEWEST, PLENTY};

/// Why a run ended early. The robot is at rest then.
#[derive(Debug, Clone, PartialEq)]
pub enum EndReason {
    /// No trusted pose arrived for as long as the run waits.
    PoseLost {
        /// Time since the last one.
        waited: Duration,
    },
    /// Poses come, too late to be trusted, for as long as the run waits.
    PosesLate {
        /// By how much later than the fastest one.
        late: Duration,
    },
    /// Fewer poses come than the robot can walk by.
    TooFewPoses {
        /// Poses a second.
        rate: f64,
    },
    /// The poses stand still although the robot is commanded to walk.
    NotMoving {
        /// Time of walking without motion.
        walked: Duration,
    },
    /// The poses move otherwise than the robot is commanded.
    NotAnswering {
        /// Time for which they did.
        walked: Duration,
    },
    /// The poses jumped to where the robot cannot be.
    Jumped {
        /// How far, m.
        distance: f64,
        /// By which angle, degrees.
        turn: f64,
    },
    /// The robot walks, and does not get on along its path.
    NoProgress {
        /// Time for which it did not.
        held: Duration,
        /// Where it is.
        at: Position,
    },
    /// The robot is outside the fence.
    OutsideFence {
        /// Where the robot is.
        at: Position,
        /// The fence.
        fence: Area,
    },
    /// The robot is on its side or back.
    Tilted {
        /// How far its body is from upright, degrees.
        degrees: f64,
    },
    /// Somebody carries the robot.
    Lifted {
        /// How far it is above where it began, m.
        rise: f64,
    },
    /// The run begins away from its path, and may not approach it.
    NotOnPath {
        /// Distance from the path, m.
        error: f64,
        /// Largest allowed distance, m.
        limit: f64,
    },
    /// The robot is too far from the path.
    OffPath {
        /// Distance from the path, m.
        error: f64,
        /// Largest allowed distance, m.
        limit: f64,
    },
    /// The battery is empty.
    Battery {
        /// Its voltage at rest, V.
        volts: f32,
        /// Lowest allowed voltage, V.
        least: f32,
    },
    /// The controller, a program of its own, failed: in this sentence.
    Controller(String),
    /// The experiment cannot be made so: in this sentence.
    Experiment(String),
}

impl EndReason {
    /// Returns why poses are missing where the newest came by so much later than the fastest one.
    #[must_use]
    pub(crate) fn of_poses_that_come(self, late: Duration) -> Self {
        match self {
            Self::PoseLost { .. } if late > LATE => Self::PosesLate { late },
            other => other,
        }
    }
}

impl fmt::Display for EndReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PoseLost { waited } => write!(
                f,
                "no trusted pose for {:.1} s: is the robot in view of the cameras? run `flix doctor`",
                waited.as_secs_f64()
            ),
            Self::TooFewPoses { rate } => write!(
                f,
                "{rate:.1} poses a second come, and {FEWEST:.0} are the fewest to walk by: let the tracker send {PLENTY:.0} or more"
            ),
            Self::PosesLate { late } => write!(
                f,
                "poses come {:.1} s late: is the network of the cameras or the computer that sends them busy? give them a \
                 network of their own, by cable; or was the tracker's clock set, or does it run slow?",
                late.as_secs_f64()
            ),
            Self::NotMoving { walked } => write!(
                f,
                "the pose did not move while the robot walked for {:.1} s: is it blocked, or are these \
                 the poses of another robot (--natnet-server, --body)?",
                walked.as_secs_f64()
            ),
            Self::NotAnswering { walked } => write!(
                f,
                "the poses moved otherwise than the robot was commanded for {:.0} s: are they those of another body (--body), \
                 a recording, or in mirrored axes (--up)? or does an obstacle hold the robot?",
                walked.as_secs_f64()
            ),
            Self::NoProgress { held, at } => write!(
                f,
                "the robot walked for {:.0} s at {:.2},{:.2} m and did not get on along its path: look for an obstacle, \
                 identify its modes again with `flix identify`, or draw the path with wider bends",
                held.as_secs_f64(),
                at.x,
                at.y
            ),
            Self::Jumped { distance, turn } => write!(
                f,
                "the pose jumped by {distance:.2} m and {turn:.0} degrees, farther than the robot can have walked: did the \
                 tracker swap it with another body, lose it or flip it, or did somebody carry it? look where it is \
                 before you go on"
            ),
            Self::OutsideFence { at, fence } => write!(
                f,
                "the robot is outside the fence ({fence}) at {:.2},{:.2} m: carry it back, let it walk \
                 to the path with --approach, or give --fence",
                at.x, at.y
            ),
            Self::Tilted { degrees } => write!(
                f,
                "the robot is tilted by {degrees:.0} degrees: wait until the rotors stand, then put it on its feet"
            ),
            Self::Lifted { rise } => write!(
                f,
                "the robot was lifted by {:.0} mm: wait until the rotors stand, then put it on the floor",
                rise * 1e3
            ),
            Self::NotOnPath { error, limit } => write!(
                f,
                "the robot is {:.0} mm from its path, more than the {:.0} mm allowed at the start: put it there, or let \
                 it walk there without --no-approach",
                error * 1e3,
                limit * 1e3
            ),
            Self::OffPath { error, limit } => write!(
                f,
                "the robot is {:.0} mm off its path, more than the {:.0} mm allowed: look for an \
                 obstacle, identify its modes again with `flix identify`, or raise --error-limit",
                error * 1e3,
                limit * 1e3
            ),
            Self::Battery { volts, least } => write!(
                f,
                "the battery is at {volts:.1} V, below {least} V: charge it, then run the same command again"
            ),
            Self::Controller(sentence) | Self::Experiment(sentence) => f.write_str(sentence),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_that_come_late_are_reported_with_their_delay() {
        let lost = EndReason::PoseLost { waited: Duration::from_secs(5) };
        let late = lost.clone().of_poses_that_come(Duration::from_millis(1998)).to_string();
        assert!(late.starts_with("poses come 2.0 s late"), "{late}");
        assert_eq!(lost.clone().of_poses_that_come(LATE), lost);
        let blocked = EndReason::NotMoving { walked: Duration::from_secs(3) };
        assert_eq!(blocked.clone().of_poses_that_come(LATE * 2), blocked);
    }
}
