//! `flix status`: shows the state of the robot.

use std::fmt::Write;
use std::process::ExitCode;
use std::time::Duration;

use flix_protocol::message::{
    Command, CrashReport, DropReason, Dropped, EncoderHealth, Fault, Identity, Magnet,
    MotorTelemetry, Outcome, Setpoint, Telemetry,
};
use serde::Serialize;
use serde_json::{Map, Value};

use super::address::RobotArgs;
use super::crash;
use flix_host::link::udp::Connection;
use flix_host::link::{Client, LinkError};
use flix_host::link::{RobotLink, explain};
use flix_host::system::interrupt::Interrupt;
use flix_host::system::text::{fixed, printable};
use flix_shell::output::{milliseconds, print, print_json};
use flix_shell::{Error, Exit};

/// Longest wait for telemetry; its lowest rate is one per second.
pub const TELEMETRY_PATIENCE: Duration = Duration::from_secs(3);

/// Show the state of the robot: faults with their first cause, rotors, battery, link.
///
/// The robot does not move, and its state does not change.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  flix status walker-3f2c
  flix status walker-3f2c --json | jq -e '.faults == []'")]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let mut connection = args.robot.connect(&interrupt)?;
    let status = ask(&mut connection)?;
    connection.leave();
    if args.json {
        print_json(&status)?;
    } else {
        print(&describe(&status, &args.robot.robot))?;
    }
    Ok(Exit::Done.into())
}

/// The state of a robot, with units in the names.
#[derive(Debug, Clone, Serialize)]
pub struct Status {
    robot: Robot,
    crash: Option<String>,
    operator: String,
    state: String,
    stopped: bool,
    stopped_by: Option<String>,
    link_late: bool,
    frequency_limited: bool,
    faults: Vec<Explained>,
    first_fault: Option<String>,
    commanded: Shaking,
    measured: Shaking,
    motors: Motors,
    bus_voltage_v: Option<f32>,
    modulation: f32,
    #[serde(rename = "loop")]
    timing: Timing,
    link: Link,
}

#[derive(Debug, Clone, Serialize)]
struct Robot {
    name: String,
    board: String,
    version: String,
    reset_reason: String,
}

#[derive(Debug, Clone, Serialize)]
struct Explained {
    name: String,
    meaning: &'static str,
}

#[derive(Debug, Clone, Copy, Serialize)]
struct Shaking {
    frequency_hz: f32,
    direction_deg: f32,
}

#[derive(Debug, Clone, Copy, Serialize)]
struct Motors {
    top: Motor,
    bottom: Motor,
}

#[derive(Debug, Clone, Copy, Serialize)]
struct Motor {
    angle_deg: f32,
    speed_hz: f32,
    current_d_a: f32,
    current_q_a: f32,
    encoder: Encoder,
}

/// Readings since power-up, and what the encoder says of its magnet.
#[derive(Debug, Clone, Copy, Serialize)]
struct Encoder {
    dropped: u32,
    corrected: u32,
    #[serde(serialize_with = "as_text")]
    magnet: Magnet,
}

fn as_text<S: serde::Serializer>(magnet: &Magnet, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(magnet)
}

#[derive(Debug, Clone, Copy, Serialize)]
struct Timing {
    uptime_s: f64,
    ticks: u64,
    longest_interval_us: u32,
    overruns: u32,
}

#[derive(Debug, Clone, Serialize)]
struct Link {
    round_trip_ms: Option<f64>,
    command_age_ms: Option<f64>,
    late_commands: u32,
    signal_dbm: Option<i8>,
    robot: End,
    host: End,
}

/// One end's view of the link; dropped datagrams by reason.
#[derive(Debug, Clone, Serialize)]
struct End {
    accepted: u64,
    lost: u64,
    dropped: Map<String, Value>,
}

/// Requests the state of a connected robot.
pub fn ask(connection: &mut Connection) -> Result<Status, LinkError> {
    let Outcome::Identity(identity) = connection.ask(Command::Identify)? else {
        return Err(LinkError::OtherAnswer);
    };
    let crash = crash::ask(connection)?;
    let telemetry = match connection.client().telemetry() {
        Some(telemetry) => *telemetry,
        None => connection
            .wait_for_telemetry(TELEMETRY_PATIENCE, |_| true)?
            .ok_or(LinkError::Unanswered)?,
    };
    let status = Status::new(&identity, &telemetry, connection.client());
    Ok(Status { crash: crash.as_ref().map(accident), ..status })
}

