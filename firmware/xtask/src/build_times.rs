//! `cargo xtask measure`: where the seconds go, into the tables of CONTRIBUTING.md.
//!
//! Builds are counted in CPU seconds (user and system) of each compiler, which other work on the machine disturbs little. Cargo's
//! own `--timings` knows the time on the clock alone, two compilers at once each. So this program stands between cargo and the
//! compiler (`RUSTC_WRAPPER`), starts it, and asks the system what its child took. What cargo would build anew does not
//! depend on it. Test binaries are timed on the clock, one after the other as cargo runs them.
//!
//! How long lanes take is in their own table (`crate::lanes`).

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::sync::Arc;
use std::time::{Instant, SystemTime};

use serde::Deserialize;
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::marked;
use crate::quick::{named, unified};
use crate::run::{self, Error};
use crate::toolchain;
use crate::workspace::Workspace;

/// Names the file to which compilers' seconds are added; set where this program stands in for one.
pub(crate) const LOG: &str = "XTASK_COMPILERS";
/// Ticks a second of the times in `/proc`: USER_HZ, 100 on every Linux that Rust is built for (proc(5)).
const TICKS: f64 = 100.0;
/// The page with the tables.
const PAGE: &str = "CONTRIBUTING.md";
/// Test binaries that take less are one row, s.
const LEAST: f64 = 1.0;
/// The row of what is not ours.
const ELSEWHERE: &str = "dependencies";

/// What is measured.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Build from nothing, in target/measure.
    #[arg(long)]
    cold: bool,
    /// Measure these packages alone, their tests built after a change of each; write no table.
    #[arg(long, conflicts_with = "cold")]
    package: Vec<String>,
}

/// Stands in for the compiler: runs it and adds its seconds to the log.
pub(crate) fn compile(log: &OsString) -> ExitCode {
    let mut arguments = std::env::args_os().skip(1);
    let Some(rustc) = arguments.next() else { return ExitCode::FAILURE };
    let arguments: Vec<OsString> = arguments.collect();
    let status = Command::new(rustc).args(&arguments).status();
    // What is no question about the compiler itself, which cargo asks in the name of ___.
    let name = arguments.iter().skip_while(|argument| *argument != "--crate-name").nth(1);
    let is_unit = name.is_some_and(|name| name != "___");
    if let (true, Ok(package)) = (is_unit, std::env::var("CARGO_PKG_NAME")) {
        let line = format!("{package} {}\n", seconds_of_children().unwrap_or_default());
        // One write, which is not mixed with those of others.
        let file = File::options().append(true).create(true).open(log);
        let _ = file.and_then(|mut file| file.write_all(line.as_bytes()));
    }
    // A compiler's codes fit; one that a signal ended has none.
    let code = status.ok().and_then(|status| status.code()).unwrap_or(1);
    ExitCode::from(u8::try_from(code).unwrap_or(1))
}

/// Returns the CPU seconds of the children that have ended.
fn seconds_of_children() -> Option<f64> {
    children(&std::fs::read_to_string("/proc/self/stat").ok()?)
}

/// Reads user and system time of ended children of `/proc/self/stat`, the 16th and 17th field.
fn children(stat: &str) -> Option<f64> {
    // The second field, the program's name in parentheses, may hold blanks.
    let (_, fields) = stat.rsplit_once(')')?;
    let times: Vec<f64> = fields
        .split_whitespace()
        .skip(13)
        .take(2)
        .map(str::parse)
        .collect::<Result<_, _>>()
        .ok()?;
    (times.len() == 2).then(|| times.iter().sum::<f64>() / TICKS)
}

/// A build: CPU seconds of each package, and seconds on the clock.
#[derive(Default)]
struct Build {
    packages: BTreeMap<String, f64>,
    wall: f64,
}

impl Build {
    /// Builds, with this program between cargo and the compiler.
    fn run(folder: &Path, cargo: &mut Command) -> Result<Self, Error> {
        let log = run::target_directory().join("measure.log");
        run::write(&log, [])?;
        let own =
            std::env::current_exe().map_err(|source| Error::File { path: log.clone(), source })?;
        let kept = run::target_directory().join("measure-compiler");
        std::fs::copy(own, &kept).map_err(|source| Error::File { path: kept.clone(), source })?;
        let start = Instant::now();
        cargo.env("CARGO_TARGET_DIR", folder).env("RUSTC_WRAPPER", kept).env(LOG, &log);
        run::run(cargo)?;
        let wall = start.elapsed().as_secs_f64();
        let text = String::from_utf8_lossy(&run::read(&log)?).into_owned();
        Ok(Self { packages: sums(&text), wall })
    }

