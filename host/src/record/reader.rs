//! Reads a record.

use std::collections::BTreeMap;
use std::path::{Path as FilePath, PathBuf};

use mcap::read::Options;
use serde::Deserialize;

use super::message::{
    CommandRow, LogRow, NavigationRow, PathRow, PoseRow, TelemetryRow, Timestamp,
};
use super::{ENDING, FOLDER};

/// A whole run.
#[derive(Debug, Clone, Default)]
pub struct Run {
    /// File of the record.
    pub file: PathBuf,
    /// Facts, settings, versions and results by the name of their group.
    pub facts: BTreeMap<String, BTreeMap<String, String>>,
    /// Names and sizes (bytes) of files in the record.
    pub attachments: Vec<(String, usize)>,
    /// Poses as they arrived.
    pub poses: Vec<PoseRow>,
    /// The last path.
    pub path: Option<PathRow>,
    /// Commands.
    pub commands: Vec<CommandRow>,
    /// Estimates of navigation.
    pub navigation: Vec<NavigationRow>,
    /// Telemetry.
    pub telemetry: Vec<TelemetryRow>,
    /// Events.
    pub events: Vec<LogRow>,
    /// Whether the record has its end; without it, the program was killed.
    pub is_complete: bool,
    /// Rows of topics that this version does not know.
    pub unknown: usize,
    first: Option<u64>,
    last: u64,
}

/// File and size of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct RunSummary {
    /// Its file.
    pub file: PathBuf,
    /// Size, bytes.
    pub bytes: u64,
}

/// Why a record could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file could not be read.
    #[error("cannot read {}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// Not a record, or damaged.
    #[error("{} is not a record of a run: {reason}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// The error of the format.
        reason: String,
    },
    /// There is no such run.
    #[error("there is no run \"{name}\" in {}; `flix runs list` shows all", folder.display())]
    NoSuchRun {
        /// The requested name.
        name: String,
        /// The folder of the runs.
        folder: PathBuf,
    },
    /// There is no run.
    #[error("there is no run in {} yet", .0.display())]
    NoRuns(PathBuf),
}

/// Returns all runs below an output folder, the oldest first.
///
/// # Errors
/// When the folder cannot be read; a missing one holds no runs.
pub fn list(out: &FilePath) -> Result<Vec<RunSummary>, ReadError> {
    let folder = out.join(FOLDER);
    let failed = |source| ReadError::File { path: folder.clone(), source };
    let entries = match std::fs::read_dir(&folder) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(e) => return Err(failed(e)),
    };
    let mut runs = Vec::new();
    for entry in entries {
        let entry = entry.map_err(failed)?;
        let file = entry.path();
        if file.extension().is_some_and(|e| e == ENDING) {
            let bytes = entry.metadata().map_err(failed)?.len();
            runs.push(RunSummary { file, bytes });
        }
    }
    runs.sort_by(|a, b| a.file.cmp(&b.file));
    Ok(runs)
}

impl Run {
    /// Finds a run by `last`, by a part of its name, or by its path, and reads it.
    ///
    /// # Errors
    /// When there is none, or it cannot be read.
    pub fn find(out: &FilePath, name: &str) -> Result<Self, ReadError> {
        let direct = FilePath::new(name);
        if direct.is_file() {
            return Self::read(direct);
        }
        if direct.is_dir() {
            let source = std::io::ErrorKind::IsADirectory.into();
            return Err(ReadError::File { path: direct.to_owned(), source });
        }
        let runs = list(out)?;
        if name == "last" {
            let last = runs.last().ok_or_else(|| ReadError::NoRuns(out.join(FOLDER)))?;
            return Self::read(&last.file);
        }
        let matches = |run: &&RunSummary| {
            run.file.file_stem().is_some_and(|stem| stem.to_string_lossy().contains(name))
        };
        let found = runs.iter().rev().find(matches).ok_or_else(|| ReadError::NoSuchRun {
            name: name.to_owned(),
            folder: out.join(FOLDER),
        })?;
        Self::read(&found.file)
    }

