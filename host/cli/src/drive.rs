//! `flix drive`: shakes with one pair for a time.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use flix_protocol::message::{Event, Setpoint, Telemetry};
use flix_protocol::units::{self, Degrees, Hertz, OutOfRange};
use serde::Serialize;

use super::address::RobotArgs;
use super::moved::{Motion, Walked};
use super::run::{HeightCheck, PlaceArgs, PoseArgs, record};
use flix_host::link::udp::{Connection, FAREWELL_PATIENCE, STOP_PATIENCE};
use flix_host::link::{LinkError, RobotLink, Update, errors, explain, is_reached};
use flix_host::pose::PoseSource;
use flix_host::pose::any::Poses;
use flix_host::record::{RecordError, Recorder};
use flix_host::system::Clock;
use flix_host::system::interrupt::Interrupt;
use flix_host::system::text::fixed;
use flix_host::teleop::paper_modes::PaperMode;
use flix_shell::number::in_unit;
use flix_shell::output::{
    complain, milliseconds, optional_path_as_text, print, print_json, progress, waiting,
};
use flix_shell::stream::StreamArgs;
use flix_shell::time::positive_duration;
use flix_shell::{Error, Exit};

/// Interval of the progress bar, and of looks at the poses.
const SLICE: Duration = Duration::from_millis(10);

/// Arm the robot, shake at one frequency and direction for a time, and disarm it.
///
/// Ctrl-C, SIGTERM and a closed terminal stop the robot before the program ends. With --pose it reports how the robot
/// moved: nothing holds its heading here, and modes that go forward curve.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
The five modes of the paper's Table IV:
  forward       --frequency -30 --direction 30
  left turn     --frequency -30 --direction 90
  right turn    --frequency 30 --direction 90
  strafe left   --frequency 30 --direction 30
  strafe right  --frequency -30 --direction -60

Examples:
  flix drive walker-3f2c --frequency -30 --direction 30 --for 5s
  flix drive daisy --frequency -30 --direction 30 --for 5s --pose natnet")]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
    #[command(flatten)]
    poses: PoseArgs,
    /// Shaking frequency, -35 to 35 Hz; positive: the top rotor turns clockwise seen from above.
    #[arg(long, value_name = "HZ", allow_hyphen_values = true, value_parser = frequency)]
    frequency: Hertz,
    /// Shaking direction, -90 to 90 degrees from forward; positive: to the right.
    #[arg(long, value_name = "DEG", allow_hyphen_values = true, value_parser = direction)]
    direction: Degrees,
    /// Duration, for example 5, 5s or 1500ms.
    #[arg(long = "for", value_name = "TIME", value_parser = positive_duration)]
    duration: Duration,
    #[command(flatten)]
    place: PlaceArgs,
    /// Write no record.
    #[arg(long)]
    no_record: bool,
    #[command(flatten)]
    stream: StreamArgs,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Parses a shaking frequency.
pub fn frequency(text: &str) -> Result<Hertz, String> {
    let check =
        |value| Hertz::new(value).and_then(|it| Setpoint::new(it, Degrees::ZERO).map(|_| it));
    parse(
        text,
        check,
        ("shaking frequency", "Hz"),
        -flix_protocol::message::MAXIMUM_FREQUENCY.get(),
    )
}

/// Parses a shaking direction.
pub fn direction(text: &str) -> Result<Degrees, String> {
    let check =
        |value| Degrees::new(value).and_then(|it| Setpoint::new(Hertz::ZERO, it).map(|_| it));
    parse(
        text,
        check,
        ("shaking direction", "deg"),
        -flix_protocol::message::MAXIMUM_DIRECTION.get(),
    )
}

/// Parses a number. The error always names the range of a command, not the wider one of the unit.
fn parse<T>(
    text: &str,
    check: impl Fn(f32) -> Result<T, OutOfRange>,
    (quantity, unit): (&str, &str),
    minimum: f32,
) -> Result<T, String> {
    let maximum = -minimum;
    let value = in_unit(text, unit)
        .map_err(|error| format!("{error}; the {quantity} is from {minimum} to {maximum} {unit}"))?
        as f32;
    // No negative zero.
    check(value + 0.0).map_err(|error| {
        let unit = error.unit;
        format!("{quantity} {value} {unit} is outside {minimum} to {maximum} {unit}")
    })
}

