//! A test that no modules depend on each other in a circle: two of one folder that each need the other, directly or by way of more.
//!
//! Imports are read as text, tests left out. What a folder's own file (`mod.rs`, `lib.rs`) only passes on (`pub use`) counts
//! as taken from where it comes. What it defines itself its modules may take, unless it uses them in turn.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

use std::collections::{BTreeMap, BTreeSet};

use crate::run;
use crate::tree::Tree;
use crate::workspace::Workspace;

/// A module, or an item in one, by the names on the way to it from the root of its crate.
type Place = Vec<String>;

/// A crate.
#[derive(Default)]
struct House {
    modules: BTreeMap<Place, Module>,
}

/// What a module's file says.
#[derive(Default)]
struct Module {
    /// Paths that begin with `crate`, `super` or `self`.
    paths: Vec<Place>,
    /// Paths of `pub use`, by the name at their end.
    passed_on: BTreeMap<String, Place>,
    /// The paths that are not passed on, and those that begin with a module of its folder.
    used: Vec<Place>,
}

/// Roots whose own file may use modules that use it.
const UNTIDY: [&str; 3] = [
    "firmware/src/bin/flix-robot/main.rs",
    "firmware/src/bin/pil/main.rs",
    "sim-hil/python/src/lib.rs",
];

/// A module of a folder, another that it needs, and one path that says so.
type Needs = BTreeMap<String, BTreeMap<String, String>>;

impl House {
    /// Reads a crate from its root file, by the modules that it declares.
    fn read(root: &str, file: &dyn Fn(&str) -> Option<String>) -> Self {
        let mut house = Self::default();
        let folder = root.rsplit_once('/').map_or("", |(folder, _)| folder);
        house.add(Place::new(), &file(root).unwrap(), folder, file);
        house
    }

    fn add(
        &mut self,
        place: Place,
        text: &str,
        folder: &str,
        file: &dyn Fn(&str) -> Option<String>,
    ) {
        let words = without_tests(words(text));
        for (index, word) in words.iter().enumerate() {
            let [child, ";"] = words.get(index + 1..index + 3).unwrap_or_default() else {
                continue;
            };
            if *word != "mod" {
                continue;
            }
            let inner = format!("{folder}/{child}");
            // One that a path elsewhere declares is not looked for.
            let text = file(&format!("{inner}.rs")).or_else(|| file(&format!("{inner}/mod.rs")));
            if let Some(text) = text {
                let child = [place.as_slice(), &[(*child).to_owned()]].concat();
                self.add(child, &text, &inner, file);
            }
        }
        self.modules.insert(place, Module::of(&words));
    }

    /// Returns the module that a path leads to from a module.
    fn module(&self, from: &[String], path: &[String], depth: u32) -> Place {
        let mut rest = path;
        let mut place = from.to_vec();
        if let [first, after @ ..] = rest
            && first == "crate"
        {
            (place, rest) = (Place::new(), after);
        }
        while let [first, after @ ..] = rest
            && (first == "super" || first == "self")
        {
            if first == "super" {
                place.pop();
            }
            rest = after;
        }
        while let [next, after @ ..] = rest {
            let inner = [place.as_slice(), std::slice::from_ref(next)].concat();
            if self.modules.contains_key(&inner) {
                (place, rest) = (inner, after);
                continue;
            }
            let passed_on = self.modules.get(&place).and_then(|module| module.passed_on.get(next));
            return match passed_on {
                // Two that pass a name on to each other would never end.
                Some(from) if depth < 8 => self.module(&place, from, depth + 1),
                _ => place,
            };
        }
        place
    }

    /// Returns the modules of each folder that are in circles, with the paths that make them so.
    fn circles(&self) -> Vec<String> {
        let mut folders = BTreeMap::<Place, Needs>::new();
        for (place, module) in &self.modules {
            for path in &module.paths {
                let other = self.module(place, path, 0);
                let shared =
                    place.iter().zip(&other).take_while(|(one, other)| one == other).count();
                let (Some(one), Some(needed)) = (place.get(shared), other.get(shared)) else {
                    continue;
                };
                let needs = folders.entry(place[..shared].to_vec()).or_default();
                let said = format!("{} takes {}", place.join("/"), path.join("::"));
                needs.entry(one.clone()).or_default().entry(needed.clone()).or_insert(said);
            }
        }
        folders.values().flat_map(said_of_circles).collect()
    }
}

