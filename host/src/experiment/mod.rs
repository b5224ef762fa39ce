//! Experiments that a robot is identified from, as files of rows: what `flix experiment` records and `flix-sim study
//! sysid` reads. `sim-hil/docs/sysid.md` has the format of each.
//!
//! | experiment | what happens |
//! |---|---|
//! | [`air`] | the robot hangs on cords and is shaken; motion capture sees how it swings |
//! | [`drops`] | somebody drops the robot onto its feet; motion capture sees how it sinks and springs back |
//! | [`grid`] | the robot walks every pair of a grid, over as many runs as it takes |
//! | [`walks`] | the robot walks; its mean motion counts, as in [`crate::nav::Identification`] |
//!
//! What decides takes poses, telemetry and time as arguments. [`Sheet`] alone touches a file.

pub mod air;
pub mod drops;
pub mod grid;
mod sheet;
pub mod walks;

pub use sheet::{Column, Sheet, SheetError};

use flix_protocol::units::Instant;

/// Returns a time in seconds. Exact to a microsecond for a thousand years.
fn seconds(time: Instant) -> f64 {
    time.as_micros() as f64 * 1e-6
}
