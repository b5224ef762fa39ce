//! What the documents point at exists: files, folders and headings of the repository.
use std::path::{Path, PathBuf};

/// Folders that are not part of the repository.
const BUILT: [&str; 3] = ["target", "out", ".git"];
/// Endings of files that running text names by their path from the root.
const NAMED: [&str; 6] = [".rs", ".toml", ".py", ".csv", ".mjs", ".sh"];
/// What was true of earlier versions, and may name what is gone.
const HISTORY: &str = "CHANGELOG.md";

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn documents(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let (folders, files): (Vec<_>, Vec<_>) = entries.partition(|path| path.is_dir());
    let is_document =
        |file: &PathBuf| file.extension().is_some_and(|it| it == "md") && !file.ends_with(HISTORY);
    let ours = folders.iter().filter(|folder| BUILT.iter().all(|name| !folder.ends_with(name)));
    let inner = ours.flat_map(|folder| documents(folder));
    files.into_iter().filter(is_document).chain(inner).collect()
}

/// Returns the targets of a page's links.
fn links(text: &str) -> Vec<&str> {
    let ends = text.split("](").skip(1);
    ends.filter_map(|rest| rest.split_once(')')).map(|(target, _)| target).collect()
}

/// Returns how a heading is linked to: in small letters, without punctuation, hyphens for spaces.
fn anchor(heading: &str) -> String {
    let kept = heading.trim_start_matches('#').trim().chars();
    let kept = kept.filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c));
    kept.collect::<String>().to_lowercase().replace(' ', "-")
}

/// Returns what a target lacks: the file, or the heading in it.
fn lacks(page: &Path, target: &str) -> Option<String> {
    if target.contains("://") {
        return None;
    }
    let (file, heading) = target.split_once('#').unwrap_or((target, ""));
    let file = if file.is_empty() { page.to_owned() } else { page.parent().unwrap().join(file) };
    if !file.exists() {
        return Some(format!("{}: no {target}", page.display()));
    }
    let has =
        |text: String| text.lines().any(|line| line.starts_with('#') && anchor(line) == heading);
    let is_there = heading.is_empty() || std::fs::read_to_string(file).is_ok_and(has);
    (!is_there).then(|| format!("{}: no heading of {target}", page.display()))
}

#[test]
fn every_link_of_the_documents_leads_somewhere() {
    let pages = documents(&root());
    let mut wrong = Vec::new();
    let mut count = 0;
    for page in &pages {
        let text = std::fs::read_to_string(page).unwrap();
        count += links(&text).len();
        wrong.extend(links(&text).into_iter().filter_map(|target| lacks(page, target)));
    }
    assert_eq!(wrong, Vec::<String>::new());
    assert!(count > 100, "the links are not found: {count}");
}

#[test]
fn every_source_that_the_documents_name_exists() {
    let mut wrong = Vec::new();
    for page in documents(&root()) {
        let text = std::fs::read_to_string(&page).unwrap();
        let spans = text.split('`').skip(1).step_by(2);
        let named = spans.filter(|span| {
            let is_path = span.contains('/') && !span.contains([' ', '<', '*']);
            is_path && NAMED.iter().any(|ending| span.ends_with(ending))
        });
        // From the root, from the page's folder, or from one above it.
        let exists = |path: &str| page.ancestors().skip(1).any(|folder| folder.join(path).exists());
        let lost = named.filter(|span| !span.starts_with(['/', '~']) && !exists(span));
        wrong.extend(lost.map(|span| format!("{}: no {span}", page.display())));
    }
    assert_eq!(wrong, Vec::<String>::new());
}

#[test]
fn a_link_to_what_is_gone_is_seen() {
    let page = root().join("README.md");
    assert_eq!(lacks(&page, "CONTRIBUTING.md#add-a-setting"), None);
    assert!(lacks(&page, "CONTRIBUTING.md#add-nothing").is_some());
    assert!(lacks(&page, "no/such/page.md").is_some());
}
