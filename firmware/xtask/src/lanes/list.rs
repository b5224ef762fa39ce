//! The list of lanes, `.ci/lanes.toml`: what each runs, what it depends on, when it was green last.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use glob::{MatchOptions, Pattern};
use serde::Deserialize;

use crate::run::Error;
use crate::tree::{self, Tree};

/// Where the list is.
pub(crate) const FILE: &str = ".ci/lanes.toml";
/// The table's name in the page that shows it.
pub(super) const TABLE: &str = "lanes";
/// The table's head.
const HEAD: &str =
    "| lane | checks | run by | last green run | seconds |\n|---|---|---|---|---:|\n";

/// All lanes.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct List {
    /// The page with the table of the last green runs.
    pub(super) page: String,
    /// Files that every lane depends on.
    common: Patterns,
    /// Files in packages that no lane depends on, unless it names them.
    #[serde(default)]
    except: Patterns,
    /// What belongs to no lane.
    pub(super) always: Always,
    /// The lanes, in the order in which they run.
    #[serde(rename = "lane")]
    pub(super) lanes: Vec<Lane>,
}

/// What no lane runs or reads: what is done with every change, pages, and files of other tools.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Always {
    pub(super) packages: Vec<String>,
    pub(super) files: Patterns,
}

/// One lane.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Lane {
    /// One word, for the command line and the log.
    pub(super) name: String,
    /// What it checks, for people.
    pub(super) checks: String,
    /// Packages that it depends on; with them those that they need.
    #[serde(default)]
    pub(super) packages: Vec<String>,
    /// Files that it depends on.
    #[serde(default)]
    pub(super) files: Patterns,
    /// Files in its packages that it does not depend on.
    #[serde(default)]
    except: Patterns,
    /// Lines of shell; the first that fails ends the lane.
    pub(super) run: Vec<String>,
    /// Whether it is too long for `.ci/run`.
    #[serde(default)]
    pub(super) long: bool,
    /// Whether it builds in folders of its own, so that it may run beside the tests.
    #[serde(default)]
    pub(super) apart: bool,
    /// Whether a program of it has to keep up with the wall clock: all other lanes run at a lower priority.
    #[serde(default)]
    pub(super) paced: bool,
    /// Its last green run.
    pub(super) last: Option<Record>,
}

/// A green run.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Record {
    /// The commit that was checked.
    pub(super) commit: String,
    /// The day, as in 2026-11-25.
    pub(super) date: String,
    /// How long it took, s.
    pub(super) seconds: u64,
}

/// Patterns of files: `*` within one folder, `**` over any number of them.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(try_from = "Vec<String>")]
pub(super) struct Patterns(Vec<Pattern>);

impl TryFrom<Vec<String>> for Patterns {
    type Error = glob::PatternError;

    fn try_from(patterns: Vec<String>) -> Result<Self, Self::Error> {
        patterns.iter().map(|pattern| Pattern::new(pattern)).collect::<Result<_, _>>().map(Self)
    }
}

impl Patterns {
    /// Returns whether one of them names the file.
    pub(super) fn name(&self, file: &str) -> bool {
        self.0.iter().any(|pattern| matches(pattern, file))
    }

    /// Returns those that name none of these files.
    #[cfg(test)]
    pub(super) fn idle<'a>(&'a self, files: &'a [String]) -> impl Iterator<Item = &'a str> {
        let is_idle = |pattern: &&Pattern| !files.iter().any(|file| matches(pattern, file));
        self.0.iter().filter(is_idle).map(Pattern::as_str)
    }
}

fn matches(pattern: &Pattern, file: &str) -> bool {
    let options = MatchOptions { require_literal_separator: true, ..MatchOptions::new() };
    pattern.matches_with(file, options)
}

impl List {
    /// Reads the list of a clone as it is now.
    pub(crate) fn read(tree: &Tree) -> Result<Self, Error> {
        let text = tree.now(FILE).ok_or_else(|| {
            Error::Sentence(format!("{FILE} cannot be read: it lists the lanes, see CONTRIBUTING"))
        })?;
        Self::parse(&text)
    }

