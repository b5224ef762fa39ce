//! Reads a record.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path as FilePath, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

use serde::Deserialize;

use super::message::{
    CommandRow, LogRow, NavigationRow, PathRow, PoseRow, TelemetryRow, Timestamp,
};
use super::parts::{Directory, Part, Parts};
use super::{ENDING, FOLDER};
use crate::system::file;

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
    /// What of the file could not be trusted and was left out.
    pub damage: Damage,
    first: Option<u64>,
    last: u64,
}

/// What of a record could not be trusted and was left out. Its text is a sentence about that, empty for none.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Damage {
    /// Parts of the file whose check sum or form is wrong.
    pub parts: usize,
    /// Rows in them, as far as they can be counted.
    pub rows: u64,
    /// Whether the check sum over the whole file is wrong although no part is: facts have none of their own.
    pub is_changed: bool,
}

impl Damage {
    /// Returns whether anything was left out.
    #[must_use]
    pub const fn is_loss(&self) -> bool {
        self.parts > 0 || self.rows > 0
    }

    /// Returns whether anything was left out or may be wrong.
    #[must_use]
    pub const fn is_none(&self) -> bool {
        !self.is_loss() && !self.is_changed
    }
}

impl fmt::Display for Damage {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_loss() {
            let count = |count: u64, what: &str| match count {
                1 => format!("1 {what}"),
                count => format!("{count} {what}s"),
            };
            let (rows, parts) = (count(self.rows, "row"), count(self.parts as u64, "part"));
            write!(formatter, "damaged: {rows} left out, {parts} of the file cannot be trusted")
        } else if self.is_changed {
            formatter.write_str("changed since it was written: a setting or a result may be wrong")
        } else {
            Ok(())
        }
    }
}

/// File and size of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct RunSummary {
    /// Its file.
    pub file: PathBuf,
    /// Size, bytes.
    pub bytes: u64,
    /// Time of its first row since 1970, or when the file was written where it has none.
    pub started: Duration,
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
            match summary(&path) {
                Ok((bytes, started)) => found.runs.push(RunSummary { file: path, bytes, started }),
                Err(source) => found.skipped.push(ReadError::File { path, source }),
            }
        }
    }
    // Without the extension: the second of one moment follows the first.
    found.runs.sort_by_key(|run| (run.started, run.file.file_stem().map(ToOwned::to_owned)));
    Ok(found)
}

/// Returns the size of a record, and when its run started.
fn summary(path: &FilePath) -> std::io::Result<(u64, Duration)> {
    let metadata = file::open(path)?.metadata()?;
    let mut parts = Parts::open(path)?;
    let mut first = None;
    while first.is_none() {
        match parts.next(true)? {
            Some(Part::Rows(rows) | Part::Rest(rows)) => {
                Directory::default().read(&rows, |_, header, _| {
                    first.get_or_insert(header.log_time);
                });
            }
            Some(_) => {}
            None => break,
        }
    }
    let written = || metadata.modified().ok()?.duration_since(UNIX_EPOCH).ok();
    let started = first.map(Duration::from_nanos).or_else(written);
    Ok((metadata.len(), started.unwrap_or_default()))
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

    /// Reads a record, also one without its end because the program was killed. Of one that is damaged it reads the parts
    /// that are whole, and [`damage`](Self::damage) says what was left out.
    ///
    /// # Errors
    /// When the file cannot be read or is not a record.
    pub fn read(file: &FilePath) -> Result<Self, ReadError> {
        let mut run = Self { file: file.to_owned(), ..Self::default() };
        run.fill(true)?;
        Ok(run)
    }

    /// Reads the facts of a record and the names of its attachments, without its rows.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn read_head(file: &FilePath) -> Result<Self, ReadError> {
        let mut run = Self { file: file.to_owned(), ..Self::default() };
        run.fill(false)?;
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

    fn fill(&mut self, with_rows: bool) -> Result<(), ReadError> {
        let failed = |path: &FilePath| {
            let path = path.to_owned();
            |source| ReadError::File { path, source }
        };
        let path = self.file.clone();
        let mut parts = Parts::open(&path).map_err(failed(&path))?;
        let mut directory = Directory::default();
        directory.read(parts.summary(), |_, _, _| ());
        self.is_complete = parts.is_complete();
        let mut read = 0;
        while let Some(part) = parts.next(with_rows).map_err(failed(&path))? {
            let (rows, is_rest) = match part {
                Part::Facts(facts) => {
                    self.facts.insert(facts.name, facts.metadata);
                    continue;
                }
                Part::Attachment(header, data) => {
                    self.attachments.push((header.name, data.len()));
                    continue;
                }
                Part::Damaged(part) => {
                    self.damage.parts += 1;
                    self.damage.rows += directory.read_damaged(&part);
                    continue;
                }
                Part::Rows(rows) => (rows, false),
                Part::Rest(rows) => (rows, true),
            };
            directory.read(&rows, |directory, header, data| {
                let topic = directory.channels.get(&header.channel_id).map(|it| it.topic.as_str());
                if topic.is_some_and(|topic| self.keep(topic, data).is_some()) {
                    read += 1;
                    let time = header.log_time;
                    self.first = Some(self.first.map_or(time, |first| first.min(time)));
                    self.last = self.last.max(time);
                } else if !is_rest {
                    // One that is no row although its chunk is whole, or whose channel was lost.
                    self.damage.rows += 1;
                }
            });
        }
        if with_rows {
            if let Some(rows) = parts.rows() {
                self.damage.rows = rows.saturating_sub(read);
            }
            let is_changed = parts.is_unchanged().map_err(failed(&path))? == Some(false);
            self.damage.is_changed = is_changed && self.damage.parts == 0;
        }
        if self.first.is_some() || !self.facts.is_empty() || !with_rows {
            return Ok(());
        }
        let reason = if !parts.is_record {
            "it does not begin as an MCAP file does"
        } else if self.damage.parts > 0 {
            "none of its parts is whole"
        } else {
            "it has neither rows nor facts"
        };
        Err(ReadError::Format { path, reason: reason.to_owned() })
    }

    /// Keeps a row; nothing where it is none.
    fn keep(&mut self, topic: &str, data: &[u8]) -> Option<()> {
        match topic {
            "/pose" => self.poses.push(row(data)?),
            "/path" => self.path = Some(row(data)?),
            "/log" => self.events.push(row(data)?),
            "/command" => self.commands.push(row(data)?),
            "/navigation" => self.navigation.push(row(data)?),
            "/telemetry" => self.telemetry.push(row(data)?),
            _ => self.unknown += 1,
        }
        Some(())
    }
}

fn row<'a, T: Deserialize<'a>>(data: &'a [u8]) -> Option<T> {
    serde_json::from_slice(data).ok()
}
