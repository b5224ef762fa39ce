//! Every equation, table, section and figure of the paper that sources and documentation cite exists.
//!
//! The paper is not part of the repository; what it numbers is listed in the first table of docs/paper.md.
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Kind and number, for example ("table", "III").
type Citation = (&'static str, String);

/// Each kind with its words, in the singular.
const KINDS: [(&str, &[&str]); 4] = [
    ("equation", &["equation", "eq", "eqn"]),
    ("table", &["table", "tab"]),
    ("section", &["section", "sec", "sect", "\u{a7}"]),
    ("figure", &["figure", "fig"]),
];
/// Endings of the files that are read.
const TEXTS: [&str; 9] = ["rs", "md", "toml", "py", "js", "mjs", "html", "sh", "yaml"];
/// Folders that are not part of the repository.
const BUILT: [&str; 3] = ["target", "out", ".git"];
/// What may stand between two numbers of one citation.
const JOINTS: [&str; 5] = ["and", "or", "to", "-", "\u{2013}"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Returns sources and pages below a folder, but for what is built or written by a run.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let is_read = |path: &PathBuf| {
        path.extension().is_some_and(|it| TEXTS.iter().any(|wanted| it == *wanted))
    };
    let (folders, files): (Vec<_>, Vec<_>) = entries.partition(|path| path.is_dir());
    let is_ours = |folder: &&PathBuf| BUILT.iter().all(|name| !folder.ends_with(name));
    let inner = folders.iter().filter(is_ours);
    files.into_iter().filter(is_read).chain(inner.flat_map(|folder| self::files(folder))).collect()
}

/// Distinguishes the paper's way to number this kind from other numbers.
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
    let joined = lines.collect::<Vec<_>>().join(" ").replace('\u{a7}', "\u{a7} ");
    let words: Vec<&str> =
        joined.split([' ', '~', '\u{a0}', '\t']).filter(|it| !it.is_empty()).collect();
    let mut found = Vec::new();
    for (at, word) in words.iter().enumerate() {
        let word =
            word.trim_matches(|c: char| !c.is_alphanumeric() && c != '\u{a7}').to_lowercase();
        let word = word.trim_end_matches('s');
        let Some((kind, _)) = KINDS.into_iter().find(|(_, names)| names.contains(&word)) else {
            continue;
        };
        for number in &words[at + 1..] {
            let numbers = numbers(kind, number);
            if numbers.is_empty() && !JOINTS.contains(number) {
                break;
            }
            found.extend(numbers.into_iter().map(|number| (kind, number)));
        }
    }
    found
}

/// Returns the numbers in a word such as "17", "(17)'s", "3(b)" or "4\u{2013}7"; none where a part of it is no number.
fn numbers(kind: &str, word: &str) -> Vec<String> {
    let word = word.trim_end_matches("'s").replace('(', "");
    let dashes: &[char] = if kind == "section" { &[] } else { &['-'] };
    let parts = word.split(|c| ['\u{2013}', '/', ','].contains(&c) || dashes.contains(&c));
    let bare = parts.map(|part| part.trim_matches(|c: char| !c.is_alphanumeric()));
    let bare: Vec<String> = bare.filter(|part| !part.is_empty()).map(str::to_owned).collect();
    if bare.iter().all(|part| is_number(kind, part)) { bare } else { Vec::new() }
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
    for path in files(&root()) {
        if path.ends_with("tests/citations.rs") {
            continue;
        }
        let found = citations(&std::fs::read_to_string(&path).unwrap());
        wrong.extend(
            found.iter().filter(|it| !listed.contains(it)).map(|(kind, number)| {
                format!("{}: the paper has no {kind} {number}", path.display())
            }),
        );
        cited.extend(found);
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
fn citations_are_read_however_they_are_written() {
    let text = "eq. 17, Eqs. (18)\u{2013}(19); equations 4-7 \u{2013} 99; Fig. 3(z) and fig.\u{a0}9; \u{a7}VII-C, Sec. VIII; tables III/XI";
    let found: Vec<String> =
        citations(text).into_iter().map(|(kind, number)| format!("{kind} {number}")).collect();
    let expected = [
        "equation 17",
        "equation 18",
        "equation 19",
        "equation 4",
        "equation 7",
        "equation 99",
        "figure 3z",
        "figure 9",
        "section VII-C",
        "section VIII",
        "table III",
        "table XI",
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
