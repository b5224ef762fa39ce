//! The list of this repository, and what makes lanes due, in clones made here.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;
use std::path::Path;

use super::due::{Judge, Reason};
use super::list::{FILE, List, Record, TABLE, with_record};
use super::{Args, run_lanes};
use crate::marked;
use crate::run;
use crate::test_repository::TestRepository;
use crate::tree::Tree;
use crate::workspace::Workspace;

impl TestRepository {
    /// Writes into the list that all lanes were green at the commit that is checked out.
    fn all_green(&self) {
        let head = self.tree().head().unwrap();
        let mut text = self.read(FILE);
        for lane in &List::parse(&text).unwrap().lanes {
            let record = Record { commit: head.clone(), date: "2026-11-25".into(), seconds: 7 };
            text = with_record(&text, &lane.name, &record).unwrap();
        }
        self.write(FILE, &text);
    }

    /// Returns the lanes that are due, with the reason.
    fn reasons(&self) -> BTreeMap<String, Reason> {
        let tree = self.tree();
        let list = List::read(&tree).unwrap();
        let mut judge = Judge::new(&tree, &list).unwrap();
        let named = |lane: &super::Lane| {
            judge.reason(lane).unwrap().map(|reason| (lane.name.clone(), reason))
        };
        list.lanes.iter().filter_map(named).collect()
    }

    fn due(&self) -> Vec<String> {
        self.reasons().into_keys().collect()
    }

    fn run(&self, words: &[&str]) -> Result<(), run::Error> {
        let (names, flags): (Vec<&str>, Vec<&str>) =
            words.iter().partition(|word| !word.starts_with("--"));
        let has = |flag: &str| flags.contains(&flag);
        let args = Args {
            names: names.into_iter().map(str::to_owned).collect(),
            run: true,
            all: has("--all"),
            long: has("--long"),
            apart: has("--apart").then_some(true).or(has("--together").then_some(false)),
            jobs: if has("--at-once") { NonZeroUsize::MAX } else { NonZeroUsize::MIN },
            record: has("--record"),
            table: false,
        };
        run_lanes(&self.tree(), &self.path("logs"), &args)
    }
}

/// A workspace: `upper` needs `base`, `inner` lies in the folder of `upper`, `tool` needs `upper` for its tests.
fn small() -> TestRepository {
    let package = |name: &str, rest: &str| {
        format!("[package]\nname = \"{name}\"\nversion = \"0.1.0\"\nedition = \"2024\"\n{rest}")
            .into_bytes()
    };
    let plain = |text: &str| text.as_bytes().to_vec();
    let clone = TestRepository::of([
        (
            "Cargo.toml",
            plain(
                "[workspace]\nresolver = \"3\"\nmembers = [\"base\", \"upper\", \"upper/inner\", \"tool\"]\n",
            ),
        ),
        ("base/Cargo.toml", package("base", "")),
        ("base/src/lib.rs", plain("")),
        ("base/src/more.rs", plain("")),
        ("upper/Cargo.toml", package("upper", "[dependencies]\nbase = { path = \"../base\" }\n")),
        ("upper/src/lib.rs", plain("")),
        ("upper/README.md", plain("")),
        ("upper/inner/Cargo.toml", package("inner", "")),
        ("upper/inner/src/lib.rs", plain("")),
        ("upper/inner/src/more.rs", plain("")),
        (
            "tool/Cargo.toml",
            package("tool", "[dev-dependencies]\nupper = { path = \"../upper\" }\n"),
        ),
        ("tool/src/lib.rs", plain("")),
        (".ci/check", plain("")),
        (".ci/data", plain("")),
        (".ci/run", plain("")),
        (".gitignore", plain("/target\n/logs\n/Cargo.lock.orig\n")),
        ("Cargo.lock", plain(LOCK)),
        ("PAGE.md", plain("# Page\n<!-- lanes: x -->\n<!-- end of lanes -->\n")),
        (FILE, plain(LIST)),
    ]);
    clone.all_green();
    clone.commit();
    clone
}

