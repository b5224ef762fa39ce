//! Files that sources take in by their path: what their package is built from, too, wherever they lie.

use crate::tree::Tree;

/// What stands before the path.
const BEFORE: [&str; 3] = ["include_str!(\"", "include_bytes!(\"", "#[path = \""];

/// A file, and the source that takes it in, both from the root.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Included {
    pub(crate) file: String,
    pub(crate) by: String,
    /// Whether tests alone do.
    pub(crate) for_tests: bool,
}

impl Included {
    /// Returns whether programs are built from it: pages are taken in for documents alone.
    pub(crate) fn is_built(&self) -> bool {
        !self.for_tests && !self.file.ends_with(".md")
    }
}

/// Returns the files that these sources take in.
pub(crate) fn included(tree: &Tree, sources: &[String]) -> Vec<Included> {
    let sources = sources.iter().filter(|file| file.ends_with(".rs"));
    let texts = sources.filter_map(|source| Some((source, tree.now(source)?)));
    texts.flat_map(|(source, text)| of_source(source, &text)).collect()
}

fn of_source(source: &str, text: &str) -> Vec<Included> {
    let (mut before, mut in_tests) = ("", false);
    let mut found = Vec::new();
    for line in text.lines() {
        let is_for_tests = before.trim() == "#[cfg(test)]";
        in_tests |= is_for_tests && line.starts_with("mod ") && line.ends_with('{');
        let path = BEFORE.iter().find_map(|it| line.split_once(it)?.1.split('"').next());
        found.extend(path.map(|path| Included {
            file: beside(source, path),
            by: source.to_owned(),
            for_tests: is_for_tests || in_tests,
        }));
        before = line;
    }
    found
}

/// Returns a path that starts in the folder of a source, from the root.
fn beside(source: &str, path: &str) -> String {
    let mut parts: Vec<&str> = source.split('/').collect();
    parts.pop();
    for part in path.split('/') {
        match part {
            ".." => drop(parts.pop()),
            "." => {}
            part => parts.push(part),
        }
    }
    parts.join("/")
}

#[cfg(test)]
mod checks {
    use super::*;

    #[test]
    fn files_are_found_wherever_they_lie() {
        let text = "#![doc = include_str!(\"../README.md\")]\n\
                    #[cfg(test)]\n#[path = \"../../tests/walked.rs\"]\nmod walked;\n\
                    const PAGE: &[u8] = include_bytes!(\"page.html\");\n\
                    #[cfg(test)]\nmod tests {\n    const ONE: &str = include_str!(\"one\");\n}\n";
        let included = of_source("host/cli/src/lib.rs", text);
        let found: Vec<(&str, bool)> =
            included.iter().map(|it| (it.file.as_str(), it.for_tests)).collect();
        let expected = [
            ("host/cli/README.md", false),
            ("host/tests/walked.rs", true),
            ("host/cli/src/page.html", false),
            ("host/cli/src/one", true),
        ];
        assert_eq!(found, expected);
    }
}
