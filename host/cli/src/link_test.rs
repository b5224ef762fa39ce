//! `flix link-test`: measures the quality of the link.

use std::fmt::Write;
use std::process::ExitCode;
use std::time::Duration;

use serde::Serialize;

use super::address::RobotArgs;
use flix_host::link::udp::Connection;
use flix_host::link::{ANSWER_TIME, KEEP_ALIVE, LinkError, RobotLink};
use flix_host::system::interrupt::Interrupt;
use flix_shell::output::{milliseconds, print, print_json, progress};
use flix_shell::time::positive_duration;
use flix_shell::{Error, Exit};

/// Interval of the progress bar.
const SLICE: Duration = Duration::from_millis(100);
/// Loss above which commands may come late: at 30 % three in a row are lost every second.
const POOR_LOSS: f64 = 0.1;
/// Round trip above which steering by hand feels late.
const POOR_ROUND_TRIP_MS: f64 = 100.0;

/// Measure round trip and loss of the link. The robot does not move.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix link-test walker-3f2c --for 30s
  flix link-test walker-3f2c --json | jq .round_trip_ms.p99")]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    /// Duration of the measurement.
    #[arg(long = "for", value_name = "TIME", default_value = "5s", value_parser = positive_duration)]
    duration: Duration,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    seconds: f64,
    pings: u64,
    answered: u64,
    /// Share of pings without an answer within a second, from 0 to 1.
    loss: f64,
    round_trip_ms: RoundTrip,
    /// Age of the newest command at its arrival, by the robot's own clock.
    command_age_ms: Option<f64>,
    /// Commands that came too late to count, since the robot started.
    late_commands: u32,
    /// Datagrams that did not arrive, by direction.
    lost_to_robot: u32,
    lost_from_robot: u64,
    /// Radio power at the robot.
    signal_dbm: Option<i8>,
}

#[derive(Debug, Serialize)]
struct RoundTrip {
    p50: Option<f64>,
    p90: Option<f64>,
    p99: Option<f64>,
    maximum: Option<f64>,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let mut connection = args.robot.connect(&interrupt)?;
    let report = measure(&mut connection, args.duration)?;
    if args.json {
        print_json(&report)?;
    } else {
        print(&describe(&report))?;
    }
    Ok(Exit::Done.into())
}

fn measure(connection: &mut Connection, duration: Duration) -> Result<Report, LinkError> {
    // A ping counts when its answer is in, or overdue.
    let whole = duration + ANSWER_TIME;
    let bar = progress(whole);
    let start = std::time::Instant::now();
    while start.elapsed() < whole {
        let left = whole.saturating_sub(start.elapsed());
        connection.wait_for(left.min(SLICE), |_, _| None::<()>)?;
        bar.set_position(u64::try_from(start.elapsed().as_millis()).unwrap_or(u64::MAX));
    }
    bar.finish_and_clear();
    let client = connection.client();
    let (statistics, health) = (client.statistics(), client.health());
    let link = client.telemetry().map(|telemetry| telemetry.link);
    let quantile = |share| statistics.counted_quantile(share).map(milliseconds);
    Ok(Report {
        seconds: duration.as_secs_f64(),
        pings: statistics.orders(),
        answered: statistics.answered(),
        loss: statistics.loss(),
        round_trip_ms: RoundTrip {
            p50: quantile(0.5),
            p90: quantile(0.9),
            p99: quantile(0.99),
            maximum: quantile(1.0),
        },
        command_age_ms: link.and_then(|link| link.age()).map(milliseconds),
        late_commands: link.map_or(0, |link| link.late),
        lost_to_robot: link.map_or(0, |link| link.lost),
        lost_from_robot: health.lost,
        signal_dbm: link.and_then(|link| link.signal_dbm),
    })
}

fn describe(report: &Report) -> String {
    let mut text = String::new();
    let ms =
        |value: Option<f64>| value.map_or_else(|| "none".to_owned(), |it| format!("{it:.2} ms"));
    let RoundTrip { p50, p90, p99, maximum } = report.round_trip_ms;
    let mut row = |name: &str, value: String| {
        // Writing to a string does not fail.
        let _ = writeln!(text, "{name:<22} {value}");
    };
    row(
        "pings",
        format!(
            "{} in {} s, one every {} ms",
            report.pings,
            report.seconds,
            KEEP_ALIVE.as_millis()
        ),
    );
    let within = ANSWER_TIME.as_secs();
    row("unanswered", format!("{:.2} % within {within} s", 100.0 * report.loss));
    row("round trip, median", ms(p50));
    row("round trip, p90", ms(p90));
    row("round trip, p99", ms(p99));
    row("round trip, longest", ms(maximum));
    row("age of commands", ms(report.command_age_ms));
    row("late commands", report.late_commands.to_string());
    row("lost to the robot", report.lost_to_robot.to_string());
    row("lost from the robot", report.lost_from_robot.to_string());
    if let Some(power) = report.signal_dbm {
        row("radio power", format!("{power} dBm"));
    }
    row("verdict", verdict(report).to_owned());
    text
}

fn verdict(report: &Report) -> &'static str {
    let lost = f64::from(report.lost_to_robot) + report.lost_from_robot as f64;
    if report.loss > POOR_LOSS && lost > 0.5 * report.loss * report.pings as f64 {
        "poor: the loss is high; move nearer, or use a free channel"
    } else if report.loss > POOR_LOSS
        || report.round_trip_ms.p99.is_none_or(|p99| p99 > POOR_ROUND_TRIP_MS)
    {
        "poor: answers are late; look for other traffic, or for power saving in the network"
    } else {
        "good"
    }
}
