//! The image on the emulated chip: built here, run by `flix-chip`.

mod defects;
mod other;

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::chip::{Chip, Options};
use crate::run::{self, Error};
use crate::toolchain;

/// Builds the emulator, unless there is one, and the program that makes the journey beside it; returns the emulator's path.
fn program(args: &Args) -> Result<PathBuf, Error> {
    if let Some(program) = &args.program {
        return run::absolute(program);
    }
    let mut build = toolchain::cargo();
    build.args([
        "build",
        "--quiet",
        "--release",
        "--package",
        "flix-cli",
        "--package",
        "flix-chip",
    ]);
    run::run(&mut build)?;
    run::absolute(&run::target_directory().join("release/flix-chip"))
}

/// Prepares a run of an image.
fn emulator(args: &Args, image: &Path) -> Result<Command, Error> {
    let mut command = run::command(program(args)?);
    command.arg(image);
    Ok(command)
}

/// What is run, and how its result is printed.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Run this image (ELF) instead of building one.
    image: Option<PathBuf>,
    /// The encoders, where they are not those the board is sold with.
    #[arg(long, value_parser = ["mt6701", "as5047p"])]
    encoder: Option<String>,
    /// Measure shorter, and cut power in fewer flash operations.
    #[arg(long)]
    quick: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// Run these parts alone: session, network, join, restarts, power, journey, other.
    #[arg(long, value_delimiter = ',', num_args = 1..)]
    part: Vec<String>,
    /// Assume that a miss of the cache in front of the flash takes so many nanoseconds.
    #[arg(long, default_value_t = 0)]
    cache_miss_ns: u64,
    /// Assume that the radio's library masks all interrupts for so many microseconds with each call.
    #[arg(long, default_value_t = 0)]
    radio_lock_us: u64,
    /// Assume that ROM and boot loader take so many milliseconds from a reset on.
    #[arg(long, default_value_t = 300)]
    boot_ms: u64,
    /// Serve the robot to `flix` and other programs of this computer, at most in real time, until Ctrl-C.
    #[arg(long, conflicts_with_all = ["part", "quick", "json"])]
    live: bool,
    /// Run this `flix-chip` instead of building one.
    #[arg(long)]
    program: Option<PathBuf>,
    /// Build an image with each of the defects in `sim-hil/chip/defects.toml`, and check that each is caught.
    #[arg(long, conflicts_with_all = ["image", "encoder", "quick", "part", "live"])]
    defects: bool,
    /// Try these defects alone: those whose names contain one of these, separated by commas.
    #[arg(long, requires = "defects", value_delimiter = ',', num_args = 1..)]
    named: Vec<String>,
}

impl Args {
    /// Whether the session of another image is run, too.
    fn runs_other(&self) -> bool {
        let is_wanted = self.part.is_empty() || self.part.iter().any(|part| part == other::PART);
        is_wanted && self.image.is_none() && self.encoder.is_none() && !self.live
    }
}

/// Builds the image, unless there is one, and runs it; an error when something does not hold.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    if args.defects {
        return defects::run(&program(args)?, &args.named, args.json);
    }
    let other = if args.runs_other() { Some(other::image()?) } else { None };
    let image = match &args.image {
        Some(image) => run::absolute(image)?,
        None => toolchain::build_silently(
            Chip::Esp32c6,
            &Options { encoder: args.encoder.clone(), ..Options::default() },
        )?,
    };
    let mut command = emulator(args, &image)?;
    if let Some(other) = other {
        command.arg("--other").arg(other);
    }
    command.args(args.encoder.iter().flat_map(|encoder| ["--encoder", encoder]));
    command.args(args.part.iter().flat_map(|part| ["--part", part]));
    for (option, value) in [
        ("--cache-miss-ns", args.cache_miss_ns),
        ("--radio-lock-us", args.radio_lock_us),
        ("--boot-ms", args.boot_ms),
    ] {
        command.args([option, &value.to_string()]);
    }
    command.args(args.live.then_some("--live"));
    command.args(args.quick.then_some("--quick")).args(args.json.then_some("--json"));
    run::run(&mut command)
}
