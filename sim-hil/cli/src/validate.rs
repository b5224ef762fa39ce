//! `flix-sim validate`: every figure beside what it must agree with.

use flix_shell::number::within;
use std::process::ExitCode;

use super::arguments::{Vector, parse_leg};
use super::error::Error;
use super::measure::{MeasureArgs, measure};
use flix_sim::experiment::validation::{Options, validation};

/// Compute every figure of the reference table, or others, and check whether they agree
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Without options the figures are those of reference model A. For the same figures from MuJoCo:\n  python3 sim-hil/validation/validate.py\n\nExamples:\n  flix-sim validate --json\n  flix-sim validate --model W --leg rr --force 0,0.1,0 --frequency 25"
)]
pub struct Args {
    /// Model: a TOML file, the name of a shipped one, or random-SEED
    #[arg(long, default_value = "A")]
    model: String,
    /// Frequency of the shaker on a stand, -35 to 35 Hz; may be given several times
    #[arg(long, value_name = "HZ", allow_hyphen_values = true, value_parser = within(-35.0..=35.0, "frequency", " Hz"))]
    frequency: Vec<f64>,
    /// Direction of the shaker, -90 to 90 degrees, positive to the right
    #[arg(long, value_name = "DEG", default_value_t = 30.0, allow_hyphen_values = true, value_parser = within(-90.0..=90.0, "direction", " degrees"))]
    direction: f64,
    /// Leg that is loaded: fl, fr, rl or rr
    #[arg(long, default_value = "fl", value_parser = parse_leg)]
    leg: usize,
    /// Force on its tip, N
    #[arg(long, value_name = "X,Y,Z", default_value = "0.2,0,0", allow_hyphen_values = true)]
    force: Vector,
    /// Torque on its tip, N m
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,0", allow_hyphen_values = true)]
    torque: Vector,
    #[command(flatten)]
    measure: MeasureArgs,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = flix_sim::model::RobotModel::named(&args.model)?;
    let mut options = Options {
        direction_deg: args.direction,
        leg: args.leg,
        force: args.force.0,
        torque: args.torque.0,
        ..Options::default()
    };
    if !args.frequency.is_empty() {
        options.frequencies_hz.clone_from(&args.frequency);
    }
    measure("validate", &[&validation(&model, options)?], &args.measure)
}