    fn total(&self) -> f64 {
        // A sum of none would be -0.0.
        self.packages.values().fold(0.0, |sum, seconds| sum + seconds)
    }

    /// Returns the seconds of one of our packages.
    fn of(&self, package: &str) -> f64 {
        self.packages.get(package).copied().unwrap_or_default()
    }

    /// Returns the seconds of all other packages, and how many they are.
    fn elsewhere(&self, ours: &BTreeSet<&str>) -> (f64, usize) {
        let others = self.packages.iter().filter(|(name, _)| !ours.contains(name.as_str()));
        others.fold((0.0, 0), |(sum, count), (_, seconds)| (sum + seconds, count + 1))
    }
}

/// Sums the lines `PACKAGE SECONDS` of a log by package.
fn sums(log: &str) -> BTreeMap<String, f64> {
    let mut sums = BTreeMap::new();
    for (package, seconds) in log.lines().filter_map(|line| line.split_once(' ')) {
        *sums.entry(package.to_owned()).or_default() += seconds.parse().unwrap_or(0.0);
    }
    sums
}

/// What is read of cargo's `--message-format json`: a program that it has built, and the file that this begins with.
#[derive(Deserialize)]
struct Built {
    executable: Option<PathBuf>,
    target: Option<Target>,
}

#[derive(Deserialize)]
struct Target {
    src_path: PathBuf,
}

/// Returns the package of each test binary, by the binary's name.
fn packages(
    workspace: &Workspace,
    folder: &Path,
    mut cargo: Command,
) -> Result<BTreeMap<String, String>, Error> {
    cargo.env("CARGO_TARGET_DIR", folder).args(["--no-run", "--message-format", "json"]);
    let root = run::root();
    let of = |line: &str| {
        let built: Built = serde_json::from_str(line).ok()?;
        let source = built.target?.src_path;
        let owner = workspace.owner(source.strip_prefix(&root).ok()?.to_str()?)?;
        Some((stem(&built.executable?)?, owner.to_owned()))
    };
    Ok(run::output(&mut cargo)?.lines().filter_map(of).collect())
}

/// Returns a program's name, without its ending.
fn stem(program: &Path) -> Option<String> {
    Some(program.file_stem()?.to_str()?.to_owned())
}

/// Runs tests; returns how long each binary took, s.
fn tests(
    workspace: &Workspace,
    folder: &Path,
    testing: impl Fn() -> Command,
) -> Result<Vec<(String, f64)>, Error> {
    let packages = packages(workspace, folder, testing())?;
    let mut cargo = testing();
    cargo.env("CARGO_TARGET_DIR", folder);
    let name = || Error::Failed("cargo test".to_owned());
    let mut child = cargo.stderr(Stdio::piped()).spawn().map_err(|_| name())?;
    let mut binaries = Vec::new();
    let mut running: Option<(String, Instant)> = None;
    for line in child.stderr.take().into_iter().flat_map(|errors| BufReader::new(errors).lines()) {
        let line = line.map_err(|_| name())?;
        eprintln!("{line}");
        if let Some(next) = binary(&packages, &line) {
            binaries
                .extend(running.take().map(|(name, start)| (name, start.elapsed().as_secs_f64())));
            running = Some((next, Instant::now()));
        }
    }
    binaries.extend(running.take().map(|(name, start)| (name, start.elapsed().as_secs_f64())));
    if child.wait().is_ok_and(|status| status.success()) { Ok(binaries) } else { Err(name()) }
}

/// Returns the binary that a line of cargo says is running now: its package, and what it is made of.
fn binary(packages: &BTreeMap<String, String>, line: &str) -> Option<String> {
    let line = line.trim_start();
    if let Some(package) = line.strip_prefix("Doc-tests ") {
        return Some(format!("{package}, documentation"));
    }
    let (source, program) = line.strip_prefix("Running ")?.split_once(" (")?;
    let program = stem(Path::new(program.trim_end_matches(')')))?;
    let name = packages.get(&program).map_or(program.as_str(), String::as_str);
    Some(format!("{name}, {}", source.trim_start_matches("unittests ")))
}