const LIST: &str = r#"# What is checked.
page = "PAGE.md"
common = ["Cargo.toml"]
except = ["**/*.md"]

[always]
packages = []
files = [".ci/run", ".ci/data", ".ci/lanes.toml", ".gitignore", "*.md", "Cargo.lock"]

# Of the one.
[[lane]]
name = "base"
checks = "the base"
packages = ["base"]
run = [
    "echo base",
    "test ! -e fail",
]

# Of the other.
[[lane]]
name = "inner"
checks = "what lies within"
packages = ["inner"]
run = ["echo inner"]

[[lane]]
name = "script"
checks = "a script"
files = [".ci/check"]
run = ["echo script", "touch logs/script-ran"]

[[lane]]
name = "tool"
checks = "the tool"
packages = ["tool"]
except = ["upper/src/excepted.rs"]
long = true
run = ["echo tool"]
"#;

const LOCK: &str = r#"version = 4

[[package]]
name = "base"
version = "0.1.0"
dependencies = ["near"]

[[package]]
name = "far"
version = "1.0.0"
source = "registry+x"
checksum = "f1"

[[package]]
name = "far"
version = "2.0.0"
source = "registry+x"
checksum = "f2"

[[package]]
name = "inner"
version = "0.1.0"
dependencies = ["far 2.0.0"]

[[package]]
name = "near"
version = "1.0.0"
source = "registry+x"
checksum = "n1"
dependencies = ["far 1.0.0"]

[[package]]
name = "tool"
version = "0.1.0"
dependencies = ["upper"]

[[package]]
name = "unused"
version = "1.0.0"
source = "registry+x"
checksum = "u1"

[[package]]
name = "upper"
version = "0.1.0"
dependencies = ["base"]
"#;

#[test]
fn nothing_is_due_after_a_green_run() {
    assert_eq!(small().due(), [""; 0]);
}

#[test]
fn a_lane_is_due_when_something_changes_that_its_sources_take_in_wherever_it_lies() {
    let clone = small();
    clone.write("upper/src/lib.rs", "#[path = \"../inner/src/more.rs\"]\nmod more;\n");
    clone
        .write("upper/inner/src/more.rs", "const A: &str = include_str!(\"../../../.ci/data\");\n");
    clone.commit();
    clone.all_green();
    assert_eq!(clone.due(), [""; 0]);
    clone.write(".ci/data", "1\n");
    assert_eq!(clone.due(), ["inner", "tool"]);
}

#[test]
fn a_lane_is_due_when_its_package_or_one_that_this_needs_changes() {
    let clone = small();
    clone.write("base/src/lib.rs", "//! Edited.\n");
    assert_eq!(clone.due(), ["base", "tool"]);
    clone.commit();
    assert_eq!(clone.due(), ["base", "tool"]);
    assert_eq!(clone.reasons()["base"], Reason::File("base/src/lib.rs".into(), 0));
}

#[test]
fn a_package_within_the_folder_of_another_belongs_to_itself() {
    let clone = small();
    clone.write("upper/inner/src/lib.rs", "//! Edited.\n");
    assert_eq!(clone.due(), ["inner"]);
}

#[test]
fn new_and_removed_and_moved_files_count_and_ignored_ones_do_not() {
    let clone = small();
    clone.write("target/x", "");
    clone.write("upper/README.md", "for people");
    clone.write("upper/src/excepted.rs", "");
    assert_eq!(clone.due(), [""; 0]);
    clone.write("upper/src/new.rs", "");
    assert_eq!(clone.due(), ["tool"]);
    std::fs::remove_file(clone.path("upper/inner/src/more.rs")).unwrap();
    assert_eq!(clone.due(), ["inner", "tool"]);
    std::fs::rename(clone.path("base/src/more.rs"), clone.path("base.rs")).unwrap();
    assert_eq!(clone.due(), ["base", "inner", "tool"]);
}

#[test]
fn a_file_that_a_pattern_names_makes_its_lane_due() {
    let clone = small();
    clone.write(".ci/check", "true\n");
    assert_eq!(clone.due(), ["script"]);
}

