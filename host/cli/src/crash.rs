//! `flix crash`: shows what the robot kept of its last accident.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use flix_protocol::message::{BuildId, Command, CrashReport, FaultSummary, MotorCurrents, Outcome};
use serde::Serialize;

use super::address::RobotArgs;
use crate::symbols::{Frame, LARGEST_ELF, Symbols};
use flix_host::link::explain;
use flix_host::link::udp::Connection;
use flix_host::link::{LinkError, RobotLink};
use flix_host::system::file;
use flix_host::system::interrupt::Interrupt;
use flix_host::system::text::printable;
use flix_shell::output::{complain, print, print_json};
use flix_shell::{Error, Exit};

/// Show what ended the robot's run before its last start: panic, watchdog or brown-out, and the last fault.
///
/// The robot keeps this over a restart, until power goes. It does not move, and its state does not change.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix crash walker-3f2c
  flix crash daisy --elf target/riscv32imac-unknown-none-elf/chip/flix-robot
  flix crash walker-3f2c --json | jq .message")]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    /// ELF file of the firmware that the robot runs, for the names of functions and lines.
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let elf = args.elf.as_deref().map(|path| Ok::<_, Error>((path, read(path)?))).transpose()?;
    let symbols = match &elf {
        Some((path, bytes)) => {
            let symbols = Symbols::read(bytes)
                .map_err(|error| Error::usage(format_args!("{}: {error}", path.display())))?;
            Some((*path, symbols))
        }
        None => None,
    };
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let mut connection = args.robot.connect(&interrupt)?;
    let report = ask(&mut connection)?;
    connection.leave();
    if let (Some((path, symbols)), Some(report)) = (&symbols, &report) {
        check_build(path, symbols.build(), report)?;
    }
    let Some(report) = report else {
        return Err(Error::new(
            Exit::Nothing,
            "no accident and no fault before the robot's last start",
        ));
    };
    let crash = Crash::new(&report, symbols.as_ref().map(|(_, it)| it));
    if args.json {
        print_json(&crash)?;
    } else {
        print(&describe(&crash))?;
    }
    Ok(Exit::Done.into())
}

fn read(path: &Path) -> Result<Vec<u8>, Error> {
    file::read(path, LARGEST_ELF)
        .map_err(|error| Error::usage(format_args!("{}: {error}", path.display())))
}

/// Asks a connected robot what it kept.
pub(super) fn ask(connection: &mut Connection) -> Result<Option<CrashReport>, LinkError> {
    match connection.ask(Command::Crash)? {
        Outcome::Crash(report) => Ok(report),
        _ => Err(LinkError::OtherAnswer),
    }
}

/// Refuses names from the file of another build; warns where nobody knows.
fn check_build(path: &Path, build: BuildId, report: &CrashReport) -> Result<(), Error> {
    let path = path.display();
    match report.build {
        Some(crashed) if crashed != build => Err(Error::usage(format_args!(
            "{path} is build {build}, and build {crashed} crashed: give the ELF file that was flashed"
        ))),
        Some(_) => Ok(()),
        None => {
            complain(format_args!(
                "the robot does not know its build: names are right only if {path} was flashed"
            ));
            Ok(())
        }
    }
}

/// What the robot kept, with units in the names.
#[derive(Debug, Clone, Serialize)]
struct Crash {
    reset_reason: String,
    message: Option<String>,
    uptime_s: Option<f64>,
    version: Option<String>,
    build: Option<String>,
    calls: Vec<Call>,
    fault: Option<Accident>,
    advice: Option<&'static str>,
}

/// Where the program was.
#[derive(Debug, Clone, Serialize)]
struct Call {
    address: String,
    /// Empty without an ELF file.
    frames: Vec<Frame>,
}

/// The last fault.
#[derive(Debug, Clone, Serialize)]
struct Accident {
    time_s: f64,
    first_fault: Option<String>,
    faults: Vec<String>,
    meaning: Option<&'static str>,
    state: String,
    frequency_hz: f32,
    direction_deg: f32,
    top: Currents,
    bottom: Currents,
    bus_voltage_v: Option<f32>,
}

#[derive(Debug, Clone, Copy, Serialize)]
struct Currents {
    current_d_a: f32,
    current_q_a: f32,
}

