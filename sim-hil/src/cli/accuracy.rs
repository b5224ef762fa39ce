//! `flix-sim accuracy`: the figures that the robot promises, measured.

use std::process::ExitCode;

use super::{Error, progress, tell};
use crate::reliability::accuracy::{
    ACROSS_LIMIT, Accuracy, DIRECTION_LIMIT_DEG, FORCE_LIMIT_DEG, FREQUENCY_LIMIT_HZ, HoldResult,
    RUNS, SETTLE_LIMIT_S, measure,
};
use crate::rig::bench::{BASES, Base};

/// Measure how well f and theta are held, over all of them.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  flix-sim accuracy\n  flix-sim accuracy --seed 7 --json")]
pub struct Args {
    /// Which robot: its motors, wiring, sensor errors and noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write the figures as JSON, and nothing else.
    #[arg(long)]
    json: bool,
}

/// # Errors
/// When a robot could not be brought to run.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let bar = progress(RUNS as u64, "measuring");
    let accuracy = measure(args.seed, || bar.inc(1))?;
    bar.finish_and_clear();
    tell(&accuracy, accuracy.pass, args.json, || table(&accuracy, args.seed))
}

fn table(accuracy: &Accuracy, seed: u64) -> String {
    let mut text = format!("Robot of seed {seed}, the plant's truth:\n\n");
    text += "base    f (Hz)  theta (deg)   f rms (Hz)  theta rms (deg)  force (deg)  across (%)\n";
    for hold in &accuracy.hold {
        text += &format!(
            "{:5} {:>8.0} {:>12.0} {:>12.4} {:>16.3} {:>12.3} {:>11.2}{}\n",
            hold.base,
            hold.f_hz,
            hold.theta_deg,
            hold.f_rms_hz,
            hold.theta_rms_deg,
            hold.force_error_deg,
            100.0 * hold.across_axis,
            mark(hold.passes()),
        );
    }
    text += &format!(
        "limit {:>34.4} {:>16.3} {:>12.3} {:>11.2}\n",
        FREQUENCY_LIMIT_HZ,
        DIRECTION_LIMIT_DEG,
        FORCE_LIMIT_DEG,
        100.0 * ACROSS_LIMIT
    );
    for base in BASES {
        text += &worst(base, accuracy.hold.iter().filter(|hold| hold.base == base));
    }
    text +=
        "\nstep                                           settled (s)  current (A)  limit (A)\n";
    for step in &accuracy.steps {
        let settled = step.settle_s.map_or_else(|| "never".to_owned(), |s| format!("{s:.3}"));
        text += &format!(
            "{:46} {settled:>11} {:>12.3} {:>10.3}{}\n",
            step.name,
            step.peak_current_a,
            step.current_limit_a,
            mark(step.passes()),
        );
    }
    text += &format!("{:46} {SETTLE_LIMIT_S:>11.3}\n\n", "limit");
    text + if accuracy.pass { "All within limits.\n" } else { "Not all within limits.\n" }
}

fn worst<'a>(base: Base, of: impl Iterator<Item = &'a HoldResult>) -> String {
    let largest = of.fold([0.0_f64; 4], |largest, hold| {
        [
            largest[0].max(hold.f_rms_hz),
            largest[1].max(hold.theta_rms_deg),
            largest[2].max(hold.force_error_deg.abs()),
            largest[3].max(100.0 * hold.across_axis),
        ]
    });
    let [f, theta, force, across] = largest;
    format!("worst, {base:5} {f:>27.4} {theta:>16.3} {force:>12.3} {across:>11.2}\n")
}

fn mark(passes: bool) -> &'static str {
    if passes { "" } else { "  <-- outside" }
}
