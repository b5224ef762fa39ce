//! Repositories that tests make.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

use std::path::PathBuf;
use std::process::Command;

use crate::run;
use crate::tree::Tree;

/// A clone in a folder of its own, which goes with it.
pub(crate) struct TestRepository {
    pub(crate) folder: tempfile::TempDir,
}

impl TestRepository {
    /// Makes a clone of these files, with one commit.
    pub(crate) fn of<'a>(files: impl IntoIterator<Item = (&'a str, Vec<u8>)>) -> Self {
        let clone = Self { folder: tempfile::tempdir().unwrap() };
        for (file, contents) in files {
            run::write(&clone.path(file), contents).unwrap();
        }
        clone.git(&["init", "--quiet"]);
        clone.commit();
        clone
    }

    pub(crate) fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    pub(crate) fn git(&self, arguments: &[&str]) -> String {
        let mut git = Command::new("git");
        for variable in ["GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"] {
            git.env_remove(variable);
        }
        git.env("GIT_CONFIG_GLOBAL", "/dev/null").env("GIT_CONFIG_NOSYSTEM", "1");
        for role in ["AUTHOR", "COMMITTER"] {
            git.env(format!("GIT_{role}_NAME"), "x").env(format!("GIT_{role}_EMAIL"), "x@y");
        }
        run::output(git.current_dir(self.folder.path()).args(arguments)).unwrap()
    }

    /// Commits everything and returns the commit.
    pub(crate) fn commit(&self) -> String {
        self.git(&["add", "--all"]);
        self.git(&["commit", "--quiet", "--allow-empty", "--message", "x"]);
        self.tree().head().unwrap()
    }

    pub(crate) fn tree(&self) -> Tree {
        Tree::new(self.folder.path())
    }

    pub(crate) fn read(&self, file: &str) -> String {
        self.tree().now(file).unwrap()
    }

    pub(crate) fn write(&self, file: &str, contents: &str) {
        run::write(&self.path(file), contents).unwrap();
    }

    pub(crate) fn edit(&self, file: &str, from: &str, to: &str) {
        let text = self.read(file);
        assert!(text.contains(from), "{file} lacks {from}");
        self.write(file, &text.replacen(from, to, 1));
    }
}
