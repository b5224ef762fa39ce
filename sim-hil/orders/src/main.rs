//! Explores all runs, or those whose name contains an argument: `cargo run --release -p flix-orders -- [--json] [--trace] [NAME..]`.
#![forbid(unsafe_code)]

use std::process::ExitCode;
use std::time::{Duration, Instant};

use flix_orders::{End, RUNS, Run, Verdict, search};

fn main() -> ExitCode {
    let (options, names): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).partition(|it| it.starts_with("--"));
    let is_known = |it: &String| it == "--json" || it == "--trace";
    if let Some(option) = options.iter().find(|it| !is_known(it)) {
        eprintln!("{option} is no option: use --json, --trace, or parts of the names of runs");
        return ExitCode::from(2);
    }
    let has = |option: &str| options.iter().any(|it| it == option);
    let is_wanted =
        |run: &&Run| names.is_empty() || names.iter().any(|it| run.name.contains(it.as_str()));
    let runs: Vec<&Run> = RUNS.iter().filter(is_wanted).collect();
    if runs.is_empty() {
        eprintln!("no run has a name with {}", names.join(" or "));
        return ExitCode::from(2);
    }
    let results: Vec<Finished> = runs
        .into_iter()
        .map(|run| {
            let start = Instant::now();
            let finished = Finished { run, verdict: search(&run.model), time: start.elapsed() };
            if has("--json") {
                eprintln!("{}", finished.row());
            } else {
                println!("{}", finished.row());
            }
            if has("--trace") || !finished.is_as_expected() {
                finished.print_trace();
            }
            finished
        })
        .collect();
    if has("--json") {
        let rows: Vec<String> = results.iter().map(Finished::json).collect();
        println!("[\n  {}\n]", rows.join(",\n  "));
    }
    if results.iter().all(Finished::is_as_expected) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// A run that has ended.
struct Finished {
    run: &'static Run,
    verdict: Verdict,
    time: Duration,
}

impl Finished {
    fn is_as_expected(&self) -> bool {
        self.run.is_as_expected(&self.verdict)
    }

    fn result(&self) -> String {
        match &self.verdict.end {
            End::Holds => "holds".to_owned(),
            End::Breaks(invariant, _) => format!("breaks {invariant}"),
            End::TooManyStates => "too many states".to_owned(),
        }
    }

    fn row(&self) -> String {
        let note = if self.is_as_expected() { "" } else { ", NOT AS EXPECTED" };
        let (name, states, seconds) = (self.run.name, self.verdict.states, self.time.as_secs_f64());
        format!("{name:<60} {states:>10} {seconds:>7.1} s  {}{note}", self.result())
    }

    fn json(&self) -> String {
        let Verdict { states, calm_states, end, .. } = &self.verdict;
        let trace = match end {
            End::Breaks(_, trace) => trace.iter().map(|(step, _)| format!("\"{step}\"")).collect(),
            _ => Vec::new(),
        };
        format!(
            "{{\"name\": \"{}\", \"states\": {states}, \"calm_states\": {calm_states}, \"result\": \"{}\", \
             \"as_expected\": {}, \"seconds\": {:.2}, \"trace\": [{}]}}",
            self.run.name,
            self.result(),
            self.is_as_expected(),
            self.time.as_secs_f64(),
            trace.join(", "),
        )
    }

    /// Prints the history to standard error, so that `--json` stays JSON.
    fn print_trace(&self) {
        if let End::Breaks(invariant, trace) = &self.verdict.end {
            eprintln!("    {invariant}: {}", invariant.broken());
            for (step, world) in trace {
                eprintln!("    {:<50} {world}", step.to_string());
            }
        }
    }
}
