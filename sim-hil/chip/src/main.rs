#![forbid(unsafe_code)]
//! Runs the robot's image on an emulated ESP32-C6 with the simulated robot at its pins, and says whether it does what it
//! has to: `cargo xtask emulate` builds the image and calls this.

mod air;
mod flood;
mod join;
mod journey;
mod live;
mod pins;
mod power;
mod restart;
mod rig;
mod session;
mod start;

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use crate::air::Air;
use crate::join::Join;
use crate::journey::{Journey, JourneyError, travel};
use crate::live::Live;
use crate::restart::Restart;
use crate::rig::{Rig, RigError};
use crate::session::{Battery, Report, Times, drive, magnet_failures};
use crate::start::Start;
use clap::{Parser, ValueEnum};
use flix_esp32c6::chip::{ResetReason, Silicon};
use flix_esp32c6::image::{Image, ImageError};
use flix_esp32c6::marks::Memory;
use flix_esp32c6::network::PASSPHRASE;
use flix_firmware::board::EncoderKind;
use flix_sim::study::lines;
use serde::Serialize;

/// Run an ESP32-C6 image on an emulated chip, with the simulated robot at its pins.
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
    /// Run these parts alone.
    #[arg(long, value_enum, value_delimiter = ',', num_args = 1..)]
    part: Vec<Part>,
    /// Serve the robot to programs of this computer, at most in real time, until Ctrl-C.
    #[arg(long, conflicts_with_all = ["part", "quick", "json"])]
    live: bool,
    /// An image for AS5047P encoders and with a battery divider: its session is run, too, in short.
    #[arg(long, value_name = "IMAGE")]
    other: Option<PathBuf>,
    /// The `flix` that makes the journey [default: that beside this program].
    #[arg(long, value_name = "PROGRAM")]
    flix: Option<PathBuf>,
    /// Assume that ROM and boot loader take so many milliseconds from a reset to the image's first instruction.
    #[arg(long, default_value_t = 300)]
    boot_ms: u64,
    /// Assume that a miss of the cache in front of the flash takes so many nanoseconds.
    #[arg(long, default_value_t = 0)]
    cache_miss_ns: u64,
    /// Assume that the radio's library masks all interrupts for so many microseconds with each call.
    #[arg(long, default_value_t = 0)]
    radio_lock_us: u64,
    /// Measure shorter, and cut power in every 32nd flash operation instead of in each.
    #[arg(long)]
    quick: bool,
    /// Cut power no more once a robot had neither the old nor the new.
    #[arg(long)]
    until_failure: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// Print what the robot says over its serial port.
    #[arg(long)]
    log: bool,
}

/// What is tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Part {
    /// Provision, restart, connect, arm, align, the five modes, disarm.
    Session,
    /// A flood of forged datagrams; the radio gone for 5 s and back.
    Network,
    /// A pass phrase, DHCP that loses and refuses, attempts of which nothing comes, a wrong password.
    Join,
    /// Hangs and panics before the fast loop, in it, and in the tasks.
    Restarts,
    /// Power lost in flash operations of provisioning and of a settings save.
    Power,
    /// The session, in short, of the image given with --other.
    Other,
    /// The real `flix` over a pseudo-terminal and UDP: provision, discover, status, parameters, drive, stop, revoke, forget.
    Journey,
}

impl Cli {
    fn runs(&self, part: Part) -> bool {
        self.part.is_empty() || self.part.contains(&part)
    }

    fn flix(&self) -> PathBuf {
        let beside = |program: PathBuf| program.with_file_name("flix");
        let own = || std::env::current_exe().map_or_else(|_| "flix".into(), beside);
        self.flix.clone().unwrap_or_else(own)
    }

    /// Prepares a robot with this image.
    fn rig(&self, image: Image, encoder: EncoderKind) -> Rig {
        let mut rig = Rig::new(image, encoder, self.seed);
        rig.chip.assume(Silicon {
            boot: Duration::from_millis(self.boot_ms),
            cache_miss: Duration::from_nanos(self.cache_miss_ns),
            radio_lock: Duration::from_micros(self.radio_lock_us),
        });
        rig
    }

    fn times(&self) -> Times {
        let [settle, measure] = if self.quick { QUICK_TIMES } else { TIMES };
        Times { settle, measure }
    }
}

