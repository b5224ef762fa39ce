//! `cargo xtask quick`: whether a change is wrong, within a minute or two.
//!
//! | step | of what |
//! |---|---|
//! | format | the workspace |
//! | types | what changed, and all that needs it; everything where versions or the compiler changed |
//! | lints | the packages that changed |
//! | tests | the packages that changed |
//!
//! All of it is built as `cargo test --workspace` and `.ci/run` build it, in the same folder, so that nothing is built twice.

use std::collections::BTreeSet;
use std::process::Command;
use std::time::Instant;

use crate::included::{Included, included};
use crate::lanes::{LIST, List};
use crate::run::{self, Error};
use crate::toolchain;
use crate::tree::{Tree, short};
use crate::workspace::Workspace;

/// Makes cargo give dependencies the features that the whole workspace asks for, whichever packages are named; else a test of one
/// package builds most of its dependencies once more. The pinned cargo knows this, and keeps it for nightly ones, which the
/// last variable lets it take itself for; the compiler and build scripts see no difference.
const UNIFIED: [(&str, &str); 3] = [
    ("CARGO_UNSTABLE_FEATURE_UNIFICATION", "true"),
    ("CARGO_RESOLVER_FEATURE_UNIFICATION", "workspace"),
    ("__CARGO_TEST_CHANNEL_OVERRIDE_DO_NOT_USE_THIS", "nightly"),
];
/// Pages for people: no part of the package in whose folder they lie.
const PAGES: &str = ".md";
/// Versions of all that is built.
const LOCK: &str = "Cargo.lock";
/// The package whose tests read the list of lanes.
const OWN: &str = env!("CARGO_PKG_NAME");

/// What counts as changed.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// What differs from this commit; by default what is not committed, or else the last commit.
    #[arg(long, value_name = "COMMIT")]
    since: Option<String>,
}

/// What is passed on to `cargo test`.
#[derive(clap::Args)]
pub(crate) struct TestArgs {
    /// Options of `cargo test`, such as `-p flix-protocol`.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

/// Tests single packages as the whole workspace's tests build them.
pub(crate) fn test(args: &TestArgs) -> Result<(), Error> {
    run::run(unified().arg("test").args(&args.arguments))
}

/// Prepares cargo for single packages, which share what the whole workspace's tests have built.
fn unified() -> Command {
    let mut cargo = toolchain::cargo();
    cargo.envs(UNIFIED);
    cargo
}

/// Returns the commit that a change is compared with.
fn base(tree: &Tree, since: Option<&str>) -> Result<String, Error> {
    if let Some(since) = since {
        return tree.commit(since).map_err(|_| {
            Error::Sentence(format!("this clone has no commit {since:?}: name one, such as main"))
        });
    }
    let head = tree.head()?;
    if !tree.changed_since(&head)?.is_empty() {
        return Ok(head);
    }
    // The first commit of all, or of a shallow clone, is compared with itself.
    Ok(tree.commit("HEAD~1").unwrap_or(head))
}

/// Returns the packages that these files belong to, and those whose sources take them in.
fn packages<'a>(
    workspace: &'a Workspace,
    included: &[Included],
    files: &[String],
) -> BTreeSet<&'a str> {
    let owners = files.iter().filter(|file| !file.ends_with(PAGES));
    let includers = included.iter().filter(|it| files.contains(&it.file)).map(|it| &it.by);
    let packages = owners.chain(includers).filter_map(|file| workspace.owner(file));
    let own = files.iter().any(|file| file == LIST).then_some(OWN);
    packages.chain(own).collect()
}

/// A step: its name, the arguments of cargo, and what a user types to repeat it.
struct Step {
    name: &'static str,
    arguments: Vec<String>,
    repeat: String,
}

impl Step {
    fn new(name: &'static str, words: &[&str]) -> Self {
        let arguments = words.iter().map(|word| (*word).to_owned()).collect();
        Self { name, arguments, repeat: format!("cargo {}", words.join(" ")) }
    }

    fn run(&self) -> Result<(), Error> {
        println!("== {}: {}", self.name, self.repeat);
        let start = Instant::now();
        let outcome = run::run(unified().args(&self.arguments));
        println!("== {}: {:.1} s", self.name, start.elapsed().as_secs_f64());
        outcome.map_err(|_| {
            Error::Sentence(format!("{} failed; repeat it with `{}`", self.name, self.repeat))
        })
    }
}

/// Returns the options of cargo that name these packages.
fn named<'a>(packages: &BTreeSet<&'a str>) -> Vec<&'a str> {
    packages.iter().flat_map(|name| ["-p", *name]).collect()
}

