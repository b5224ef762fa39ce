//! What crosses between the fast and the slow half, which run at different priorities or on
//! different cores.
//!
//! ```text
//! slow half  -- Configuration, then Asked -->  Exchange  -->  fast half, every tick
//!            <------------- Report ----------            <--  every tenth tick
//!            <------------- Scope -----------            <--  a row in every tick
//! ```
//!
//! - Whole values cross, and the newest of each kind wins: neither half ever waits for the other.
//! - What must not be lost when a value is overwritten crosses as a wrapping counter: stops and halts in
//!   [`Asked`], events in the [`Report`].
//! - A [`Configuration`] waits until the fast half takes it, which it does only while the motors are
//!   not driven. It drives none while one waits.
//!
//! Who shares the exchange between interrupts, cores or threads implements [`Access`]. Each access
//! lasts for the copy of the values that cross, so that a lock delays a tick by no more.

use core::borrow::BorrowMut;

use flix_protocol::message::{
    EncoderHealth, Fault, Faults, Halt, LoopTiming, Permit, Setpoint, State, Trial,
};
use flix_protocol::units::Instant;
use serde::{Deserialize, Serialize};

use crate::alignment::Alignment;
use crate::fast::configuration::Configuration;
use crate::fast::interval::Interval;
use crate::scope::{Memory, Scope};
use crate::units::{Current, RotorAngle, Speed, Voltage};

/// The kind of the order in force; [`Asked`] holds its values, in integers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Wanted {
    /// Disarm, and stay disarmed.
    #[default]
    Off,
    /// Align, then hold the rotors at rest.
    Arm,
    /// Follow [`Asked::frequency`] and [`Asked::direction`].
    Shake,
    /// Do [`Asked::trial`].
    Try,
    /// Forget the latched stop and the faults whose cause is gone.
    Clear,
}

/// The slow half's demand, handed over whole in every tick: the order in force as a level, and counters of stops and halts, which
/// must not be lost when a newer order takes the place of an older one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Asked {
    /// Kind of the order in force.
    pub wanted: Wanted,
    /// Permit that the order carries.
    pub permit: Permit,
    /// Number of the order; another number is another order.
    pub number: u32,
    /// Whether motors may begin to be driven: the link is steady, and the settings are known and stable.
    pub begins: bool,
    /// f of [`Wanted::Shake`].
    pub frequency: Speed,
    /// theta of [`Wanted::Shake`], within a quarter turn either side of forward.
    pub direction: RotorAngle,
    /// The trial of [`Wanted::Try`].
    pub trial: Option<Trial>,
    /// When the newest valid command arrived.
    pub heard: Instant,
    /// Until when the newest valid command counts, however it travelled: its moment and the command
    /// age.
    pub expires: Instant,
    /// Counts the stops that are to latch, of any operator, wrapping.
    pub stops: u8,
    /// Counts the halts that the fast half does not see by itself, wrapping: stops from outside, sessions that begin or end.
    pub halts: u8,
    /// Counts telemetry sent: starts a new measuring period of [`LoopTiming::longest_interval_us`] and
    /// [`Report::modulation`].
    pub period: u8,
}

impl Asked {
    /// Takes over a sign of life that arrived now.
    pub const fn hear(&mut self, now: Instant, expires: Instant) {
        self.heard = now;
        self.expires = expires;
    }

    /// Takes over another order, and counts it. f and theta stay as they are.
    pub const fn want(&mut self, wanted: Wanted, permit: Permit) {
        (self.wanted, self.permit) = (wanted, permit);
        self.number = self.number.wrapping_add(1);
    }

    /// Takes over a setpoint, which is in range by its type.
    pub fn set(&mut self, setpoint: &Setpoint) {
        self.frequency = setpoint.frequency().into();
        self.direction = setpoint.direction().into();
    }
}

/// One motor as the fast half sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MotorReport {
    /// Where the eccentric mass stands.
    pub angle: RotorAngle,
    /// How fast it turns.
    pub speed: Speed,
    /// Current that makes no torque.
    pub current_d: Current,
    /// Current that makes torque, clockwise positive.
    pub current_q: Current,
}

/// Things that happened, each a wrapping counter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EventCounters {
    /// Faults and stop were forgotten.
    pub cleared: u8,
    /// A stop was latched.
    pub stopped: u8,
    /// No valid command for [`LINK_LATE`](flix_protocol::failsafe::LINK_LATE).
    pub link_late: u8,
    /// None for [`COMMAND_DEADLINE`](flix_protocol::failsafe::COMMAND_DEADLINE): ramping down.
    pub command_deadline: u8,
    /// The newest command became too old while others still arrived in time: ramping down.
    pub command_age: u8,
    /// None for [`LINK_LOST`](flix_protocol::failsafe::LINK_LOST): disarmed.
    pub link_lost: u8,
    /// The battery fell below its warning threshold.
    pub battery_low: u8,
    /// f was held below what was asked, for want of voltage or current.
    pub frequency_limited: u8,
}

