//! `flix-sim adversary`: what somebody without the key can do to a live robot.

use std::process::ExitCode;

use flix_shell::number::whole;

use super::error::Error;
use super::output::{print_verdict, progress, row, table, words};
use flix_sim::reliability::adversary::{
    AMPLIFICATION_LIMIT, ANSWERS_LIMIT, DISCOVERY_LIMIT_PER_S, Effort, FOREIGN_STOP_LIMIT_S,
    HANDSHAKE_LIMIT_S, MOVEMENT_LIMIT_S, NEXT_OPERATOR_LIMIT_S, POSE_LIMIT_M, Verdict, measure,
};

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
    /// Print JSON only
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let Args { datagrams, sessions, bytes, seed, .. } = *args;
    let bar = progress(datagrams + sessions + bytes, "attacking");
    let measured = measure(seed, Effort { datagrams, sessions, bytes }, |done| bar.inc(done));
    bar.finish_and_clear();
    print_verdict(measured, |verdict| verdict.pass, args.json, text)
}

fn text(verdict: &Verdict) -> String {
    let mut sent = vec![row!["sent", "number"]];
    sent.extend(verdict.kinds.iter().map(|(kind, count)| row![words(kind), count]));
    let mut dropped = vec![row!["dropped as", "datagrams"]];
    dropped.extend(verdict.dropped.iter().map(|(it, count)| row![it.replace('_', " "), count]));
    let figures = [
        row!["figure", "measured", "limit"],
        row!["forgeries accepted", verdict.accepted_forgeries, 0],
        row!["movements caused", verdict.movements, 0],
        row!["handshake (s)", format!("{:.3}", verdict.handshake_s), HANDSHAKE_LIMIT_S],
        row!["share of answers heard", format!("{:.3}", verdict.answers_heard), ANSWERS_LIMIT],
        row!["ticks missed", verdict.overruns, 0],
        row![
            "movement after the operator's last intent (s)",
            format!("{:.3}", verdict.longest_movement_after_intent_s),
            MOVEMENT_LIMIT_S
        ],
        row![
            "stop of a second key holder (s)",
            format!("{:.3}", verdict.longest_foreign_stop_s),
            FOREIGN_STOP_LIMIT_S
        ],
        row![
            "next operator's wait (s)",
            format!("{:.3}", verdict.longest_wait_of_next_operator_s),
            NEXT_OPERATOR_LIMIT_S
        ],
        row![
            "bytes of mDNS out per byte in, from other networks",
            format!("{:.2}", verdict.off_link_amplification),
            0
        ],
        row![
            "bytes of mDNS out per byte in, from the robot's own",
            format!("{:.2}", verdict.on_link_amplification),
            AMPLIFICATION_LIMIT
        ],
        row!["answers of mDNS a second", verdict.discovery_answers_per_s, DISCOVERY_LIMIT_PER_S],
        row!["starts and clears without the present permit", verdict.unshown_starts, 0],
        row!["failures while keys are renewed", verdict.renewal_failures, 0],
        row!["failures at the operator's end, cable and server", verdict.siege_failures, 0],
        row![
            "recorded sessions that a key learnt later opens",
            if verdict.forward_secret { "none" } else { "some" },
            "none"
        ],
        row![
            "farthest trusted pose (m)",
            format!("{:.3}", verdict.farthest_trusted_pose_m),
            POSE_LIMIT_M
        ],
        row!["panics", verdict.panics, 0],
    ];
    format!(
        "{} datagrams, {} sessions and {} fuzzed bytes against robots of seed {}:\n\n{}\n{}\n{}\n{}\n",
        verdict.datagrams,
        verdict.sessions + verdict.intrusions,
        verdict.fuzzed_bytes,
        verdict.seed,
        table(&sent),
        table(&dropped),
        table(&figures),
        if verdict.pass { "Nobody got in, nothing moved." } else { "Not all within limits." }
    )
}
