//! `flix-sim study all`: every study, one after the other.

use std::process::ExitCode;
use std::time::Instant;

use clap::{Parser, Subcommand};

use crate::arguments::PaperModelArgs;
use crate::error::Error;
use crate::output::print;

/// Run every study
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The search of `calibrate` is part of --quick alone: in full it takes hours and has a command of its own.\n\nExamples:\n  flix-sim study all --quick\n  flix-sim study all --model calibrated"
)]
pub struct Args {
    #[command(flatten)]
    model: PaperModelArgs,
    /// Take a first look: short, coarse walks
    #[arg(long)]
    quick: bool,
}

#[derive(Debug, Parser)]
struct Line<C: Subcommand> {
    #[command(subcommand)]
    command: C,
}

/// The studies, as they are typed; the bool is set for those that walk and know `--quick`.
const STUDIES: [(&str, bool); 7] = [
    ("actuation", false),
    ("leg", false),
    ("mobility", true),
    ("sensitivity mass", true),
    ("sensitivity friction", true),
    // The walks of both.
    ("select --resume", true),
    ("select --resume --statements", true),
];

/// Runs every study by `run`, which takes one of the commands `C`.
pub(super) fn run<C: Subcommand>(
    args: &Args,
    run: impl Fn(&C) -> Result<ExitCode, Error>,
) -> Result<ExitCode, Error> {
    let start = Instant::now();
    let quick = |walks: bool| if args.quick && walks { " --quick" } else { "" };
    let mut lines: Vec<String> =
        STUDIES.iter().map(|(study, walks)| format!("{study}{}", quick(*walks))).collect();
    if args.quick {
        lines.push("calibrate --quick --restart --out out/study/calibrate-quick".to_owned());
    }
    for line in lines {
        print(&format!("\n== flix-sim study {line} --model {}\n\n", args.model.model))?;
        let words =
            ["study"].into_iter().chain(line.split(' ')).chain(["--model", &args.model.model]);
        let parsed = Line::<C>::try_parse_from(words).map_err(Error::usage)?;
        run(&parsed.command)?;
    }
    print(&format!("\nall studies took {:.0} s\n", start.elapsed().as_secs_f64()))?;
    Ok(ExitCode::SUCCESS)
}