#[test]
fn what_all_depend_on_makes_all_due() {
    let clone = small();
    clone.edit("Cargo.toml", "[workspace]", "# Edited.\n[workspace]");
    assert_eq!(clone.due(), ["base", "inner", "script", "tool"]);
}

#[test]
fn another_version_makes_due_what_follows_from_it_and_nothing_else() {
    for (from, to, due, words) in [
        ("n1", "n2", &["base", "tool"][..], "near 1.0.0 -> 1.0.0"),
        ("\"2.0.0\"", "\"2.0.1\"", &["inner"], "far 2.0.0 -> none"),
        ("dependencies = [\"near\"]\n", "", &["base", "tool"], "far 1.0.0 -> none"),
        ("u1", "u2", &[], ""),
    ] {
        let clone = small();
        clone.edit("Cargo.lock", from, to);
        assert_eq!(clone.due(), due, "{from} -> {to}");
        let is_named = |reason: &Reason| reason.to_string().starts_with(words);
        assert!(clone.reasons().values().all(is_named), "{:?}", clone.reasons());
    }
}

#[test]
fn another_command_makes_its_lane_due_and_another_record_or_comment_does_not() {
    let clone = small();
    clone.edit(FILE, "seconds = 7", "seconds = 8");
    clone.edit(FILE, "# Of the one.", "# Of the first.");
    assert_eq!(clone.due(), [""; 0]);
    clone.edit(FILE, "echo inner", "echo more");
    assert_eq!(clone.due(), ["inner"]);
    assert_eq!(clone.reasons()["inner"], Reason::Entry);
}

#[test]
fn a_lane_is_due_without_a_record_and_where_the_clone_lacks_its_commit() {
    let clone = small();
    let head = clone.tree().head().unwrap();
    let (kept, _) = LIST.split_once("# Of the one.").unwrap();
    let text = clone.read(FILE);
    let (_, lanes) = text.split_once("# Of the one.").unwrap();
    let last = lanes.lines().find(|line| line.starts_with("last = ")).unwrap().to_owned();
    clone.write(FILE, &format!("{kept}# Of the one.{}", lanes.replacen(&last, "", 1)));
    assert_eq!(clone.reasons()["base"], Reason::NeverGreen);
    let absent = "0123456789".repeat(4);
    clone.write(FILE, &text.replacen(last.split('"').nth(1).unwrap(), &absent, 1));
    assert_ne!(head, absent);
    assert_eq!(clone.reasons(), [("base".to_owned(), Reason::Unknown(absent))].into());
}

#[test]
fn a_shallow_clone_runs_what_it_knows_nothing_of() {
    let clone = small();
    clone.commit();
    let folder = tempfile::tempdir().unwrap();
    let source = format!("file://{}", clone.folder.path().display());
    let shallow = folder.path().join("shallow");
    clone.git(&["clone", "--quiet", "--depth", "1", &source, &shallow.to_string_lossy()]);
    let tree = Tree::new(&shallow);
    let list = List::read(&tree).unwrap();
    let mut judge = Judge::new(&tree, &list).unwrap();
    for lane in &list.lanes {
        assert!(matches!(judge.reason(lane).unwrap(), Some(Reason::Unknown(_))), "{}", lane.name);
    }
}

#[test]
fn a_new_crate_or_script_that_belongs_to_no_lane_is_named() {
    let clone = small();
    let orphans = || {
        let tree = clone.tree();
        let list = List::read(&tree).unwrap();
        Judge::new(&tree, &list).unwrap().orphans(&tree.tracked().unwrap())
    };
    assert_eq!(orphans(), [""; 0]);
    clone.edit("Cargo.toml", "\"tool\"", "\"tool\", \"new\"");
    clone.write("new/Cargo.toml", &clone.read("base/Cargo.toml").replace("base", "new"));
    clone.write("new/src/lib.rs", "");
    clone.write(".ci/new", "");
    clone.git(&["add", "--all"]);
    let [package, script] = &orphans()[..] else { panic!("{:?}", orphans()) };
    assert!(package.starts_with("the package new belongs to no lane: name it"), "{package}");
    assert!(script.starts_with(".ci/new belongs to no lane: name it"), "{script}");
    clone.edit(FILE, "packages = []", "packages = [\"new\"]");
    clone.edit(FILE, "\".ci/run\"", "\".ci/run\", \".ci/new\"");
    assert_eq!(orphans(), [""; 0]);
}

