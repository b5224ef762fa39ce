//! What operator and robot say to each other.
//!
//! Three roots: a [`Command`] from the operator, and from the robot a [`Reply`] to one command,
//! a periodic [`Telemetry`], or an [`Event`] that is told once. They travel in
//! [`ToRobot`] and [`ToOperator`], inside the sessions of [`crate::session`].

use core::fmt;

use heapless::{String, Vec};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::units::{Amperes, Degrees, Hertz, Instant, OutOfRange, Ratio, Volts, within};

/// Largest shaking frequency that may be commanded, either sense (paper, section IV: "below 35 Hz").
pub const MAXIMUM_FREQUENCY: Hertz = Hertz::saturating(35.0);
/// Largest shaking direction that may be commanded, either side (paper, section II-E: [-90, 90] degrees).
pub const MAXIMUM_DIRECTION: Degrees = Degrees::saturating(90.0);

/// The pair that selects how the robot moves: shaking frequency f and direction theta.
///
/// f is in [-35, 35] Hz, positive when the top rotor turns clockwise seen from above; theta in
/// [-90, 90] degrees from forward, positive to the right.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
pub struct Setpoint {
    frequency: Hertz,
    direction: Degrees,
}

impl Setpoint {
    /// Standing still.
    pub const REST: Self = Self { frequency: Hertz::ZERO, direction: Degrees::ZERO };

    /// Checks a pair.
    ///
    /// # Errors
    /// When either is outside what the robot can be asked for.
    pub fn new(frequency: Hertz, direction: Degrees) -> Result<Self, OutOfRange> {
        let setpoint = Self { frequency, direction };
        setpoint.check().map(|()| setpoint)
    }

    /// A received pair can be out of range: the robot checks it before it moves, and answers with
    /// the range.
    ///
    /// # Errors
    /// As for [`Setpoint::new`].
    pub fn check(&self) -> Result<(), OutOfRange> {
        let (f, theta) = (MAXIMUM_FREQUENCY.get(), MAXIMUM_DIRECTION.get());
        within("shaking frequency", Hertz::UNIT, self.frequency.get(), -f, f)?;
        within("shaking direction", Degrees::UNIT, self.direction.get(), -theta, theta)?;
        Ok(())
    }

    /// f.
    #[must_use]
    pub const fn frequency(&self) -> Hertz {
        self.frequency
    }

    /// theta.
    #[must_use]
    pub const fn direction(&self) -> Degrees {
        self.direction
    }
}

/// Longest parameter name, in bytes.
pub const NAME_LENGTH: usize = 32;
/// A name on the wire.
pub type Name = String<NAME_LENGTH>;
/// Most parameter entries in one reply.
pub const PARAMETERS_PER_REPLY: usize = 4;

/// What the operator asks of the robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum Command {
    /// Shake so; also the sign of life that the command deadline waits for.
    Setpoint(Setpoint),
    /// Make the motors ready: aligns them when needed, then holds them at rest.
    Arm,
    /// Ramp down and let go of the motors.
    Disarm,
    /// Ramp down now, and stay stopped until [`Command::Clear`]. Idempotent; accepted in every state.
    Stop,
    /// Forget the latched stop and every latched fault whose cause is gone.
    Clear,
    /// Read or change settings.
    Parameter(ParameterCommand),
    /// Who are you?
    Identify,
    /// Are you there? The number comes back.
    Ping(u32),
}

/// Reading and changing settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum ParameterCommand {
    /// One setting by name.
    Get(Name),
    /// Change one setting, until power-off unless saved. Refused while the motors turn.
    Set(Name, f32),
    /// The entries from this index on, as many as fit one reply.
    List(u16),
    /// Keep all settings over power-off.
    Save,
    /// Back to defaults, until power-off unless saved.
    Reset,
}