/// Drives until interrupted or until an error, and then stops the robot.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let setpoint = Setpoint::new(args.frequency, args.direction).map_err(Error::usage)?;
    if args.no_record && args.stream.is_asked_for() {
        return Err(Error::usage("--foxglove streams what is recorded: leave --no-record out"));
    }
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let poses = args.poses.open_if_named()?;
    let mut connection = args.robot.connect(&interrupt)?;
    let recorder = if args.no_record {
        None
    } else {
        let source = poses.as_ref().map(Poses::name);
        let mut recorder = record(&args.place, &mut connection, source, "drive", BTreeMap::new())?;
        args.stream.start(&mut recorder)?;
        Some(recorder)
    };
    let held = Held::new(setpoint);
    let mut log = DriveLog {
        held,
        seconds: 0.0,
        recorder,
        trouble: None,
        poses,
        heights: HeightCheck::default(),
        walked: None,
    };
    let armed = waiting("the robot to align its motors and prove its link", || connection.arm());
    if armed.is_err() {
        // Nothing was driven: it is no run.
        if let Some(recorder) = log.recorder.take() {
            recorder.discard();
        }
    }
    let driven = armed.and_then(|()| drive(&mut connection, setpoint, args.duration, &mut log));
    let failed = match driven {
        Ok(()) => None,
        Err(LinkError::Interrupted) => Some(stop(&mut connection)),
        Err(error) => Some(give_up(&mut connection, error.into())),
    };
    let ending = failed.as_ref().or(log.trouble.as_ref());
    let results = log.held.results(ending);
    let record = log.recorder.take().map(|recorder| recorder.conclude(results)).transpose();
    if let Some(error) = failed {
        return Err(error);
    }
    let (record, unwritten) =
        record.map_or_else(|error| (None, Some(error.into())), |file| (file, None));
    let report = Report::new(args, &log, &connection, record);
    connection.leave();
    if args.json {
        print_json(&report)?
    } else {
        print(&describe(&report))?;
        if args.poses.pose.is_some() && report.moved.is_none() {
            print("no trusted pose arrived; `flix doctor` with the same --pose finds out why\n")?
        }
    }
    log.trouble.or(unwritten).map_or(Ok(Exit::Done.into()), Err)
}

/// Stops the robot after an interruption. Returns the error that reports it.
pub fn stop(connection: &mut Connection) -> Error {
    let is_stopped = connection.stop(STOP_PATIENCE);
    connection.leave();
    let sentence = if is_stopped {
        "interrupted: the robot has acknowledged the stop; `flix clear` makes it ready again"
    } else {
        "interrupted: stop was sent, and the robot has not acknowledged it; without commands it stops by itself"
    };
    Error::new(Exit::Interrupted, sentence)
}

/// Stops a robot that may still be driven after an error. Returns the error, which reports the stop.
pub fn give_up(connection: &mut Connection, error: Error) -> Error {
    let is_latched = connection.client().is_driving() && connection.stop(FAREWELL_PATIENCE);
    if !is_latched || error.sentence.contains("flix clear") {
        return error;
    }
    let sentence =
        format!("{error}; the robot has acknowledged a stop: `flix clear` makes it ready again",);
    Error { sentence, ..error }
}

/// Drives an armed robot, and disarms it.
fn drive(
    connection: &mut Connection,
    setpoint: Setpoint,
    duration: Duration,
    log: &mut DriveLog,
) -> Result<(), LinkError> {
    let (client, now) = connection.operate();
    client.hold(now, setpoint);
    log.write(|recorder| recorder.command(now, &setpoint, "drive"));
    let began = now;
    let bar = progress(duration);
    let start = Clock::start();
    // Poses that waited for the arming show no drive.
    log.look(now);
    log.walked = None;
    let mut is_low = false;
    while start.elapsed() < duration {
        let left = duration.saturating_sub(start.elapsed());
        let trouble = connection.wait_for(left.min(SLICE), |_, update| {
            let now = began + start.elapsed();
            log.write(|recorder| recorder.update(now, update));
            match update {
                Update::Telemetry(telemetry) => log.held.add(start.elapsed(), telemetry),
                // A contact that bounces says so again and again.
                Update::Event(report)
                    if matches!(report.event, Event::BatteryLow(_))
                        && !std::mem::replace(&mut is_low, true) =>
                {
                    bar.suspend(|| complain(explain::event(&report.event)));
                }
                _ => {}
            }
            LinkError::while_driven(update)
        })?;
        if let Some(error) = trouble {
            return Err(error);
        }
        log.look(began + start.elapsed());
        // A record that cannot be written stops the drive, not the record alone.
        if log.trouble.is_some() {
            break;
        }
        bar.set_position(u64::try_from(start.elapsed().as_millis()).unwrap_or(u64::MAX));
    }
    bar.finish_and_clear();
    log.seconds = start.elapsed().as_secs_f64();
    connection.disarm()
}

