//! `cargo xtask lanes`: what a change may break beyond the tests, run where it may.
//!
//! A lane is a check that an ordinary change cannot break: other targets, the wheel, the emulated chip. The list
//! `.ci/lanes.toml` names its command, the packages and files that it depends on, and its last green run. A lane is due when
//! something of that differs from the commit of its last green run: a file, its own entry, or the version of a package from
//! elsewhere.

mod due;
mod list;
mod lock;
#[cfg(test)]
mod tests;

use std::fs::File;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::{Mutex, PoisonError, mpsc};
use std::time::Instant;

use due::{Judge, Reason};
pub(crate) use list::{FILE as LIST, List};
use list::{Lane, Record};

use crate::marked;
use crate::run::{self, Error};
use crate::tree::{Tree, short};

/// Lines of a failed lane's log that are printed.
const SHOWN: usize = 40;
/// What a command of a lane starts with where it is this program.
const OURS: &str = "cargo xtask ";
/// How much a lane that is not `paced` yields to others: to a tenth of their share of a processor.
const NICENESS: &str = "10";

/// What is done with which lanes.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// These lanes alone.
    names: Vec<String>,
    /// Run those that are due.
    #[arg(long)]
    run: bool,
    /// Run them whether they are due or not.
    #[arg(long, requires = "run")]
    all: bool,
    /// Run long lanes, too, as `.ci/long` does.
    #[arg(long, requires = "run")]
    long: bool,
    /// Those alone that build in folders of their own and may run beside the tests (true), or the others alone (false).
    #[arg(long, requires = "run")]
    apart: Option<bool>,
    /// Run so many at once.
    #[arg(long, requires = "run", default_value = "1", value_name = "N")]
    jobs: NonZeroUsize,
    /// Write each green run into `.ci/lanes.toml` and its table; a run that was cut short goes on where it was.
    #[arg(long, requires = "run")]
    record: bool,
    /// Renew the table of the last green runs, and run nothing.
    #[arg(long, conflicts_with = "run")]
    table: bool,
}

/// Prints the lanes, or runs them.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    let tree = Tree::new(&run::root());
    tree.must_be_clone()?;
    let logs = run::target_directory().join("lanes");
    if args.table {
        return renew_table(&tree, &List::read(&tree)?);
    }
    if args.run { run_lanes(&tree, &logs, args) } else { print(&tree, &args.names) }
}

/// Returns the lanes of these names; all where none is named.
fn chosen<'a>(list: &'a List, names: &[String]) -> Result<Vec<&'a Lane>, Error> {
    if names.is_empty() {
        return Ok(list.lanes.iter().collect());
    }
    names.iter().map(|name| list.lane(name)).collect()
}

fn print(tree: &Tree, names: &[String]) -> Result<(), Error> {
    let list = List::read(tree)?;
    let mut judge = Judge::new(tree, &list)?;
    println!("{:16} {:5} {:32} why", "lane", "due", "last green run");
    for lane in chosen(&list, names)? {
        let (due, why) = match judge.reason(lane)? {
            Some(reason) if lane.long => ("long", format!("due: {reason}")),
            Some(reason) => ("yes", reason.to_string()),
            None => ("no", "nothing that it depends on changed".to_owned()),
        };
        println!(
            "{:16} {due:5} {:32} {why}",
            lane.name,
            lane.last.as_ref().map_or("-".into(), words)
        );
    }
    let orphans = judge.orphans(&tree.tracked()?);
    if orphans.is_empty() { Ok(()) } else { Err(Error::Sentence(orphans.join("\n"))) }
}

/// Returns a green run in words.
fn words(Record { commit, date, seconds }: &Record) -> String {
    format!("{date} {}, {seconds} s", short(commit))
}