/// The radio transmits with no less.
const LEAST_TRANSMIT_DBM: f64 = 10.0;
/// Interrupts of the radio and the scheduler (esp-radio, esp-rtos).
const RADIO_PRIORITY: u32 = 1;
/// To approach each setpoint, and to measure it; the same in short.
const TIMES: [Duration; 2] = [Duration::from_secs(4), Duration::from_secs(1)];
const QUICK_TIMES: [Duration; 2] = [Duration::from_secs(1), Duration::from_millis(300)];
/// Every so many flash operations power is cut in the short form.
const QUICK_STRIDE: usize = 32;

/// Why nothing was found out.
#[derive(Debug, thiserror::Error)]
enum Error {
    #[error("{path}: {source}")]
    File { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Image(#[from] ImageError),
    #[error(transparent)]
    Journey(#[from] JourneyError),
}

/// What is printed. What was not tried is null.
#[derive(Debug, Default, Serialize)]
struct Verdict {
    #[serde(flatten)]
    session: Option<Report>,
    start: Option<start::Report>,
    network: Option<Air>,
    join: Option<Join>,
    restarts: Option<Vec<Restart>>,
    flash_cuts: Option<usize>,
    flash_lost: Option<usize>,
    journey: Option<Journey>,
    memory: Option<Memory>,
    other: Option<Other>,
    failures: Vec<String>,
    pass: bool,
}

/// What the session of the other image came to.
#[derive(Debug, Serialize)]
struct Other {
    #[serde(flatten)]
    session: Report,
    battery: Battery,
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

fn read(path: &Path) -> Result<Image, Error> {
    let bytes =
        std::fs::read(path).map_err(|source| Error::File { path: path.to_path_buf(), source })?;
    Ok(Image::parse(&bytes)?)
}

fn run(cli: &Cli) -> Result<bool, Error> {
    let image = read(&cli.image)?;
    let encoder = EncoderKind::named(&cli.encoder).unwrap_or(EncoderKind::Mt6701);
    if cli.live {
        return Err(serve(cli.rig(image, encoder), cli.log).into());
    }
    let started = Instant::now();
    let mut verdict = Verdict::default();
    let mut rig = cli.rig(image.clone(), encoder);
    if let Err(error) = try_robot(cli, &mut rig, &mut verdict) {
        verdict.failures.push(error.to_string());
    }
    if cli.log {
        eprintln!("{}", rig.log());
    }
    verdict.failures.extend(rig.findings());
    if cli.runs(Part::Join) {
        let mut rig = cli.rig(image.clone(), encoder);
        match join::try_all(&mut rig, cli.quick, &progress) {
            Ok(mut join) => {
                verdict.failures.append(&mut join.failures);
                verdict.join = Some(join);
            }
            Err(error) => verdict.failures.push(format!("joining: {error}{}", tail(&rig))),
        }
        if cli.log {
            eprintln!("{}", rig.log());
        }
    }
    if cli.runs(Part::Power) {
        let stride = if cli.quick { QUICK_STRIDE } else { 1 };
        match power::cut_all(&image, encoder, cli.seed, stride, cli.until_failure, &progress) {
            Ok(cuts) => {
                verdict.flash_cuts = Some(cuts.cuts);
                verdict.flash_lost = Some(cuts.lost);
                verdict.failures.extend(cuts.failures);
            }
            Err(error) => verdict.failures.push(format!("power cuts: {error}")),
        }
    }
    if cli.runs(Part::Journey) {
        let rig = cli.rig(image, encoder);
        match travel(rig, &cli.flix(), cli.times(), &progress) {
            Ok(mut journey) => {
                verdict.failures.append(&mut journey.failures);
                verdict.journey = Some(journey);
            }
            Err(error) => verdict.failures.push(format!("journey: {error}")),
        }
    }
    if let Some(path) = cli.other.as_ref().filter(|_| cli.runs(Part::Other)) {
        progress("the image with other encoders and a battery divider");
        match try_other(cli.rig(read(path)?, EncoderKind::As5047p)) {
            Ok((other, failures)) => {
                verdict.other = Some(other);
                verdict.failures.extend(failures);
            }
            Err(error) => verdict.failures.push(format!("other image: {error}")),
        }
    }
    verdict.pass = verdict.failures.is_empty();
    progress("");
    if cli.json {
        println!("{}", serde_json::to_string(&verdict).unwrap_or_default());
    } else {
        print(&verdict, started.elapsed());
    }
    Ok(verdict.pass)
}

/// Serves a robot for ever; returns why that ended.
fn serve(rig: Rig, log: bool) -> JourneyError {
    let mut live = match Live::new(rig) {
        Ok(live) => live,
        Err(source) => {
            return JourneyError::System {
                what: "terminal and socket of the robot".into(),
                source,
            };
        }
    };
    println!("serial port {}, address {}", live.port.display(), live.address());
    println!(
        "first: flix provision --port {} --ssid lab, password `{PASSPHRASE}`",
        live.port.display()
    );
    let mut shown = 0;
    loop {
        if let Err(error) = live.advance() {
            return error.into();
        }
        if log && shown < live.rig.serial.len() {
            eprint!("{}", String::from_utf8_lossy(&live.rig.serial[shown..]));
            shown = live.rig.serial.len();
        }
    }
}

/// Returns what a robot's start is, again and again, if it restarts; for the sentence of what it did not do.
fn tail(rig: &Rig) -> String {
    let unasked = rig.resets.iter().filter(|(_, reason)| *reason != ResetReason::Software);
    match unasked.clone().next() {
        Some((at, reason)) => {
            format!(
                " (a reset by {reason:?} after {:.2} s, {} in all)",
                at.as_secs_f64(),
                unasked.count()
            )
        }
        None => String::new(),
    }
}

/// Shows on a terminal what is being done.
fn progress(what: &str) {
    if std::io::stderr().is_terminal() {
        eprint!("\r\x1b[2K{what}");
    }
}

/// Runs the session of a robot with other encoders, which measures its battery; with what does not hold.
fn try_other(mut rig: Rig) -> Result<(Other, Vec<String>), RigError> {
    rig.provision()?;
    rig.connect()?;
    let battery = Battery::of(&mut rig)?;
    let [settle, measure] = QUICK_TIMES;
    let session = drive(&mut rig, Times { settle, measure }, &progress)?;
    let magnets = magnet_failures(&mut rig)?;
    let failures = session.failures().into_iter().chain(battery.failure()).chain(magnets);
    let failures = failures.chain(rig.findings());
    let failures = failures.map(|failure| format!("other image: {failure}")).collect();
    Ok((Other { session, battery }, failures))
}

/// Tries what one robot can show without losing its power.
fn try_robot(cli: &Cli, rig: &mut Rig, verdict: &mut Verdict) -> Result<(), RigError> {
    let parts = [Part::Session, Part::Network, Part::Restarts];
    if !parts.into_iter().any(|part| cli.runs(part)) {
        return Ok(());
    }
    progress("provisioning");
    rig.provision()?;
    rig.connect()?;
    let power = rig.chip.counters().transmit_power_dbm;
    if power.is_none_or(|power| power < LEAST_TRANSMIT_DBM) {
        verdict.failures.push(format!("the radio transmits with {power:?} dBm"));
    }
    let priority = rig.chip.counters().fast_loop_priority;
    if priority <= RADIO_PRIORITY {
        let sentence = "the fast loop's interrupt is not above the radio's: priority";
        verdict.failures.push(format!("{sentence} {priority}"));
    }
    let start = Start::of(&rig.chip);
    verdict.failures.extend(start.failures());
    verdict.start = Some(start.report());
    let counters = rig.chip.counters();
    if counters.radio_sleeps {
        verdict.failures.push("the radio sleeps between beacons".to_owned());
    }
    if cli.runs(Part::Session) {
        let report = drive(rig, cli.times(), &progress)?;
        verdict.failures.extend(report.failures());
        verdict.session = Some(report);
    }
    if cli.runs(Part::Network) {
        progress("a flood of forged datagrams, then no radio for 5 s");
        let network = air::trouble(rig, cli.times(), cli.seed)?;
        verdict.failures.extend(network.failures());
        verdict.network = Some(network);
    }
    let unexpected = rig.resets.iter().filter(|(_, reason)| *reason != ResetReason::Software);
    let sentence = |(at, reason): &(_, _)| format!("a reset by {reason:?} after {at:?}");
    verdict.failures.extend(unexpected.map(sentence));
    verdict.memory = Some(Memory::of(&rig.chip));
    verdict.failures.extend(verdict.memory.iter().flat_map(Memory::failures));
    if cli.runs(Part::Restarts) {
        let restarts = restart::try_all(rig, &progress)?;
        verdict.failures.extend(restarts.iter().flat_map(|restart| restart.failures.clone()));
        verdict.restarts = Some(restarts);
    }
    Ok(())
}

/// Prints every figure by its key in the JSON, what does not hold, and the result.
fn print(verdict: &Verdict, host: Duration) {
    println!("{}{:.1} s", lines(verdict), host.as_secs_f64());
    for failure in &verdict.failures {
        println!("FAILED: {failure}");
    }
    println!("{}", if verdict.pass { "pass" } else { "fail" });
}
