//! The simulated robot's command line.
#![forbid(unsafe_code)]

use std::process::ExitCode;

use clap::FromArgMatches as _;
use flix_sim::cli::{Cli, run};

fn main() -> ExitCode {
    let matches = Cli::description().get_matches();
    match Cli::from_arg_matches(&matches) {
        Ok(cli) => run(cli),
        Err(error) => error.exit(),
    }
}