/// What is kept of a drive.
struct DriveLog {
    held: Held,
    /// Duration of the drive, s.
    seconds: f64,
    recorder: Option<Recorder>,
    poses: Option<Poses>,
    heights: HeightCheck,
    walked: Option<Walked>,
    /// Why the record is not complete; ends the drive.
    trouble: Option<Error>,
}

impl DriveLog {
    fn write(&mut self, row: impl FnOnce(&mut Recorder) -> Result<(), RecordError>) {
        if let Some(Err(error)) = self.recorder.as_mut().map(row) {
            (self.recorder, self.trouble) = (None, Some(error.into()));
        }
    }

    /// Takes the poses that have arrived. The robot is not steered by them, but a source that fails ends the drive.
    fn look(&mut self, now: units::Instant) {
        loop {
            let polled = self.poses.as_mut().map_or(Ok(None), |poses| poses.poll(now));
            match polled {
                Ok(None) => return,
                Ok(Some(sample)) => {
                    let is_planar = self.poses.as_ref().is_some_and(Poses::is_planar);
                    self.heights.look(&sample, is_planar);
                    Walked::observe(&mut self.walked, &sample);
                    self.write(|recorder| recorder.pose(&sample));
                }
                Err(error) => (self.poses, self.trouble) = (None, Some(error.into())),
            }
        }
    }
}

/// How well the robot held the commanded pair, from its own telemetry.
#[derive(Debug, Clone)]
struct Held {
    setpoint: Setpoint,
    settled_after: Option<Duration>,
    samples: u32,
    frequency_sum: f64,
    frequency_square: f64,
    direction_sum: f64,
    direction_square: f64,
    peak_current: f32,
    bus_voltage: Option<f32>,
}

impl Held {
    fn new(setpoint: Setpoint) -> Self {
        Self {
            setpoint,
            settled_after: None,
            samples: 0,
            frequency_sum: 0.0,
            frequency_square: 0.0,
            direction_sum: 0.0,
            direction_square: 0.0,
            peak_current: 0.0,
            bus_voltage: None,
        }
    }

    /// Adds a telemetry. Errors count from the moment that f and theta are reached.
    fn add(&mut self, at: Duration, telemetry: &Telemetry) {
        let motors = telemetry.motors.iter();
        let current = |current_d: f32, current_q: f32| current_d.hypot(current_q);
        self.peak_current = motors
            .map(|motor| current(motor.current_d.get(), motor.current_q.get()))
            .fold(self.peak_current, f32::max);
        self.bus_voltage = telemetry.bus_voltage.map(|voltage| voltage.get());
        let [frequency, direction] = errors(telemetry, &self.setpoint);
        if self.settled_after.is_none() && is_reached(telemetry, &self.setpoint) {
            self.settled_after = Some(at);
        }
        if self.settled_after.is_some() {
            self.samples += 1;
            self.frequency_sum += f64::from(frequency);
            self.frequency_square += f64::from(frequency).powi(2);
            self.direction_sum += f64::from(direction);
            self.direction_square += f64::from(direction).powi(2);
        }
    }

    /// Returns the results for the record.
    fn results(&self, trouble: Option<&Error>) -> BTreeMap<String, String> {
        let ending = trouble.map_or_else(|| "finished".to_owned(), ToString::to_string);
        let mut results = BTreeMap::from([("ending".to_owned(), ending)]);
        if let Some(figures) = self.figures() {
            let Figures { frequency_rms_error_hz, direction_rms_error_deg, .. } = figures;
            results.extend([
                ("frequency_rms_error_hz".into(), format!("{frequency_rms_error_hz:.3}")),
                ("direction_rms_error_deg".into(), format!("{direction_rms_error_deg:.2}")),
            ]);
        }
        results
    }

    fn figures(&self) -> Option<Figures> {
        let count = f64::from(self.samples);
        (self.samples > 0).then(|| Figures {
            samples: self.samples,
            frequency_hz: f64::from(self.setpoint.frequency().get()) + self.frequency_sum / count,
            frequency_rms_error_hz: (self.frequency_square / count).sqrt(),
            direction_deg: f64::from(self.setpoint.direction().get()) + self.direction_sum / count,
            direction_rms_error_deg: (self.direction_square / count).sqrt(),
        })
    }
}

#[derive(Debug, Serialize)]
struct Report {
    commanded: Commanded,
    seconds: f64,
    settled_after_s: Option<f64>,
    held: Option<Figures>,
    peak_current_a: f32,
    bus_voltage_v: Option<f32>,
    /// With poses.
    moved: Option<Motion>,
    link: Link,
    #[serde(serialize_with = "optional_path_as_text")]
    record: Option<PathBuf>,
}

