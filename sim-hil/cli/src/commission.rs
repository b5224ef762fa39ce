//! `flix-sim commission`: robots whose motors nobody knows find their own values.

use std::process::ExitCode;

use flix_shell::number::whole;

use super::error::Error;
use super::output::{headings, mark, print_verdict, progress, row, table};
use flix_sim::reliability::commission::{
    CURRENT_LIMIT_A, Commissioning, LATENCY_LIMIT_US, Late, Trialled, VALUE_LIMIT, measure,
};

/// Let robots with unknown motors find their own values, and check these
///
/// Each robot is drawn: phase resistance 0.1 to 10 ohm, inductance 20 uH to 5 mH, flux linkage 0.5 to 10 mWb, 4 to 14 pole
/// pairs, encoders up to 2.5 ms late, current amplifiers wrong by up to 20 %, with and without a battery divider. It is
/// commissioned over its link as `flix commission` does it; on a board without current sense it must refuse until the
/// motors are entered, to 3 %, and then find how late its encoders are; with each of 23 wiring faults it must name the fault with its
/// motor and phase. 100 robots take eight minutes.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim commission\n  flix-sim commission --seeds 100 --first-seed 7000 --json\n  \
                  flix-sim commission --loss 0.3"
)]
pub struct Args {
    /// How many robots
    #[arg(long, value_name = "COUNT", default_value_t = 20, value_parser = whole::<usize>(1..=100_000))]
    seeds: usize,
    /// Seed of the first robot; the others follow
    #[arg(long, value_name = "SEED", default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    first_seed: u64,
    /// Share of the datagrams that the network loses in either direction, 0 to 0.9 [default: 0.01]; wiring faults are searched without
    #[arg(long, value_name = "SHARE", value_parser = super::conditions::parse_loss)]
    loss: Option<f64>,
    /// Print JSON only
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// When a robot cannot be built.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let bar = progress(args.seeds as u64, "commissioning");
    let measured = measure(args.seeds, args.first_seed, args.loss, || bar.inc(1));
    bar.finish_and_clear();
    print_verdict(measured, |it| it.pass, args.json, text)
}

fn text(all: &Commissioning) -> String {
    let mut rows =
        vec![headings("seed|R (%)|L (%)|flux (%)|latency (us)|pole pairs|current (A)|time (s)")];
    rows.extend(all.each.iter().map(line));
    rows.push(row![
        "limit",
        percent(VALUE_LIMIT),
        percent(VALUE_LIMIT),
        percent(VALUE_LIMIT),
        format!("{LATENCY_LIMIT_US:.0}"),
        "exact",
        format!("{CURRENT_LIMIT_A:.2}"),
    ]);
    let mut late = vec![headings("without current sense|latency (us)|current (A)|time (s)")];
    late.extend(all.voltage_mode.each.iter().map(late_line));
    late.push(
        row!["limit", format!("{LATENCY_LIMIT_US:.0}"), format!("{CURRENT_LIMIT_A:.2}"), "",],
    );
    let wiring = &all.wiring_faults;
    let mut faults = vec![headings("wiring fault|tried|named")];
    let line = |(kind, [tried, named]): (&&str, &[usize; 2])| {
        row![kind, tried, named, mark(tried == named)]
    };
    faults.extend(wiring.kinds.iter().map(line));
    let missed =
        wiring.missed.iter().map(|one| format!("seed {}, {}: {}\n", one.seed, one.kind, one.said));
    format!(
        "Largest error of the two motors of each robot, against the plant:\n\n{}\n{} of {} robots found within the limits; motors came to \
         rest {} times because no order counted.\n\n\
         {}\n{} of {} robots without current sense found within the limits.\n\n{}\n{} of {} wiring faults named, with motor and phase; at most \
         {:.2} A\n{}",
        table(&rows),
        all.found,
        all.robots,
        all.lapses,
        table(&late),
        all.voltage_mode.found,
        all.robots,
        table(&faults),
        wiring.named,
        wiring.tried,
        wiring.largest_current_a,
        missed.collect::<String>(),
    )
}

fn line(robot: &Trialled) -> Vec<String> {
    let (current, time) =
        (format!("{:.2}", robot.largest_current_a), format!("{:.1}", robot.seconds));
    match (&robot.errors, &robot.failure) {
        (Some(errors), _) => row![
            robot.seed,
            percent(errors.resistance),
            percent(errors.inductance),
            percent(errors.flux),
            format!("{:.0}", errors.latency_us),
            if errors.exact { "exact" } else { "wrong" },
            current,
            time,
            mark(robot.passes()),
        ],
        (None, failure) => row![
            robot.seed,
            failure.clone().unwrap_or_default(),
            "",
            "",
            "",
            "",
            current,
            time,
            mark(false),
        ],
    }
}

fn late_line(robot: &Late) -> Vec<String> {
    let (current, time) =
        (format!("{:.2}", robot.largest_current_a), format!("{:.1}", robot.seconds));
    let found = match robot.error_us {
        Some(error) => format!("{error:.0}"),
        None => robot.failure.clone().unwrap_or_default(),
    };
    row![robot.seed, found, current, time, mark(robot.passes())]
}

fn percent(share: f64) -> String {
    format!("{:.2}", 100.0 * share)
}
