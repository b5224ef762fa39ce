//! Reports of the robot: telemetry many times a second, and events.

use core::time::Duration;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::fault::{Fault, Faults};
use super::link::LinkQuality;
use super::names::names;
use super::operator::OperatorName;
use super::order::{Halt, Permit, Withheld};
use super::setpoint::Setpoint;
use crate::units::{Amperes, Degrees, Hertz, Instant, Ratio, Volts};

/// State of the supervisor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum State {
    /// The motors coast.
    Disarmed,
    /// The robot drives the motors to measure: electrical angles and the zero of the current sensors, or in a trial.
    Aligning,
    /// The robot holds the rotors at rest, ready for a setpoint.
    Armed,
    /// The robot shakes, or ramps to its setpoint.
    Running,
    /// Both rotors ramp down together.
    Stopping,
    /// A fault is latched; the motors are not driven.
    Faulted,
}

impl State {
    /// Returns whether the motors are not driven.
    #[must_use]
    pub const fn is_idle(self) -> bool {
        matches!(self, Self::Disarmed | Self::Faulted)
    }
}

names!(State {
    Disarmed: "disarmed",
    Aligning: "aligning",
    Armed: "armed",
    Running: "running",
    Stopping: "stopping",
    Faulted: "faulted",
});

/// One motor with its rotor, as measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
pub struct MotorTelemetry {
    /// Angle of the rotor (arm of the eccentric mass) from forward, clockwise seen from above.
    pub angle: Degrees,
    /// Speed in turns per second, clockwise positive.
    pub speed: Hertz,
    /// Direct current, which makes no torque.
    pub current_d: Amperes,
    /// Quadrature current, which makes torque: the mean since the previous telemetry, as it ripples with the rotors.
    pub current_q: Amperes,
    /// Its least and its largest value since the previous telemetry.
    pub current_q_range: [Amperes; 2],
}

/// Timing of the fast loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, Schema)]
pub struct LoopTiming {
    /// Ticks since power-up.
    pub ticks: u64,
    /// Longest interval between two ticks since the previous telemetry, microseconds.
    pub longest_interval_us: u32,
    /// Late ticks since power-up.
    pub overruns: u32,
}

/// State of a magnet, as its encoder reports it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, Schema)]
pub enum Magnet {
    /// Nothing is wrong with it.
    #[default]
    Good,
    /// Its field is too weak: the encoder amplifies as much as it can.
    Weak,
    /// Its field is too strong: the encoder amplifies as little as it can.
    Strong,
    /// There is none.
    Missing,
}

names!(Magnet { Good: "good", Weak: "too weak", Strong: "too strong", Missing: "missing" });

/// How an encoder does its work; counters since power-up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, Schema)]
pub struct EncoderHealth {
    /// Readings that failed, or that were not believed.
    pub dropped: u32,
    /// Readings that were believed though they were 2.8 to 11 degrees from where the rotor was expected: each pulls the
    /// motor.
    pub corrected: u32,
    /// State of its magnet.
    pub magnet: Magnet,
}

