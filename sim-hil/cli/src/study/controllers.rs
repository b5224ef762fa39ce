//! `flix-sim study controllers`: the learned controller against the present one.

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::Arc;

use flix_shell::course::load_experience;
use flix_shell::number::whole;
use serde::Serialize;

use super::options::{RunArgs, show};
use crate::arguments::ModelArgs;
use crate::error::Error;
use crate::output::{print, print_json};
use flix_sim::experiment::walk::require_walker;
use flix_sim::rig::shipped_mode_tables::shipped_table;
use flix_sim::study::Table;
use flix_study::controllers::{CONTROLLERS, Controllers, Taken, is_better, taken, worst_third};

/// Follow a figure eight with robots that no controller has seen: error, time and energy of the learned controller and of the
/// predictive one
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A robot is the model with other friction left and right (58 % up or down), 50 g somewhere on its plate, legs 20 % stiffer or softer, on a floor that falls by up to 5 degrees. `--model stranger-SEED` of the other commands is one of them. 40 robots take 20 minutes on two cores.\n\nExamples:\n  flix-sim study controllers --robots 40 --first-seed 1000 --json\n  flix-sim track figure8 --model stranger-1007 --controller learned"
)]
pub struct Args {
    #[command(flatten)]
    model: ModelArgs,
    /// Number of robots
    #[arg(long, default_value_t = 40, value_parser = whole::<u64>(1..=10_000))]
    robots: u64,
    /// Seed of the first robot
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    first_seed: u64,
    /// Experience of the learned controller, which `learn` writes [default: of robots like W]
    #[arg(long, value_name = "FILE")]
    experience: Option<std::path::PathBuf>,
    #[command(flatten)]
    run: RunArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    controllers: BTreeMap<String, Taken>,
    pass: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    require_walker(&model)?;
    let study = Controllers {
        table: shipped_table(&args.model.model).map_err(Error::usage)?,
        experience: Arc::new(load_experience(args.experience.as_deref())?),
        model,
        robots: args.robots,
        first_seed: args.first_seed,
    };
    let Some(table) = args.run.run(&study)? else { return Ok(ExitCode::SUCCESS) };
    let report = report(&table);
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.to_text())?;
        show(&table, &args.run.folder(&study))?;
    }
    Ok(if report.pass { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn report(table: &Table) -> Report {
    let [present, learned] = CONTROLLERS.map(|controller| taken(table, controller));
    let pass = is_better(&learned, &present);
    let names = CONTROLLERS.map(|controller| controller.to_string());
    Report { controllers: names.into_iter().zip([present, learned]).collect(), pass }
}

impl Report {
    fn to_text(&self) -> String {
        let mut text = String::from(
            "controller   finished  RMS mm median  worst  time s median  worst third  energy J median  worst third\n",
        );
        for (name, taken) in &self.controllers {
            let finished = taken.finished.iter().filter(|finished| **finished).count();
            text.push_str(&format!(
                "{name:11}  {finished:>8}  {:>13.1}  {:>5.1}  {:>13.0}  {:>11.0}  {:>15.0}  {:>11.0}\n",
                median(&taken.rms_mm),
                taken.rms_mm.iter().copied().fold(0.0, f64::max),
                median(&taken.seconds),
                worst_third(&taken.seconds),
                median(&taken.energy_j),
                worst_third(&taken.energy_j),
            ));
        }
        let verdict = if self.pass { "holds" } else { "does not hold" };
        text + &format!(
            "the learned controller is within 20 mm RMS on every robot, and its worst third takes 30 % less: {verdict}\n"
        )
    }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}