impl House {
    /// Returns what modules take from the file of a folder around them that needs them in turn.
    fn knots(&self) -> Vec<String> {
        let mut needs = BTreeMap::<&Place, BTreeMap<Place, &Place>>::new();
        for (place, module) in &self.modules {
            for path in &module.used {
                let other = self.module(place, path, 0);
                if other != *place {
                    needs.entry(place).or_default().entry(other).or_insert(path);
                }
            }
        }
        let leads = |from: &Place, to: &Place| {
            let (mut reached, mut open) = (BTreeSet::new(), vec![from]);
            while let Some(next) = open.pop() {
                let new = needs.get(next).into_iter().flat_map(BTreeMap::keys);
                open.extend(new.filter(|one| reached.insert(*one)));
            }
            reached.contains(to)
        };
        let up = needs.iter().flat_map(|(place, others)| {
            others
                .iter()
                .filter(move |(other, _)| place.starts_with(other))
                .map(move |it| (place, it))
        });
        up.filter(|(place, (other, _))| leads(other, place))
            .map(|(place, (_, path))| format!("{} takes {}", place.join("/"), path.join("::")))
            .collect()
    }
}

/// Returns what ties the modules of a folder that are in circles.
fn said_of_circles(needs: &Needs) -> Vec<String> {
    let reached = |from: &str| {
        let (mut reached, mut open) = (BTreeSet::new(), vec![from.to_owned()]);
        while let Some(next) = open.pop() {
            let new = needs.get(&next).into_iter().flat_map(BTreeMap::keys);
            open.extend(new.filter(|one| reached.insert((*one).clone())).cloned());
        }
        reached
    };
    let reached: BTreeMap<&String, BTreeSet<String>> =
        needs.keys().map(|one| (one, reached(one))).collect();
    let leads =
        |one: &String, other: &String| reached.get(one).is_some_and(|to| to.contains(other));
    let ties = needs.iter().flat_map(|(one, others)| {
        others.iter().filter(move |(other, _)| leads(other, one)).map(|(_, said)| said.clone())
    });
    ties.collect()
}

impl Module {
    fn of(words: &[&str]) -> Self {
        let mut module = Self::default();
        let children: BTreeSet<&str> =
            words.windows(3).filter(|it| it[0] == "mod" && it[2] == ";").map(|it| it[1]).collect();
        // Depths of braces at which a module inside this file begins.
        let (mut depth, mut inner) = (0_u32, Vec::new());
        let mut is_passed_on = false;
        for (index, word) in words.iter().enumerate() {
            match *word {
                "{" => {
                    if index >= 2 && words[index - 2] == "mod" {
                        inner.push(depth);
                    }
                    depth += 1;
                }
                "}" => {
                    depth = depth.saturating_sub(1);
                    inner.pop_if(|it| *it == depth);
                }
                "use" => is_passed_on = is_public(&words[..index]),
                ";" => is_passed_on = false,
                _ => {}
            }
            let starts = ["crate", "super", "self"].contains(word)
                && words.get(index + 1) == Some(&"::")
                && index.checked_sub(1).is_none_or(|before| words[before] != "::");
            let starts_below = children.contains(word)
                && words.get(index + 1) == Some(&"::")
                && (index == 0 || words[index - 1] != "::");
            if starts || starts_below {
                let mut paths = Vec::new();
                spread(words, index, &Place::new(), &mut paths);
                let paths = paths.into_iter().filter_map(|path| out_of(path, inner.len()));
                for path in paths {
                    if !is_passed_on {
                        module.used.push(path.clone());
                    }
                    if starts {
                        module.paths.push(path);
                    }
                }
            }
            if *word == "use" && is_public(&words[..index]) {
                let mut paths = Vec::new();
                spread(words, index + 1, &Place::new(), &mut paths);
                let named = paths.into_iter().filter_map(|path| Some((path.last()?.clone(), path)));
                module.passed_on.extend(named);
            }
        }
        module
    }
}

/// Returns a path from inside so many modules of one file, as from the file; `None` where it stays inside.
fn out_of(path: Place, depth: usize) -> Option<Place> {
    let up = path.iter().take_while(|word| *word == "super").count();
    match path.first().map(String::as_str) {
        Some("super") if up > depth => Some(path[depth..].to_vec()),
        Some("crate") => Some(path),
        _ if depth == 0 => Some(path),
        _ => None,
    }
}