/// A setting with its meaning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub struct Parameter {
    /// Position in the list.
    pub index: u16,
    /// For example `current_limit`.
    pub name: Name,
    /// Symbol of the unit, for example `A`.
    pub unit: String<8>,
    /// The present value.
    pub value: f32,
    /// The value of a new robot.
    pub default: f32,
    /// Smallest accepted value.
    pub minimum: f32,
    /// Largest accepted value.
    pub maximum: f32,
}

/// Command and its number, as sent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub struct ToRobot {
    /// Chosen by the operator; comes back in the reply.
    pub request: u32,
    /// What to do.
    pub command: Command,
}

/// What to answer to an authentic command that cannot be read: its request number, and the range
/// when it was a setpoint outside every range (NaN, infinite, absurd), [`Refusal::Malformed`]
/// otherwise. `None` when not even the request number can be read.
///
/// Never panics.
#[must_use]
pub fn unreadable(plain: &[u8]) -> Option<(u32, Refusal)> {
    let (request, rest) = postcard::take_from_bytes::<u32>(plain).ok()?;
    let refusal = postcard::from_bytes::<UncheckedSetpoint>(rest).ok().and_then(|setpoint| {
        let UncheckedSetpoint::Setpoint(frequency, direction) = setpoint;
        let frequency = Hertz::new(frequency).and_then(|f| Setpoint::new(f, Degrees::ZERO));
        let direction = Degrees::new(direction).and_then(|theta| Setpoint::new(Hertz::ZERO, theta));
        match (frequency, direction) {
            (Err(_), _) => Some(Refusal::frequency()),
            (_, Err(_)) => Some(Refusal::direction()),
            _ => None,
        }
    });
    Some((request, refusal.unwrap_or(Refusal::Malformed)))
}

/// [`Command::Setpoint`] before its numbers are checked; the same bytes.
#[derive(Deserialize)]
enum UncheckedSetpoint {
    Setpoint(f32, f32),
}

/// What the robot sends.
// Telemetry is the largest and by far the most frequent; nothing is kept in collections.
#[allow(clippy::large_enum_variant, reason = "sent and dropped, never stored")]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum ToOperator {
    /// The answer to one command.
    Reply(Reply),
    /// How the robot is, many times a second.
    Telemetry(Telemetry),
    /// Something that happened.
    Event(EventReport),
}

/// The answer to the command with this request number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub struct Reply {
    /// [`ToRobot::request`] of the command.
    pub request: u32,
    /// What became of it.
    pub outcome: Outcome,
}

/// What became of a command.
#[allow(clippy::large_enum_variant, reason = "sent and dropped, never stored")]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum Outcome {
    /// Accepted.
    Done,
    /// Not done, and nothing changed.
    Refused(Refusal),
    /// One setting.
    Parameter(Parameter),
    /// Some of `total` settings.
    Parameters {
        /// How many there are in all.
        total: u16,
        /// A run of them.
        entries: Vec<Parameter, PARAMETERS_PER_REPLY>,
    },
    /// Who answers.
    Identity(Identity),
    /// The number of a ping.
    Pong(u32),
}

/// Why a command was not done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub enum Refusal {
    /// The command could not be read: another version, or a NaN in it.
    Malformed,
    /// A value outside its range.
    OutOfRange {
        /// What it was for.
        name: Name,
        /// Smallest accepted value.
        minimum: f32,
        /// Largest accepted value.
        maximum: f32,
    },
    /// No setting of this name.
    UnknownParameter,
    /// Not in this state.
    State(State),
    /// A fault stands; see [`Telemetry::faults`].
    Faulted(Faults),
    /// The stop is latched: clear it first.
    Stopped,
    /// The link has not been good for long enough to arm.
    LinkUnproven,
    /// The settings could not be written.
    Storage,
    /// The setting takes whole numbers alone.
    NotWhole {
        /// Which setting.
        name: Name,
    },
}

impl Refusal {
    /// The shaking frequency was out of range.
    #[must_use]
    pub fn frequency() -> Self {
        Self::out_of_range("shaking frequency", -MAXIMUM_FREQUENCY.get(), MAXIMUM_FREQUENCY.get())
    }