/// Returns the table of test binaries, slowest first.
fn table_of_tests(mut binaries: Vec<(String, f64)>) -> String {
    binaries.sort_by(|one, other| other.1.total_cmp(&one.1));
    let slow = binaries.iter().filter(|(_, seconds)| *seconds >= LEAST).count();
    let sum =
        |binaries: &[(String, f64)]| binaries.iter().fold(0.0, |sum, (_, seconds)| sum + seconds);
    let mut table = "| tests | seconds |\n|---|---:|\n".to_owned();
    // Writing to a string never fails.
    for (name, seconds) in &binaries[..slow] {
        let _ = writeln!(table, "| {name} | {seconds:.1} |");
    }
    let others = &binaries[slow..];
    let _ = writeln!(table, "| {} others below {LEAST} s | {:.1} |", others.len(), sum(others));
    let _ = writeln!(table, "| all | {:.1} |", sum(&binaries));
    table
}

/// Returns the table of a build from nothing.
fn table_of_builds(ours: &BTreeSet<&str>, release: &Build, tests: &Build) -> String {
    let mut table =
        "| from nothing, CPU seconds | `cargo run --release` | `cargo test --workspace` |\n\
                     |---|---:|---:|\n"
            .to_owned();
    // Writing to a string never fails.
    for name in ours {
        let _ = writeln!(table, "| {name} | {:.0} | {:.0} |", release.of(name), tests.of(name));
    }
    let (of_release, of_tests) = (release.elsewhere(ours), tests.elsewhere(ours));
    let _ = writeln!(
        table,
        "| {ELSEWHERE}: {} and {} | {:.0} | {:.0} |",
        of_release.1, of_tests.1, of_release.0, of_tests.0
    );
    let _ = writeln!(table, "| all | {:.0} | {:.0} |", release.total(), tests.total());
    let _ = writeln!(table, "| on the clock | {:.0} | {:.0} |", release.wall, tests.wall);
    table
}

/// Returns the table of builds after a change of one package each.
fn table_of_changes(changes: &[(&str, Build)]) -> String {
    let mut table = "| tests built after a change in | CPU seconds | on the clock |\n\
                     |---|---:|---:|\n"
        .to_owned();
    for (name, build) in changes {
        // Writing to a string never fails.
        let _ = writeln!(table, "| {name} | {:.1} | {:.1} |", build.total(), build.wall);
    }
    table
}

/// Returns on what machine and when this is measured, and how busy it is.
fn circumstances() -> Result<String, Error> {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let load = load.split(' ').next().unwrap_or_default();
    Ok(format!("{cores} cores, load {load} before, {}", run::today()?))
}

/// Writes a part of the page.
fn write(name: &str, circumstances: &str, table: &str) -> Result<(), Error> {
    let path = run::root().join(PAGE);
    let page = String::from_utf8_lossy(&run::read(&path)?).into_owned();
    let part = format!("{circumstances}:\n\n{table}");
    let page = marked::replace(&page, name, &part).ok_or_else(|| {
        Error::Sentence(format!(
            "{PAGE} has no lines `<!-- {name}: ... -->` and `<!-- end of {name} -->`: put them where the table goes"
        ))
    })?;
    run::write(&path, page)
}

/// A package with one public function more, as long as this lives. A file that is new and says the same would not do: the
/// compiler would find all that it had compiled.
struct Edited {
    source: PathBuf,
    text: Vec<u8>,
}

impl Edited {
    fn new(workspace: &Workspace, package: &str) -> Result<Self, Error> {
        let folder = run::root().join(workspace.folder(package).unwrap_or_default());
        let sources = ["src/lib.rs", "src/main.rs"].map(|file| folder.join(file));
        let source = sources.into_iter().find(|file| file.is_file()).ok_or_else(|| {
            Error::Sentence(format!(
                "{package} has neither src/lib.rs nor src/main.rs, so no change of it can be measured"
            ))
        })?;
        let text = run::read(&source)?;
        // One that no build had before.
        let number = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let function = format!(
            "\n/// Returns a number.\n#[must_use]\npub fn measured() -> u128 {{\n    {}\n}}\n",
            number.as_nanos()
        );
        run::write(&source, [&text[..], function.as_bytes()].concat())?;
        Ok(Self { source, text })
    }
}

impl Drop for Edited {
    fn drop(&mut self) {
        if let Err(error) = run::write(&self.source, &self.text) {
            eprintln!("{error}: `git checkout` it, a function `measured` was added");
        }
    }
}

/// Measures, prints, and writes the tables.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    let workspace = Workspace::read(&run::root())?;
    if args.cold { cold(&workspace) } else { warm(&workspace, &args.package) }
}

