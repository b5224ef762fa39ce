//! Reads a record.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path as FilePath, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

use mcap::records::op;
use serde::Deserialize;

use super::message::{
    CommandRow, LogRow, NavigationRow, PathRow, PoseRow, TelemetryRow, Timestamp,
};
use super::parts::{Directory, Part, Parts};
use super::{ENDING, FOLDER};
use crate::system::text::{printable, shown};

/// The word for the last run.
const LAST: &str = "last";

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
    /// Why newer records were left out, where this was found as the last run.
    pub newer: Vec<String>,
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
    /// Attached files among them.
    pub attachments: usize,
    /// Groups of facts among them.
    pub facts: usize,
    /// Whether more rows than those may be lost.
    pub is_least: bool,
    /// Rows that stand in the file again, and were read once.
    pub repeated: u64,
    /// Rows that the summary counts, where that is wrong.
    pub counted: Option<u64>,
    /// Whether all rows are there, and what is lost, or leads to no parts, is the summary behind them.
    pub is_summary_lost: bool,
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
        let is_odd = self.is_changed || self.is_summary_lost || self.repeated > 0;
        !self.is_loss() && !is_odd && self.counted.is_none()
    }
}

impl fmt::Display for Damage {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = |count: u64, what: &str| match count {
            1 => format!("1 {what}"),
            count => format!("{count} {what}s"),
        };
        let mut sentences = Vec::new();
        if self.is_loss() {
            let mut left_out = Vec::new();
            if self.rows > 0 {
                let least = if self.is_least { "at least " } else { "" };
                left_out.push(least.to_owned() + &count(self.rows, "row"));
            }
            if self.attachments > 0 {
                left_out.push(count(self.attachments as u64, "attached file"));
            }
            if self.facts > 0 {
                left_out.push(count(self.facts as u64, "group") + " of facts");
            }
            let lost = match (self.rows, self.is_least) {
                (0, true) => "rows may have been left out, ",
                (0, false) if left_out.is_empty() => "0 rows left out, ",
                _ => "",
            };
            let mut left_out = left_out.join(", ");
            if !left_out.is_empty() {
                left_out += " left out, ";
            }
            let parts = count(self.parts as u64, "part");
            sentences
                .push(format!("damaged: {left_out}{lost}{parts} of the file cannot be trusted"));
        } else if self.is_changed {
            let sentence = "changed since it was written: a setting or a result may be wrong";
            sentences.push(sentence.to_owned());
        }
        if self.repeated > 0 {
            let rows = count(self.repeated, "row");
            sentences.push(format!("{rows} stood in the file again and were read once"));
        }
        if let Some(counted) = self.counted {
            sentences.push(format!("its summary counts {}, which is wrong", count(counted, "row")));
        }
        if self.is_summary_lost {
            let sentence = "all rows are there; the summary behind them, which other programs need, is lost or wrong";
            sentences.push(sentence.to_owned());
        }
        formatter.write_str(&sentences.join("; "))
    }
}

/// File and size of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct RunSummary {
    /// Its file.
    pub file: PathBuf,
    /// Size, bytes.
    pub bytes: u64,
    /// Time of its first row since 1970, or when the file was written where that is not known.
    pub started: Duration,
    /// Whether it has rows or facts, or may have, where the file cannot be read; anything else is never the last run.
    pub is_run: bool,
}

/// Why a record could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file could not be read.
    #[error("cannot read {}: {source}", shown(path))]
    File {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// Not a record, or damaged.
    #[error("{} is not a record of a run: {reason}", shown(path))]
    Format {
        /// The file.
        path: PathBuf,
        /// The error of the format.
        reason: String,
    },
    /// There is no such run.
    #[error(
        "there is no run \"{}\" in {}; `flix runs list` shows all",
        printable(name),
        shown(folder)
    )]
    NoSuchRun {
        /// The requested name.
        name: String,
        /// The folder of the runs.
        folder: PathBuf,
    },
    /// Several runs have this in their names.
    #[error(
        "\"{}\" is in the names of {count} runs, {} and {} among them: write more of the name",
        printable(name),
        printable(first),
        printable(second)
    )]
    Ambiguous {
        /// The requested name.
        name: String,
        /// How many there are.
        count: usize,
        /// One of them.
        first: String,
        /// Another of them.
        second: String,
    },
    /// There is no run.
    #[error("there is no run in {} yet", shown(.0))]
    NoRuns(PathBuf),
}