/// Returns the steps for packages that changed, and all that need them: nobody where only pages changed.
fn steps(changed: &BTreeSet<&str>, dependents: &BTreeSet<&str>) -> Vec<Step> {
    let format = Step::new("format", &["fmt", "--all", "--check"]);
    let (changed, dependents) = (named(changed), named(dependents));
    let types = [&["check", "--all-targets"][..], &dependents].concat();
    if changed.is_empty() {
        let types = (!dependents.is_empty()).then(|| Step::new("types", &types));
        return [format].into_iter().chain(types).collect();
    }
    let lints = [&["clippy", "--all-targets"][..], &changed, &["--", "-D", "warnings"]].concat();
    let tests = Step::new("tests", &[&["test"][..], &changed].concat());
    // What is typed builds as this does.
    let tests = Step { repeat: tests.repeat.replacen("cargo", "cargo xtask", 1), ..tests };
    vec![format, Step::new("types", &types), Step::new("lints", &lints), tests]
}

/// Runs the steps; the first that fails ends it.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    let tree = Tree::new(&run::root());
    tree.must_be_clone()?;
    let start = Instant::now();
    let base = base(&tree, args.since.as_deref())?;
    let workspace = Workspace::read(tree.root())?;
    let files = tree.changed_since(&base)?;
    let included = included(&tree, &tree.tracked()?);
    let changed = packages(&workspace, &included, &files);
    let list = List::read(&tree)?;
    let of_all = files.iter().find(|file| *file == LOCK || list.is_common(file));
    let names = changed.iter().copied().collect::<Vec<_>>().join(", ");
    let names = if names.is_empty() { "no package".to_owned() } else { names };
    let count = match files.len() {
        1 => "1 file".to_owned(),
        count => format!("{count} files"),
    };
    println!("since {}: {count} changed, of {names}", short(&base));
    let owned: Vec<String> = changed.iter().map(|name| (*name).to_owned()).collect();
    let dependents = match of_all {
        None => workspace.dependents(&owned),
        Some(file) => {
            println!("everything is built from {file}: types are checked of all packages");
            workspace.names().collect()
        }
    };
    for step in steps(&changed, &dependents) {
        step.run()?;
    }
    println!("quick: {:.0} s; `.ci/run` decides", start.elapsed().as_secs_f64());
    Ok(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]
mod tests {
    use super::*;
    use crate::test_repository::TestRepository;

    #[test]
    fn a_change_is_what_is_not_committed_or_else_the_last_commit_or_since_the_one_named() {
        let clone = TestRepository::of([("file", b"1".to_vec())]);
        let base = |since: Option<&str>| base(&clone.tree(), since);
        let first = clone.tree().head().unwrap();
        assert_eq!(base(None).unwrap(), first, "the first commit has none before it");
        clone.write("file", "2");
        let second = clone.commit();
        assert_eq!(base(None).unwrap(), first);
        clone.write("new", "");
        assert_eq!(base(None).unwrap(), second);
        assert_eq!(base(Some("HEAD~1")).unwrap(), first);
        let error = base(Some("no-such")).unwrap_err().to_string();
        assert!(error.starts_with("this clone has no commit \"no-such\""), "{error}");
    }

    #[test]
    fn a_file_is_of_all_packages_built_from_it_and_a_page_of_those_that_take_it_in() {
        let workspace = Workspace::read(&run::root()).unwrap();
        let sources = ["firmware/xtask/src/chip.rs", "host/shell/src/lib.rs"].map(str::to_owned);
        let included = included(&Tree::new(&run::root()), &sources);
        let of = |file: &str| packages(&workspace, &included, &[file.to_owned()]);
        assert_eq!(of("firmware/xtask/src/quick.rs"), ["xtask"].into());
        assert_eq!(of("firmware/board_choice.rs"), ["flix-firmware", "xtask"].into());
        assert_eq!(of("host/README.md"), [].into());
        assert_eq!(of("host/shell/README.md"), ["flix-shell"].into());
        assert_eq!(of(LIST), ["xtask"].into());
    }

    #[test]
    fn types_are_checked_of_all_that_needs_a_change_and_tests_run_of_it_alone() {
        let steps = steps(&["one"].into(), &["one", "two"].into());
        let repeats: Vec<&str> = steps.iter().map(|step| step.repeat.as_str()).collect();
        assert_eq!(
            repeats,
            [
                "cargo fmt --all --check",
                "cargo check --all-targets -p one -p two",
                "cargo clippy --all-targets -p one -- -D warnings",
                "cargo xtask test -p one",
            ]
        );
        assert_eq!(steps.last().unwrap().arguments, ["test", "-p", "one"]);
    }

    #[test]
    fn a_change_of_pages_alone_is_formatted_alone() {
        assert_eq!(steps(&[].into(), &[].into()).len(), 1);
    }

    #[test]
    fn types_of_all_are_checked_where_all_changed() {
        let steps = steps(&[].into(), &["one", "two"].into());
        assert_eq!(steps.last().unwrap().repeat, "cargo check --all-targets -p one -p two");
    }
}