/// Returns why a lane is left out; nothing where it runs.
fn left_out(lane: &Lane, reason: Option<&Reason>, args: &Args) -> Option<String> {
    let is_wanted = args.long || !args.names.is_empty();
    match (reason, &lane.last) {
        _ if args.all && (is_wanted || !lane.long) => None,
        (None, Some(last)) => {
            Some(format!("nothing that it depends on changed since {}", words(last)))
        }
        (Some(reason), _) if lane.long && !is_wanted => {
            Some(format!("long, `.ci/long` runs it; due: {reason}"))
        }
        _ => None,
    }
}

/// Runs the lanes that are due, and goes on where one fails.
fn run_lanes(tree: &Tree, logs: &Path, args: &Args) -> Result<(), Error> {
    let list = List::read(tree)?;
    let mut judge = Judge::new(tree, &list)?;
    let mut wanted = Vec::new();
    for lane in chosen(&list, &args.names)? {
        if args.apart.is_some_and(|apart| apart != lane.apart) {
            if !args.names.is_empty() {
                println!("{}: left out, its `apart` is {}", lane.name, lane.apart);
            }
            continue;
        }
        let reason = judge.reason(lane)?;
        match left_out(lane, reason.as_ref(), args) {
            Some(why) => println!("{}: left out, {why}", lane.name),
            None => wanted.push((lane, reason.map_or("asked for".into(), |why| why.to_string()))),
        }
    }
    if args.record {
        is_recordable(tree, &list, &judge, &wanted)?;
    }
    let program = Program::keep(logs)?;
    let head = tree.head()?;
    let queue = Mutex::new(wanted.iter());
    let next = || queue.lock().unwrap_or_else(PoisonError::into_inner).next();
    let (sender, ended) = mpsc::channel();
    let mut failed = Vec::new();
    std::thread::scope(|scope| {
        for sender in vec![sender; args.jobs.get().min(wanted.len())] {
            let (next, program) = (&next, &program);
            scope.spawn(move || {
                while let Some((lane, why)) = next() {
                    let log = logs.join(format!("{}.log", lane.name));
                    println!("{}: runs, {why}; log: {}", lane.name, log.display());
                    let start = Instant::now();
                    let outcome = program.run(tree, lane, &log);
                    // Refused where recording failed and nobody listens any more.
                    let _ = sender.send((lane, log, outcome, start.elapsed().as_secs()));
                }
            });
        }
        for (lane, log, outcome, seconds) in ended {
            match outcome {
                Ok(()) => {
                    println!("{}: green after {seconds} s", lane.name);
                    if args.record {
                        record(tree, lane, &head, seconds)?;
                    }
                }
                Err(error) => {
                    print_end(&log);
                    println!("{}: failed after {seconds} s: {error}", lane.name);
                    failed.push(lane.name.as_str());
                }
            }
        }
        Ok(())
    })?;
    if failed.is_empty() {
        return Ok(());
    }
    Err(Error::Sentence(format!(
        "{} of {} lanes failed: {}; try one again with `cargo xtask lanes --run --all {}`",
        failed.len(),
        wanted.len(),
        failed.join(", "),
        failed[0]
    )))
}

/// Prints the last lines of a log.
fn print_end(log: &Path) {
    let bytes = run::read(log).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let lines: Vec<&str> = text.lines().collect();
    for line in &lines[lines.len().saturating_sub(SHOWN)..] {
        println!("    {line}");
    }
}

/// This program where no build replaces it: called by cargo, it would wait for whatever else builds.
struct Program(PathBuf);

impl Program {
    fn keep(folder: &Path) -> Result<Self, Error> {
        let kept = folder.join("xtask");
        let new = kept.with_extension(std::process::id().to_string());
        let file = |source| Error::File { path: kept.clone(), source };
        run::write(&new, [])?;
        std::env::current_exe().and_then(|own| std::fs::copy(own, &new)).map_err(file)?;
        // In the place of one that may be running.
        std::fs::rename(&new, &kept).map_err(file)?;
        Ok(Self(kept))
    }

