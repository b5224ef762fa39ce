//! States in build scripts which commit a program is built from.

use std::ffi::OsStr;
use std::hash::{DefaultHasher, Hasher as _};
use std::path::Path;
use std::process::{Command, Stdio};

/// Digits of a commit's hash.
const COMMIT_DIGITS: &str = "12";
/// Digits of the hash of what differs from the commit.
const DIFFERENCE_DIGITS: usize = 8;

/// Sets `FLIX_VERSION` for the package whose build script calls it: the package's version, and in a repository `+` and the newest
/// commit that changed `packages` (folders below the root of the repository), with `-dirty.` and a hash of the difference where
/// their sources differ from it. Cargo calls the script again when one of them changes.
pub fn emit(packages: &[&str]) {
    let version = std::env::var("CARGO_PKG_VERSION").unwrap_or_default();
    let here = std::env::current_dir().unwrap_or_default();
    let build = watch(&here, packages).map(|build| format!("+{build}")).unwrap_or_default();
    println!("cargo::rustc-env=FLIX_VERSION={version}{build}");
}

/// Names what cargo has to watch, and returns the commit.
fn watch(here: &Path, packages: &[&str]) -> Option<String> {
    let root = git(here, ["rev-parse", "--show-toplevel"])?;
    let root = Path::new(&root);
    let sources: Vec<String> = packages
        .iter()
        .flat_map(|package| ["src", "Cargo.toml"].map(|file| format!("{package}/{file}")))
        .chain(["Cargo.toml", "Cargo.lock"].map(str::to_owned))
        .collect();
    // Every commit and every checkout writes a line of it.
    let log = here.join(git(here, ["rev-parse", "--git-path", "logs/HEAD"])?);
    for path in sources.iter().map(|source| root.join(source)).chain([log]) {
        // A path that is missing would call the script each time.
        if path.exists() {
            println!("cargo::rerun-if-changed={}", path.display());
        }
    }
    commit(root, &sources)
}

/// Returns the newest commit that changed the sources; `None` outside a repository, or where none did.
fn commit(root: &Path, sources: &[String]) -> Option<String> {
    let ask = |arguments: &[&str]| {
        git(root, arguments.iter().copied().chain(["--"]).chain(sources.iter().map(String::as_str)))
    };
    let format = format!("--abbrev={COMMIT_DIGITS}");
    let commit = ask(&["log", "-1", "--format=%h", &format]).filter(|it| !it.is_empty())?;
    let mut difference = ask(&["diff", "HEAD", "--binary", "--no-ext-diff"])?;
    for file in ask(&["ls-files", "--others", "--exclude-standard"])?.lines() {
        difference += file;
        difference += &git(root, ["hash-object", file])?;
    }
    if difference.is_empty() {
        return Some(commit);
    }
    let mut hasher = DefaultHasher::new();
    hasher.write(difference.as_bytes());
    Some(format!("{commit}-dirty.{:.DIFFERENCE_DIGITS$}", format!("{:016x}", hasher.finish())))
}

/// Returns what `git` prints, without the blanks at its end.
fn git(folder: &Path, arguments: impl IntoIterator<Item = impl AsRef<OsStr>>) -> Option<String> {
    let mut command = Command::new("git");
    command.arg("-C").arg(folder).args(arguments).stderr(Stdio::null());
    let output = command.output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8_lossy(&output.stdout).trim_end().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A repository with one committed source.
    fn repository() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(folder.path().join("robot/src")).unwrap();
        std::fs::write(folder.path().join("robot/src/lib.rs"), "one").unwrap();
        run(folder.path(), &["init", "--quiet"]);
        save(folder.path());
        folder
    }

    fn run(folder: &Path, arguments: &[&str]) {
        let person = ["-c", "user.name=a", "-c", "user.email=a@b"];
        assert!(git(folder, person.iter().chain(arguments)).is_some(), "{arguments:?}");
    }

    fn save(folder: &Path) {
        run(folder, &["add", "--all"]);
        run(folder, &["commit", "--quiet", "--message", "m"]);
    }

    fn built(folder: &Path) -> Option<String> {
        commit(folder, &["robot/src".to_owned()])
    }

    #[test]
    fn a_commit_is_that_of_the_sources_alone() {
        let folder = repository();
        let first = built(folder.path()).unwrap();
        assert_eq!(first.len(), 12);
        std::fs::write(folder.path().join("README.md"), "text").unwrap();
        assert_eq!(built(folder.path()), Some(first.clone()), "another file");
        save(folder.path());
        assert_eq!(built(folder.path()), Some(first), "a commit of another file");
    }

    #[test]
    fn differences_from_a_commit_are_told_apart() {
        let folder = repository();
        let clean = built(folder.path()).unwrap();
        let mut seen = vec![clean.clone()];
        for (file, text) in
            [("lib.rs", "two"), ("lib.rs", "three"), ("new.rs", "a"), ("new.rs", "b")]
        {
            std::fs::write(folder.path().join("robot/src").join(file), text).unwrap();
            let build = built(folder.path()).unwrap();
            assert!(build.starts_with(&format!("{clean}-dirty.")), "{build}");
            assert!(!seen.contains(&build), "{build} twice");
            seen.push(build);
        }
        save(folder.path());
        let later = built(folder.path()).unwrap();
        assert!(!seen.contains(&later) && !later.contains("dirty"), "{later}");
    }

    #[test]
    fn sources_outside_a_repository_have_no_commit() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(built(folder.path()), None);
        let empty = repository();
        assert_eq!(commit(empty.path(), &["elsewhere".to_owned()]), None);
    }
}
