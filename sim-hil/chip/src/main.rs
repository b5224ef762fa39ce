#![forbid(unsafe_code)]
//! Runs the robot's image on an emulated ESP32-C6 with the simulated robot at its pins, and says whether it does what it
//! has to: `cargo xtask emulate` builds the image and calls this.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::Parser;
use flix_chip::chip::ResetReason;
use flix_chip::image::{Image, ImageError};
use flix_chip::rig::{Rig, RigError};
use flix_chip::session::{Report, Times, drive};
use flix_firmware::board::EncoderKind;
use serde::Serialize;

/// Runs an ESP32-C6 image: provision, restart, connect, arm, align, the five modes, disarm.
#[derive(Parser)]
#[command(name = "flix-chip", version)]
struct Cli {
    /// The image, as it would be flashed (ELF).
    image: PathBuf,
    /// The encoders that the image was built for.
    #[arg(long, default_value = "mt6701", value_parser = ["mt6701", "as5047p"])]
    encoder: String,
    /// Where all chance starts.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Seconds to approach each setpoint, and to measure it.
    #[arg(long, num_args = 2, value_names = ["SETTLE", "MEASURE"], default_values_t = [4.0, 1.0])]
    times: Vec<f64>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// Print what the robot says over its serial port.
    #[arg(long)]
    log: bool,
}

/// Why nothing was found out.
#[derive(Debug, thiserror::Error)]
enum Error {
    #[error("{path}: {source}")]
    File { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Image(#[from] ImageError),
}

/// What is printed.
#[derive(Debug, Serialize)]
struct Verdict {
    #[serde(flatten)]
    report: Report,
    failures: Vec<String>,
    pass: bool,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    match run(&cli) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

fn run(cli: &Cli) -> Result<bool, Error> {
    let bytes = std::fs::read(&cli.image)
        .map_err(|source| Error::File { path: cli.image.clone(), source })?;
    let image = Image::parse(&bytes)?;
    let encoder = EncoderKind::named(&cli.encoder).unwrap_or(EncoderKind::Mt6701);
    let mut rig = Rig::new(image, encoder, cli.seed);
    let started = Instant::now();
    let outcome = session(&mut rig, &cli.times);
    if cli.log {
        eprintln!("{}", rig.log());
    }
    let verdict = judge(&rig, outcome);
    if cli.json {
        println!("{}", serde_json::to_string(&verdict).unwrap_or_default());
    } else {
        print(&verdict, rig.chip.now(), started.elapsed());
    }
    Ok(verdict.pass)
}

fn session(rig: &mut Rig, times: &[f64]) -> Result<Report, RigError> {
    rig.provision()?;
    rig.connect()?;
    let [settle, measure] =
        [0, 1].map(|index| Duration::from_secs_f64(times.get(index).copied().unwrap_or(1.0)));
    drive(rig, Times { settle, measure })
}

/// What was promised and does not hold.
fn judge(rig: &Rig, outcome: Result<Report, RigError>) -> Verdict {
    let (report, mut failures) = match outcome {
        Ok(report) => {
            let failures = report.failures();
            (report, failures)
        }
        Err(error) => (Report::default(), vec![error.to_string()]),
    };
    let unexpected = rig.resets.iter().filter(|(_, reason)| *reason != ResetReason::Software);
    failures.extend(unexpected.map(|(at, reason)| format!("a reset by {reason:?} after {at:?}")));
    failures.extend(rig.findings());
    let pass = failures.is_empty();
    Verdict { report, failures, pass }
}

fn print(verdict: &Verdict, chip: Duration, host: Duration) {
    println!("    f        theta   f RMS    theta RMS  peak current");
    for hold in &verdict.report.hold {
        println!(
            "{:6.1} Hz {:6.1} deg  {:.3} Hz {:.3} deg  {:.2} A of {:.2} A",
            hold.f_hz,
            hold.theta_deg,
            hold.f_rms_hz,
            hold.theta_rms_deg,
            hold.peak_current_a,
            hold.current_limit_a
        );
    }
    let report = &verdict.report;
    println!("PWM: {:?} Hz; shares (mean, lowest, highest): {:.3?}", report.pwm_hz, report.shares);
    println!("missed ticks: {}; longest gap: {:.0} us", report.overruns, report.longest_gap_us);
    println!("{:.1} s of the chip in {:.1} s", chip.as_secs_f64(), host.as_secs_f64());
    for failure in &verdict.failures {
        println!("FAILED: {failure}");
    }
    println!("{}", if verdict.pass { "pass" } else { "fail" });
}
