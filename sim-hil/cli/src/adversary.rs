//! `flix-sim adversary`: what somebody without the key can do to a live robot.

use std::process::ExitCode;

use flix_shell::number::whole;

use super::error::Error;
use super::measure::{MeasureArgs, measure};
use flix_sim::reliability::adversary::{Effort, adversary};

/// Attack live robots over their link and count what the attack achieves
///
/// Each robot under forged datagrams has a twin that is not attacked; the two must stay the same to the last bit. Other
/// robots have an operator whose network delays, drops, keeps and releases what he sends, or carries forged ARP and mDNS
/// beside it: they must come to rest, and answer their operator alone.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim adversary\n  flix-sim adversary --datagrams 500000 --sessions 33 --bytes 5000000 --json"
)]
pub struct Args {
    /// Number of datagrams that the attacker makes up
    #[arg(long, default_value_t = 10_000_000, value_parser = whole::<u64>(1..=1_000_000_000_000))]
    datagrams: u64,
    /// Number of sessions over a network in the attacker's hands
    #[arg(long, default_value_t = 330, value_parser = whole::<u64>(1..=1_000_000_000_000))]
    sessions: u64,
    /// Number of bytes fed to decoders, sessions and the robot
    #[arg(long, default_value_t = 100_000_000, value_parser = whole::<u64>(1..=1_000_000_000_000))]
    bytes: u64,
    /// Seed of the robots and of the attack
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    seed: u64,
    #[command(flatten)]
    measure: MeasureArgs,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let Args { datagrams, sessions, bytes, seed, .. } = *args;
    let study = adversary(seed, Effort { datagrams, sessions, bytes });
    measure("adversary", &[&study], &args.measure)
}
