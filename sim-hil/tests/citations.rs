//! Every equation, table, section and figure of the paper that sources and documentation cite exists.
//!
//! The paper is not part of the repository; what it numbers is listed in the first table of docs/paper.md.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Kind and number, for example ("table", "III").
type Citation = (&'static str, String);

const KINDS: [&str; 4] = ["equation", "table", "section", "figure"];
/// What may stand between two numbers of one citation.
const JOINTS: [&str; 3] = ["and", "or", "to"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Returns sources and pages below a folder, but for what is built.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let is_read = |path: &PathBuf| {
        path.extension()
            .is_some_and(|it| ["rs", "md", "toml", "py"].iter().any(|wanted| it == *wanted))
    };
    let (folders, files): (Vec<_>, Vec<_>) = entries.partition(|path| path.is_dir());
    let inner = folders.iter().filter(|folder| !folder.ends_with("target"));
    files.into_iter().filter(is_read).chain(inner.flat_map(|folder| self::files(folder))).collect()
}

/// Tells the paper's way to number this kind from other numbers.
fn is_number(kind: &str, text: &str) -> bool {
    let roman = |text: &str| !text.is_empty() && text.chars().all(|c| "IVX".contains(c));
    match kind {
        "equation" => !text.is_empty() && text.chars().all(|c| c.is_ascii_digit()),
        "table" => roman(text),
        "section" => match text.split_once('-') {
            Some((chapter, part)) => roman(chapter) && matches!(part.as_bytes(), [b'A'..=b'Z']),
            None => roman(text),
        },
        _ => {
            let digits = text.trim_end_matches(|c: char| c.is_ascii_lowercase());
            text.len() <= digits.len() + 1 && is_number("equation", digits)
        }
    }
}

/// Returns what a text cites, read across the ends of lines and the marks of comments.
fn citations(text: &str) -> Vec<Citation> {
    let lines = text.lines().map(|line| line.trim_start().trim_start_matches(['/', '!', '#']));
    let joined = lines.collect::<Vec<_>>().join(" ");
    let words: Vec<&str> = joined.split_whitespace().collect();
    let mut found = Vec::new();
    for (at, word) in words.iter().enumerate() {
        let word = word.trim_matches(|c: char| !c.is_alphanumeric()).to_lowercase();
        let Some(kind) = KINDS.into_iter().find(|kind| word.trim_end_matches('s') == *kind) else {
            continue;
        };
        for number in &words[at + 1..] {
            let bare = number.trim_matches(|c: char| !c.is_alphanumeric());
            if is_number(kind, bare) {
                found.push((kind, bare.to_owned()));
            } else if !JOINTS.contains(number) {
                break;
            }
        }
    }
    found
}

/// Returns what docs/paper.md lists: the first cells of its first table.
fn listed() -> BTreeSet<Citation> {
    let page = std::fs::read_to_string(root().join("sim-hil/docs/paper.md")).unwrap();
    let table = page.lines().skip_while(|line| !line.starts_with('|'));
    let cells = table
        .take_while(|line| line.starts_with('|'))
        .map(|line| line.split('|').nth(1).unwrap().to_owned());
    cells.flat_map(|cell| citations(&cell)).collect()
}

#[test]
fn every_number_of_the_paper_that_is_cited_exists() {
    let listed = listed();
    let mut cited = BTreeSet::new();
    let mut wrong = Vec::new();
    for part in ["protocol", "firmware", "host", "sim-hil", "README.md"] {
        let path = root().join(part);
        for path in if path.is_dir() { files(&path) } else { vec![path] } {
            if path.ends_with("tests/citations.rs") {
                continue;
            }
            let found = citations(&std::fs::read_to_string(&path).unwrap());
            wrong.extend(found.iter().filter(|it| !listed.contains(it)).map(|(kind, number)| {
                format!("{}: the paper has no {kind} {number}", path.display())
            }));
            cited.extend(found);
        }
    }
    assert_eq!(wrong, Vec::<String>::new());
    assert!(cited.len() > 30, "the citations are not found: {cited:?}");
}

#[test]
fn citations_are_read_across_lines_and_lists() {
    let text = "/// (paper, sections II-C and III-B, table\n/// IV): equations 6 and 7; figures 5a to 5e at 42 pairs.";
    let found: Vec<String> =
        citations(text).into_iter().map(|(kind, number)| format!("{kind} {number}")).collect();
    let expected = [
        "section II-C",
        "section III-B",
        "table IV",
        "equation 6",
        "equation 7",
        "figure 5a",
        "figure 5e",
    ];
    assert_eq!(found, expected);
}

#[test]
fn other_tables_and_sections_are_not_the_papers() {
    assert_eq!(citations("Table 5-2 of the data sheet, section 3.4, a table of Twists"), vec![]);
}

#[test]
fn the_papers_numbers_are_all_listed() {
    let count = |kind| listed().iter().filter(|(of, _)| *of == kind).count();
    assert_eq!((count("equation"), count("table")), (9, 4));
}