/// Returns whether `pub` or `pub(...)` ends these words.
fn is_public(words: &[&str]) -> bool {
    match words {
        [.., "pub"] => true,
        [before @ .., ")"] => before
            .iter()
            .rposition(|word| *word == "(")
            .is_some_and(|open| before[..open].ends_with(&["pub"])),
        _ => false,
    }
}

/// Adds the paths that begin at this word, one for each name in braces, and returns where they end.
fn spread(words: &[&str], mut at: usize, before: &[String], found: &mut Vec<Place>) -> usize {
    let mut place = before.to_vec();
    loop {
        match words.get(at) {
            Some(&"{") => {
                at += 1;
                while let Some(word) = words.get(at).filter(|word| **word != "}") {
                    at = match *word {
                        "," => at + 1,
                        "as" => at + 2,
                        _ => spread(words, at, &place, found).max(at + 1),
                    };
                }
                return at + 1;
            }
            Some(word) if word.starts_with(is_of_a_name) => {
                // `crate::x::{self, y}`: the module itself.
                if *word != "self" || place.is_empty() {
                    place.push((*word).to_owned());
                }
                at += 1;
                if words.get(at) != Some(&"::") {
                    break;
                }
                at += 1;
            }
            _ => break,
        }
    }
    found.push(place);
    at
}

fn is_of_a_name(character: char) -> bool {
    character.is_alphanumeric() || character == '_'
}

/// Returns names, `::` and signs of a source; no comments, texts or characters.
fn words(mut rest: &str) -> Vec<&str> {
    let mut words = Vec::new();
    while let Some(first) = rest.chars().next() {
        let after = &rest[first.len_utf8()..];
        let hashes = after.len() - after.trim_start_matches('#').len();
        rest = if rest.starts_with("//") {
            rest.find('\n').map_or("", |end| &rest[end..])
        } else if rest.starts_with("/*") {
            after.find("*/").map_or("", |end| &after[end + 2..])
        } else if first == 'r' && after[hashes..].starts_with('"') {
            let (text, end) = (&after[hashes + 1..], format!("\"{}", "#".repeat(hashes)));
            text.find(&end).map_or("", |at| &text[at + end.len()..])
        } else if first == '"' {
            after_text(after)
        } else if first == '\'' {
            after_character(after)
        } else if is_of_a_name(first) {
            let end = rest.find(|other| !is_of_a_name(other)).unwrap_or(rest.len());
            words.push(&rest[..end]);
            &rest[end..]
        } else {
            let length = if rest.starts_with("::") { 2 } else { first.len_utf8() };
            if !first.is_whitespace() {
                words.push(&rest[..length]);
            }
            &rest[length..]
        };
    }
    words
}

/// Returns what follows a text, from behind its first quotation mark on.
fn after_text(text: &str) -> &str {
    let mut is_escaped = false;
    let end = text.find(|character| {
        let ends = character == '"' && !is_escaped;
        is_escaped = character == '\\' && !is_escaped;
        ends
    });
    end.map_or("", |end| &text[end + 1..])
}

/// Returns what follows a character such as `'x'`, or the mark of a lifetime.
fn after_character(text: &str) -> &str {
    let mut characters = text.chars();
    let first = characters.next().unwrap_or(' ');
    if first == '\\' {
        let end = text[2..].find('\'');
        return end.map_or("", |end| &text[end + 3..]);
    }
    characters.as_str().strip_prefix('\'').unwrap_or(text)
}

/// Leaves out items that are for tests.
fn without_tests(words: Vec<&str>) -> Vec<&str> {
    const FOR_TESTS: [&str; 7] = ["#", "[", "cfg", "(", "test", ")", "]"];
    let mut kept = Vec::new();
    let mut at = 0;
    while at < words.len() {
        if !words[at..].starts_with(&FOR_TESTS) {
            kept.push(words[at]);
            at += 1;
            continue;
        }
        // The item ends with its braces, or with a semicolon outside of all.
        let mut depth = 0_u32;
        while let Some(word) = words.get(at) {
            at += 1;
            match *word {
                "{" | "(" | "[" => depth += 1,
                ")" | "]" => depth -= 1,
                "}" if depth == 1 => break,
                "}" => depth -= 1,
                ";" if depth == 0 => break,
                _ => {}
            }
        }
    }
    kept
}