/// The state of the robot at one moment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
pub struct Telemetry {
    /// Time on the robot's clock.
    pub time: Instant,
    /// State of the supervisor.
    pub state: State,
    /// Latched faults.
    pub faults: Faults,
    /// The first of them: the cause of the rest.
    pub first_fault: Option<Fault>,
    /// Whether a stop is latched.
    pub stopped: bool,
    /// Whether commands are late: the first step of the failsafe ladder.
    pub link_late: bool,
    /// Whether voltage or current hold f below its setpoint. [`Event::FrequencyLimited`] reports the same, but may be lost.
    pub frequency_limited: bool,
    /// Permit that an order has to carry to begin anything.
    pub permit: Permit,
    /// Why the permit was counted up last.
    pub halt: Halt,
    /// Number of the newest order that the fast loop has looked at, among the operator's datagrams of the session, counted from 1;
    /// 0 before the first.
    pub heard: u64,
    /// Time from the arrival of that order to this telemetry, microseconds; `u16::MAX` when it is longer.
    pub held_us: u16,
    /// Why the newest order is not obeyed.
    pub withheld: Option<Withheld>,
    /// The commanded pair.
    pub setpoint: Setpoint,
    /// Measured f, over the last turn.
    pub frequency: Hertz,
    /// Measured theta: the mean since the previous telemetry, as it ripples with the rotors.
    pub direction: Degrees,
    /// Its least and its largest value since the previous telemetry. The line of force repeats every half turn, so that
    /// either may be half a turn away.
    pub direction_range: [Degrees; 2],
    /// Top motor, bottom motor.
    pub motors: [MotorTelemetry; 2],
    /// Top encoder, bottom encoder.
    pub encoders: [EncoderHealth; 2],
    /// Voltage on the battery side of the bridge, the mean since the previous telemetry; none where the board does not
    /// measure it.
    pub bus_voltage: Option<Volts>,
    /// Its least and its largest value since the previous telemetry.
    pub bus_voltage_range: Option<[Volts; 2]>,
    /// Largest recent duty, as a share of the bridge's range.
    pub modulation: Ratio,
    /// Timing of the fast loop.
    pub timing: LoopTiming,
    /// How well the robot receives the operator.
    pub link: LinkQuality,
    /// Operator that holds the session.
    pub operator: OperatorName,
    /// Operator that latched the stop; `None` without a stop.
    pub stopped_by: Option<OperatorName>,
    /// When the robot was last asked to stop, or a fault was last latched, on its clock, while a stop or a fault is latched.
    pub latched_at: Option<Instant>,
}

impl Telemetry {
    /// Returns how long ago the robot was last asked to stop, or a fault was last latched, where either is.
    #[must_use]
    pub fn latched_for(&self) -> Option<Duration> {
        self.latched_at.map(|at| self.time.since(at))
    }
}

/// An event with its number and time. Each is sent once, in order.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
pub struct EventReport {
    /// Counts up by one; a gap shows that some were lost.
    pub number: u32,
    /// Time on the robot's clock.
    pub time: Instant,
    /// The event.
    pub event: Event,
}

/// Something that happened to the robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
pub enum Event {
    /// The robot started.
    Started,
    /// The supervisor changed state.
    State(State),
    /// A fault was latched.
    Fault(Fault),
    /// Latched faults and stop were cleared.
    Cleared,
    /// A stop was latched.
    Stopped,
    /// This operator opened a session.
    OperatorConnected(OperatorName),
    /// The operator closed its session.
    OperatorLeft,
    /// Commands are late: the first step of the failsafe ladder.
    LinkLate,
    /// The command deadline passed: the rotors ramp down.
    CommandDeadline,
    /// The link is lost: the robot disarms.
    LinkLost,
    /// Settings were written.
    SettingsSaved,
    /// Stored settings were damaged or out of range; these have their defaults, and are assumed.
    SettingsDefaulted,
    /// The battery is low.
    BatteryLow(Volts),
    /// The link is slow: commands arrive, but too old to count.
    CommandsLate {
        /// Age of the first of them, milliseconds; `u16::MAX` when it was older than the robot
        /// remembers.
        age_ms: u16,
        /// The largest age at which a command counts, milliseconds.
        limit_ms: u16,
    },
    /// The newest setpoint became too old: the rotors ramp down.
    CommandAge,
    /// This operator stopped the robot from outside the session.
    StoppedFromOutside(OperatorName),
    /// Voltage or current do not reach the commanded f: the robot holds this f, and theta.
    FrequencyLimited(Hertz),
    /// An encoder says that its magnet is not good. Sent once a start for each kind.
    Magnet {
        /// 0 top, 1 bottom.
        motor: u8,
        /// State of the magnet.
        magnet: Magnet,
    },
}
