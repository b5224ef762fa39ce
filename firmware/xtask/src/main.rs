#![forbid(unsafe_code)]
//! Work that is more than one cargo call, on chips and on what a change has to pass: `cargo xtask --help`.
//!
//! Where rustup and espup are installed their toolchains are used. Where they cannot be had,
//! Debian's compiler builds the ESP32-C6 and a stand-in target type-checks the other two chips.

mod chip;
mod emulate;
mod flash;
mod image;
mod in_memory;
mod included;
mod lanes;
mod marked;
#[cfg(test)]
mod module_cycles;
mod panic_free;
mod quick;
mod run;
mod setup;
mod stock;
#[cfg(test)]
mod test_repository;
mod tick_instructions;
mod toolchain;
mod tree;
mod web;
mod workspace;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};

use chip::{Chip, Options};
use run::Error;

/// Build, check and flash the chip images; run what a change has to pass.
#[derive(Parser)]
#[command(name = "cargo xtask", version, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    task: Task,
}

const EXAMPLES: &str = "Examples:
  cargo xtask setup                                  install what a fresh machine lacks
  cargo xtask build esp32c6
  cargo xtask flash esp32 --board dengfoc-v3-01
  cargo xtask flash esp32 -- --flash-freq 40mhz      what stands behind -- is espflash's
  cargo xtask check esp32 --encoder mt6701
  cargo xtask build esp32 --stock                    an experiment: without espup
  cargo xtask emulate                                provision, drive, and try what goes wrong
  cargo xtask emulate --quick --json
  cargo xtask emulate --live                         then: flix provision --port PORT --ssid lab --open
  cargo xtask pil --chip esp32 --json
  cargo xtask size
  cargo xtask web                                    then open target/site/index.html
  cargo xtask quick                                  is my change wrong?
  cargo xtask lanes                                  which checks are due, and why
  cargo xtask lanes --run web chips";

#[derive(Subcommand)]
enum Task {
    /// Install what is missing: the compiler's target and sources, QEMU, an image maker.
    Setup(setup::Args),
    /// Build the chip's firmware.
    Build(Build),
    /// Type-check the chip's firmware with every board and encoder, or with those named.
    Check(Choice),
    /// Make a flashable file of the chip's firmware.
    Image(Image),
    /// Build, flash and show the log (needs espflash and a board).
    Flash(Flash),
    /// Replay a recorded walk on an emulated processor: compare every bit, count instructions.
    Pil(tick_instructions::Args),
    /// Run the ESP32-C6 image on an emulated chip with the simulated robot at its pins.
    Emulate(emulate::Args),
    /// Print what images take of flash and memory; fail above the ceilings.
    Size(image::Args),
    /// Build the page of the simulated robot into target/site; fail when it is too large.
    Web(web::Args),
    /// Check a change within a minute or two: format, types, lints, and the tests of the packages that changed.
    Quick(quick::Args),
    /// Test single packages without building their dependencies with other features than the whole workspace's.
    Test(quick::TestArgs),
    /// Print the checks of `.ci/lanes.toml`, which of them are due and why; run those.
    Lanes(lanes::Args),
    /// Check that no panic can be reached from the fast tick; fail when one can.
    PanicFree,
}

#[derive(Args)]
struct Choice {
    /// Chip to build for.
    chip: Chip,
    #[command(flatten)]
    options: Options,
}

#[derive(Args)]
struct Build {
    #[command(flatten)]
    choice: Choice,
    /// Build for the ESP32 by the stock compiler: an experiment, which no chip has run.
    #[arg(long)]
    stock: bool,
}

#[derive(Args)]
struct Image {
    #[command(flatten)]
    build: Build,
    /// Options of espflash, behind `--`, such as `--flash-freq 40mhz`.
    #[arg(last = true)]
    espflash: Vec<String>,
}

#[derive(Args)]
struct Flash {
    #[command(flatten)]
    choice: Choice,
    /// Options of espflash, behind `--`, such as `--flash-freq 40mhz` or `--port PORT`.
    #[arg(last = true)]
    espflash: Vec<String>,
}

impl Build {
    /// Builds, prints the path of the ELF file and returns it.
    fn elf(&self) -> Result<PathBuf, Error> {
        let Choice { chip, options } = &self.choice;
        if self.stock { stock::build(*chip, options) } else { toolchain::build(*chip, options) }
    }
}

fn main() -> ExitCode {
    let outcome = match Cli::parse().task {
        Task::Setup(args) => setup::setup(&args),
        Task::Build(args) => args.elf().map(drop),
        Task::Check(Choice { chip, options }) => toolchain::check(chip, &options),
        Task::Image(Image { build, espflash }) => {
            build.elf().and_then(|elf| image::make(build.choice.chip, &elf, &espflash)).map(drop)
        }
        Task::Flash(Flash { choice, espflash }) => {
            flash::flash(choice.chip, &choice.options, &espflash)
        }
        Task::Pil(args) => tick_instructions::run(&args),
        Task::Emulate(args) => emulate::run(&args),
        Task::Size(args) => image::size(&args),
        Task::Web(args) => web::run(&args),
        Task::Quick(args) => quick::run(&args),
        Task::Test(args) => quick::test(&args),
        Task::Lanes(args) => lanes::run(&args),
        Task::PanicFree => panic_free::run(),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
