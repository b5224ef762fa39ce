//! Writes a record.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path as FilePath, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use flix_protocol::message::{EventReport, Setpoint, Telemetry};
use flix_protocol::units::Instant;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions, Writer};
use serde::Serialize;

use super::message::{
    BASE_LINK, CommandRow, FramesRow, LogRow, MAP, NavigationRow, PathRow, PoseRow, TelemetryRow,
    Timestamp,
};
use super::{Channel, ENDING, FOLDER};
use crate::link::Update;
use crate::link::explain;
use crate::nav::{Path, PlanarPose, Progress};
use crate::pose::PoseSample;
use crate::system::text::shown;

/// Facts of a run that are known at its start.
#[derive(Debug, Clone, Default)]
pub struct RunDescription {
    /// Name of the run, for the file: `track-figure-eight`.
    pub name: String,
    /// Facts about the run: robot, task, program.
    pub run: BTreeMap<String, String>,
    /// All settings.
    pub settings: BTreeMap<String, String>,
    /// Versions of programs and firmware.
    pub versions: BTreeMap<String, String>,
}

/// Severity of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// Expected.
    Information,
    /// Unusual.
    Warning,
    /// The run ended early.
    Error,
}

/// Why a record could not be written.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file could not be written.
    #[error(
        "cannot write the record {}: {source}; check the folder and the space on its disk",
        shown(path)
    )]
    File {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The disk has less room than is to stay free.
    #[error(
        "the record {} ends: {} MB are free on its disk, and {} MB are to stay free; choose another --out, or less by --leave-free",
        shown(path), free / MEGABYTE, leaves / MEGABYTE
    )]
    LittleSpace {
        /// The file.
        path: PathBuf,
        /// Free on its disk, bytes.
        free: u64,
        /// To stay free, bytes.
        leaves: u64,
    },
    /// The MCAP writer failed.
    #[error("cannot write the record: {}", cause(.0))]
    Format(#[from] mcap::McapError),
    /// A row has no JSON form, because a value is not a number.
    #[error("cannot write the record: {0}")]
    Row(#[from] serde_json::Error),
}

/// Says what a disk said, without the way on which it was said.
fn cause(error: &mcap::McapError) -> String {
    match error {
        mcap::McapError::Io(error) => {
            format!("{error}; check the folder and the space on its disk")
        }
        error => error.to_string(),
    }
}

/// Bytes of a megabyte.
pub const MEGABYTE: u64 = 1_000_000;

const POSE: usize = 0;
const PATH: usize = 1;
const LOG: usize = 2;
const COMMAND: usize = 3;
const NAVIGATION: usize = 4;
const TELEMETRY: usize = 5;
const FRAMES: usize = 6;

const fn channel(
    topic: &'static str,
    schema: &'static str,
    text: &'static str,
    holds: bool,
) -> Channel {
    Channel { topic, schema, text, holds }
}

/// The kinds of rows of a record.
pub const CHANNELS: [Channel; 7] = [
    channel("/pose", "foxglove.PoseInFrame", include_str!("schemas/PoseInFrame.json"), false),
    channel("/path", "foxglove.PosesInFrame", include_str!("schemas/PosesInFrame.json"), true),
    channel("/log", "foxglove.Log", include_str!("schemas/Log.json"), false),
    channel("/command", "flix.Command", include_str!("schemas/Command.json"), false),
    channel("/navigation", "flix.Navigation", include_str!("schemas/Navigation.json"), false),
    channel("/telemetry", "flix.Telemetry", include_str!("schemas/Telemetry.json"), false),
    FRAMES_CHANNEL,
];

/// Poses of frames, for programs that show a robot by its URDF.
pub const FRAMES_CHANNEL: Channel =
    channel("/tf", "foxglove.FrameTransforms", include_str!("schemas/FrameTransforms.json"), false);

/// Who reads a record while it is written.
pub trait Reader {
    /// Takes a row as JSON: the index of its channel in [`CHANNELS`], its time since 1970, ns.
    fn row(&mut self, channel: usize, nanos: u64, row: &[u8]);
}

/// Writer of one record. Times are on the clock of the run, which starts at the moment given to
/// [`Recorder::create`]. When it is dropped without [`Recorder::finish`], the file is completed too.
pub struct Recorder {
    path: PathBuf,
    writer: Writer<BufWriter<File>>,
    channels: [u16; CHANNELS.len()],
    counts: [u32; CHANNELS.len()],
    start_nanos: u64,
    flushed: u64,
    reader: Option<Box<dyn Reader>>,
    /// To stay free on the disk, bytes.
    leaves: u64,
    /// Behind the writer, which completes the file when it is dropped.
    _lock: Lock,
}

/// Marks a file as one that is being written, until it is dropped; a program that is being started meanwhile, and has the file open
/// for a moment, does not keep the mark.
struct Lock(Option<File>);

impl Drop for Lock {
    fn drop(&mut self) {
        if let Some(file) = &self.0 {
            let _ = file.unlock();
        }
    }
}

/// Longest time of the run that is not yet on the disk, ns: what a program that is killed loses, and how
/// late a full disk is noticed.
const FLUSH_PERIOD: u64 = 1_000_000_000;

impl Recorder {
    /// Begins the record `OUT/runs/DATE-NAME.mcap`.
    ///
    /// # Errors
    /// When the file cannot be made.
    pub fn create(
        out: &FilePath,
        started: SystemTime,
        description: &RunDescription,
    ) -> Result<Self, RecordError> {
        let folder = out.join(FOLDER);
        std::fs::create_dir_all(&folder)
            .map_err(|source| RecordError::File { path: folder.clone(), source })?;
        let (path, file) = new_file(&folder, started, &description.name)?;
        let begun = Self::begin(path.clone(), file, started, description);
        if begun.is_err() {
            // Nobody could read it.
            let _ = std::fs::remove_file(path);
        }
        begun
    }

    fn begin(
        path: PathBuf,
        file: File,
        started: SystemTime,
        description: &RunDescription,
    ) -> Result<Self, RecordError> {
        let lock = Lock(file.try_clone().ok());
        let mut writer = WriteOptions::new()
            .compression(None)
            .library(crate::system::program::get())
            .create(BufWriter::new(file))?;
        let mut channels = [0; CHANNELS.len()];
        for (id, channel) in channels.iter_mut().zip(&CHANNELS) {
            let schema =
                writer.add_schema(channel.schema, "jsonschema", channel.text.as_bytes())?;
            *id = writer.add_channel(schema, channel.topic, "json", &BTreeMap::new())?;
        }
        let mut run = description.run.clone();
        run.insert("name".into(), description.name.clone());
        let started = in_calendar(started);
        run.insert("started".into(), humantime::format_rfc3339_millis(started).to_string());
        for (name, metadata) in [
            ("run", &run),
            ("settings", &description.settings),
            ("versions", &description.versions),
        ] {
            writer.write_metadata(&Metadata { name: name.into(), metadata: metadata.clone() })?;
        }
        let since_1970 = started.duration_since(UNIX_EPOCH).unwrap_or_default();
        let start_nanos = u64::try_from(since_1970.as_nanos()).unwrap_or(u64::MAX);
        Ok(Self {
            path,
            writer,
            channels,
            counts: [0; CHANNELS.len()],
            start_nanos,
            flushed: start_nanos,
            reader: None,
            leaves: 0,
            _lock: lock,
        })
    }

    /// Keeps this much of the disk free, bytes: a record without an end fills it, 5 GB a day. It is looked at now, and with each
    /// second of the run. Where the system does not state the free space, nothing is kept.
    ///
    /// # Errors
    /// When less is free already.
    pub fn leave_free(&mut self, bytes: u64) -> Result<(), RecordError> {
        self.leaves = bytes;
        self.check_space()
    }

    fn check_space(&self) -> Result<(), RecordError> {
        let (path, leaves) = (&self.path, self.leaves);
        match fs4::available_space(path) {
            Ok(free) if free < leaves => {
                Err(RecordError::LittleSpace { path: path.clone(), free, leaves })
            }
            _ => Ok(()),
        }
    }

    /// Gives every row from now on to a reader, too.
    pub fn show(&mut self, reader: impl Reader + 'static) {
        self.reader = Some(Box::new(reader));
    }

    /// Returns the path of the record.
    #[must_use]
    pub fn path(&self) -> &FilePath {
        &self.path
    }

    /// Records a pose.
    ///
    /// # Errors
    /// When it cannot be written, as for all rows.
    pub fn pose(&mut self, sample: &PoseSample) -> Result<(), RecordError> {
        if !sample.pose.is_finite() {
            return self.log(sample.time, Level::Warning, "a pose that is no number was not used");
        }
        let time = self.timestamp(sample.time);
        self.write(POSE, sample.time, &PoseRow::new(time, sample))?;
        if !sample.valid {
            return Ok(());
        }
        self.write(FRAMES, sample.time, &FramesRow::new(time, [(BASE_LINK, MAP, sample.pose)]))
    }

    /// Records the path to follow.
    ///
    /// # Errors
    /// As for [`Recorder::pose`].
    pub fn path_to_follow(&mut self, now: Instant, path: &Path) -> Result<(), RecordError> {
        let row = PathRow::new(self.timestamp(now), path);
        self.write(PATH, now, &row)
    }

    /// Records a message.
    ///
    /// # Errors
    /// As for [`Recorder::pose`].
    pub fn log(&mut self, now: Instant, level: Level, message: &str) -> Result<(), RecordError> {
        let level = match level {
            Level::Information => 2,
            Level::Warning => 3,
            Level::Error => 4,
        };
        let row = LogRow {
            timestamp: self.timestamp(now),
            level,
            message: message.to_owned(),
            name: "flix".to_owned(),
            file: String::new(),
            line: 0,
        };
        self.write(LOG, now, &row)
    }

    /// Records an event of the robot, which arrived `now`.
    ///
    /// # Errors
    /// As for [`Recorder::pose`].
    pub fn event(&mut self, now: Instant, report: &EventReport) -> Result<(), RecordError> {
        use flix_protocol::message::Event;
        let level = match report.event {
            Event::Fault(_) => Level::Error,
            Event::LinkLate
            | Event::CommandDeadline
            | Event::CommandsLate { .. }
            | Event::CommandAge
            | Event::StoppedFromOutside(_)
            | Event::LinkLost
            | Event::BatteryLow(_)
            | Event::Magnet { .. }
            | Event::FrequencyLimited(_) => Level::Warning,
            _ => Level::Information,
        };
        let seconds = report.time.as_micros() as f64 * 1e-6;
        let event = explain::event(&report.event);
        self.log(now, level, &format!("robot at {seconds:.3} s: {event}"))
    }

    /// Records what the robot reported; other updates of the link leave no row.
    ///
    /// # Errors
    /// As for [`Recorder::pose`].
    pub fn update(&mut self, now: Instant, update: &Update) -> Result<(), RecordError> {
        match update {
            Update::Telemetry(telemetry) => self.telemetry(now, telemetry),
            Update::Event(report) => self.event(now, report),
            _ => Ok(()),
        }
    }

    /// Records a command.
    ///
    /// # Errors
    /// As for [`Recorder::pose`].
    pub fn command(
        &mut self,
        now: Instant,
        setpoint: &Setpoint,
        mode: &str,
    ) -> Result<(), RecordError> {
        let row = CommandRow::new(self.timestamp(now), setpoint, mode);
        self.write(COMMAND, now, &row)
    }

    /// Records the estimate and the progress of navigation.
    ///
    /// # Errors
    /// As for [`Recorder::pose`].
    pub fn navigation(
        &mut self,
        now: Instant,
        pose: &PlanarPose,
        progress: &Progress,
    ) -> Result<(), RecordError> {
        let row = NavigationRow::new(self.timestamp(now), pose, progress);
        self.write(NAVIGATION, now, &row)
    }

    /// Records telemetry.
    ///
    /// # Errors
    /// As for [`Recorder::pose`].
    pub fn telemetry(&mut self, now: Instant, telemetry: &Telemetry) -> Result<(), RecordError> {
        let row = TelemetryRow::new(self.timestamp(now), telemetry);
        self.write(TELEMETRY, now, &row)
    }

    /// Attaches a file to the record.
    ///
    /// # Errors
    /// As for [`Recorder::pose`].
    pub fn attach(
        &mut self,
        now: Instant,
        name: &str,
        media_type: &str,
        content: &[u8],
    ) -> Result<(), RecordError> {
        let time = self.nanos(now);
        let attachment = Attachment {
            log_time: time,
            create_time: time,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: Cow::Borrowed(content),
        };
        self.writer.attach(&attachment).map_err(|error| failed(&self.path, error))
    }

    /// Records the results of the run, such as `path_error_rms_mm`.
    ///
    /// # Errors
    /// As for [`Recorder::pose`].
    pub fn results(&mut self, results: BTreeMap<String, String>) -> Result<(), RecordError> {
        self.writer
            .write_metadata(&Metadata { name: "results".into(), metadata: results })
            .map_err(|error| failed(&self.path, error))
    }

    /// Records the results of the run, completes the file and returns its path.
    ///
    /// # Errors
    /// As for [`Recorder::finish`].
    pub fn conclude(mut self, results: BTreeMap<String, String>) -> Result<PathBuf, RecordError> {
        self.results(results)?;
        self.finish()
    }

    /// Removes the file: the run did not take place.
    pub fn discard(self) {
        let path = self.path.clone();
        drop(self);
        // What cannot be removed is a record without rows.
        let _ = std::fs::remove_file(path);
    }

    /// Completes the file and returns its path.
    ///
    /// # Errors
    /// When the end cannot be written.
    pub fn finish(mut self) -> Result<PathBuf, RecordError> {
        self.writer.finish().map_err(|error| failed(&self.path, error))?;
        Ok(self.path.clone())
    }

    fn nanos(&self, now: Instant) -> u64 {
        self.start_nanos.saturating_add(now.as_micros().saturating_mul(1000))
    }

    fn timestamp(&self, now: Instant) -> Timestamp {
        Timestamp::from_nanos(self.nanos(now))
    }

    fn write(
        &mut self,
        channel: usize,
        now: Instant,
        row: &impl Serialize,
    ) -> Result<(), RecordError> {
        let time = self.nanos(now);
        let header = MessageHeader {
            channel_id: self.channels[channel],
            sequence: self.counts[channel],
            log_time: time,
            publish_time: time,
        };
        self.counts[channel] = self.counts[channel].wrapping_add(1);
        let row = serde_json::to_vec(row)?;
        if let Some(reader) = &mut self.reader {
            reader.row(channel, time, &row);
        }
        let mut written = self.writer.write_to_known_channel(&header, &row);
        if written.is_ok() && time.saturating_sub(self.flushed) >= FLUSH_PERIOD {
            self.flushed = time;
            written = self.writer.flush();
            self.check_space()?;
        }
        written.map_err(|error| failed(&self.path, error))
    }
}

/// Names the file and the system's error where there is one: the format does not.
pub(super) fn failed(path: &FilePath, error: mcap::McapError) -> RecordError {
    match error {
        mcap::McapError::Io(source) => RecordError::File { path: path.to_owned(), source },
        error => RecordError::Format(error),
    }
}

/// Last second of the year 9999, s since 1970: dates have four digits for the year.
const LAST_SECOND: u64 = 253_402_300_799;

/// Returns a time that has a date: of a computer whose clock is not set, and says less than 1970 or more than 9999, the
/// nearest.
#[must_use]
pub fn in_calendar(time: SystemTime) -> SystemTime {
    time.clamp(UNIX_EPOCH, UNIX_EPOCH + Duration::from_secs(LAST_SECOND))
}

/// Returns a name for files: date and time, and what they are of.
#[must_use]
pub fn dated(started: SystemTime, name: &str) -> String {
    let date: String = humantime::format_rfc3339_seconds(in_calendar(started))
        .to_string()
        .chars()
        .filter_map(|c| match c {
            '-' | ':' | 'Z' => None,
            'T' => Some('-'),
            c => Some(c),
        })
        .collect();
    let name: String =
        name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
    format!("{date}-{name}")
}

/// Creates a new file: two runs of one second get two files.
fn new_file(
    folder: &FilePath,
    started: SystemTime,
    name: &str,
) -> Result<(PathBuf, File), RecordError> {
    let name = dated(started, name);
    let mut attempt = 1;
    loop {
        let suffix = if attempt == 1 { String::new() } else { format!("-{attempt}") };
        let path = folder.join(format!("{name}{suffix}.{ENDING}"));
        match File::create_new(&path) {
            Ok(file) => {
                // Marks it as one that is being written; a file system without locks cannot.
                let _ = file.try_lock();
                return Ok((path, file));
            }
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists && attempt < 1000 => {
                attempt += 1
            }
            Err(source) => return Err(RecordError::File { path, source }),
        }
    }
}