    /// Reads a text.
    pub(super) fn parse(text: &str) -> Result<Self, Error> {
        let list: Self =
            toml::from_str(text).map_err(|error| Error::Sentence(format!("{FILE}: {error}")))?;
        let mut seen = BTreeSet::new();
        match list.lanes.iter().find(|lane| !seen.insert(&lane.name)) {
            Some(lane) => Err(Error::Sentence(format!(
                "{FILE} has two lanes {:?}: give each a name of its own",
                lane.name
            ))),
            None => Ok(list),
        }
    }

    /// Returns the lane of this name.
    pub(super) fn lane(&self, name: &str) -> Result<&Lane, Error> {
        self.lanes.iter().find(|lane| lane.name == name).ok_or_else(|| {
            let names: Vec<_> = self.lanes.iter().map(|lane| lane.name.as_str()).collect();
            Error::Sentence(format!("no lane is called {name:?}: choose of {}", names.join(", ")))
        })
    }

    /// Returns whether every lane depends on a file.
    pub(crate) fn is_common(&self, file: &str) -> bool {
        self.common.name(file)
    }

    /// Returns whether a lane depends on a file; `is_in_package` says whether this lies in one of its packages.
    pub(super) fn depends(&self, lane: &Lane, file: &str, is_in_package: bool) -> bool {
        let is_excepted = self.except.name(file) || lane.except.name(file);
        self.is_common(file) || lane.files.name(file) || (is_in_package && !is_excepted)
    }

    /// Returns whether a lane is defined as in another list, whatever its last green run.
    pub(super) fn defines_alike(&self, lane: &Lane, other: &Self) -> bool {
        let alike =
            |one: &Lane| Lane { last: None, ..one.clone() } == Lane { last: None, ..lane.clone() };
        let around = self.common == other.common && self.except == other.except;
        around && other.lanes.iter().any(alike)
    }

    /// Returns whether both lists define the same lanes, whatever their last green runs.
    pub(super) fn equals(&self, other: &Self) -> bool {
        self.lanes.len() == other.lanes.len()
            && self.lanes.iter().all(|lane| self.defines_alike(lane, other))
    }

    /// Returns the table of the last green runs.
    pub(super) fn table(&self) -> String {
        let mut table = HEAD.to_owned();
        for Lane { name, checks, long, last, .. } in &self.lanes {
            let by = if *long { ".ci/long" } else { ".ci/run" };
            let (run, seconds) = last.as_ref().map_or(("none".into(), "".into()), |last| {
                let commit = tree::short(&last.commit);
                (format!("{}, `{commit}`", last.date), last.seconds.to_string())
            });
            // Writing to a string never fails.
            let _ = writeln!(table, "| {name} | {checks} | `{by}` | {run} | {seconds} |");
        }
        table
    }
}

/// Returns the text of a list with another last green run of a lane. Nothing else changes, comments neither.
pub(super) fn with_record(text: &str, lane: &str, record: &Record) -> Result<String, Error> {
    let Record { commit, date, seconds } = record;
    let line = format!(r#"last = {{ commit = "{commit}", date = "{date}", seconds = {seconds} }}"#);
    let mut lines: Vec<&str> = text.lines().collect();
    let name = format!("name = {lane:?}");
    let named = lines.iter().position(|line| line.trim() == name);
    let written = named.map(|named| {
        let rest = &lines[named..];
        let end = rest.iter().position(|line| line.starts_with('[')).unwrap_or(rest.len());
        match rest[..end].iter().position(|line| line.starts_with("last = ")) {
            Some(old) => lines[named + old] = &line,
            None => {
                // Behind the last line that is neither empty nor a comment on what follows.
                let is_ours = |line: &&str| !line.is_empty() && !line.starts_with('#');
                let behind = rest[..end].iter().rposition(is_ours).unwrap_or(0) + 1;
                lines.insert(named + behind, &line);
            }
        }
        lines.join("\n") + "\n"
    });
    // Whether the edit did what it should is read from its outcome.
    let (old, new) = (List::parse(text)?, written.as_deref().map(List::parse).transpose()?);
    let is_right = new.is_some_and(|new| {
        let last = new.lanes.iter().find(|one| one.name == lane).and_then(|one| one.last.as_ref());
        last == Some(record) && new.equals(&old)
    });
    written.filter(|_| is_right).ok_or_else(|| {
        Error::Sentence(format!(
            "the run of {lane} cannot be written into {FILE}: \
             give its entry the line `{name}` and put its arrays' brackets on lines that do not start with one"
        ))
    })
}
