//! The rows of a record, as in the file.

use std::collections::BTreeMap;

use flix_protocol::message::{DropReason, EncoderHealth, MotorTelemetry, Setpoint, Telemetry};
use serde::{Deserialize, Serialize};

use crate::nav::{Path, PlanarPose, Progress};
use crate::pose::{Pose, PoseSample, Quaternion, Vector};

/// Name in the records of the frame that does not move, in which poses are given (REP 105).
pub const MAP: &str = "map";
/// Name of the body's frame, as in the robot's URDF (REP 105).
pub const BASE_LINK: &str = "base_link";

/// A moment in the format of Foxglove: time since 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Timestamp {
    /// Seconds.
    pub sec: u32,
    /// Nanoseconds.
    pub nsec: u32,
}

/// A pose as it arrived.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PoseRow {
    /// Time of the row.
    pub timestamp: Timestamp,
    /// Name of the frame: the world.
    pub frame_id: String,
    /// The pose.
    pub pose: Pose,
    /// Whether the source trusted the pose.
    pub valid: bool,
}

/// Poses of frames on others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FramesRow {
    /// The frames.
    pub transforms: Vec<FrameRow>,
}

/// Pose of a frame on another.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameRow {
    /// Time of the row.
    pub timestamp: Timestamp,
    /// Name of the frame that carries it.
    pub parent_frame_id: String,
    /// Its own name.
    pub child_frame_id: String,
    /// Where its origin is, m.
    pub translation: Vector,
    /// How it is turned.
    pub rotation: Quaternion,
}

/// The path to follow.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PathRow {
    /// Time of the row.
    pub timestamp: Timestamp,
    /// Name of the frame: the world.
    pub frame_id: String,
    /// Its points, each facing along it.
    pub poses: Vec<Pose>,
}

/// An event.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LogRow {
    /// Time of the row.
    pub timestamp: Timestamp,
    /// 1 debug, 2 information, 3 warning, 4 error.
    pub level: u8,
    /// What happened.
    pub message: String,
    /// Source of the message.
    pub name: String,
    /// Unused; part of the schema.
    pub file: String,
    /// Unused; part of the schema.
    pub line: u32,
}

/// A command.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CommandRow {
    /// Time of the row.
    pub timestamp: Timestamp,
    /// Commanded f, Hz.
    pub frequency_hz: f64,
    /// Commanded theta, degrees.
    pub direction_deg: f64,
    /// Name of the mode, or why the robot rests.
    pub mode: String,
}

/// The estimate of navigation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NavigationRow {
    /// Time of the row.
    pub timestamp: Timestamp,
    /// Filtered position east, m.
    pub x_m: f64,
    /// Filtered position north, m.
    pub y_m: f64,
    /// Filtered heading, rad counter-clockwise from x.
    pub heading_rad: f64,
    /// Distance from the path, positive to the left, or from the goal, m.
    pub error_m: f64,
    /// Root mean square of the error so far, m.
    pub error_rms_m: f64,
    /// Arc length covered on the path, m.
    pub arc_length_m: f64,
    /// Arc length in laps.
    pub laps: f64,
}

/// One motor with its rotor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MotorRow {
    /// Angle of the rotor from forward, clockwise, degrees.
    pub angle_deg: f64,
    /// Speed in turns per second, clockwise positive.
    pub speed_hz: f64,
    /// Direct current, which makes no torque, A.
    pub current_d_a: f64,
    /// Quadrature current, which makes torque, the mean since the row before, A.
    pub current_q_a: f64,
    /// Its least value since the row before, A. None in records older than this column, as of all such.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub current_q_least_a: Option<f64>,
    /// Its largest value since the row before, A.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub current_q_largest_a: Option<f64>,
    /// Readings of its encoder, since power-up, that failed or were not believed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub readings_dropped: Option<u32>,
    /// Readings of its encoder, since power-up, that were believed though they were far from where the rotor was expected.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub readings_corrected: Option<u32>,
}

