//! `flix-sim learn`: gain the experience that the learned controller needs.

use std::path::PathBuf;
use std::process::ExitCode;

use flix_shell::number::whole;

use super::arguments::ModelArgs;
use super::error::Error;
use super::output::{print, progress, write_or_print};
use flix_study::learn::{Plan, gain};

/// Let many robots of a kind walk, for the learned controller
///
/// Each has other friction left and right, 50 g somewhere on its plate, other legs, and walks on a slope of 5 degrees.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix-sim learn --model W --out W.experience.toml
  flix-sim track figure8 --model stranger-7 --controller learned --experience W.experience.toml")]
pub struct Args {
    #[command(flatten)]
    model: ModelArgs,
    /// Number of robots
    #[arg(long, default_value_t = 160, value_parser = whole::<u64>(2..=100_000))]
    robots: u64,
    /// Seed of the first robot
    #[arg(long, default_value_t = 1_000_000, value_parser = whole::<u64>(0..=u64::MAX))]
    first_seed: u64,
    /// Ways to differ that all pairs (f, theta) share
    #[arg(long, default_value_t = 12, value_parser = whole::<u32>(0..=50))]
    factors: u32,
    /// File for the experience
    #[arg(long, value_name = "FILE", default_value = "experience.toml")]
    out: PathBuf,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    flix_host::system::file::check_writable(&args.out).map_err(Error::write(&args.out))?;
    let model = args.model.load()?;
    let plan = Plan {
        robots: args.robots,
        first_seed: args.first_seed,
        factors: args.factors as usize,
        step: 2e-4,
    };
    let bar = progress(args.robots, "robots walked");
    let experience =
        gain(&model, &plan, &mut |robots| bar.set_position(robots)).map_err(Error::usage)?;
    bar.finish_and_clear();
    write_or_print(Some(&args.out), &experience.to_toml())?;
    let pairs = experience.walks().len();
    print(&format!("{} pairs, {} robots  {}\n", pairs, args.robots, args.out.display()))?;
    Ok(ExitCode::SUCCESS)
}
