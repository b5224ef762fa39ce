//! `flix clear`: clears a latched stop, and faults whose cause is gone.

use std::process::ExitCode;
use std::time::Instant;

use super::address::RobotArgs;
use flix_host::link::explain;
use flix_host::system::interrupt::Interrupt;
use flix_protocol::message::Telemetry;
use flix_shell::output::{print, waiting};
use flix_shell::{Error, Exit};

/// Clear a latched stop, and faults whose cause is gone.
///
/// Nothing moves: the next command must arm the robot.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
}

/// Clears, and waits until the robot reports it.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let asked = Instant::now();
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let mut connection = args.robot.connect(&interrupt)?;
    let before = waiting("the robot to be ready again", || connection.clear(asked))?;
    print(&format!("{}ready\n", cleared(&before)))?;
    Ok(Exit::Done.into())
}

/// Returns the lines that name the stop and the faults which were cleared, for a person who has not looked at the robot before.
fn cleared(before: &Telemetry) -> String {
    let by = before.stopped_by.map_or_else(String::new, |by| format!(" of {by}"));
    let stop = before.stopped.then(|| format!("cleared: the stop{by}\n"));
    let faults = before.faults.iter().map(|it| format!("cleared: {it}: {}\n", explain::fault(it)));
    stop.into_iter().chain(faults).collect()
}
