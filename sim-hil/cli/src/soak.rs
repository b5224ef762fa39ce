//! `flix-sim soak`: hours of random commands, faults and link trouble, in virtual time.

use flix_shell::number::{whole, within};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use serde::Serialize;

use super::error::Error;
use super::output::{print_verdict, progress, row, table, words};
use flix_sim::reliability::soak::{GROWTH_LIMIT, Verdict, measure};

/// Run robots through hours of random commands, faults and link trouble, in virtual time
///
/// In every tick: no current above its limit, nothing spinning while disarmed, never two operators, no late tick, no
/// stuck state. Now and then all is mended, and the robot has to shake as commanded.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim soak --hours 0.167\n  flix-sim soak --hours 24 --seed 7 --json"
)]
pub struct Args {
    /// Virtual time of all robots together, hours; a minute to a year
    #[arg(long, default_value_t = 1.0, value_parser = within(0.0167..=8_760.0, "number of hours", ""))]
    hours: f64,
    /// Seed of the robots and of what happens to them
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    seed: u64,
    /// Print JSON only
    #[arg(long)]
    json: bool,
}

/// The verdict with the time that it took.
#[derive(Serialize)]
struct Report {
    #[serde(flatten)]
    verdict: Verdict,
    machine_s: f64,
    times_real_time: f64,
}

/// Runs the command.
///
/// # Errors
/// When a robot could not be armed while all was well, or diverged.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let total = Duration::from_secs_f64(3_600.0 * args.hours);
    let bar = progress(total.as_secs(), "running");
    let began = Instant::now();
    let verdict = measure(args.seed, total, |seconds| bar.inc(seconds));
    let machine_s = began.elapsed().as_secs_f64();
    bar.finish_and_clear();
    let times_real_time = total.as_secs_f64() / machine_s;
    let measured = verdict.map(|verdict| Report { verdict, machine_s, times_real_time });
    print_verdict(measured, |report| report.verdict.pass, args.json, text)
}

fn text(Report { verdict, machine_s, times_real_time }: &Report) -> String {
    let mut figures = vec![
        row!["figure", "measured", ""],
        row!["commands", verdict.commands],
        row!["link troubles", verdict.link_troubles],
        row!["hardware faults", verdict.hardware_faults],
        row!["restarts", verdict.restarts],
        row!["recoveries", verdict.episodes],
        row!["panics", verdict.panics],
        row!["longest recovery", format!("{:.2}", verdict.longest_recovery_s), "s"],
        row!["largest current", format!("{:.2}", verdict.largest_current_a), "A, hardware sound"],
    ];
    if let Some(growth) = verdict.growth_bytes {
        let limit = format!("KiB, limit {}", GROWTH_LIMIT / 1024);
        figures.push(row!["growth of memory", growth / 1024, limit]);
    }
    let mut rules = vec![row!["rule", "broken"]];
    rules.extend(verdict.violations.iter().map(|(rule, count)| row![words(rule), count]));
    let examples: String = verdict.examples.iter().map(|it| format!("  {it}\n")).collect();
    format!(
        "{} robots of seed {} ran for {:.2} hours in {machine_s:.0} s, {times_real_time:.0} times real time:\n\n\
         {}\n{}{examples}\n{}\n",
        verdict.robots,
        verdict.seed,
        verdict.virtual_hours,
        table(&figures),
        table(&rules),
        if verdict.pass { "No rule broken." } else { "Rules were broken." }
    )
}
