//! The packages of the workspace: their folders, and which needs which, by `cargo metadata`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::run::{self, Error};
use crate::toolchain;

/// What is read of `cargo metadata --no-deps`.
#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Described>,
    workspace_root: PathBuf,
}

#[derive(Deserialize)]
struct Described {
    name: String,
    manifest_path: PathBuf,
    dependencies: Vec<Dependency>,
}

#[derive(Deserialize)]
struct Dependency {
    /// Where it is a package of this workspace.
    path: Option<PathBuf>,
}

/// A package: its folder with a `/` at its end, empty for the root, and the packages that it names.
struct Package {
    folder: String,
    needs: BTreeSet<String>,
}

/// All packages, by name.
pub(crate) struct Workspace {
    packages: BTreeMap<String, Package>,
}

impl Workspace {
    /// Asks cargo, without a network.
    pub(crate) fn read(root: &Path) -> Result<Self, Error> {
        let mut cargo = toolchain::cargo();
        cargo.args(["metadata", "--format-version", "1", "--no-deps", "--offline"]);
        let printed = run::output(cargo.current_dir(root))?;
        let metadata: Metadata = serde_json::from_str(&printed)
            .map_err(|error| Error::Sentence(format!("cargo metadata: {error}")))?;
        Ok(Self::of(&metadata))
    }

    fn of(metadata: &Metadata) -> Self {
        let folders: BTreeMap<&Path, &str> = metadata
            .packages
            .iter()
            .filter_map(|package| Some((package.manifest_path.parent()?, package.name.as_str())))
            .collect();
        let named = |path: &PathBuf| folders.get(path.as_path()).map(|name| (*name).to_owned());
        let packages = folders.iter().map(|(folder, name)| {
            let described = metadata.packages.iter().filter(|package| package.name == **name);
            let dependencies = described.flat_map(|package| &package.dependencies);
            let needs = dependencies.filter_map(|needed| named(needed.path.as_ref()?)).collect();
            let folder = slashed(folder.strip_prefix(&metadata.workspace_root).unwrap_or(folder));
            ((*name).to_owned(), Package { folder, needs })
        });
        Self { packages: packages.collect() }
    }

    /// Returns the names of all packages.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.packages.keys().map(String::as_str)
    }

    /// Returns the folder of a package, from the root, with a `/` at its end.
    #[cfg(test)]
    pub(crate) fn folder(&self, name: &str) -> Option<&str> {
        self.packages.get(name).map(|package| package.folder.as_str())
    }

    /// Returns the package that a file belongs to: that of the innermost folder around it.
    pub(crate) fn owner(&self, file: &str) -> Option<&str> {
        let around = self.packages.iter().filter(|(_, package)| file.starts_with(&package.folder));
        around.max_by_key(|(_, package)| package.folder.len()).map(|(name, _)| name.as_str())
    }

    /// Returns these packages and all that they need, for their tests and build scripts, too.
    pub(crate) fn closure(&self, names: &[String]) -> BTreeSet<&str> {
        self.grow(names, |known, other| self.needs(known, other))
    }

    /// Returns these packages and all that need them.
    pub(crate) fn dependents(&self, names: &[String]) -> BTreeSet<&str> {
        self.grow(names, |known, other| self.needs(other, known))
    }

    fn needs(&self, package: &str, needed: &str) -> bool {
        self.packages.get(package).is_some_and(|package| package.needs.contains(needed))
    }

    /// Adds packages that follow from one that is known already, until there are no more.
    fn grow(&self, names: &[String], follows: impl Fn(&str, &str) -> bool) -> BTreeSet<&str> {
        let mut known: BTreeSet<&str> =
            self.names().filter(|name| names.iter().any(|wanted| wanted == name)).collect();
        loop {
            let is_new = |other: &&str| {
                !known.contains(other) && known.iter().any(|known| follows(known, other))
            };
            let more: Vec<&str> = self.names().filter(is_new).collect();
            if more.is_empty() {
                return known;
            }
            known.extend(more);
        }
    }
}

/// Returns a folder with `/` between its parts and at its end.
fn slashed(folder: &Path) -> String {
    folder.iter().map(|part| format!("{}/", part.to_string_lossy())).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]
mod tests {
    use super::*;

    /// Returns the features of each package that a program is built of.
    fn features(program: &str) -> BTreeMap<String, BTreeSet<String>> {
        let mut cargo = toolchain::cargo();
        cargo.args(["tree", "--offline", "--locked", "--package", program]);
        cargo.args([
            "--edges",
            "normal,build",
            "--prefix",
            "none",
            "--no-dedupe",
            "--format",
            "{p}|{f}",
        ]);
        let printed = run::output(cargo.current_dir(run::root())).unwrap();
        let mut features = BTreeMap::<_, BTreeSet<_>>::new();
        for (package, of) in printed.lines().filter_map(|line| line.split_once('|')) {
            // Once for the program, once for what runs while it is built.
            features.entry(package.to_owned()).or_default().insert(of.to_owned());
        }
        features
    }

    #[test]
    fn what_both_programs_need_has_the_same_features_in_both_and_is_built_once() {
        let (robot, operator) = (features("flix-sim-cli"), features("flix-cli"));
        assert!(robot.len() > 100 && operator.len() > 100, "cargo printed no packages");
        let differ: Vec<String> = robot
            .iter()
            .filter_map(|(package, one)| {
                let other = operator.get(package).filter(|other| *other != one)?;
                Some(format!("{package}: {one:?} and {other:?}"))
            })
            .collect();
        let page = "host/shell/Cargo.toml";
        assert!(differ.is_empty(), "name these features in {page}:\n{}", differ.join("\n"));
    }
}
