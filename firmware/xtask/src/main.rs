#![forbid(unsafe_code)]
//! Chip work that is more than one cargo call: `cargo xtask --help`.
//!
//! Where rustup and espup are installed their toolchains are used. Where they cannot be had,
//! Debian's compiler builds the ESP32-C6 and a stand-in target type-checks the other two chips.

mod chip;
mod image;
mod panic_free;
mod pil;
mod run;
mod setup;
mod toolchain;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use chip::{Chip, Options};

/// Builds, checks, measures and flashes the chip images.
#[derive(Parser)]
#[command(name = "cargo xtask", version, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    task: Task,
}

const EXAMPLES: &str = "Examples:
  cargo xtask setup                                  what a fresh machine lacks
  cargo xtask build esp32c6
  cargo xtask flash esp32 --board dengfoc-v3-01
  cargo xtask check esp32 --encoder mt6701
  cargo xtask size";

#[derive(Subcommand)]
enum Task {
    /// Brings what is missing: the compiler's target and sources, QEMU, an image maker.
    Setup,
    /// Builds the chip's firmware.
    Build {
        /// The chip.
        chip: Chip,
        #[command(flatten)]
        options: Options,
    },
    /// Type-checks the chip's firmware with every board and encoder, or with those named.
    Check {
        /// The chip.
        chip: Chip,
        #[command(flatten)]
        options: Options,
    },
    /// Makes a flashable file of the chip's firmware.
    Image {
        /// The chip.
        chip: Chip,
        #[command(flatten)]
        options: Options,
    },
    /// Builds, flashes and shows the log (needs espflash and a board).
    Flash {
        /// The chip.
        chip: Chip,
        #[command(flatten)]
        options: Options,
    },
    /// Replays a recorded walk on an emulated processor: same bits as here, instructions counted.
    Pil,
    /// Prints what the ESP32-C6 image takes of flash and memory; fails above the ceilings.
    Size,
    /// Shows that no panic can be reached from the fast tick; fails when one can.
    PanicFree,
}

fn main() -> ExitCode {
    let outcome = match Cli::parse().task {
        Task::Setup => setup::setup(),
        Task::Build { chip, options } => toolchain::build(chip, &options).map(drop),
        Task::Check { chip, options } => toolchain::check(chip, &options),
        Task::Image { chip, options } => image::make(chip, &options).map(drop),
        Task::Flash { chip, options } => toolchain::flash(chip, &options),
        Task::Pil => pil::run(),
        Task::Size => image::size(),
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