impl Crash {
    fn new(report: &CrashReport, symbols: Option<&Symbols<'_>>) -> Self {
        let shown = |text: &str| (!text.is_empty()).then(|| printable(text).into_owned());
        let call = |address: &u32| Call {
            address: format!("{address:#010x}"),
            frames: symbols.map(|symbols| symbols.frames(*address)).unwrap_or_default(),
        };
        Self {
            reset_reason: printable(&report.reset.to_string()).into_owned(),
            message: shown(&report.message),
            uptime_s: report.uptime.map(|time| time.as_micros() as f64 * 1e-6),
            version: shown(&report.version),
            build: report.build.map(|build| build.to_string()),
            calls: report.counters.iter().map(call).collect(),
            fault: report.fault.as_ref().map(Accident::from),
            advice: explain::reset(&report.reset),
        }
    }
}

impl From<&FaultSummary> for Accident {
    fn from(fault: &FaultSummary) -> Self {
        let [top, bottom] = fault.currents.map(|MotorCurrents { direct, quadrature }| Currents {
            current_d_a: direct.get(),
            current_q_a: quadrature.get(),
        });
        Self {
            time_s: fault.time.as_micros() as f64 * 1e-6,
            first_fault: fault.first_fault.map(|fault| fault.to_string()),
            faults: fault.faults.iter().map(|fault| fault.to_string()).collect(),
            meaning: fault.first_fault.map(explain::fault),
            state: fault.state.to_string(),
            frequency_hz: fault.frequency.get(),
            direction_deg: fault.direction.get(),
            top,
            bottom,
            bus_voltage_v: fault.bus_voltage.map(|voltage| voltage.get()),
        }
    }
}

// Writing to a string does not fail.
fn describe(crash: &Crash) -> String {
    let mut text = format!("The robot restarted after {}.\n", crash.reset_reason);
    if let Some(message) = &crash.message {
        let _ = writeln!(text, "It said: {message}");
    }
    if let Some(uptime) = crash.uptime_s {
        let _ = writeln!(text, "It had run for {uptime:.1} s.");
    }
    if let Some(version) = &crash.version {
        let build = crash.build.as_ref().map_or_else(String::new, |it| format!(", build {it}"));
        let _ = writeln!(text, "It ran firmware {version}{build}.");
    }
    text += &describe_calls(&crash.calls);
    match &crash.fault {
        Some(fault) => text += &describe_fault(fault),
        None => text += "\nNo fault was latched before.\n",
    }
    if let Some(advice) = crash.advice {
        let _ = writeln!(text, "\nWhat to do: {advice}.");
    }
    text
}

fn describe_calls(calls: &[Call]) -> String {
    if calls.is_empty() {
        return String::new();
    }
    let mut text = "\nWhere the program was, the innermost call first:\n".to_owned();
    for Call { address, frames } in calls {
        let _ = writeln!(text, "  {address}{}", frames.first().map_or_else(String::new, place));
        for frame in frames.iter().skip(1) {
            let _ = writeln!(text, "    inlined into{}", place(frame));
        }
    }
    if calls.iter().all(|call| call.frames.is_empty()) {
        text += "`--elf FILE` names functions and lines.\n";
    }
    text
}

fn place(frame: &Frame) -> String {
    let function = frame.function.as_deref().unwrap_or("unknown");
    match (&frame.file, frame.line) {
        (Some(file), Some(line)) => format!(" {function}, {file}:{line}"),
        (Some(file), None) => format!(" {function}, {file}"),
        _ => format!(" {function}"),
    }
}

fn describe_fault(fault: &Accident) -> String {
    let first = fault.first_fault.as_deref().unwrap_or("unknown");
    let meaning = fault.meaning.map_or_else(String::new, |it| format!(": {it}"));
    let mut text =
        format!("\nIts last fault, {:.3} s after it started: {first}{meaning}.\n", fault.time_s);
    let later: Vec<&str> =
        fault.faults.iter().map(String::as_str).filter(|name| *name != first).collect();
    if !later.is_empty() {
        let _ = writeln!(text, "More faults followed: {}.", later.join(", "));
    }
    let voltage = fault.bus_voltage_v.map_or_else(String::new, |it| format!(", battery {it:.2} V"));
    let _ = writeln!(
        text,
        "Just before: {}, f {:.1} Hz, theta {:.1} deg{voltage}.",
        fault.state, fault.frequency_hz, fault.direction_deg
    );
    for (name, Currents { current_d_a, current_q_a }) in
        [("Top", fault.top), ("Bottom", fault.bottom)]
    {
        let _ = writeln!(text, "{name} motor: d {current_d_a:.2} A, q {current_q_a:.2} A.");
    }
    text
}

