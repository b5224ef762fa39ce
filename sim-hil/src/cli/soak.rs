//! `flix-sim soak`: hours of trouble, in virtual time.

use std::process::ExitCode;
use std::time::{Duration, Instant};

use serde::Serialize;

use super::{Error, progress, tell, words};
use crate::reliability::soak::{GROWTH_LIMIT, Verdict, measure};

/// Let robots live through hours of random commands, faults and link trouble, in virtual time.
///
/// In every tick: no current above its limit, nothing spinning while disarmed, never two operators, no late tick, no
/// stuck state. Now and then all is mended, and the robot has to shake as it is told.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim soak --hours 0.167\n  flix-sim soak --hours 24 --seed 7 --json"
)]
pub struct Args {
    /// Virtual time of all robots together, hours; at least a minute.
    #[arg(long, default_value_t = 1.0, value_parser = hours)]
    hours: f64,
    /// Which robots, and what happens to them.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write the figures as JSON, and nothing else.
    #[arg(long)]
    json: bool,
}

fn hours(text: &str) -> Result<f64, String> {
    /// A minute, and a year.
    const RANGE: core::ops::RangeInclusive<f64> = 1.0 / 60.0..=8_760.0;
    let hours: f64 = text.parse().map_err(|_| format!("{text} is no number of hours"))?;
    if RANGE.contains(&hours) {
        Ok(hours)
    } else {
        Err(format!("{hours} is outside {:.4} to {} hours", RANGE.start(), RANGE.end()))
    }
}

/// The verdict with what it took.
#[derive(Serialize)]
struct Told {
    #[serde(flatten)]
    verdict: Verdict,
    machine_s: f64,
    times_real_time: f64,
}

/// # Errors
/// When a robot could not be armed while all was well, or diverged.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let total = Duration::from_secs_f64(3_600.0 * args.hours);
    let bar = progress(total.as_secs(), "living");
    let began = Instant::now();
    let verdict = measure(args.seed, total, |seconds| bar.inc(seconds))?;
    let machine_s = began.elapsed().as_secs_f64();
    bar.finish_and_clear();
    let told = Told { times_real_time: total.as_secs_f64() / machine_s, verdict, machine_s };
    tell(&told, told.verdict.pass, args.json, || table(&told))
}

fn table(told: &Told) -> String {
    let Told { verdict, machine_s, times_real_time } = told;
    let mut text = format!(
        "{} robots of seed {} lived {:.2} hours in {machine_s:.0} s, {times_real_time:.0} times real time:\n\n",
        verdict.robots, verdict.seed, verdict.virtual_hours,
    );
    for (what, count) in [
        ("commands", verdict.commands),
        ("troubles of the link", verdict.link_troubles),
        ("hardware faults", verdict.hardware_faults),
        ("restarts", verdict.restarts),
        ("recoveries asked for", verdict.episodes),
        ("panics", verdict.panics),
    ] {
        text += &format!("{what:24} {count:>10}\n");
    }
    text += &format!(
        "{:24} {:>10.2} s\n{:24} {:>10.2} A, hardware sound\n",
        "longest recovery",
        verdict.longest_recovery_s,
        "largest current",
        verdict.largest_current_a,
    );
    if let Some(growth) = verdict.growth_bytes {
        let kib = growth / 1024;
        text +=
            &format!("{:24} {kib:>10} KiB   limit {}\n", "memory grown by", GROWTH_LIMIT / 1024);
    }
    text += "\nrules broken\n";
    for (rule, count) in &verdict.violations {
        text += &format!("{:24} {count:>10}\n", words(rule));
    }
    for example in &verdict.examples {
        text += &format!("  {example}\n");
    }
    text + if verdict.pass { "\nNo rule broken.\n" } else { "\nNot all is well.\n" }
}