    /// Runs a lane's lines; the first that fails ends it.
    fn run(&self, tree: &Tree, lane: &Lane, log: &Path) -> Result<(), Error> {
        let file = |source| Error::File { path: log.to_path_buf(), source };
        run::write(log, [])?;
        for line in &lane.run {
            let mut output = File::options().append(true).open(log).map_err(file)?;
            std::io::Write::write_all(&mut output, format!("+ {line}\n").as_bytes())
                .map_err(file)?;
            let errors = output.try_clone().map_err(file)?;
            let command = match line.strip_prefix(OURS) {
                Some(arguments) => format!(r#""$XTASK" {arguments}"#),
                None => line.clone(),
            };
            // Where the time goes.
            let times = "echo 'user and system time, of the shell and of what it ran:'; times";
            let timed = format!("trap \"{times}\" EXIT; {command}");
            let niceness = if lane.paced { "0" } else { NICENESS };
            run::run(
                run::command("nice")
                    .current_dir(tree.root())
                    .args(["-n", niceness, "bash"])
                    .args(["-euo", "pipefail", "-c", &timed])
                    .env("XTASK", &self.0)
                    // Nothing is skipped for want of a program.
                    .env("CI", "true")
                    .env("SUDO", if run::is_root() { "" } else { "sudo" })
                    .stdout(Stdio::from(output))
                    .stderr(Stdio::from(errors)),
            )
            .map_err(|_| Error::Sentence(line.clone()))?;
        }
        Ok(())
    }
}

/// Checks that what is run is what the commit holds: records apart, no tracked file differs, and no other input is new.
fn is_recordable(
    tree: &Tree,
    list: &List,
    judge: &Judge<'_>,
    wanted: &[(&Lane, String)],
) -> Result<(), Error> {
    let head = tree.head()?;
    let differs = |file: &String| {
        let (then, now) = (tree.at(&head, file).unwrap_or_default(), tree.now(file));
        let now = now.unwrap_or_default();
        if *file == list::FILE {
            return !List::parse(&then).is_ok_and(|then| then.equals(list));
        }
        let without = |page: &str| marked::replace(page, list::TABLE, "");
        *file != list.page || without(&then).is_none() || without(&then) != without(&now)
    };
    let untracked = tree.untracked()?;
    let edited = tree.edited_since(&head)?.into_iter().find(differs);
    let new = wanted.iter().find_map(|(lane, _)| judge.inputs(lane, &untracked).first().copied());
    match edited.as_deref().or(new) {
        None => Ok(()),
        Some(file) => Err(Error::Sentence(format!(
            "a green run is recorded for a commit, and {file} differs from {}: commit it, or run without --record",
            short(&head)
        ))),
    }
}

/// Writes a green run into the list and its table, unless something changed while it ran.
fn record(tree: &Tree, lane: &Lane, commit: &str, seconds: u64) -> Result<(), Error> {
    let text = tree.now(list::FILE).unwrap_or_default();
    let list = List::parse(&text)?;
    if let Some(reason) = Judge::new(tree, &list)?.reason_since(lane, commit)? {
        println!("{}: not recorded, since it ran {reason}", lane.name);
        return Ok(());
    }
    let record = Record { commit: commit.to_owned(), date: run::today()?, seconds };
    let text = list::with_record(&text, &lane.name, &record)?;
    run::write(&tree.root().join(list::FILE), &text)?;
    renew_table(tree, &List::parse(&text)?)
}

/// Writes the table of the last green runs into its page.
fn renew_table(tree: &Tree, list: &List) -> Result<(), Error> {
    let page = tree.now(&list.page).unwrap_or_default();
    let renewed = marked::replace(&page, list::TABLE, &list.table()).ok_or_else(|| {
        Error::Sentence(format!(
            "{} has no lines `<!-- {TABLE}: ... -->` and `<!-- end of {TABLE} -->`: put them around the table",
            list.page,
            TABLE = list::TABLE
        ))
    })?;
    run::write(&tree.root().join(&list.page), renewed)
}