/// Telemetry of the robot. What is absent is left out: a field of a schema has one type, by the readers of Foxglove and Lichtblick.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TelemetryRow {
    /// Time of arrival.
    pub timestamp: Timestamp,
    /// Time on the robot's clock, s.
    pub robot_time_s: f64,
    /// State of the supervisor.
    pub state: String,
    /// Latched faults.
    pub faults: Vec<String>,
    /// The first of them: the cause of the rest. None in records older than this column.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first_fault: Option<String>,
    /// Whether a stop is latched.
    pub stopped: bool,
    /// Whether commands are late.
    pub link_late: bool,
    /// Whether voltage or current hold f below what is asked for. None in records older than this column.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frequency_limited: Option<bool>,
    /// Commanded f, Hz.
    pub commanded_frequency_hz: f64,
    /// Commanded theta, degrees.
    pub commanded_direction_deg: f64,
    /// Measured f, Hz.
    pub frequency_hz: f64,
    /// Measured theta, the mean since the row before, degrees.
    pub direction_deg: f64,
    /// Its least value since the row before, degrees; the line of force repeats every half turn.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction_least_deg: Option<f64>,
    /// Its largest value since the row before, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction_largest_deg: Option<f64>,
    /// Top motor.
    pub top: MotorRow,
    /// Bottom motor.
    pub bottom: MotorRow,
    /// Voltage on the battery side of the bridge, the mean since the row before, V; none where it is not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bus_voltage_v: Option<f64>,
    /// Its least value since the row before, V.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bus_voltage_least_v: Option<f64>,
    /// Its largest value since the row before, V.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bus_voltage_largest_v: Option<f64>,
    /// Largest recent duty, as a share of the bridge's range.
    pub modulation: f64,
    /// Longest interval between two ticks of the fast loop, microseconds.
    pub longest_interval_us: u32,
    /// Late ticks.
    pub overruns: u32,
    /// Datagrams that the robot accepted.
    pub accepted: u32,
    /// Commands that did not reach it.
    pub lost: u32,
    /// Datagrams that it dropped, by reason. Empty in records older than this column.
    #[serde(default)]
    pub dropped: BTreeMap<String, u32>,
    /// Time since its last valid command, microseconds.
    pub silence_us: u32,
    /// Age of the newest command at its arrival, ms; none when it was older than the robot remembers,
    /// and in records older than this column.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command_age_ms: Option<f64>,
}

impl Timestamp {
    /// Makes a timestamp from nanoseconds since 1970; after the year 2106 it stays at the end.
    #[must_use]
    pub fn from_nanos(nanos: u64) -> Self {
        let sec = u32::try_from(nanos / 1_000_000_000).unwrap_or(u32::MAX);
        Self { sec, nsec: (nanos % 1_000_000_000) as u32 }
    }

    /// Returns the seconds since `start`.
    #[must_use]
    pub(crate) fn seconds_since(&self, start: &Self) -> f64 {
        f64::from(self.sec) - f64::from(start.sec)
            + (f64::from(self.nsec) - f64::from(start.nsec)) * 1e-9
    }
}

impl PoseRow {
    pub(super) fn new(timestamp: Timestamp, sample: &PoseSample) -> Self {
        Self { timestamp, frame_id: MAP.to_owned(), pose: sample.pose, valid: sample.valid }
    }
}

impl FramesRow {
    /// Makes a row from the name of each frame, that of its carrier, and its pose there.
    pub fn new<'a>(
        timestamp: Timestamp,
        frames: impl IntoIterator<Item = (&'a str, &'a str, Pose)>,
    ) -> Self {
        let row = |(child, parent, pose): (&str, &str, Pose)| FrameRow {
            timestamp,
            parent_frame_id: parent.to_owned(),
            child_frame_id: child.to_owned(),
            translation: pose.position,
            rotation: pose.orientation,
        };
        Self { transforms: frames.into_iter().map(row).collect() }
    }
}

