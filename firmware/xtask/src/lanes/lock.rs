//! The lock file: which packages from elsewhere, in which versions, follow from packages of ours.

use std::collections::{BTreeMap, BTreeSet};

use serde::Deserialize;

/// Where it is.
pub(super) const FILE: &str = "Cargo.lock";

/// A lock file.
#[derive(Debug, Default, Deserialize)]
pub(super) struct Lock {
    #[serde(default, rename = "package")]
    packages: Vec<Package>,
}

#[derive(Debug, Deserialize)]
struct Package {
    name: String,
    version: String,
    /// None for a package of this workspace.
    source: Option<String>,
    checksum: Option<String>,
    /// Each `NAME`, `NAME VERSION` or `NAME VERSION (SOURCE)`, as much as it needs to be the only one.
    #[serde(default)]
    dependencies: Vec<String>,
}

impl Package {
    fn is_meant(&self, dependency: &str) -> bool {
        let mut words = dependency.split(' ');
        words.next() == Some(&self.name)
            && words.next().is_none_or(|version| version == self.version)
            && words.next().is_none_or(|source| {
                let ours = self.source.as_deref().unwrap_or_default();
                source.trim_matches(['(', ')']) == ours
            })
    }

    /// Returns what makes it this one and no other: its version, where it comes from, its content.
    fn identity(&self) -> [&str; 3] {
        let Self { version, source, checksum, .. } = self;
        [version, source.as_deref().unwrap_or_default(), checksum.as_deref().unwrap_or_default()]
    }
}

impl Lock {
    /// Reads a lock file; an unreadable one holds nothing.
    pub(super) fn parse(text: &str) -> Self {
        toml::from_str(text).unwrap_or_default()
    }

    /// Returns the packages from elsewhere that follow from ours, by name.
    fn follow<'a>(&'a self, ours: &BTreeSet<&str>) -> BTreeMap<&'a str, BTreeSet<[&'a str; 3]>> {
        let mut by_name: BTreeMap<&str, Vec<&Package>> = BTreeMap::new();
        for package in &self.packages {
            by_name.entry(&package.name).or_default().push(package);
        }
        let is_root =
            |package: &&Package| package.source.is_none() && ours.contains(package.name.as_str());
        let mut open: Vec<&Package> = self.packages.iter().filter(is_root).collect();
        let mut seen: BTreeSet<*const Package> =
            open.iter().copied().map(std::ptr::from_ref).collect();
        let mut found: BTreeMap<&str, BTreeSet<[&str; 3]>> = BTreeMap::new();
        while let Some(package) = open.pop() {
            if package.source.is_some() {
                found.entry(&package.name).or_default().insert(package.identity());
            }
            for dependency in &package.dependencies {
                let name = dependency.split(' ').next().unwrap_or_default();
                let named = by_name.get(name).into_iter().flatten().copied();
                let meant = named.filter(|package| package.is_meant(dependency));
                open.extend(meant.filter(|package| seen.insert(std::ptr::from_ref(*package))));
            }
        }
        found
    }

    /// Returns in words what of the packages that follow from ours differs from an older lock file.
    pub(super) fn differences(&self, old: &Self, ours: &BTreeSet<&str>) -> Vec<String> {
        let (before, now) = (old.follow(ours), self.follow(ours));
        let versions = |found: &BTreeMap<&str, BTreeSet<[&str; 3]>>, name: &str| {
            let versions = found.get(name).into_iter().flatten().map(|[version, ..]| *version);
            let versions = versions.collect::<Vec<_>>().join(" and ");
            if versions.is_empty() { "none".to_owned() } else { versions }
        };
        let names: BTreeSet<&str> = before.keys().chain(now.keys()).copied().collect();
        let changed = names.into_iter().filter(|name| before.get(name) != now.get(name));
        changed
            .map(|name| format!("{name} {} -> {}", versions(&before, name), versions(&now, name)))
            .collect()
    }
}
