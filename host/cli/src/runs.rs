//! `flix runs`: lists, shows, plots and exports the records of runs.

use std::path::PathBuf;
use std::process::ExitCode;

use serde_json::{Value, json};

use flix_host::record::{
    Listing, ReadError, Repaired, Run, RunSummary, csv, is_being_written, list, repair, ros2,
};
use flix_host::system::text::{printable, shown};
use flix_plot::{Figure, record};
use flix_shell::output::{complain, headings, print, print_json, table_for_terminal};
use flix_shell::{Error, Exit};

/// List, show, plot and export the records of runs.
///
/// Every run of `flix track`, `home`, `identify`, `experiment` and `drive`, and `teleop --record`, writes one MCAP file
/// below OUT/runs, which Foxglove opens as it is.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix runs list
  flix runs show last
  flix runs plot last              SVG and PNG beside the record
  flix runs repair last            of a program that was killed
  flix runs export-csv 20261121 --to tables
  flix runs export-ros2 last       for `ros2 bag play`")]
pub struct Args {
    /// Folder of the output.
    #[arg(long, value_name = "DIR", default_value = "out", global = true)]
    out: PathBuf,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// List all runs, the oldest first.
    List {
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Complete the record of a program that was killed, or one that is damaged, for other programs that read MCAP.
    ///
    /// The file as it was stays beside it, with `.original` behind its name.
    Repair {
        /// Run: `last`, a part of its name, or its file.
        #[arg(default_value = "last")]
        run: String,
    },
    /// Show the settings and results of a run.
    Show {
        /// Run: `last`, a part of its name, or its file.
        #[arg(default_value = "last")]
        run: String,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Plot the track and the timeline of a run, as SVG and PNG.
    Plot {
        /// Run: `last`, a part of its name, or its file.
        #[arg(default_value = "last")]
        run: String,
        /// Folder for the figures [default: beside the record].
        #[arg(long, value_name = "DIR")]
        to: Option<PathBuf>,
    },
    /// Export the rows of a run as tables, one CSV file per topic.
    ExportCsv {
        /// Run: `last`, a part of its name, or its file.
        #[arg(default_value = "last")]
        run: String,
        /// Folder for the tables [default: beside the record].
        #[arg(long, value_name = "DIR")]
        to: Option<PathBuf>,
    },
    /// Export poses, velocity and battery of a run as a bag that `ros2 bag play` plays.
    ExportRos2 {
        /// Run: `last`, a part of its name, or its file.
        #[arg(default_value = "last")]
        run: String,
        /// Folder for the bag [default: beside the record].
        #[arg(long, value_name = "DIR")]
        to: Option<PathBuf>,
    },
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    match &args.action {
        Action::List { json } => list_runs(&args.out, *json)?,
        Action::Repair { run } => {
            let run = find_run(args, run)?;
            let file = &run.file;
            complain_of(&run, &[run.damage.to_string()]);
            match repair(file)? {
                Some(Repaired { rows, original, .. }) => {
                    complain(format_args!("as it was: {}", shown(&original)));
                    print(&format!("completed, {rows} rows: {}\n", shown(file)))?;
                }
                None => print(&format!("is complete: {}\n", shown(file)))?,
            }
        }
        Action::Show { run, json } => show(&find(args, run)?, *json)?,
        Action::Plot { run, to } => {
            let run = find(args, run)?;
            let (has_track, has_timeline) = (record::has_track(&run), record::has_timeline(&run));
            if !has_track && !has_timeline {
                let sentence = format_args!(
                    "{}: there is nothing to plot: the record has no rows of poses, commands or telemetry",
                    shown(&run.file)
                );
                return Err(Error::new(Exit::Nothing, sentence));
            }
            let (folder, stem) = beside(&run, to.as_ref());
            let figures: [(_, _, &dyn Figure); 2] = [
                ("track", has_track, &record::track(&run)),
                ("timeline", has_timeline, &record::timeline(&run)),
            ];
            for (kind, _, figure) in figures.into_iter().filter(|(_, has_data, _)| *has_data) {
                let written =
                    figure.write(&folder, &format!("{stem}-{kind}")).map_err(Error::usage)?;
                print(&format!("{}\n{}\n", written.svg.display(), written.png.display()))?;
            }
        }
        Action::ExportCsv { run, to } => {
            let run = find(args, run)?;
            for file in csv::export(&run, &beside(&run, to.as_ref()).0)? {
                print(&format!("{}\n", file.display()))?;
            }
        }
        Action::ExportRos2 { run, to } => {
            let run = find(args, run)?;
            print(&format!("{}\n", ros2::export(&run, &beside(&run, to.as_ref()).0)?.display()))?;
        }
    }
    Ok(Exit::Done.into())
}

/// Finds a run and reads it; says what was left out, and whether the record goes on.
fn find(args: &Args, name: &str) -> Result<Run, Error> {
    let run = find_run(args, name)?;
    let end = if run.is_complete { String::new() } else { unfinished(&run) };
    complain_of(&run, &[run.damage.to_string(), end]);
    Ok(run)
}

/// Finds a run and reads it; says which newer ones were left out.
fn find_run(args: &Args, name: &str) -> Result<Run, Error> {
    let run = Run::find(&args.out, name)?;
    for reason in &run.newer {
        complain(format_args!("{reason}: newer than {}, and skipped", shown(&run.file)));
    }
    Ok(run)
}

/// Says on one line what is the matter with a record, if anything.
fn complain_of(run: &Run, sentences: &[String]) {
    let sentences: Vec<_> =
        sentences.iter().filter(|it| !it.is_empty()).map(String::as_str).collect();
    if !sentences.is_empty() {
        complain(format_args!("{}: {}", shown(&run.file), sentences.join("; ")));
    }
}

/// Returns the folder for the output of a run, and the stem of its file names.
fn beside(run: &Run, to: Option<&PathBuf>) -> (PathBuf, String) {
    let own = run.file.parent().map(PathBuf::from).unwrap_or_default();
    let stem =
        run.file.file_stem().map_or_else(|| "run".into(), |s| s.to_string_lossy().into_owned());
    (to.cloned().unwrap_or(own), stem)
}

fn list_runs(out: &std::path::Path, as_json: bool) -> Result<(), Error> {
    let Listing { runs, skipped } = list(out)?;
    let mut heads = Vec::new();
    let head_of = |run: RunSummary| Ok((Run::read_head(&run.file)?, run.bytes));
    for head in
        skipped.into_iter().map(|(_, reason)| Err(reason)).chain(runs.into_iter().map(head_of))
    {
        match head {
            Ok(head) => heads.push(head),
            Err(reason) => complain(format_args!("{reason}: skipped")),
        }
    }
    if as_json {
        let rows: Vec<Value> = heads
            .iter()
            .map(|(run, bytes)| {
                json!({
                    "file": run.file.to_string_lossy(),
                    "bytes": bytes,
                    "started": run.fact("run", "started"),
                    "robot": run.fact("run", "robot"),
                    "name": run.fact("run", "name"),
                    "result": result(run),
                })
            })
            .collect();
        return print_json(&rows);
    }
    if heads.is_empty() {
        return print(&format!("no runs below {}\n", out.display()));
    }
    let mut rows = vec![headings("run|robot|kB|result")];
    rows.extend(heads.iter().map(|(run, bytes)| {
        let stem = run.file.file_stem().unwrap_or_default();
        vec![
            shown(stem.as_ref()),
            run.fact("run", "robot").to_owned(),
            format!("{:.1}", *bytes as f64 / 1e3),
            result(run),
        ]
    }));
    print(&table_for_terminal(&rows))
}

/// Returns how a run ended, and its figures.
fn result(run: &Run) -> String {
    if !run.is_complete {
        let has_any = run.has_rows() || !run.facts.is_empty() || is_being_written(&run.file);
        return match (!has_any).then(|| Run::read(&run.file)) {
            Some(Err(ReadError::Format { reason, .. })) => {
                format!("not a record of a run: {reason}")
            }
            Some(Err(error)) => error.to_string(),
            Some(Ok(run)) => unfinished(&run),
            None => unfinished(run),
        };
    }
    if !run.damage.is_none() {
        let words = match run.damage.is_summary_lost {
            true => "its summary is wrong: `flix runs repair` writes it",
            false => "damaged: `flix runs repair` keeps what is whole",
        };
        return words.to_owned();
    }
    let fact = |name| run.fact("results", name);
    let figures =
        match (fact("path_error_rms_mm"), fact("final_error_mm"), fact("frequency_rms_error_hz")) {
            ("", "", "") => String::new(),
            ("", "", f) => {
                format!(", within {f} Hz and {} degrees RMS", fact("direction_rms_error_deg"))
            }
            ("", error, _) => format!(", {error} mm away"),
            (error, ..) => format!(", {error} mm RMS, {} laps", fact("laps")),
        };
    fact("ending").to_owned() + &figures
}

/// Returns why a record has no end, and what to do.
fn unfinished(run: &Run) -> String {
    let reason = if is_being_written(&run.file) {
        "still running"
    } else if !run.has_rows() {
        "unfinished, and without a row that is whole"
    } else if run.damage.is_summary_lost {
        "without its summary: `flix runs repair` writes it"
    } else {
        "unfinished: `flix runs repair` completes the record"
    };
    reason.to_owned()
}

fn show(run: &Run, as_json: bool) -> Result<(), Error> {
    if as_json {
        return print_json(&description(run));
    }
    // A line end in what a record holds begins no line.
    let mut text = format!("{}\n{:>14}  {:.1} s\n", shown(&run.file), "duration", run.seconds());
    for (topic, rows) in counts(run) {
        text += &format!("{topic:>14}  {rows} rows\n");
    }
    for (name, bytes) in &run.attachments {
        text += &format!("{:>14}  {}, {bytes} bytes\n", "attached", printable(name));
    }
    for (group, facts) in &run.facts {
        text += &format!("\n{}\n", printable(group));
        for (name, value) in facts {
            text += &format!("{:>24}  {}\n", printable(name), printable(value));
        }
    }
    if !run.events.is_empty() {
        text += "\nevents\n";
    }
    for event in &run.events {
        let message = printable(&event.message);
        text += &format!("{:>12.3} s  {message}\n", run.time(&event.timestamp));
    }
    print(&text)
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
        "file": run.file.to_string_lossy(),
        "seconds": run.seconds(),
        "rows": counts(run).into_iter().collect::<std::collections::BTreeMap<_, _>>(),
        "attachments": run.attachments.iter().map(|a| &a.0).collect::<Vec<_>>(),
        "facts": run.facts,
        "rows_left_out": run.damage.rows,
        "damage": run.damage.to_string(),
        "is_complete": run.is_complete,
        "events": events,
    })
}
