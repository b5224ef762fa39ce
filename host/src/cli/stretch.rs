//! Stretches of an identification: what the commands that walk a robot in them share.

use std::time::Duration;

use flix_protocol::message::Setpoint;

use super::time::duration;
use crate::nav::{Area, IdentificationSettings};

/// Without trusted poses a measurement ends after this time.
pub(super) const POSE_PATIENCE: Duration = Duration::from_secs(5);

/// Parses the duration of a stretch, 2 to 120 s.
pub(super) fn stretch(text: &str) -> Result<Duration, String> {
    let time = duration(text)?;
    if (Duration::from_secs(2)..=Duration::from_secs(120)).contains(&time) {
        Ok(time)
    } else {
        Err(format!("a stretch of {} s is outside 2 to 120 s", time.as_secs_f64()))
    }
}

/// Returns the settings of an identification of these pairs, as every command has them.
pub(super) fn settings(
    pairs: Vec<(String, Setpoint)>,
    stretch: Duration,
    rounds: u32,
    fence: Area,
) -> IdentificationSettings {
    IdentificationSettings {
        pairs,
        stretch,
        rounds,
        fence,
        pose_deadline: Duration::from_millis(100),
        pose_patience: POSE_PATIENCE,
        least_battery: None,
        known: None,
    }
}