/// Prepares a run of tests: of these packages, or of all.
fn testing(packages: &BTreeSet<&str>) -> Command {
    if packages.is_empty() {
        let mut cargo = toolchain::cargo();
        cargo.args(["test", "--workspace"]);
        return cargo;
    }
    let mut cargo = unified();
    cargo.arg("test").args(named(packages));
    cargo
}

fn cold(workspace: &Workspace) -> Result<(), Error> {
    let circumstances = circumstances()?;
    let folder = run::target_directory().join("measure");
    if folder.exists() {
        std::fs::remove_dir_all(&folder)
            .map_err(|source| Error::File { path: folder.clone(), source })?;
    }
    let all = BTreeSet::new();
    let release = Build::run(&folder, toolchain::cargo().args(["build", "--release"]))?;
    let built = Build::run(&folder, testing(&all).arg("--no-run"))?;
    let builds = table_of_builds(&workspace.names().collect(), &release, &built);
    println!("{builds}");
    write("builds", &circumstances, &builds)?;
    measure_tests(workspace, &folder, &circumstances)
}

fn measure_tests(workspace: &Workspace, folder: &Path, circumstances: &str) -> Result<(), Error> {
    let binaries = table_of_tests(tests(workspace, folder, || testing(&BTreeSet::new()))?);
    println!("{binaries}");
    write("tests", circumstances, &binaries)
}

fn warm(workspace: &Workspace, packages: &[String]) -> Result<(), Error> {
    let circumstances = circumstances()?;
    let folder: PathBuf = run::target_directory();
    let wanted: BTreeSet<&str> = packages.iter().map(String::as_str).collect();
    // Who stops this stops the compiler, whose end takes the function out of the source again.
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::default())
            .map_err(|error| Error::Sentence(format!("signals cannot be handled: {error}")))?;
    }
    let build = || Build::run(&folder, testing(&wanted).arg("--no-run"));
    // Whatever is not built yet is not counted.
    build()?;
    let mut changes = Vec::new();
    for name in workspace.names().filter(|name| wanted.is_empty() || wanted.contains(name)) {
        let edited = Edited::new(workspace, name)?;
        changes.push((name, build()?));
        drop(edited);
        // As it was again: else that would count for the next.
        build()?;
    }
    let changes = table_of_changes(&changes);
    println!("{circumstances}:\n\n{changes}");
    if wanted.is_empty() {
        write("changes", &circumstances, &changes)?;
        return measure_tests(workspace, &folder, &circumstances);
    }
    println!("{}", table_of_tests(tests(workspace, &folder, || testing(&wanted))?));
    Ok(())
}

#[cfg(test)]
mod checks {
    use super::*;

    #[test]
    fn seconds_of_children_are_read_behind_any_name() {
        let stat = "7 (a) b) R 1 2 3 4 5 6 7 8 9 10 11 12 250 50 20 0";
        assert_eq!(children(stat), Some(3.0));
        assert_eq!(children("7 (a) R 1"), None);
    }

    #[test]
    fn compilers_of_a_package_are_summed() {
        let sums = sums("one 1.5\ntwo 2\none 0.25\n");
        assert_eq!(sums, [("one".to_owned(), 1.75), ("two".to_owned(), 2.0)].into());
    }

    #[test]
    fn binaries_are_named_by_cargos_lines() {
        let packages = [("flix_sim-00c0ffee".to_owned(), "flix-sim".to_owned())].into();
        let of = |line: &str| binary(&packages, line);
        assert_eq!(
            of("     Running unittests src/lib.rs (target/debug/deps/flix_sim-00c0ffee)"),
            Some("flix-sim, src/lib.rs".into())
        );
        assert_eq!(
            of("     Running tests/link.rs (/x/debug/deps/link-00c0ffee)"),
            Some("link-00c0ffee, tests/link.rs".into())
        );
        assert_eq!(of("   Doc-tests flix_sim"), Some("flix_sim, documentation".into()));
        assert_eq!(of("   Compiling flix-sim v0.1.0 (/x)"), None);
    }

    #[test]
    fn short_binaries_are_one_row() {
        let binaries = [("one", 0.5), ("slow", 3.0), ("two", 0.25)];
        let table =
            table_of_tests(binaries.map(|(name, seconds)| (name.to_owned(), seconds)).into());
        let rows: Vec<&str> = table.lines().skip(2).collect();
        assert_eq!(rows, ["| slow | 3.0 |", "| 2 others below 1 s | 0.8 |", "| all | 3.8 |"]);
    }
}