#[derive(Debug, Serialize)]
struct Commanded {
    frequency_hz: f32,
    direction_deg: f32,
}

#[derive(Debug, Serialize)]
struct Figures {
    /// Telemetry that the figures are of.
    samples: u32,
    frequency_hz: f64,
    frequency_rms_error_hz: f64,
    direction_deg: f64,
    direction_rms_error_deg: f64,
}

#[derive(Debug, Serialize)]
struct Link {
    round_trip_p50_ms: Option<f64>,
    round_trip_p99_ms: Option<f64>,
    loss: f64,
}

impl Report {
    fn new(args: &Args, log: &DriveLog, connection: &Connection, record: Option<PathBuf>) -> Self {
        let DriveLog { held, seconds, walked, .. } = log;
        let statistics = connection.client().statistics();
        let quantile = |share| statistics.round_trip_quantile(share).map(milliseconds);
        Self {
            commanded: Commanded {
                frequency_hz: args.frequency.get(),
                direction_deg: args.direction.get(),
            },
            seconds: *seconds,
            settled_after_s: held.settled_after.map(|it| it.as_secs_f64()),
            held: held.figures(),
            peak_current_a: held.peak_current,
            bus_voltage_v: held.bus_voltage,
            moved: walked.as_ref().map(Walked::motion),
            link: Link {
                round_trip_p50_ms: quantile(0.5),
                round_trip_p99_ms: quantile(0.99),
                loss: statistics.loss(),
            },
            record,
        }
    }
}

fn describe(report: &Report) -> String {
    let mut text = String::new();
    let Report { commanded, held, .. } = report;
    // Writing to a string does not fail.
    let _ = match held {
        Some(held) => writeln!(
            text,
            "f      {:>7} Hz  held {:>7} Hz  within {:.3} Hz RMS\n\
             theta  {:>7} deg held {:>7} deg within {:.2} deg RMS\n\
             reached after {:.2} s; {:.1} s in all, {} samples since; peak current {:.2} A",
            fixed(commanded.frequency_hz.into(), 2),
            fixed(held.frequency_hz, 2),
            held.frequency_rms_error_hz,
            fixed(commanded.direction_deg.into(), 1),
            fixed(held.direction_deg, 1),
            held.direction_rms_error_deg,
            report.settled_after_s.unwrap_or_default(),
            report.seconds,
            held.samples,
            report.peak_current_a,
        ),
        None => writeln!(
            text,
            "f {:.2} Hz and theta {:.1} deg were not reached within {:.1} s; peak current {:.2} A",
            commanded.frequency_hz, commanded.direction_deg, report.seconds, report.peak_current_a,
        ),
    };
    if let Some(moved) = &report.moved {
        let turns = [PaperMode::LeftTurn, PaperMode::RightTurn].map(PaperMode::setpoint);
        let Commanded { frequency_hz, direction_deg } = report.commanded;
        let is_turn = turns.iter().any(|turn| {
            (turn.frequency().get(), turn.direction().get()) == (frequency_hz, direction_deg)
        });
        text += &moved.describe(is_turn, report.seconds);
    }
    if let Some(file) = &report.record {
        text += &format!("record {}\n", file.display());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_negative_zero_is_driven_as_zero() {
        let signs = [frequency("-0").unwrap().get(), direction("-0.0").unwrap().get()];
        assert!(signs.iter().all(|value| value.is_sign_positive()));
    }

    #[test]
    fn numbers_that_cannot_be_driven_are_refused_with_the_range() {
        for text in ["36", "-35.1", "NaN", "nan", "inf", "-inf", "1e9", "1e99", "", "fast", "30kg"]
        {
            let sentence = frequency(text).unwrap_err();
            assert!(sentence.contains("-35 to 35"), "{text}: {sentence}");
        }
        for text in ["91", "-90.5", "NaN", "-inf", "400", "left"] {
            let sentence = direction(text).unwrap_err();
            assert!(sentence.contains("-90 to 90"), "{text}: {sentence}");
        }
    }

    #[test]
    fn the_whole_range_can_be_driven() {
        for text in ["-35", "35", "0", "-0", "29.5", "+30", "30Hz", "-30 Hz"] {
            assert!(frequency(text).is_ok(), "{text}");
        }
        for text in ["-90", "90", "0.25", "30deg", "-1.5 rad"] {
            assert!(direction(text).is_ok(), "{text}");
        }
    }
}
