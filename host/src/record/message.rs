//! The rows of a record, as they stand in the file.

use std::collections::BTreeMap;

use flix_protocol::message::{DropReason, MotorTelemetry, Setpoint, Telemetry};
use serde::{Deserialize, Serialize};

use crate::nav::{Path, PlanarPose, Progress};
use crate::pose::{Pose, PoseSample};

/// Name of the world frame in the records.
const WORLD: &str = "world";

/// A moment as Foxglove writes it: since 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Timestamp {
    /// Whole seconds.
    pub sec: u32,
    /// The rest, ns.
    pub nsec: u32,
}

/// `foxglove.Vector3`, m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Vector {
    x: f64,
    y: f64,
    z: f64,
}

/// `foxglove.Quaternion`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

/// `foxglove.Pose`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseFields {
    position: Vector,
    orientation: Quaternion,
}

/// A pose as it came.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PoseRow {
    /// When.
    pub timestamp: Timestamp,
    /// The world frame.
    pub frame_id: String,
    /// The pose.
    pub pose: PoseFields,
    /// Whether the source trusted it.
    pub valid: bool,
}

/// The path to follow.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PathRow {
    /// When.
    pub timestamp: Timestamp,
    /// The world frame.
    pub frame_id: String,
    /// Its points, each facing along it.
    pub poses: Vec<PoseFields>,
}

/// An event.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LogRow {
    /// When.
    pub timestamp: Timestamp,
    /// 1 debug, 2 information, 3 warning, 4 error.
    pub level: u8,
    /// What happened.
    pub message: String,
    /// Who says so.
    pub name: String,
    /// Unused; part of the schema.
    pub file: String,
    /// Unused; part of the schema.
    pub line: u32,
}

/// What was commanded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CommandRow {
    /// When.
    pub timestamp: Timestamp,
    /// f.
    pub frequency_hz: f64,
    /// theta.
    pub direction_deg: f64,
    /// Name of the mode, or why the robot rests.
    pub mode: String,
}

/// What navigation makes of the poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NavigationRow {
    /// When.
    pub timestamp: Timestamp,
    /// Filtered.
    pub x_m: f64,
    /// Filtered.
    pub y_m: f64,
    /// Filtered.
    pub heading_rad: f64,
    /// Distance from the path, left positive, or from the goal.
    pub error_m: f64,
    /// Root mean square so far.
    pub error_rms_m: f64,
    /// Made good on the path.
    pub arc_length_m: f64,
    /// The same in laps.
    pub laps: f64,
}

/// One motor with its rotor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MotorRow {
    /// Rotor from forward, clockwise.
    pub angle_deg: f64,
    /// Turns per second, clockwise positive.
    pub speed_hz: f64,
    /// Makes no torque.
    pub current_d_a: f64,
    /// Makes torque.
    pub current_q_a: f64,
}

/// The robot as it reports itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TelemetryRow {
    /// When it arrived.
    pub timestamp: Timestamp,
    /// The robot's own clock.
    pub robot_time_s: f64,
    /// Where its supervisor stands.
    pub state: String,
    /// Latched faults.
    pub faults: Vec<String>,
    /// The first of them: the cause of the rest. None in records older than this column.
    #[serde(default)]
    pub first_fault: Option<String>,
    /// Whether a stop is latched.
    pub stopped: bool,
    /// Whether commands are late.
    pub link_late: bool,
    /// f as asked for.
    pub commanded_frequency_hz: f64,
    /// theta as asked for.
    pub commanded_direction_deg: f64,
    /// f as measured.
    pub frequency_hz: f64,
    /// theta as measured.
    pub direction_deg: f64,
    /// Top motor.
    pub top: MotorRow,
    /// Bottom motor.
    pub bottom: MotorRow,
    /// Battery side of the bridge; none where it is not measured.
    pub bus_voltage_v: Option<f64>,
    /// Largest duty of late, share of what the bridge can give.
    pub modulation: f64,
    /// Longest interval between two ticks of the fast loop.
    pub longest_interval_us: u32,
    /// Ticks that came too late.
    pub overruns: u32,
    /// Datagrams that the robot accepted.
    pub accepted: u32,
    /// Commands that never reached it.
    pub lost: u32,
    /// Datagrams that it dropped, by reason. Empty in records older than this column.
    #[serde(default)]
    pub dropped: BTreeMap<String, u32>,
    /// Time since its last valid command.
    pub silence_us: u32,
}

