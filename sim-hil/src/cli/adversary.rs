//! `flix-sim adversary`: what somebody without the key can do to a live robot.

use std::process::ExitCode;

use super::{Error, progress, tell, words};
use crate::reliability::adversary::{HANDSHAKE_LIMIT_S, Verdict, measure};

/// Attack live robots over their link, and tell what came of it.
///
/// Each robot has a twin that is left alone; the two must stay the same to the last bit.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim adversary\n  flix-sim adversary --datagrams 500000 --bytes 5000000 --json"
)]
pub struct Args {
    /// How many datagrams the attacker sends.
    #[arg(long, default_value_t = 10_000_000)]
    datagrams: u64,
    /// How many bytes decoders, sessions and the robot are fed.
    #[arg(long, default_value_t = 100_000_000)]
    bytes: u64,
    /// Which robots, and which attack.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write the figures as JSON, and nothing else.
    #[arg(long)]
    json: bool,
}

/// # Errors
/// When a robot could not be armed even without an attack.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let bar = progress(args.datagrams + args.bytes, "attacking");
    let verdict = measure(args.seed, args.datagrams, args.bytes, |datagrams, bytes| {
        bar.inc(datagrams + bytes)
    })?;
    bar.finish_and_clear();
    tell(&verdict, verdict.pass, args.json, || table(&verdict))
}

fn table(verdict: &Verdict) -> String {
    let mut text =
        format!("{} datagrams against robots of seed {}:\n\n", verdict.datagrams, verdict.seed);
    for (kind, count) in &verdict.kinds {
        text += &format!("{:18} {count:>12}\n", words(kind));
    }
    text += "\ndropped for being\n";
    for (name, count) in &verdict.dropped {
        text += &format!("{:18} {count:>12}\n", name.replace('_', " "));
    }
    text += &format!(
        "\nforgeries accepted {:>12}   limit 0\nmovements caused   {:>12}   limit 0\n\
         handshake, s       {:>12.3}   limit {HANDSHAKE_LIMIT_S}\nticks missed       {:>12}   limit 0\n\
         panics             {:>12}   limit 0, in {} fuzzed bytes\n\n",
        verdict.accepted_forgeries,
        verdict.movements,
        verdict.handshake_s,
        verdict.overruns,
        verdict.panics,
        verdict.fuzzed_bytes,
    );
    text + if verdict.pass { "Nobody got in, nothing moved.\n" } else { "Not all within limits.\n" }
}