    /// The shaking direction was out of range.
    #[must_use]
    pub fn direction() -> Self {
        Self::out_of_range("shaking direction", -MAXIMUM_DIRECTION.get(), MAXIMUM_DIRECTION.get())
    }

    /// A value was out of this range. A name longer than [`NAME_LENGTH`] is cut.
    #[must_use]
    pub fn out_of_range(name: &str, minimum: f32, maximum: f32) -> Self {
        let mut kept = Name::new();
        // Cutting is all that a full buffer means here.
        let _ = name.chars().try_for_each(|character| kept.push(character));
        Self::OutOfRange { name: kept, minimum, maximum }
    }
}

impl From<OutOfRange> for Refusal {
    fn from(error: OutOfRange) -> Self {
        Self::out_of_range(error.quantity, error.minimum, error.maximum)
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Malformed => f.write_str("the robot could not read the command"),
            Self::OutOfRange { name, minimum, maximum } => {
                write!(f, "{name} must be from {minimum} to {maximum}")
            }
            Self::UnknownParameter => f.write_str("the robot has no setting of this name"),
            Self::State(state) => write!(f, "the robot is {state} and cannot do this now"),
            Self::Faulted(faults) => write!(f, "a fault stands ({faults}): clear it first"),
            Self::Stopped => f.write_str("the robot was stopped: clear the stop first"),
            Self::LinkUnproven => f.write_str("the link has not been steady for half a second yet"),
            Self::Storage => f.write_str("the robot could not write its settings"),
            Self::NotWhole { name } => write!(f, "{name} must be a whole number"),
        }
    }
}

/// Which robot this is and what runs on it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub struct Identity {
    /// Chosen when the robot was provisioned.
    pub name: Name,
    /// The driver board, for example `MKS DUAL FOC V3.3 PLUS`.
    pub board: Name,
    /// Version of the firmware.
    pub version: String<16>,
}

/// Where the supervisor stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum State {
    /// The motors are let go.
    Disarmed,
    /// Finding the electrical angle and the current sensors' zero.
    Aligning,
    /// Holding the rotors at rest, ready for a setpoint.
    Armed,
    /// Shaking, or on the way to it.
    Running,
    /// Both rotors ramp down together.
    Stopping,
    /// A fault is latched; the motors are let go.
    Faulted,
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Disarmed => "disarmed",
            Self::Aligning => "aligning",
            Self::Armed => "armed",
            Self::Running => "running",
            Self::Stopping => "stopping",
            Self::Faulted => "faulted",
        })
    }
}

/// One thing that can go wrong. Latched until cleared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[repr(u8)]
pub enum Fault {
    /// A phase current above the limit of the hardware.
    OverCurrent,
    /// The battery is below its cut-off.
    UnderVoltage,
    /// The bus is above what the bridge stands.
    OverVoltage,
    /// A rotor faster than any command.
    OverSpeed,
    /// An encoder does not answer, or answers nonsense.
    EncoderLost,
    /// Full current and no movement.
    Stall,
    /// f or theta far from its reference for too long.
    PhaseLockLost,
    /// The fast loop came too late too often.
    LoopOverrun,
    /// The motor did not follow its alignment: missing magnet, open or swapped phase.
    Alignment,
    /// The current sensors disagree or read far from zero at rest.
    CurrentSense,
    /// The stored settings could not be read; defaults are in force.
    Settings,
}

impl Fault {
    /// All of them, in order of their bits.
    pub const ALL: [Self; 11] = [
        Self::OverCurrent,
        Self::UnderVoltage,
        Self::OverVoltage,
        Self::OverSpeed,
        Self::EncoderLost,
        Self::Stall,
        Self::PhaseLockLost,
        Self::LoopOverrun,
        Self::Alignment,
        Self::CurrentSense,
        Self::Settings,
    ];
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::OverCurrent => "over-current",
            Self::UnderVoltage => "under-voltage",
            Self::OverVoltage => "over-voltage",
            Self::OverSpeed => "over-speed",
            Self::EncoderLost => "encoder lost",
            Self::Stall => "stall",
            Self::PhaseLockLost => "phase lock lost",
            Self::LoopOverrun => "loop overrun",
            Self::Alignment => "alignment failed",
            Self::CurrentSense => "current sense",
            Self::Settings => "settings unreadable",
        })
    }
}