    /// Reads a record, also one without its end because the program was killed.
    ///
    /// # Errors
    /// When the file cannot be read or is not a record.
    pub fn read(file: &FilePath) -> Result<Self, ReadError> {
        let bytes = std::fs::read(file)
            .map_err(|source| ReadError::File { path: file.to_owned(), source })?;
        let mut run = Self { file: file.to_owned(), ..Self::default() };
        run.fill(&bytes).map_err(|reason| ReadError::Format { path: file.to_owned(), reason })?;
        Ok(run)
    }

    /// Reads the facts of a record and the names of its attachments, without its rows.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn read_head(file: &FilePath) -> Result<Self, ReadError> {
        let bytes = std::fs::read(file)
            .map_err(|source| ReadError::File { path: file.to_owned(), source })?;
        let mut run = Self { file: file.to_owned(), ..Self::default() };
        run.read_facts(&bytes);
        Ok(run)
    }

    /// Returns the fact of this name in a group, or an empty text.
    #[must_use]
    pub fn fact(&self, group: &str, name: &str) -> &str {
        self.facts.get(group).and_then(|g| g.get(name)).map_or("", String::as_str)
    }

    /// Returns the time from the first to the last row, s.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.last.saturating_sub(self.first.unwrap_or(self.last)) as f64 * 1e-9
    }

    /// Returns the seconds from the first row to this time.
    #[must_use]
    pub fn time(&self, timestamp: &Timestamp) -> f64 {
        timestamp.seconds_since(&Timestamp::from_nanos(self.first.unwrap_or(0)))
    }

    fn fill(&mut self, bytes: &[u8]) -> Result<(), String> {
        let tolerant = Options::IgnoreEndMagic.into();
        let stream =
            mcap::MessageStream::new_with_options(bytes, tolerant).map_err(|e| e.to_string())?;
        for message in stream {
            let message = match message {
                Ok(message) => message,
                // The file was cut off here; the rows before are valid.
                Err(_) if self.first.is_some() => break,
                Err(e) => return Err(e.to_string()),
            };
            self.first = Some(self.first.map_or(message.log_time, |t| t.min(message.log_time)));
            self.last = self.last.max(message.log_time);
            self.keep(&message.channel.topic, &message.data)?;
        }
        self.read_facts(bytes);
        if self.first.is_none() && self.facts.is_empty() {
            return Err("it is empty".to_owned());
        }
        Ok(())
    }

    fn keep(&mut self, topic: &str, data: &[u8]) -> Result<(), String> {
        match topic {
            "/pose" => self.poses.push(row(topic, data)?),
            "/path" => self.path = Some(row(topic, data)?),
            "/log" => self.events.push(row(topic, data)?),
            "/command" => self.commands.push(row(topic, data)?),
            "/navigation" => self.navigation.push(row(topic, data)?),
            "/telemetry" => self.telemetry.push(row(topic, data)?),
            _ => self.unknown += 1,
        }
        Ok(())
    }

    fn read_facts(&mut self, bytes: &[u8]) {
        self.is_complete = is_complete(bytes);
        let Ok(records) =
            mcap::read::LinearReader::new_with_options(bytes, Options::IgnoreEndMagic.into())
        else {
            return;
        };
        for record in records.map_while(Result::ok) {
            match record {
                mcap::records::Record::Metadata(metadata) => {
                    self.facts.insert(metadata.name, metadata.metadata);
                }
                mcap::records::Record::Attachment { header, data, .. } => {
                    self.attachments.push((header.name, data.len()));
                }
                _ => {}
            }
        }
    }
}

/// Returns whether a record has its summary and its end.
pub(super) fn is_complete(bytes: &[u8]) -> bool {
    matches!(mcap::Summary::read(bytes), Ok(Some(_)))
}

fn row<'a, T: Deserialize<'a>>(topic: &str, data: &'a [u8]) -> Result<T, String> {
    serde_json::from_slice(data).map_err(|e| format!("a row of {topic} is damaged: {e}"))
}