/// How the fast half is, for telemetry, events and settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Time of the tick.
    pub time: Instant,
    /// Where the supervisor stands.
    pub state: State,
    /// Whether the motors are not driven, and the rotors stand or have braked for 0.5 s.
    pub rests: bool,
    /// Latched faults.
    pub faults: Faults,
    /// The first of them.
    pub first_fault: Option<Fault>,
    /// Whether a stop is latched.
    pub stopped: bool,
    /// Whether commands are late.
    pub link_late: bool,
    /// Whether voltage or current hold f below what is asked for.
    pub frequency_limited: bool,
    /// Present permit.
    pub permit: Permit,
    /// Why the permit was counted up last.
    pub halt: Halt,
    /// [`Asked::number`] of the newest order that was looked at.
    pub obeyed: u32,
    /// [`Asked::stops`] that have latched.
    pub stops: u8,
    /// [`Asked::halts`] that have counted the permit up.
    pub halts: u8,
    /// f as measured, averaged over some turns.
    pub frequency: Speed,
    /// theta as measured.
    pub direction: RotorAngle,
    /// Top, bottom.
    pub motors: [MotorReport; 2],
    /// What ripples, over this measuring period.
    pub interval: Interval,
    /// Top, bottom.
    pub encoders: [EncoderHealth; 2],
    /// Battery side of the bridges, where the board measures it.
    pub bus_voltage: Option<Voltage>,
    /// Largest phase voltage of this measuring period as a share of what the bridge can give;
    /// `u16::MAX` is all.
    pub modulation: u16,
    /// How the fast loop keeps time; the longest interval is that of this measuring period.
    pub timing: LoopTiming,
    /// Counts finished alignments.
    pub alignments: u8,
    /// What the last finished alignment found, to be kept in the settings.
    pub alignment: [Alignment; 2],
    /// What happened.
    pub events: EventCounters,
}

impl Report {
    /// Returns the state for those who write flash or restart the chip, which holds up the fast loop: a robot that is idle and
    /// still brakes, coasts or is ramped down is stopping.
    #[must_use]
    pub const fn settled(&self) -> State {
        if self.state.is_idle() && !self.rests { State::Stopping } else { self.state }
    }
}

/// Values that the two halves have left for each other. `M` is the memory of the [`Scope`].
#[derive(Debug, Clone)]
pub struct Exchange<M = Memory> {
    asked: Asked,
    /// Offered by the slow half and not taken yet.
    configuration: Option<Configuration>,
    report: Report,
    /// What the fast half has seen of itself, tick by tick.
    pub scope: Scope<M>,
}

impl<M: BorrowMut<Memory>> Exchange<M> {
    /// Returns an exchange in which nothing is asked for; `report` is the fast half's first.
    #[must_use]
    pub fn new(report: Report, memory: M) -> Self {
        Self { asked: Asked::default(), configuration: None, report, scope: Scope::new(memory) }
    }

    /// Leaves what the slow half asks for. A configuration that the fast half has not taken yet
    /// stays, unless there is a newer one.
    pub fn ask(&mut self, asked: Asked, configuration: Option<&Configuration>) {
        if let Some(configuration) = configuration {
            self.configuration = Some(*configuration);
        }
        self.asked = asked;
    }

    /// Returns whether a configuration waits for the fast half.
    #[must_use]
    pub const fn is_configuration_waiting(&self) -> bool {
        self.configuration.is_some()
    }

    /// Returns what is asked now, after `configure` was shown the configuration that waits, if any;
    /// while `configure` refuses it by `false`, it goes on waiting.
    pub fn take(&mut self, configure: impl FnOnce(&Configuration) -> bool) -> Asked {
        if self.configuration.as_ref().is_some_and(configure) {
            self.configuration = None;
        }
        self.asked
    }

    /// Leaves how the fast half is.
    pub const fn report(&mut self, report: Report) {
        self.report = report;
    }

    /// Returns how the fast half was when it last reported.
    #[must_use]
    pub const fn newest_report(&self) -> &Report {
        &self.report
    }
}

/// A way to an [`Exchange`] that nobody else uses meanwhile.
pub trait Access {
    /// Memory of its scope.
    type Memory: BorrowMut<Memory>;
    /// Runs `access` alone with the exchange and returns its result.
    fn with<R>(&mut self, access: impl FnOnce(&mut Exchange<Self::Memory>) -> R) -> R;
}

/// An exchange that has one owner needs no lock.
impl<M: BorrowMut<Memory>> Access for Exchange<M> {
    type Memory = M;

    fn with<R>(&mut self, access: impl FnOnce(&mut Self) -> R) -> R {
        access(self)
    }
}
