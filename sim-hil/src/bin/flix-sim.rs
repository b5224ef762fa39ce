//! The simulated robot's command line.
#![forbid(unsafe_code)]

use std::process::ExitCode;

use clap::Parser;
use flix_sim::cli::{Cli, run};

fn main() -> ExitCode {
    run(Cli::parse())
}
