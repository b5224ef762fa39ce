//! The lanes that are due, and why.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::rc::Rc;

use super::list::{FILE as LIST, Lane, List};
use super::lock::{self, Lock};
use crate::included::{Included, included};
use crate::run::Error;
use crate::tree::{Tree, short};
use crate::workspace::Workspace;

/// Why a lane is due.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Reason {
    /// There is no record of a green run.
    NeverGreen,
    /// This clone lacks the commit of the last green run.
    Unknown(String),
    /// Its entry in the list is another one.
    Entry,
    /// This file differs, and so many more.
    File(String, usize),
    /// A package from elsewhere differs, and so many more.
    Dependency(String, usize),
}

impl fmt::Display for Reason {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let more = |more: usize| match more {
            0 => String::new(),
            more => format!(" (and {more} more)"),
        };
        match self {
            Self::NeverGreen => formatter.write_str("no green run is recorded"),
            Self::Unknown(commit) => {
                write!(
                    formatter,
                    "this clone has no commit {}: it is shallow, or history was rewritten",
                    short(commit)
                )
            }
            Self::Entry => formatter.write_str("its entry in the list changed"),
            Self::File(file, others) => write!(formatter, "{file} changed{}", more(*others)),
            Self::Dependency(words, others) => write!(formatter, "{words}{}", more(*others)),
        }
    }
}

/// What a commit holds, as far as lanes depend on it, and which files differ from it now.
struct Past {
    changed: Vec<String>,
    list: Option<List>,
    lock: Lock,
}

/// Judges lanes against a clone as it is now.
pub(super) struct Judge<'a> {
    tree: &'a Tree,
    list: &'a List,
    workspace: Workspace,
    lock: Lock,
    /// What programs are built from beside the files of their packages.
    included: Vec<Included>,
    /// By commit; nothing for one that this clone lacks.
    pasts: BTreeMap<String, Option<Rc<Past>>>,
}

impl<'a> Judge<'a> {
    /// Reads packages and versions as they are now.
    pub(super) fn new(tree: &'a Tree, list: &'a List) -> Result<Self, Error> {
        let workspace = Workspace::read(tree.root())?;
        let known: BTreeSet<&str> = workspace.names().collect();
        for lane in &list.lanes {
            if let Some(name) = lane.packages.iter().find(|name| !known.contains(name.as_str())) {
                return Err(Error::Sentence(format!(
                    "the lane {} names the package {name:?}, and there is none: name one of {}",
                    lane.name,
                    known.into_iter().collect::<Vec<_>>().join(", ")
                )));
            }
        }
        let lock = Lock::parse(&tree.now(lock::FILE).unwrap_or_default());
        let mut included = included(tree, &[tree.tracked()?, tree.untracked()?].concat());
        included.retain(Included::is_built);
        Ok(Self { tree, list, workspace, lock, included, pasts: BTreeMap::new() })
    }

    /// Returns what a commit holds; nothing where this clone lacks it.
    fn past(&mut self, commit: &str) -> Result<Option<Rc<Past>>, Error> {
        if let Some(past) = self.pasts.get(commit) {
            return Ok(past.clone());
        }
        let past = if self.tree.has(commit) { Some(Rc::new(self.read(commit)?)) } else { None };
        self.pasts.insert(commit.to_owned(), past.clone());
        Ok(past)
    }

    fn read(&self, commit: &str) -> Result<Past, Error> {
        let at = |file| self.tree.at(commit, file).unwrap_or_default();
        Ok(Past {
            changed: self.tree.changed_since(commit)?,
            list: List::parse(&at(LIST)).ok(),
            lock: Lock::parse(&at(lock::FILE)),
        })
    }

    /// Returns the files of these that a lane depends on.
    pub(super) fn inputs<'b>(&self, lane: &Lane, files: &'b [String]) -> Vec<&'b str> {
        let packages = self.workspace.closure(&lane.packages);
        let is_own = |file: &str| {
            let owner = self.workspace.owner(file);
            self.list.depends(lane, file, owner.is_some_and(|owner| packages.contains(owner)))
        };
        // What its sources take in, and what this takes in.
        let mut taken = BTreeSet::new();
        loop {
            let before = taken.len();
            for Included { file, by, .. } in &self.included {
                if taken.contains(by.as_str()) || is_own(by) {
                    taken.insert(file.as_str());
                }
            }
            if taken.len() == before {
                break;
            }
        }
        let is_input = |file: &&str| taken.contains(file) || is_own(file);
        files.iter().map(String::as_str).filter(is_input).collect()
    }

    /// Returns why a lane is due; nothing where its last green run still holds.
    pub(super) fn reason(&mut self, lane: &Lane) -> Result<Option<Reason>, Error> {
        let Some(last) = &lane.last else { return Ok(Some(Reason::NeverGreen)) };
        self.reason_since(lane, &last.commit)
    }

    /// Returns why a lane that was green at a commit is due.
    pub(super) fn reason_since(
        &mut self,
        lane: &Lane,
        commit: &str,
    ) -> Result<Option<Reason>, Error> {
        let Some(past) = self.past(commit)? else {
            return Ok(Some(Reason::Unknown(commit.to_owned())));
        };
        if !past.list.as_ref().is_some_and(|list| self.list.defines_alike(lane, list)) {
            return Ok(Some(Reason::Entry));
        }
        let files = self.inputs(lane, &past.changed);
        if let [file, others @ ..] = &files[..] {
            return Ok(Some(Reason::File((*file).to_owned(), others.len())));
        }
        let packages = self.workspace.closure(&lane.packages);
        let mut differences = self.lock.differences(&past.lock, &packages);
        Ok((!differences.is_empty()).then(|| {
            let first = differences.remove(0);
            Reason::Dependency(first, differences.len())
        }))
    }

    /// Returns what is wrong with the list: a package or a file that no lane depends on and nothing else checks.
    pub(super) fn orphans(&self, files: &[String]) -> Vec<String> {
        let always = &self.list.always;
        let has_lane = |package: &str| {
            self.list
                .lanes
                .iter()
                .any(|lane| self.workspace.closure(&lane.packages).contains(package))
        };
        let packages = self.workspace.names().filter(|name| {
            !has_lane(name) && !always.packages.iter().any(|checked| checked == name)
        });
        let packages = packages.map(|name| {
            format!(
                "the package {name} belongs to no lane: name it in the `packages` of the lane in {LIST} that checks it, \
                 or in those of `always` if none does"
            )
        });
        let files = files.iter().filter(|file| {
            self.workspace.owner(file).is_none()
                && !always.files.name(file)
                && !self.list.lanes.iter().any(|lane| self.list.depends(lane, file, false))
        });
        let files = files.map(|file| {
            format!(
                "{file} belongs to no lane: name it in the `files` of the lanes in {LIST} that run or read it, \
                 or in those of `always` if none does"
            )
        });
        packages.chain(files).collect()
    }
}