/// Returns the root files, of these, of the crates in a package's folder.
fn roots<'a>(files: &'a [String], folder: &str) -> impl Iterator<Item = &'a String> {
    let is_root = move |file: &&String| {
        let inner = file.strip_prefix(folder).and_then(|rest| rest.strip_prefix("src/"));
        inner.is_some_and(|inner| {
            ["lib.rs", "main.rs"].contains(&inner)
                || inner.strip_prefix("bin/").is_some_and(|name| {
                    name.ends_with("/main.rs") || !name.contains('/') && name.ends_with(".rs")
                })
        })
    };
    files.iter().filter(is_root)
}

#[test]
fn no_modules_of_a_package_need_each_other() {
    let tree = Tree::new(&run::root());
    let workspace = Workspace::read(&run::root()).unwrap();
    let files = tree.tracked().unwrap();
    let mut modules = 0;
    let mut circles = Vec::new();
    for name in workspace.names() {
        for root in roots(&files, workspace.folder(name).unwrap()) {
            let house = House::read(root, &|file| tree.now(file));
            modules += house.modules.len();
            let knots = if UNTIDY.contains(&root.as_str()) { Vec::new() } else { house.knots() };
            let all = house.circles().into_iter().chain(knots);
            circles.extend(all.map(|said| format!("{root}: {said}")));
        }
    }
    assert!(modules > 300, "only {modules} modules were read");
    assert!(
        circles.is_empty(),
        "move what both need to a module of its own:\n{}",
        circles.join("\n")
    );
}

/// Returns what ties the circles of a crate of these files.
fn circles(files: &[(&str, &str)]) -> Vec<String> {
    let file = |name: &str| {
        files.iter().find(|(file, _)| *file == name).map(|(_, text)| (*text).to_owned())
    };
    let house = House::read("src/lib.rs", &file);
    house.circles().into_iter().chain(house.knots()).collect()
}

#[test]
fn a_circle_of_two_of_three_and_through_what_a_folder_passes_on_is_seen() {
    let two = [
        ("src/lib.rs", "mod a; pub mod b;"),
        ("src/a.rs", "use crate::b::B; pub struct A;"),
        ("src/b.rs", "fn f() { crate::a::A; }"),
    ];
    assert_eq!(circles(&two), ["a takes crate::b::B", "b takes crate::a::A"]);
    let three = [
        ("src/lib.rs", "mod a; mod b; mod c;"),
        ("src/a/mod.rs", "mod inner;"),
        ("src/a/inner.rs", "use crate::{c, b::{self, B}};"),
        ("src/b.rs", "use super::c::C;"),
        ("src/c.rs", "use crate::a as first;"),
    ];
    assert_eq!(circles(&three).len(), 4);
    let passed_on = [
        ("src/lib.rs", "mod a; mod b; pub(crate) use a::{A, Other}; pub use b::B;"),
        ("src/a.rs", "use crate::B;"),
        ("src/b.rs", "use super::A;"),
    ];
    assert_eq!(circles(&passed_on), ["a takes crate::B", "b takes super::A"]);
}

#[test]
fn a_folder_that_uses_a_module_which_uses_it_is_seen_and_one_that_passes_it_on_is_none() {
    let inner = ("src/a/inner.rs", "use super::Ground; mod within { use super::super::Ground; }");
    for (own, ties) in [
        ("mod inner; pub struct Ground; fn f() { inner::g(); }", 1),
        ("mod inner; pub struct Ground; use self::inner::Inner;", 1),
        ("mod inner; pub struct Ground; pub use self::inner::Inner;", 0),
        ("mod inner; mod ground; pub use ground::Ground; use self::inner::Inner;", 0),
    ] {
        let ground = ("src/a/ground.rs", "pub struct Ground;");
        let files = [("src/lib.rs", "mod a;"), ("src/a/mod.rs", own), inner, ground];
        assert_eq!(circles(&files).len(), ties, "{own}");
    }
}

#[test]
fn tests_texts_comments_and_shared_ground_make_no_circle() {
    let files = [
        ("src/lib.rs", "mod a; mod b; #[cfg(test)] mod tests; pub struct Ground;"),
        ("src/a.rs", "use crate::{Ground, b::B}; const Q: char = '\"'; fn f<'a>(_: &'a str) {}"),
        (
            "src/b.rs",
            "// crate::a::A\nconst T: &str = \"\\\" crate::a::A\"; const R: &str = r#\"\" crate::a\"#;
             #[cfg(test)] use crate::a::A; #[cfg(test)] mod tests { use crate::a; } use crate::Ground;",
        ),
        ("src/tests.rs", "use crate::a; use crate::b;"),
    ];
    assert_eq!(circles(&files), Vec::<String>::new());
}
