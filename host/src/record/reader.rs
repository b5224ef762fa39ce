//! Reads a record.

use std::collections::BTreeMap;
use std::path::{Path as FilePath, PathBuf};

use mcap::read::Options;
use serde::Deserialize;

use super::message::{
    CommandRow, LogRow, NavigationRow, PathRow, PoseRow, TelemetryRow, Timestamp,
};
use super::{ENDING, FOLDER};
use crate::file;

/// Largest record that is read, bytes: several days of driving.
const LARGEST_RECORD: u64 = 1 << 30;

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
    /// Several runs have this in their names.
    #[error(
        "\"{name}\" is in the names of {count} runs, {first} and {second} among them: write more of the name"
    )]
    Ambiguous {
        /// The requested name.
        name: String,
        /// How many there are.
        count: usize,
        /// The oldest of them.
        first: String,
        /// The next of them.
        second: String,
    },
    /// There is no run.
    #[error("there is no run in {} yet", .0.display())]
    NoRuns(PathBuf),
}

/// The runs below an output folder.
#[derive(Debug, Default)]
pub struct Listing {
    /// All runs, the oldest first.
    pub runs: Vec<RunSummary>,
    /// Why entries that are named as runs were left out: folders, pipes, files that cannot be read.
    pub skipped: Vec<ReadError>,
}

/// Returns the runs below an output folder.
///
/// # Errors
/// When the folder cannot be read; a missing one holds no runs.
pub fn list(out: &FilePath) -> Result<Listing, ReadError> {
    let folder = out.join(FOLDER);
    let failed = |source| ReadError::File { path: folder.clone(), source };
    let entries = match std::fs::read_dir(&folder) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Listing::default()),
        Err(e) => return Err(failed(e)),
    };
    let mut found = Listing::default();
    for entry in entries {
        let path = entry.map_err(failed)?.path();
        if path.extension().is_some_and(|e| e == ENDING) {
            match file::open(&path).and_then(|file| file.metadata()) {
                Ok(metadata) => {
                    found.runs.push(RunSummary { file: path, bytes: metadata.len() });
                }
                Err(source) => found.skipped.push(ReadError::File { path, source }),
            }
        }
    }
    // Without the extension: the second of one moment follows the first.
    found.runs.sort_by(|a, b| a.file.file_stem().cmp(&b.file.file_stem()));
    Ok(found)
}

/// Reads the bytes of a record.
pub(super) fn read_bytes(path: &FilePath) -> Result<Vec<u8>, ReadError> {
    file::read(path, LARGEST_RECORD)
        .map_err(|source| ReadError::File { path: path.to_owned(), source })
}

impl Run {
    /// Finds a run by `last`, by a part of its name, or by its path, and reads it.
    ///
    /// # Errors
    /// When there is none, or it cannot be read.
    pub fn find(out: &FilePath, name: &str) -> Result<Self, ReadError> {
        let direct = FilePath::new(name);
        if direct.exists() {
            return Self::read(direct);
        }
        let runs = list(out)?.runs;
        if name == "last" {
            let last = runs.last().ok_or_else(|| ReadError::NoRuns(out.join(FOLDER)))?;
            return Self::read(&last.file);
        }
        let stem = |run: &RunSummary| {
            run.file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
        };
        let found: Vec<_> =
            runs.iter().filter(|run| !name.is_empty() && stem(run).contains(name)).collect();
        let exact = found.iter().find(|run| stem(run) == name);
        match (exact, found.as_slice()) {
            (Some(run), _) | (None, [run]) => Self::read(&run.file),
            (None, []) => {
                Err(ReadError::NoSuchRun { name: name.to_owned(), folder: out.join(FOLDER) })
            }
            (None, [first, second, ..]) => Err(ReadError::Ambiguous {
                name: name.to_owned(),
                count: found.len(),
                first: stem(first),
                second: stem(second),
            }),
        }
    }

    /// Reads a record, also one without its end because the program was killed.
    ///
    /// # Errors
    /// When the file cannot be read or is not a record.
    pub fn read(file: &FilePath) -> Result<Self, ReadError> {
        let bytes = read_bytes(file)?;
        let mut run = Self { file: file.to_owned(), ..Self::default() };
        run.fill(&bytes).map_err(|reason| ReadError::Format { path: file.to_owned(), reason })?;
        Ok(run)
    }

    /// Reads the facts of a record and the names of its attachments, without its rows.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn read_head(file: &FilePath) -> Result<Self, ReadError> {
        let bytes = read_bytes(file)?;
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
        let mut trouble = None;
        for message in stream {
            let message = match message {
                Ok(message) => message,
                // The file was cut off here; the rows before are valid.
                Err(e) => {
                    trouble = Some(e.to_string());
                    break;
                }
            };
            self.first = Some(self.first.map_or(message.log_time, |t| t.min(message.log_time)));
            self.last = self.last.max(message.log_time);
            self.keep(&message.channel.topic, &message.data)?;
        }
        self.read_facts(bytes);
        // Cut off within its first rows it still says what the run was; damaged with its end in place it is not to be trusted.
        match trouble {
            Some(reason) if self.first.is_none() && (self.is_complete || self.facts.is_empty()) => {
                Err(reason)
            }
            None if self.first.is_none() && self.facts.is_empty() => Err("it is empty".to_owned()),
            _ => Ok(()),
        }
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