/// The runs below an output folder.
#[derive(Debug, Default)]
pub struct Listing {
    /// All runs, the oldest first.
    pub runs: Vec<RunSummary>,
    /// Entries that are named as runs, and why they were left out: folders, pipes, files that cannot be read.
    pub skipped: Vec<(RunSummary, ReadError)>,
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
                (run, Ok(())) => found.runs.push(run),
                (run, Err(source)) => found.skipped.push((run, ReadError::File { path, source })),
            }
        }
    }
    // Without the extension: the second of one moment follows the first.
    found.runs.sort_by_key(|run| (run.started, run.file.file_stem().map(ToOwned::to_owned)));
    Ok(found)
}

/// Returns the size of a record, and when its run started; of one that cannot be read, as far as that is known, and why.
fn summary(path: &FilePath) -> (RunSummary, std::io::Result<()>) {
    let metadata = std::fs::metadata(path).ok();
    let (mut first, mut is_run) = (None, false);
    let read = look(path, &mut first, &mut is_run);
    let written = || metadata.as_ref()?.modified().ok()?.duration_since(UNIX_EPOCH).ok();
    let is_unread = read.is_err() && metadata.as_ref().is_some_and(std::fs::Metadata::is_file);
    let run = RunSummary {
        file: path.to_owned(),
        bytes: metadata.as_ref().map_or(0, std::fs::Metadata::len),
        started: first.map(Duration::from_nanos).or_else(written).unwrap_or_default(),
        is_run: is_run || first.is_some() || is_unread,
    };
    (run, read)
}

/// Looks for the time of a record's first row, ns since 1970, and whether it has facts.
fn look(path: &FilePath, first: &mut Option<u64>, is_run: &mut bool) -> std::io::Result<()> {
    let mut parts = Parts::open(path)?;
    while first.is_none() {
        match parts.next(true) {
            Ok(Some(Part::Rows(rows) | Part::Rest(rows))) => {
                Directory::default().read(&rows, |_, header, _| {
                    first.get_or_insert(header.log_time);
                });
            }
            Ok(Some(Part::Facts(_))) => *is_run = true,
            Ok(Some(_)) => {}
            Ok(None) => break,
            Err(error) => {
                *first = parts.compressed;
                return Err(error);
            }
        }
    }
    Ok(())
}

