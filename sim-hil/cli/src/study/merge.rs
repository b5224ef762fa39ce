//! `flix-sim study merge`: slices become one.

use std::path::PathBuf;
use std::process::ExitCode;

use super::options::{judged, show};
use crate::error::Error;
use crate::output::{outside, print};

/// Join the results of all slices of a study and draw its figures
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Slices of another study, other parameters or another build are refused.\n\nExample:\n  flix-sim study merge /shared/mobility/results-*.parquet --out /shared/mobility"
)]
pub struct Args {
    /// results-I-of-N.parquet files of all slices
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Folder for the whole table and its figures [default: that of the first file]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Join slices of different builds of this program, too
    #[arg(long)]
    another_build: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let table = flix_study::merge(&args.files, args.another_build)?;
    let beside = args.files.first().and_then(|file| file.parent()).map(PathBuf::from);
    let folder = args.out.clone().or(beside).unwrap_or_default();
    flix_study::write(&table, &folder.join("results.parquet"))?;
    show(&judged(&table)?, &folder)?;
    // Of a measurement: cells of a study have no limits.
    print(&outside(&table))?;
    let keeps = table.columns.iter().all(|column| column.limit.is_none()) || table.pass();
    Ok(if keeps { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