/// A set of faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, Schema)]
pub struct Faults(u16);

impl Faults {
    /// None.
    pub const NONE: Self = Self(0);

    /// With this one added.
    #[must_use]
    pub const fn with(self, fault: Fault) -> Self {
        Self(self.0 | 1 << fault as u8)
    }

    /// With this one taken out.
    #[must_use]
    pub const fn without(self, fault: Fault) -> Self {
        Self(self.0 & !(1 << fault as u8))
    }

    /// Whether this one is in.
    #[must_use]
    pub const fn contains(self, fault: Fault) -> bool {
        self.0 & 1 << fault as u8 != 0
    }

    /// Whether there is none.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Those that are in.
    pub fn iter(self) -> impl Iterator<Item = Fault> {
        Fault::ALL.into_iter().filter(move |fault| self.contains(*fault))
    }
}

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_empty() {
            return f.write_str("none");
        }
        for (index, fault) in self.iter().enumerate() {
            if index > 0 {
                f.write_str(", ")?;
            }
            fault.fmt(f)?;
        }
        Ok(())
    }
}

/// One motor with its rotor, as the robot measures it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
pub struct MotorTelemetry {
    /// Rotor (arm of the eccentric mass) from forward, clockwise seen from above.
    pub angle: Degrees,
    /// Turns per second, clockwise positive.
    pub speed: Hertz,
    /// Current that makes no torque.
    pub current_d: Amperes,
    /// Current that makes torque.
    pub current_q: Amperes,
}

/// Timing of the fast loop since the previous telemetry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, Schema)]
pub struct LoopTiming {
    /// Ticks since power-up.
    pub ticks: u64,
    /// Longest interval between two ticks, microseconds.
    pub longest_interval_us: u32,
    /// Ticks that came too late, since power-up.
    pub overruns: u32,
}

/// How well the robot hears the operator, counted since power-up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, Schema)]
pub struct LinkQuality {
    /// Datagrams accepted.
    pub accepted: u32,
    /// Commands of the present session that never came (gaps in the counter).
    pub lost: u32,
    /// Datagrams dropped, by reason.
    pub dropped: Dropped,
    /// Microseconds since the last valid command; `u32::MAX` when there was none.
    pub silence_us: u32,
    /// Received radio power, dBm; none where there is no radio or it cannot tell.
    pub signal_dbm: Option<i8>,
}

/// Datagrams dropped since power-up, by reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, Schema)]
pub struct Dropped {
    /// Not a datagram of this protocol: too short, too long, unknown kind.
    pub malformed: u32,
    /// Of another version of the protocol.
    pub version: u32,
    /// The tag did not fit: another key, forged or damaged.
    pub forged: u32,
    /// Seen before, or older than the replay window.
    pub replayed: u32,
    /// Older than a command already obeyed.
    pub stale: u32,
    /// Of a session that is not the present one.
    pub session: u32,
    /// A second operator while the first is heard.
    pub busy: u32,
    /// The robot has no key yet.
    pub unprovisioned: u32,
}

impl Dropped {
    /// Counts one more. Stays at `u32::MAX` rather than start over.
    pub const fn count(&mut self, reason: DropReason) {
        let counter = match reason {
            DropReason::Malformed => &mut self.malformed,
            DropReason::Version => &mut self.version,
            DropReason::Forged => &mut self.forged,
            DropReason::Replayed => &mut self.replayed,
            DropReason::Stale => &mut self.stale,
            DropReason::Session => &mut self.session,
            DropReason::Busy => &mut self.busy,
            DropReason::Unprovisioned => &mut self.unprovisioned,
        };
        *counter = counter.saturating_add(1);
    }

