//! `flix runs`: what was recorded.

use std::path::PathBuf;
use std::process::ExitCode;

use serde_json::{Value, json};

use super::{Error, Exit};
use crate::plot::{Figure, PlotError};
use crate::record::{ReadError, RecordError, Run, csv, figures, list};

/// List, show, plot and export the records of runs.
///
/// Every run of `flix track`, `flix home` and `flix identify` writes one MCAP file below OUT/runs,
/// which Foxglove opens as it is.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix runs list
  flix runs show last
  flix runs plot last              SVG and PNG beside the record
  flix runs export-csv 20261121 --to tables")]
pub struct Args {
    /// Folder that programs write to.
    #[arg(long, value_name = "DIR", default_value = "out", global = true)]
    out: PathBuf,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// All runs, the oldest first.
    List {
        /// As JSON.
        #[arg(long)]
        json: bool,
    },
    /// What one run was and how it went.
    Show {
        /// `last`, a part of its name, or its file.
        #[arg(default_value = "last")]
        run: String,
        /// As JSON.
        #[arg(long)]
        json: bool,
    },
    /// Draw its track and its timeline, as SVG and PNG.
    Plot {
        /// `last`, a part of its name, or its file.
        #[arg(default_value = "last")]
        run: String,
        /// Folder for the pictures; beside the record unless told.
        #[arg(long, value_name = "DIR")]
        to: Option<PathBuf>,
    },
    /// Write its rows as tables, one CSV file a topic.
    ExportCsv {
        /// `last`, a part of its name, or its file.
        #[arg(default_value = "last")]
        run: String,
        /// Folder for the tables; beside the record unless told.
        #[arg(long, value_name = "DIR")]
        to: Option<PathBuf>,
    },
}

impl From<ReadError> for Error {
    fn from(error: ReadError) -> Self {
        Self::usage(error)
    }
}

impl From<RecordError> for Error {
    fn from(error: RecordError) -> Self {
        Self::usage(error)
    }
}

impl From<PlotError> for Error {
    fn from(error: PlotError) -> Self {
        Self::usage(error)
    }
}

/// Does what was asked of the records.
///
/// # Errors
/// When a record is missing, cannot be read, or its pictures and tables cannot be written.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    match &args.action {
        Action::List { json } => list_runs(&args.out, *json)?,
        Action::Show { run, json } => show(&Run::find(&args.out, run)?, *json),
        Action::Plot { run, to } => {
            let run = Run::find(&args.out, run)?;
            let (folder, stem) = beside(&run, to.as_ref());
            for (kind, figure) in [
                ("track", &figures::track(&run) as &dyn Figure),
                ("timeline", &figures::timeline(&run)),
            ] {
                let written = figure.write(&folder, &format!("{stem}-{kind}"))?;
                println!("{}\n{}", written.svg.display(), written.png.display());
            }
        }
        Action::ExportCsv { run, to } => {
            let run = Run::find(&args.out, run)?;
            for file in csv::export(&run, &beside(&run, to.as_ref()).0)? {
                println!("{}", file.display());
            }
        }
    }
    Ok(Exit::Done.into())
}

/// The folder for what is made of a run, and its name.
fn beside(run: &Run, to: Option<&PathBuf>) -> (PathBuf, String) {
    let own = run.file.parent().map(PathBuf::from).unwrap_or_default();
    let stem =
        run.file.file_stem().map_or_else(|| "run".into(), |s| s.to_string_lossy().into_owned());
    (to.cloned().unwrap_or(own), stem)
}

fn list_runs(out: &std::path::Path, as_json: bool) -> Result<(), Error> {
    let runs = list(out)?;
    if as_json {
        let rows: Vec<Value> =
            runs.iter().map(|r| json!({ "file": r.file, "bytes": r.bytes })).collect();
        println!("{}", Value::from(rows));
        return Ok(());
    }
    if runs.is_empty() {
        println!("no runs below {}", out.display());
    }
    for run in runs {
        println!("{:>9.1} kB  {}", run.bytes as f64 / 1e3, run.file.display());
    }
    Ok(())
}

fn show(run: &Run, as_json: bool) {
    if as_json {
        println!("{}", description(run));
        return;
    }
    println!("{}", run.file.display());
    println!("{:>14}  {:.1} s", "duration", run.seconds());
    for (topic, rows) in counts(run) {
        println!("{topic:>14}  {rows} rows");
    }
    for (name, bytes) in &run.attachments {
        println!("{:>14}  {name}, {bytes} bytes", "attached");
    }
    for (group, facts) in &run.facts {
        println!("\n{group}");
        for (name, value) in facts {
            println!("{name:>24}  {value}");
        }
    }
    if !run.events.is_empty() {
        println!("\nevents");
    }
    for event in &run.events {
        println!("{:>12.3} s  {}", run.time(&event.timestamp), event.message);
    }
}

fn counts(run: &Run) -> [(&'static str, usize); 5] {
    [
        ("pose", run.poses.len()),
        ("command", run.commands.len()),
        ("navigation", run.navigation.len()),
        ("telemetry", run.telemetry.len()),
        ("log", run.events.len()),
    ]
}

fn description(run: &Run) -> Value {
    let events: Vec<Value> = run
        .events
        .iter()
        .map(
            |e| json!({ "time_s": run.time(&e.timestamp), "level": e.level, "message": e.message }),
        )
        .collect();
    json!({
        "file": run.file,
        "seconds": run.seconds(),
        "rows": counts(run).into_iter().collect::<std::collections::BTreeMap<_, _>>(),
        "attachments": run.attachments.iter().map(|a| &a.0).collect::<Vec<_>>(),
        "facts": run.facts,
        "events": events,
    })
}