#[test]
fn a_lane_of_a_package_that_is_gone_is_refused() {
    let clone = small();
    clone.edit(FILE, "[\"inner\"]", "[\"gone\"]");
    let error = clone.run(&[]).unwrap_err().to_string();
    assert!(error.contains("the lane inner names the package \"gone\""), "{error}");
}

#[test]
fn a_record_is_written_and_nothing_else_changes() {
    let record = Record { commit: "c0ffee".into(), date: "2026-11-25".into(), seconds: 12 };
    let line = "last = { commit = \"c0ffee\", date = \"2026-11-25\", seconds = 12 }\n";
    let written = with_record(LIST, "base", &record).unwrap();
    assert_eq!(
        written,
        LIST.replacen("\n\n# Of the other.", &format!("\n{line}\n# Of the other."), 1)
    );
    let again = Record { seconds: 13, ..record };
    let line_again = line.replace("12", "13");
    let rewritten = with_record(&written, "base", &again).unwrap();
    assert_eq!(rewritten, written.replace(line, &line_again));
    assert_eq!(with_record(LIST, "tool", &again).unwrap(), format!("{LIST}{line_again}"));
    assert!(with_record(LIST, "no such", &again).is_err());
}

#[test]
fn those_that_are_due_run_and_leave_their_record_and_are_not_run_again() {
    let clone = small();
    clone.write("base/src/lib.rs", "//! Edited.\n");
    let head = clone.commit();
    clone.run(&["--record"]).unwrap();
    assert!(!clone.path("logs/script-ran").exists(), "what is not due has run");
    assert_eq!(clone.due(), ["tool"], "the long one");
    let page = clone.read("PAGE.md");
    let row = format!(
        "| base | the base | `.ci/run` | {}",
        &clone.read(FILE).split_once("date = \"").unwrap().1[..10]
    );
    assert!(marked::part(&page, TABLE).unwrap().contains(&row), "{page}");
    // What was recorded on the way is no change that forbids to go on.
    clone.run(&["--record", "--long"]).unwrap();
    assert_eq!(clone.due(), [""; 0]);
    assert_eq!(clone.read(FILE).matches(&head).count(), 2);
    assert!(
        std::fs::read_to_string(clone.path("logs/base.log"))
            .unwrap()
            .contains("+ echo base\nbase\n")
    );
}

#[test]
fn all_but_those_that_keep_up_with_the_clock_yield_to_others() {
    let clone = small();
    let niceness = |lane: &str| -> i32 {
        clone.run(&["--all", lane]).unwrap();
        let log = std::fs::read_to_string(clone.path(&format!("logs/{lane}.log"))).unwrap();
        log.lines().find_map(|line| line.parse().ok()).unwrap()
    };
    clone.edit(FILE, "echo script", "nice");
    let of_others = niceness("script");
    clone.edit(FILE, "name = \"script\"", "name = \"script\"\npaced = true");
    // A session may run at the lowest priority.
    assert!(niceness("script") < of_others || of_others == 19);
}

#[test]
fn those_that_run_beside_the_tests_and_the_others_are_all() {
    let clone = small();
    clone.edit(FILE, "name = \"script\"", "name = \"script\"\napart = true");
    let log = |lane: &str| clone.path(&format!("logs/{lane}.log")).exists();
    clone.run(&["--all", "--apart"]).unwrap();
    assert!(log("script") && !log("base") && !log("inner") && !log("tool"));
    std::fs::remove_file(clone.path("logs/script.log")).unwrap();
    clone.run(&["--all", "--together"]).unwrap();
    assert!(!log("script") && log("base") && log("inner") && !log("tool"), "a long one");
    clone.run(&["--all", "--long", "--together"]).unwrap();
    assert!(log("tool"));
}

