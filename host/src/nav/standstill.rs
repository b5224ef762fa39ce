//! Watches whether the robot moves while it is commanded to walk.
//!
//! A robot whose poses stand still although it walks is blocked, or the poses are those of another
//! robot: both end a run.

use std::time::Duration;

use flix_protocol::units::Instant;

use crate::pose::geometry::{PlanarPose, wrap};

/// A robot that came this far has moved, m: well above the noise of motion capture, and a third of a
/// second's way in the paper's slowest mode.
const MOVED: f64 = 0.01;
/// A robot that turned this far has moved, rad (3 degrees).
const TURNED: f64 = 0.052;

/// Watch over the poses of one run.
#[derive(Debug, Clone, Default)]
pub(crate) struct Standstill {
    anchor: Option<PlanarPose>,
    walked: Duration,
    at: Option<Instant>,
}

impl Standstill {
    /// Takes the newest pose, and whether the robot is commanded to walk. Returns for how long it was
    /// commanded to walk since it last moved.
    pub(crate) fn watch(&mut self, now: Instant, walks: bool, pose: &PlanarPose) -> Duration {
        let passed = self.at.replace(now).map_or(Duration::ZERO, |before| now.since(before));
        let has_moved = self.anchor.is_none_or(|anchor| {
            anchor.distance_to(pose.position()) >= MOVED
                || wrap(anchor.heading - pose.heading).abs() >= TURNED
        });
        if has_moved {
            self.anchor = Some(*pose);
            self.walked = Duration::ZERO;
        } else if walks {
            self.walked += passed;
        }
        self.walked
    }
}
