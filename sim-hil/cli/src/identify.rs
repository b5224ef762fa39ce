//! `flix-sim identify`: the mode table of a simulated robot, identified in virtual time.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::SystemTime;

use flix_host::nav::{ModeTable, PlanarPose};
use flix_host::pilot::{Ending, Pilot};
use flix_host::record::Recorder;
use flix_shell::identification::{IdentificationArgs, save};

use super::conditions::{LoopArgs, description};
use super::error::Error;
use super::output::progress;
use flix_sim::experiment::course::Course;

/// Identify the walking modes of a simulated robot and write its mode table, in virtual time
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix-sim identify --model W --rounds 4 --modes out/W.modes.toml
  flix-sim identify --only forward,left,right --seconds 4")]
pub struct Args {
    #[command(flatten)]
    identification: IdentificationArgs,
    #[command(flatten)]
    conditions: LoopArgs,
    /// Folder for the record, and for the table without --modes
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let conditions = args.conditions.conditions(PlanarPose::default())?;
    let (identification, names) = args.identification.identification()?;
    let file = args.conditions.modes.clone().unwrap_or_else(|| args.out.join("modes.toml"));
    ModeTable::check_writable(&file).map_err(Error::usage)?;
    let about = description("identify", args.conditions.facts());
    let recorder = Recorder::create(&args.out, SystemTime::now(), &about)?;
    let pilot = Pilot::new(identification, names, Some(recorder));
    let mut course = Course::new(&conditions, pilot)?;
    let bar = progress(u64::from(course.pilot().helm().progress().1), "stretches");
    let ending = loop {
        if let Some(ending) = course.step()? {
            break ending;
        }
        bar.set_position(u64::from(course.pilot().helm().progress().0));
    };
    bar.finish_and_clear();
    let (identification, record) = course.into_pilot().finish(std::collections::BTreeMap::new());
    record.complete()?;
    if ending != Ending::Finished {
        return Err(Error::usage(ending));
    }
    let model = &args.conditions.model.model;
    let source =
        format!("{}; simulated, seed {}", args.identification.source(), args.conditions.seed);
    let table = identification.table(model, &source).map_err(Error::usage)?;
    save(&table, "", &file)?;
    Ok(ExitCode::SUCCESS)
}