#[test]
fn several_run_at_once_and_each_leaves_its_record_or_is_named() {
    let clone = small();
    // Each waits for the other.
    let meet = |own: &str, other: &str| {
        format!("touch logs/{own}; timeout 60 sh -c 'until test -e logs/{other}; do :; done'")
    };
    clone.edit(FILE, "echo base", &meet("base-ran", "inner-ran"));
    clone.edit(FILE, "echo inner", &meet("inner-ran", "base-ran"));
    clone.edit(FILE, "echo script", "exit 1");
    clone.commit();
    let error = clone.run(&["--at-once", "--record"]).unwrap_err().to_string();
    assert!(error.starts_with("1 of 3 lanes failed: script;"), "{error}");
    assert_eq!(clone.due(), ["script"]);
}

#[test]
fn all_runs_what_is_not_due() {
    let clone = small();
    clone.run(&["--all", "script"]).unwrap();
    assert!(clone.path("logs/script-ran").exists());
}

#[test]
fn one_that_fails_is_named_after_the_others_ran() {
    let clone = small();
    clone.write("fail", "");
    let error = clone.run(&["--all"]).unwrap_err().to_string();
    assert!(error.starts_with("1 of 3 lanes failed: base;"), "{error}");
    assert!(clone.path("logs/script-ran").exists());
}

#[test]
fn a_run_is_recorded_for_what_the_commit_holds_alone() {
    let clone = small();
    clone.write("upper/README.md", "edited\n");
    let error = clone.run(&["--all", "--record"]).unwrap_err().to_string();
    assert!(error.contains("upper/README.md differs from"), "{error}");
    clone.commit();
    clone.write("base/src/new.rs", "");
    let error = clone.run(&["--all", "--record"]).unwrap_err().to_string();
    assert!(error.contains("base/src/new.rs differs from"), "{error}");
    clone.commit();
    clone.edit(FILE, "echo inner", "echo more");
    let error = clone.run(&["--all", "--record"]).unwrap_err().to_string();
    assert!(error.contains(".ci/lanes.toml differs from"), "{error}");
}

#[test]
fn a_run_during_which_its_inputs_changed_is_not_recorded() {
    let clone = small();
    clone.edit(FILE, "echo inner", "touch upper/inner/src/new.rs");
    clone.commit();
    clone.run(&["--record"]).unwrap();
    assert_eq!(clone.due(), ["inner"]);
}

/// Returns the clone that this program is built from; nothing where it was unpacked from an archive.
fn here() -> Option<Tree> {
    let tree = Tree::new(&run::root());
    tree.root().join(".git").exists().then_some(tree)
}

#[test]
fn every_package_and_file_here_belongs_to_a_lane_or_is_always_checked() {
    let Some(tree) = here() else { return };
    let list = List::read(&tree).unwrap();
    let files = tree.tracked().unwrap();
    let orphans = Judge::new(&tree, &list).unwrap().orphans(&files);
    assert!(orphans.is_empty(), "{}", orphans.join("\n"));
    let idle: Vec<&str> = list.lanes.iter().flat_map(|lane| lane.files.idle(&files)).collect();
    assert!(idle.is_empty(), "patterns of lanes that name no file: {}", idle.join(", "));
}

