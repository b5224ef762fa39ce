//! `flix-sim shiver`: settings near the border of what the robot arms with, and whether a rotor shivers at rest.

use std::process::ExitCode;

use flix_shell::number::whole;

use super::error::Error;
use super::output::{headings, print_verdict, progress, row, table};
use flix_sim::reliability::shiver::{HEAT_LIMIT_W, Judged, Shivers, Verdict, measure};

/// Draw settings, judge them by the robot's stability margin, and run those nearest its border
///
/// Bandwidths, delays, limits and ramps are drawn, the motors are as their settings say. Each set that is run is driven at 5 Hz
/// and then rests for 5 s: the robot refuses to arm with it, both motors together stay below 0.5 W, or a fault names what is
/// wrong. 300 sets take ten seconds.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim shiver\n  flix-sim shiver --sets 10000 --nearest 10000 --first-seed 7000 --json"
)]
pub struct Args {
    /// How many sets are drawn and judged
    #[arg(long, value_name = "COUNT", default_value_t = 10_000, value_parser = whole::<usize>(1..=1_000_000))]
    sets: usize,
    /// How many of them are run, those nearest the border
    #[arg(long, value_name = "COUNT", default_value_t = 300, value_parser = whole::<usize>(1..=1_000_000))]
    nearest: usize,
    /// Seed of the first set; the others follow
    #[arg(long, value_name = "SEED", default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    first_seed: u64,
    /// Print JSON only
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// When a robot cannot be built.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let bar = progress(args.nearest.min(args.sets) as u64, "resting");
    let measured = measure(args.sets, args.nearest, args.first_seed, || bar.inc(1));
    bar.finish_and_clear();
    print_verdict(measured, |it| it.pass, args.json, text)
}

fn text(all: &Shivers) -> String {
    let count = |of: fn(&Verdict) -> bool| all.run.iter().filter(|it| of(&it.verdict)).count();
    let mut rows = vec![headings("margin|position (Hz)|tracker (Hz)|latency (us)|verdict")];
    rows.extend(all.run.iter().filter(|it| !matches!(it.verdict, Verdict::Refused(_))).map(line));
    format!(
        "{}\n{} of {} sets are armed with. Of the {} nearest the border {} are refused, {} rest, {} end in a fault; \
         limit {HEAT_LIMIT_W} W{}\n",
        table(&rows),
        all.accepted,
        all.drawn,
        all.run.len(),
        count(|it| matches!(it, Verdict::Refused(_))),
        count(|it| matches!(it, Verdict::Rested(_))),
        count(|it| matches!(it, Verdict::Faulted(_))),
        if all.pass { "" } else { ": NOT HELD" },
    )
}

fn line(judged: &Judged) -> Vec<String> {
    let value = |name: &str| judged.set.get(name).map_or_else(String::new, |it| format!("{it:.1}"));
    let verdict = match &judged.verdict {
        Verdict::Rested(heat) => format!("{heat:.3} W"),
        Verdict::Refused(said) | Verdict::Faulted(said) => said.clone(),
    };
    row![
        format!("{:.3}", judged.margin),
        value("position_bandwidth"),
        value("tracker_bandwidth"),
        value("encoder_latency"),
        verdict,
    ]
}