impl Run {
    /// Finds a run by `last`, which is the word whatever file has that name, by its path, or by a part of its name, and reads it.
    ///
    /// # Errors
    /// When there is none, or it cannot be read.
    pub fn find(out: &FilePath, name: &str) -> Result<Self, ReadError> {
        let direct = FilePath::new(name);
        if name != LAST && direct.is_file() {
            return Self::read(direct);
        }
        let Listing { runs, skipped } = list(out)?;
        if name == LAST {
            return Self::find_last(runs, skipped)?
                .ok_or_else(|| ReadError::NoRuns(out.join(FOLDER)));
        }
        let stem = |run: &RunSummary| {
            run.file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
        };
        // Those that were skipped say why, once they are read.
        let all = runs.iter().chain(skipped.iter().map(|(run, _)| run));
        let found: Vec<_> =
            all.filter(|run| !name.is_empty() && stem(run).contains(name)).collect();
        let exact = found.iter().find(|run| stem(run) == name);
        match (exact, found.as_slice()) {
            (Some(run), _) | (None, [run]) => Self::read(&run.file),
            // Says what it is, where it is no file.
            (None, []) if direct.exists() => Self::read(direct),
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

    /// Reads the newest run that can be read, with the reasons of what is newer; nothing where there is none.
    fn find_last(
        runs: Vec<RunSummary>,
        skipped: Vec<(RunSummary, ReadError)>,
    ) -> Result<Option<Self>, ReadError> {
        let (mut runs, others): (Vec<_>, Vec<_>) = runs.into_iter().partition(|run| run.is_run);
        let last = runs.pop();
        let started = last.as_ref().map(|run| run.started);
        let is_newer = |run: &RunSummary| Some(run.started) > started;
        let newer = skipped.into_iter().filter(|(run, _)| run.is_run && is_newer(run));
        let Some(last) = last else {
            let newest = newer.max_by_key(|(run, _)| run.started);
            return newest.map_or(Ok(None), |(_, reason)| Err(reason));
        };
        let mut run = Self::read(&last.file)?;
        let no_runs = others.into_iter().filter(is_newer);
        let reasons = no_runs.filter_map(|other| Self::read(&other.file).err());
        run.newer =
            newer.map(|(_, reason)| reason).chain(reasons).map(|it| it.to_string()).collect();
        Ok(Some(run))
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

    /// Reads the facts of a record and the names of its attachments, without its rows: of one without its end those that stand
    /// beside the first that is whole.
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

    /// Returns whether any row is whole.
    #[must_use]
    pub const fn has_rows(&self) -> bool {
        self.first.is_some()
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
        // Whether any row is whole says the first.
        let wants = |run: &Self| with_rows || (!run.is_complete && !run.has_rows());
        while let Some(part) = parts.next(wants(self)).map_err(failed(&path))? {
            let rows = match part {
                Part::Facts(facts) => {
                    self.facts.insert(facts.name, facts.metadata);
                    continue;
                }
                Part::Attachment(header, data) => {
                    self.attachments.push((header.name, data.len()));
                    continue;
                }
                Part::Damaged(kind, part) => {
                    self.damage.parts += 1;
                    self.damage.attachments += usize::from(kind == op::ATTACHMENT);
                    self.damage.facts += usize::from(kind == op::METADATA);
                    let is_other = matches!(kind, op::ATTACHMENT | op::METADATA);
                    self.damage.is_least |= !is_other || !part.is_empty();
                    self.damage.rows += directory.read_damaged(&part);
                    continue;
                }
                Part::Repeated(rows) => {
                    directory.read(&rows, |_, _, _| self.damage.repeated += 1);
                    continue;
                }
                Part::Rows(rows) | Part::Rest(rows) if wants(self) => rows,
                Part::Rows(_) | Part::Rest(_) => continue,
            };
            directory.read(&rows, |directory, header, data| {
                let topic = directory.channels.get(&header.channel_id).map(|it| it.topic.as_str());
                if topic.is_some_and(|topic| self.keep(topic, data).is_some()) {
                    read += 1;
                    let time = header.log_time;
                    self.first = Some(self.first.map_or(time, |first| first.min(time)));
                    self.last = self.last.max(time);
                } else {
                    // One that is no row although its chunk is whole, or whose channel was lost.
                    self.damage.rows += 1;
                }
            });
        }
        if with_rows {
            let damage = &mut self.damage;
            let is_unchanged = match damage.parts {
                0 => parts.is_unchanged().map_err(failed(&path))?,
                _ => None,
            };
            damage.is_changed = is_unchanged == Some(false);
            match parts.rows() {
                // The data has a check sum of its own, or more rows than those.
                Some(rows)
                    if rows < read
                        || (is_unchanged == Some(true) && rows != read + damage.rows) =>
                {
                    damage.counted = Some(rows);
                }
                Some(rows) => (damage.rows, damage.is_least) = (rows - read, false),
                None => {}
            }
        }
        let damage = &mut self.damage;
        damage.is_summary_lost =
            !damage.is_loss() && !damage.is_changed && parts.lost_its_summary();
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