#[cfg(test)]
mod tests {
    use flix_protocol::message::{Fault, Faults, ResetReason, State};
    use flix_protocol::units::{Amperes, Degrees, Hertz, Instant, Volts};

    use super::*;

    fn report(reset: ResetReason) -> CrashReport {
        CrashReport {
            reset,
            message: "index out of bounds: the len is 2 but the index is 2".try_into().unwrap(),
            counters: [0x4200_1234, 0x4200_5678].into_iter().collect(),
            version: "0.1.0".try_into().unwrap(),
            build: Some(BuildId([1, 2, 3, 4, 5, 6, 7, 0xAB])),
            uptime: Some(Instant::from_micros(7_654_321)),
            fault: Some(FaultSummary {
                time: Instant::from_micros(1_234_567),
                faults: Faults::NONE.with(Fault::OverCurrent).with(Fault::Stall),
                first_fault: Some(Fault::Stall),
                state: State::Running,
                frequency: Hertz::saturating(-29.75),
                direction: Degrees::saturating(59.5),
                currents: [1.0, 3.0].map(|first| MotorCurrents {
                    direct: Amperes::saturating(first),
                    quadrature: Amperes::saturating(first + 1.0),
                }),
                bus_voltage: Some(Volts::saturating(11.5)),
            }),
        }
    }

    #[test]
    fn a_panic_is_described_in_sentences_with_the_fault_before_it() {
        let report = report(ResetReason::panic("src/link.rs", 12));
        insta::assert_snapshot!(describe(&Crash::new(&report, None)));
    }

    #[test]
    fn a_watchdog_without_a_fault_is_described_with_what_to_do() {
        let report = CrashReport {
            message: "".try_into().unwrap(),
            counters: [].into_iter().collect(),
            version: "".try_into().unwrap(),
            build: None,
            uptime: None,
            fault: None,
            ..report(ResetReason::FastLoop)
        };
        insta::assert_snapshot!(describe(&Crash::new(&report, None)));
    }

    #[test]
    fn calls_are_listed_with_what_was_inlined() {
        let mut crash = Crash::new(&report(ResetReason::panic("a", 1)), None);
        let frame = |function: Option<&str>, line: Option<u32>| Frame {
            function: function.map(str::to_owned),
            file: line.map(|_| "src/link.rs".to_owned()),
            line,
        };
        crash.calls[0].frames = vec![frame(Some("inner"), Some(3)), frame(Some("outer"), Some(9))];
        crash.calls[1].frames = vec![frame(None, None)];
        insta::assert_snapshot!(describe_calls(&crash.calls));
    }

    #[test]
    fn another_build_is_refused_and_an_unknown_one_is_not() {
        let path = Path::new("flix-robot");
        let report = report(ResetReason::Tasks);
        let other = BuildId([9; 8]);
        let error = check_build(path, other, &report).unwrap_err();
        assert_eq!(error.exit, Exit::Usage);
        for word in ["0909090909090909", "01020304050607ab", "flix-robot"] {
            assert!(error.sentence.contains(word), "{error}");
        }
        assert!(check_build(path, report.build.unwrap(), &report).is_ok());
        assert!(check_build(path, other, &CrashReport { build: None, ..report }).is_ok());
    }

    #[test]
    fn what_a_robot_says_does_not_steer_the_terminal() {
        let hostile = "\u{1b}[31mred";
        let report = CrashReport {
            message: hostile.try_into().unwrap(),
            version: hostile.try_into().unwrap(),
            ..report(ResetReason::Panic(hostile.try_into().unwrap()))
        };
        assert!(!describe(&Crash::new(&report, None)).contains('\u{1b}'));
    }
}