impl Timestamp {
    /// A moment in nanoseconds since 1970; beyond the year 2106 it stays there.
    #[must_use]
    pub fn from_nanos(nanos: u64) -> Self {
        let sec = u32::try_from(nanos / 1_000_000_000).unwrap_or(u32::MAX);
        Self { sec, nsec: (nanos % 1_000_000_000) as u32 }
    }

    /// Seconds since `start`.
    #[must_use]
    pub fn seconds_since(&self, start: &Self) -> f64 {
        f64::from(self.sec) - f64::from(start.sec)
            + (f64::from(self.nsec) - f64::from(start.nsec)) * 1e-9
    }
}

impl From<&Pose> for PoseFields {
    fn from(pose: &Pose) -> Self {
        let [x, y, z] = pose.position;
        let [w, qx, qy, qz] = pose.orientation;
        Self { position: Vector { x, y, z }, orientation: Quaternion { x: qx, y: qy, z: qz, w } }
    }
}

impl PoseFields {
    /// The pose.
    #[must_use]
    pub fn pose(&self) -> Pose {
        let (p, q) = (self.position, self.orientation);
        Pose { position: [p.x, p.y, p.z], orientation: [q.w, q.x, q.y, q.z] }
    }
}

impl PoseRow {
    pub(super) fn new(timestamp: Timestamp, sample: &PoseSample) -> Self {
        let pose = PoseFields::from(&sample.pose);
        Self { timestamp, frame_id: WORLD.to_owned(), pose, valid: sample.valid }
    }
}

impl PathRow {
    pub(super) fn new(timestamp: Timestamp, path: &Path) -> Self {
        let points =
            path.points().iter().map(|p| PlanarPose { x: p.x, y: p.y, heading: p.tangent });
        let mut poses: Vec<_> = points.map(|p| PoseFields::from(&Pose::planar(p, 0.0))).collect();
        if path.is_closed() {
            poses.extend(poses.first().copied());
        }
        Self { timestamp, frame_id: WORLD.to_owned(), poses }
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

impl From<&MotorTelemetry> for MotorRow {
    fn from(motor: &MotorTelemetry) -> Self {
        Self {
            angle_deg: motor.angle.get().into(),
            speed_hz: motor.speed.get().into(),
            current_d_a: motor.current_d.get().into(),
            current_q_a: motor.current_q.get().into(),
        }
    }
}

impl TelemetryRow {
    pub(super) fn new(timestamp: Timestamp, telemetry: &Telemetry) -> Self {
        let [top, bottom] = &telemetry.motors;
        Self {
            timestamp,
            robot_time_s: telemetry.time.as_micros() as f64 * 1e-6,
            state: telemetry.state.to_string(),
            faults: telemetry.faults.iter().map(|fault| fault.to_string()).collect(),
            first_fault: telemetry.first_fault.map(|fault| fault.to_string()),
            stopped: telemetry.stopped,
            link_late: telemetry.link_late,
            commanded_frequency_hz: telemetry.setpoint.frequency().get().into(),
            commanded_direction_deg: telemetry.setpoint.direction().get().into(),
            frequency_hz: telemetry.frequency.get().into(),
            direction_deg: telemetry.direction.get().into(),
            top: top.into(),
            bottom: bottom.into(),
            bus_voltage_v: telemetry.bus_voltage.map(|volts| volts.get().into()),
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
        }
    }
}
