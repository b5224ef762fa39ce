//! The simulated robot's command line.
#![forbid(unsafe_code)]

use std::process::ExitCode;

use flix_shell::parse;
use flix_sim_cli::{Cli, run};

fn main() -> ExitCode {
    parse(Cli::description()).map_or_else(|code| code, run)
}