impl Status {
    /// Returns the robot with its board and firmware.
    pub fn robot_line(&self) -> String {
        let Robot { name, board, version, .. } = &self.robot;
        format!("{name} on {board}, firmware {version}")
    }

    fn new(identity: &Identity, telemetry: &Telemetry, client: &Client) -> Self {
        let [top, bottom] =
            [0, 1].map(|motor| Motor::new(telemetry.motors[motor], telemetry.encoders[motor]));
        let health = client.health();
        Self {
            robot: Robot {
                name: printable(&identity.name).into_owned(),
                board: printable(&identity.board).into_owned(),
                version: printable(&identity.version).into_owned(),
                reset_reason: identity.reset.to_string(),
            },
            crash: None,
            operator: telemetry.operator.to_string(),
            state: telemetry.state.to_string(),
            stopped: telemetry.stopped,
            stopped_by: telemetry.stopped_by.map(|by| by.to_string()),
            link_late: telemetry.link_late,
            frequency_limited: telemetry.frequency_limited,
            faults: telemetry.faults.iter().map(Explained::from).collect(),
            first_fault: telemetry.first_fault.map(|fault| fault.to_string()),
            commanded: telemetry.setpoint.into(),
            measured: Shaking {
                frequency_hz: telemetry.frequency.get(),
                direction_deg: telemetry.direction.get(),
            },
            motors: Motors { top, bottom },
            bus_voltage_v: telemetry.bus_voltage.map(|voltage| voltage.get()),
            modulation: telemetry.modulation.get(),
            timing: Timing {
                uptime_s: telemetry.time.as_micros() as f64 * 1e-6,
                ticks: telemetry.timing.ticks,
                longest_interval_us: telemetry.timing.longest_interval_us,
                overruns: telemetry.timing.overruns,
            },
            link: Link {
                round_trip_ms: client.statistics().last_round_trip().map(milliseconds),
                command_age_ms: telemetry.link.age().map(milliseconds),
                late_commands: telemetry.link.late,
                signal_dbm: telemetry.link.signal_dbm,
                robot: End {
                    accepted: telemetry.link.accepted.into(),
                    lost: telemetry.link.lost.into(),
                    dropped: by_reason(&telemetry.link.dropped),
                },
                host: End {
                    accepted: health.accepted,
                    lost: health.lost,
                    dropped: by_reason(&health.dropped),
                },
            },
        }
    }
}

/// Returns what a robot kept of its last accident, in a few words.
fn accident(report: &CrashReport) -> String {
    let reset = report.reset.to_string();
    let reset = printable(&reset);
    match report.fault.as_ref().and_then(|fault| fault.first_fault) {
        Some(fault) if report.reset.is_accident() => format!("{reset}, after the fault {fault}"),
        Some(fault) => format!("{fault}, before {reset}"),
        None => reset.into_owned(),
    }
}

impl From<Fault> for Explained {
    fn from(fault: Fault) -> Self {
        Self { name: fault.to_string(), meaning: explain::fault(fault) }
    }
}

impl From<Setpoint> for Shaking {
    fn from(setpoint: Setpoint) -> Self {
        Self { frequency_hz: setpoint.frequency().get(), direction_deg: setpoint.direction().get() }
    }
}

impl Motor {
    fn new(motor: MotorTelemetry, encoder: EncoderHealth) -> Self {
        let EncoderHealth { dropped, corrected, magnet } = encoder;
        Self {
            angle_deg: motor.angle.get(),
            speed_hz: motor.speed.get(),
            current_d_a: motor.current_d.get(),
            current_q_a: motor.current_q.get(),
            encoder: Encoder { dropped, corrected, magnet },
        }
    }
}

/// Returns the counter of every reason, also of those that never happened.
fn by_reason(dropped: &Dropped) -> Map<String, Value> {
    DropReason::ALL
        .into_iter()
        .map(|reason| (reason.to_string().replace(' ', "_"), dropped.get(reason).into()))
        .collect()
}

