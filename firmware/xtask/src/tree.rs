//! The files of a clone, asked of git: what differs from a commit, and what a file was then.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::run::{self, Error};

/// Variables by which a hook of git would send a command to another clone.
const REDIRECTIONS: [&str; 3] = ["GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"];

/// A clone, by its root folder. Paths of files are relative to it, with `/` between their parts.
pub(crate) struct Tree {
    root: PathBuf,
}

impl Tree {
    /// Names the clone in this folder.
    pub(crate) fn new(root: &Path) -> Self {
        Self { root: root.to_path_buf() }
    }

    /// Returns the root folder.
    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    fn git(&self, arguments: &[&str]) -> Command {
        let mut command = run::command("git");
        command.current_dir(&self.root).args(arguments);
        for variable in REDIRECTIONS {
            command.env_remove(variable);
        }
        command
    }

    fn ask(&self, arguments: &[&str]) -> Result<String, Error> {
        run::output(&mut self.git(arguments))
    }

    /// Returns the names that git prints with a zero after each.
    fn names(&self, arguments: &[&str]) -> Result<Vec<String>, Error> {
        let printed = self.ask(arguments)?;
        Ok(printed.split('\0').filter(|name| !name.is_empty()).map(str::to_owned).collect())
    }

    /// Checks that this folder is a clone.
    pub(crate) fn must_be_clone(&self) -> Result<(), Error> {
        let mut command = self.git(&["rev-parse", "--verify", "HEAD"]);
        let said = match command.output() {
            Ok(output) if output.status.success() => return Ok(()),
            Ok(output) => String::from_utf8_lossy(&output.stderr).trim().to_owned(),
            Err(error) => error.to_string(),
        };
        Err(Error::Sentence(format!(
            "what changed is asked of git, which finds no commit in {}: clone the repository, or do as git says:\n{said}",
            self.root.display()
        )))
    }

    /// Returns the commit that is checked out.
    pub(crate) fn head(&self) -> Result<String, Error> {
        self.commit("HEAD")
    }

    /// Returns the full name of a commit.
    pub(crate) fn commit(&self, name: &str) -> Result<String, Error> {
        let name = format!("{name}^{{commit}}");
        Ok(self.ask(&["rev-parse", "--verify", "--quiet", &name])?.trim().to_owned())
    }

    /// Returns whether this clone holds the commit; a shallow one may not.
    pub(crate) fn has(&self, commit: &str) -> bool {
        run::succeeds(&mut self.git(&["cat-file", "-e", &format!("{commit}^{{commit}}")]))
    }

    /// Returns the tracked files that differ from the commit: edited, added, removed, staged or not.
    pub(crate) fn edited_since(&self, commit: &str) -> Result<Vec<String>, Error> {
        self.names(&["diff", "--name-only", "--no-renames", "-z", commit, "--"])
    }

    /// Returns the files that are neither tracked nor ignored.
    pub(crate) fn untracked(&self) -> Result<Vec<String>, Error> {
        self.names(&["ls-files", "--others", "--exclude-standard", "-z"])
    }

    /// Returns all files that differ from the commit, untracked ones included.
    pub(crate) fn changed_since(&self, commit: &str) -> Result<Vec<String>, Error> {
        Ok([self.edited_since(commit)?, self.untracked()?].concat())
    }

    /// Returns all tracked files.
    pub(crate) fn tracked(&self) -> Result<Vec<String>, Error> {
        self.names(&["ls-files", "-z"])
    }

    /// Returns a file as the commit has it; nothing where it has none.
    pub(crate) fn at(&self, commit: &str, file: &str) -> Option<String> {
        let mut command = self.git(&["show", &format!("{commit}:{file}")]);
        let output = command.stderr(Stdio::null()).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
    }

    /// Returns a file as it is now; nothing where there is none.
    pub(crate) fn now(&self, file: &str) -> Option<String> {
        std::fs::read_to_string(self.root.join(file)).ok()
    }
}

/// Returns the first characters of a commit's name, enough for people.
pub(crate) fn short(commit: &str) -> &str {
    commit.get(..9).unwrap_or(commit)
}