    /// How many were dropped for this reason.
    #[must_use]
    pub const fn get(&self, reason: DropReason) -> u32 {
        match reason {
            DropReason::Malformed => self.malformed,
            DropReason::Version => self.version,
            DropReason::Forged => self.forged,
            DropReason::Replayed => self.replayed,
            DropReason::Stale => self.stale,
            DropReason::Session => self.session,
            DropReason::Busy => self.busy,
            DropReason::Unprovisioned => self.unprovisioned,
        }
    }

    /// How many were dropped for any reason.
    #[must_use]
    pub fn total(&self) -> u64 {
        DropReason::ALL.into_iter().map(|reason| u64::from(self.get(reason))).sum()
    }
}

/// Why a datagram was dropped; each has its counter in [`Dropped`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DropReason {
    /// Not a datagram of this protocol: too short, too long, unknown kind.
    Malformed,
    /// Of another version of the protocol.
    Version,
    /// The tag did not fit: another key, forged or damaged.
    Forged,
    /// Seen before, or older than the replay window.
    Replayed,
    /// Older than a command already obeyed (or a telemetry already shown).
    Stale,
    /// Of a session that is not the present one.
    Session,
    /// A second operator while the first is heard.
    Busy,
    /// The robot has no key yet.
    Unprovisioned,
}

impl DropReason {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Malformed,
        Self::Version,
        Self::Forged,
        Self::Replayed,
        Self::Stale,
        Self::Session,
        Self::Busy,
        Self::Unprovisioned,
    ];
}

impl fmt::Display for DropReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Malformed => "malformed",
            Self::Version => "other version",
            Self::Forged => "forged",
            Self::Replayed => "replayed",
            Self::Stale => "stale",
            Self::Session => "other session",
            Self::Busy => "busy",
            Self::Unprovisioned => "unprovisioned",
        })
    }
}

/// How the robot is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
pub struct Telemetry {
    /// Robot's time.
    pub time: Instant,
    /// Where the supervisor stands.
    pub state: State,
    /// Latched faults.
    pub faults: Faults,
    /// The first of them: the cause of the rest.
    pub first_fault: Option<Fault>,
    /// Whether a stop is latched.
    pub stopped: bool,
    /// Whether commands are late: the first step of the failsafe ladder.
    pub link_late: bool,
    /// What is asked for.
    pub setpoint: Setpoint,
    /// f as measured, over the last turn.
    pub frequency: Hertz,
    /// theta as measured.
    pub direction: Degrees,
    /// Top motor, bottom motor.
    pub motors: [MotorTelemetry; 2],
    /// Battery side of the bridge; none where the board cannot measure it.
    pub bus_voltage: Option<Volts>,
    /// Largest duty of late, as a share of what the bridge can give.
    pub modulation: Ratio,
    /// Fast loop.
    pub timing: LoopTiming,
    /// Link.
    pub link: LinkQuality,
}

/// Something that happened, told once and in order.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
pub struct EventReport {
    /// Counts up by one; a gap tells that some were lost.
    pub number: u32,
    /// When.
    pub time: Instant,
    /// What.
    pub event: Event,
}

/// Something that happened.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
pub enum Event {
    /// The robot started.
    Started,
    /// The supervisor changed state.
    State(State),
    /// A fault was latched.
    Fault(Fault),
    /// Latched faults and stop were forgotten.
    Cleared,
    /// A stop was latched.
    Stopped,
    /// An operator took over.
    OperatorConnected,
    /// The operator said goodbye.
    OperatorLeft,
    /// No valid command for this step of the failsafe ladder.
    LinkLate,
    /// Commands stayed away: ramping down.
    CommandDeadline,
    /// Commands stayed away for long: disarmed.
    LinkLost,
    /// Settings were written.
    SettingsSaved,
    /// Stored settings were damaged; defaults are in force.
    SettingsDefaulted,
    /// The battery is low.
    BatteryLow(Volts),
}
