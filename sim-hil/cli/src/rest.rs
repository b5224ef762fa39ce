//! `flix-sim rest`: the robot put down and weighed.

use std::process::ExitCode;

use super::arguments::ModelArgs;
use super::error::Error;
use super::output::print_figures;
use flix_sim::experiment::probe::{self, Posture, Rest};
use flix_sim::experiment::walk::DEFAULT_STEP;

/// Drop the robot from 20 mm, wait until it rests, and weigh it
///
/// Fails when it does not come to rest within 5 s.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  flix-sim rest\n  flix-sim rest --model A --json")]
pub struct Args {
    #[command(flatten)]
    model: ModelArgs,
    /// Print JSON only
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// When the model is refused or has no legs.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    let found = probe::rest(&model, DEFAULT_STEP)?;
    print_figures(&found, found.at_rest, args.json, || text(&model.name, &found))
}

fn text(model: &str, found: &Rest) -> String {
    let (loads, center, inertia) =
        (found.foot_loads_n, found.centre_of_mass_mm, found.inertia_kg_m2);
    let posture = match found.posture {
        _ if !found.at_rest => {
            "nothing within 5 s: it goes on moving, and what follows is a moment"
        }
        Posture::Feet => "its feet",
        Posture::Side => "its side: its feet do not carry it upright",
        Posture::Back => "its back: its feet do not carry it upright",
    };
    format!("Model {model}, {:.1} g, rests on {posture}\n\n", found.mass_g)
        + &format!("plate's mid-plane     {:>9.3} mm above the floor\n", found.plate_height_mm)
        + &format!(
            "foot loads            {:>9.4} fl  {:.4} fr  {:.4} rl  {:.4} rr N\n",
            loads.fl, loads.fr, loads.rl, loads.rr
        )
        + &format!(
            "centre of mass        {:>9.3} forward  {:.3} left  {:.3} above the soles, mm (straight legs)\n",
            center[0], center[1], center[2]
        )
        + &format!(
            "moments of inertia    {:>9.3e}  {:.3e}  {:.3e} kg m^2 about x, y, z\n",
            inertia[0], inertia[1], inertia[2]
        )
}