impl PathRow {
    pub(super) fn new(timestamp: Timestamp, path: &Path) -> Self {
        let mut poses: Vec<_> = path.points().iter().map(|p| Pose::planar(*p, 0.0)).collect();
        if path.is_closed() {
            poses.extend(poses.first().copied());
        }
        Self { timestamp, frame_id: MAP.to_owned(), poses }
    }
}

impl CommandRow {
    pub(super) fn new(timestamp: Timestamp, setpoint: &Setpoint, mode: &str) -> Self {
        Self {
            timestamp,
            frequency_hz: setpoint.frequency().get().into(),
            direction_deg: setpoint.direction().get().into(),
            mode: mode.to_owned(),
        }
    }
}

impl NavigationRow {
    pub(super) fn new(timestamp: Timestamp, pose: &PlanarPose, progress: &Progress) -> Self {
        Self {
            timestamp,
            x_m: pose.x,
            y_m: pose.y,
            heading_rad: pose.heading,
            error_m: progress.error,
            error_rms_m: progress.error_rms,
            arc_length_m: progress.arc_length,
            laps: progress.laps,
        }
    }
}

impl MotorRow {
    fn new(motor: &MotorTelemetry, encoder: &EncoderHealth) -> Self {
        Self {
            angle_deg: motor.angle.get().into(),
            speed_hz: motor.speed.get().into(),
            current_d_a: motor.current_d.get().into(),
            current_q_a: motor.current_q.get().into(),
            current_q_least_a: Some(motor.current_q_range[0].get().into()),
            current_q_largest_a: Some(motor.current_q_range[1].get().into()),
            readings_dropped: Some(encoder.dropped),
            readings_corrected: Some(encoder.corrected),
        }
    }
}

impl TelemetryRow {
    pub(super) fn new(timestamp: Timestamp, telemetry: &Telemetry) -> Self {
        let [top, bottom] =
            [0, 1].map(|it| MotorRow::new(&telemetry.motors[it], &telemetry.encoders[it]));
        let bus = telemetry.bus_voltage_range.map(|range| range.map(|it| f64::from(it.get())));
        Self {
            timestamp,
            robot_time_s: telemetry.time.as_micros() as f64 * 1e-6,
            state: telemetry.state.to_string(),
            faults: telemetry.faults.iter().map(|fault| fault.to_string()).collect(),
            first_fault: telemetry.first_fault.map(|fault| fault.to_string()),
            stopped: telemetry.stopped,
            link_late: telemetry.link_late,
            frequency_limited: Some(telemetry.frequency_limited),
            commanded_frequency_hz: telemetry.setpoint.frequency().get().into(),
            commanded_direction_deg: telemetry.setpoint.direction().get().into(),
            frequency_hz: telemetry.frequency.get().into(),
            direction_deg: telemetry.direction.get().into(),
            direction_least_deg: Some(telemetry.direction_range[0].get().into()),
            direction_largest_deg: Some(telemetry.direction_range[1].get().into()),
            top,
            bottom,
            bus_voltage_v: telemetry.bus_voltage.map(|volts| volts.get().into()),
            bus_voltage_least_v: bus.map(|[least, _]| least),
            bus_voltage_largest_v: bus.map(|[_, largest]| largest),
            modulation: telemetry.modulation.get().into(),
            longest_interval_us: telemetry.timing.longest_interval_us,
            overruns: telemetry.timing.overruns,
            accepted: telemetry.link.accepted,
            lost: telemetry.link.lost,
            dropped: DropReason::ALL
                .into_iter()
                .map(|reason| (reason.to_string(), telemetry.link.dropped.get(reason)))
                .collect(),
            silence_us: telemetry.link.silence_us,
            command_age_ms: telemetry.link.age().map(|age| age.as_secs_f64() * 1e3),
        }
    }
}