#[test]
fn what_the_lines_of_each_lane_here_name_is_what_it_depends_on() {
    let Some(tree) = here() else { return };
    let list = List::read(&tree).unwrap();
    let judge = Judge::new(&tree, &list).unwrap();
    let workspace = Workspace::read(tree.root()).unwrap();
    let files = tree.tracked().unwrap();
    for lane in &list.lanes {
        let mut text = lane.run.join("\n");
        let named_in = |text: &str| -> Vec<String> {
            let is_part = |letter: char| letter.is_alphanumeric() || "._-/".contains(letter);
            let words = text.split(|letter| !is_part(letter));
            let words: BTreeSet<&str> =
                words.map(|word| word.strip_prefix('/').unwrap_or(word)).collect();
            files.iter().filter(|file| words.contains(file.as_str())).cloned().collect()
        };
        let scripts = named_in(&text);
        let scripts: Vec<String> = scripts.iter().filter_map(|file| tree.now(file)).collect();
        text.push_str(&scripts.join("\n"));
        let named = named_in(&text);
        let inputs = judge.inputs(lane, &named);
        assert_eq!(inputs, named, "{} runs or reads files that it does not depend on", lane.name);
        // What follows `-p`, and this program.
        let options: Vec<&str> = text.split_whitespace().collect();
        let pairs = options.windows(2).filter(|pair| pair[0] == "-p").map(|pair| pair[1]);
        let ours = text.contains("cargo xtask").then_some("xtask");
        let packages = workspace.closure(&lane.packages);
        for package in pairs.chain(ours).filter(|name| workspace.names().any(|one| one == *name)) {
            let is_input = packages.contains(package);
            assert!(is_input, "{} builds {package} and does not depend on it", lane.name);
        }
        // Any package may ask for a feature of what is built with all of them.
        let manifests = workspace.names().filter_map(|name| workspace.folder(name));
        let manifests: Vec<String> = manifests.map(|it| format!("{it}Cargo.toml")).collect();
        let is_of_all = text.contains("--workspace") || text.contains("cargo xtask test");
        let all = judge.inputs(lane, &manifests).len() == manifests.len();
        assert!(all || !is_of_all, "{} builds with --workspace: name \"**/Cargo.toml\"", lane.name);
    }
}

#[test]
fn every_script_here_is_run_by_a_lane_or_a_test() {
    let Some(tree) = here() else { return };
    let list = List::read(&tree).unwrap();
    let files = tree.tracked().unwrap();
    let of_shell = files.iter().filter(|file| file.starts_with(".ci/") && *file != FILE);
    let sources = files.iter().filter(|file| file.ends_with(".rs"));
    let texts = of_shell.chain(sources).filter_map(|it| tree.now(it));
    let texts = texts.chain(list.lanes.iter().map(|lane| lane.run.join("\n")));
    let is_comment = |line: &str| line.trim_start().starts_with(['#', '/']);
    let text = texts.collect::<Vec<_>>().join("\n");
    let lines: Vec<&str> = text.lines().filter(|line| !is_comment(line)).collect();
    let is_script = |file: &&String| {
        let name = Path::new(file.as_str());
        let is_program = |text: String| text.starts_with("#!") || text.contains("\"__main__\"");
        match name.extension().and_then(|it| it.to_str()) {
            Some("sh" | "mjs") => true,
            Some("py") => tree.now(file).is_some_and(is_program),
            _ => false,
        }
    };
    // By its name, as a module, or with all of its folder.
    let is_run = |file: &str| {
        let (folder, name) = file.rsplit_once('/').unwrap_or(("", file));
        let (stem, ending) = name.rsplit_once('.').unwrap_or((name, ""));
        let module = format!("{}.{stem}", folder.rsplit('/').next().unwrap_or(folder));
        let ways = [name.to_owned(), module, format!("{folder}/*.{ending}")];
        lines.iter().any(|line| ways.iter().any(|way| line.contains(way)))
    };
    let idle: Vec<&String> = files.iter().filter(is_script).filter(|file| !is_run(file)).collect();
    assert!(idle.is_empty(), "no lane and no test runs {idle:?}");
}

#[test]
fn the_table_of_the_page_is_that_of_the_list() {
    let Some(tree) = here() else { return };
    let list = List::read(&tree).unwrap();
    let page = tree.now(&list.page).unwrap();
    let is_renewed = marked::part(&page, TABLE) == Some(&list.table());
    assert!(is_renewed, "{} has another table: `cargo xtask lanes --table` renews it", list.page);
}
