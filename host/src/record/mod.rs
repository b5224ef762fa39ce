//! Records of runs: one MCAP file each, for Foxglove and every other MCAP reader.
//!
//! Messages are JSON with JSON schemas. Where Foxglove has a well-known schema the record uses it:
//!
//! | topic | schema | what |
//! |---|---|---|
//! | `/pose` | `foxglove.PoseInFrame` | poses as they arrived, ENU |
//! | `/tf` | `foxglove.FrameTransforms` | the same for programs that show the robot by its URDF |
//! | `/path` | `foxglove.PosesInFrame` | the path to follow |
//! | `/log` | `foxglove.Log` | events |
//! | `/command` | `flix.Command` | f, theta and the mode's name |
//! | `/navigation` | `flix.Navigation` | filtered pose, path error |
//! | `/telemetry` | `flix.Telemetry` | telemetry of the robot |
//!
//! The file also carries the metadata `run`, `settings` and `versions`, and attachments such as the
//! mode table. [`Recorder`] writes a record, [`Run`] reads it, [`csv`] and [`ros2`] export it; `flix-plot`
//! draws it.

pub mod csv;
mod message;
mod parts;
mod reader;
mod repair;
pub mod ros2;
mod writer;

pub use message::{
    BASE_LINK, CommandRow, FrameRow, FramesRow, LogRow, MAP, MotorRow, NavigationRow, PathRow,
    PoseRow, TelemetryRow, Timestamp,
};
pub use reader::{Damage, Listing, ReadError, Run, RunSummary, list};
pub use repair::{RepairError, Repaired, is_being_written, repair};
pub use writer::{
    CHANNELS, FRAMES_CHANNEL, Level, MEGABYTE, Reader, RecordError, Recorder, RunDescription,
    dated, in_calendar,
};

/// A kind of row.
#[derive(Debug, Clone, Copy)]
pub struct Channel {
    /// Where its rows appear.
    pub topic: &'static str,
    /// Name of its schema.
    pub schema: &'static str,
    /// Its JSON schema.
    pub text: &'static str,
    /// Does a row hold until the next, so that who comes later wants it, too?
    pub holds: bool,
}

/// Folder of the records inside the output folder.
pub const FOLDER: &str = "runs";
/// File extension of a record.
pub const ENDING: &str = "mcap";