fn describe(status: &Status, name: &str) -> String {
    let mut text = String::new();
    let mut row = |name: &str, value: String| {
        // Writing to a string does not fail.
        let _ = writeln!(text, "{name:<12} {value}");
    };
    row("robot", status.robot_line());
    row("started", format!("after {}", status.robot.reset_reason));
    if let Some(crash) = &status.crash {
        row("accident", format!("{crash}: `flix crash {name}` shows more"));
    }
    row("you are", status.operator.clone());
    let stopped = match &status.stopped_by {
        Some(by) => format!(", stopped by {by}: `flix clear` makes it ready again"),
        None if status.stopped => ", stopped: `flix clear` makes it ready again".to_owned(),
        None => String::new(),
    };
    let late = if status.link_late { ", commands are late" } else { "" };
    let limited = if status.frequency_limited { ", voltage or current limits f" } else { "" };
    row("state", format!("{}{stopped}{late}{limited}", status.state));
    match &status.first_fault {
        None => row("faults", "none".to_owned()),
        Some(first) => {
            for fault in &status.faults {
                let rank = if fault.name == *first { "first" } else { "then" };
                row("fault", format!("{rank}: {}: {}", fault.name, fault.meaning));
            }
        }
    }
    let fixed = |value: f32, decimals| fixed(value.into(), decimals);
    let Shaking { frequency_hz, direction_deg } = status.commanded;
    row(
        "commanded",
        format!("f {} Hz, theta {} deg", fixed(frequency_hz, 1), fixed(direction_deg, 0)),
    );
    let Shaking { frequency_hz, direction_deg } = status.measured;
    row(
        "measured",
        format!("f {} Hz, theta {} deg", fixed(frequency_hz, 2), fixed(direction_deg, 1)),
    );
    for (name, motor) in [("top", status.motors.top), ("bottom", status.motors.bottom)] {
        let Motor { angle_deg, speed_hz, current_d_a, current_q_a, encoder } = motor;
        row(
            name,
            format!(
                "{} deg, {} Hz, d {} A, q {} A",
                fixed(angle_deg, 1),
                fixed(speed_hz, 2),
                fixed(current_d_a, 2),
                fixed(current_q_a, 2)
            ),
        );
        let Encoder { dropped, corrected, magnet } = encoder;
        row(
            "  encoder",
            format!(
                "{dropped} readings dropped, {corrected} corrected; {}",
                explain::magnet(magnet)
            ),
        );
    }
    row(
        "battery",
        status
            .bus_voltage_v
            .map_or_else(|| "not measured on this board".to_owned(), |it| format!("{it:.2} V")),
    );
    let Timing { uptime_s, ticks, longest_interval_us, overruns } = status.timing;
    row(
        "loop",
        format!(
            "{ticks} ticks in {uptime_s:.1} s, longest interval {longest_interval_us} us, {overruns} overruns"
        ),
    );
    let round_trip =
        status.link.round_trip_ms.map_or_else(|| "unknown".to_owned(), |it| format!("{it:.2} ms"));
    let signal = status.link.signal_dbm.map_or_else(String::new, |dbm| format!(", {dbm} dBm"));
    let age = status.link.command_age_ms.map_or_else(
        || "age not measured yet".to_owned(),
        |it| format!("{it:.0} ms old on arrival"),
    );
    let late = match status.link.late_commands {
        0 => String::new(),
        count => format!(", {count} came too late"),
    };
    row("link", format!("round trip {round_trip}{signal}"));
    row("commands", format!("{age}{late}"));
    for (name, end) in [("robot hears", &status.link.robot), ("host hears", &status.link.host)] {
        let End { accepted, lost, dropped } = end;
        row(name, format!("{accepted} accepted, {lost} lost, dropped: {}", reasons(dropped)));
    }
    text
}

fn reasons(dropped: &Map<String, Value>) -> String {
    let happened: Vec<String> = dropped
        .iter()
        .filter(|(_, count)| count.as_u64() != Some(0))
        .map(|(reason, count)| format!("{count} {}", reason.replace('_', " ")))
        .collect();
    if happened.is_empty() { "none".to_owned() } else { happened.join(", ") }
}
