//! The fast half of the robot, put together: encoders and currents in, duties out, 10,000 times a
//! second, in integers alone.
//!
//! The slow half (link, settings, telemetry) runs at another priority or on another core. The two
//! exchange whole values through mailboxes: an [`Order`] goes in, a [`Report`] comes out, and a
//! [`Configuration`] is taken over while the motors are let go. Events cross as counters, so that
//! none is lost when a mailbox is overwritten.
//!
//! # Fixed point
//!
//! | quantity | unit of the integer |
//! |---|---|
//! | angle | 2^-32 turn, wrapping ([`Turn`]) |
//! | speed | 2^-32 turn per tick ([`Speed`]) |
//! | current | 2^-16 A |
//! | voltage | 2^-16 V |
//!
//! Rotor angles inside are clockwise from forward, as `theta` and `f` are.

mod parameters;

pub use parameters::{AlignmentParameters, Configuration, MotorParameters, Parameters};

use flix_protocol::message::{Fault, Faults, Setpoint, State};
use flix_protocol::units::Instant;

use crate::hardware::{Actuation, Hardware, Sensors, TICK_RATE_HZ, Turn};

/// 2^-32 turn per tick.
pub type Speed = i32;

/// 2^32 / 10 kHz: one hertz as a [`Speed`].
pub(crate) const SPEED_PER_HERTZ: f32 = 4_294_967_296.0 / TICK_RATE_HZ as f32;
/// One degree as a [`Turn`].
pub(crate) const TURN_PER_DEGREE: f32 = 4_294_967_296.0 / 360.0;

/// What the slow half wants, handed over whole in every tick.
///
/// The counters wrap; a change asks once for what they count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Order {
    /// f.
    pub frequency: Speed,
    /// theta, clockwise from forward, within a quarter turn either side.
    pub direction: i32,
    /// Counts setpoints obeyed: after arming the rotors rest until the first new one.
    pub setpoints: u16,
    /// When the last valid command came.
    pub heard: Instant,
    /// Counts arm commands.
    pub arm: u8,
    /// Counts disarm commands.
    pub disarm: u8,
    /// Counts stop commands.
    pub stop: u8,
    /// Counts clear commands.
    pub clear: u8,
    /// Counts telemetry sent: starts a new measuring period of [`Timing::longest_interval_us`] and
    /// [`Report::modulation`].
    pub period: u8,
}

impl Order {
    /// Takes over a setpoint, which is in range by its type, at the moment it was heard.
    pub fn set(&mut self, setpoint: &Setpoint, now: Instant) {
        self.frequency = (setpoint.frequency().get() * SPEED_PER_HERTZ) as i32;
        self.direction = (setpoint.direction().get() * TURN_PER_DEGREE) as i32;
        self.setpoints = self.setpoints.wrapping_add(1);
        self.heard = now;
    }
}

/// What alignment found out about one motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Alignment {
    /// Electrical angle at rotor angle zero.
    pub electrical_offset: Turn,
    /// Whether the electrical angle falls when the rotor turns clockwise.
    pub reversed: bool,
    /// Whether the current amplifiers count down when current flows into the motor.
    pub current_inverted: bool,
    /// Error of the encoder by rotor angle, 2^-32 turn: cosine and sine of the first, then of the
    /// second harmonic.
    pub eccentricity: [i32; 4],
}

/// How the fast loop keeps time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Timing {
    /// Ticks since power-up.
    pub ticks: u64,
    /// Longest interval between two ticks in this measuring period, microseconds.
    pub longest_interval_us: u32,
    /// Ticks that came too late, since power-up.
    pub overruns: u32,
}

/// One motor as the fast half sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MotorReport {
    /// Rotor angle, clockwise from forward.
    pub angle: Turn,
    /// Clockwise positive.
    pub speed: Speed,
    /// Current that makes no torque, 2^-16 A.
    pub current_d: i32,
    /// Current that makes torque, clockwise positive, 2^-16 A.
    pub current_q: i32,
}

/// Things that happened, each a wrapping counter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EventCounters {
    /// Faults and stop were forgotten.
    pub cleared: u8,
    /// A stop was latched.
    pub stopped: u8,
    /// No valid command for the first step of the ladder.
    pub link_late: u8,
    /// For the second: ramping down.
    pub command_deadline: u8,
    /// For the third: disarmed.
    pub link_lost: u8,
    /// The battery fell below its warning threshold.
    pub battery_low: u8,
}

/// How the fast half is, for telemetry, events and settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Time of the tick.
    pub time: Instant,
    /// Where the supervisor stands.
    pub state: State,
    /// Latched faults.
    pub faults: Faults,
    /// The first of them.
    pub first_fault: Option<Fault>,
    /// Whether a stop is latched.
    pub stopped: bool,
    /// Whether commands are late.
    pub link_late: bool,
    /// f as measured, averaged over some turns.
    pub frequency: Speed,
    /// theta as measured.
    pub direction: i32,
    /// Top, bottom.
    pub motors: [MotorReport; 2],
    /// 2^-16 V, where the board measures it.
    pub bus_voltage: Option<i32>,
    /// Largest phase voltage of this measuring period as a share of what the bridge can give;
    /// `u16::MAX` is all.
    pub modulation: u16,
    /// Fast loop.
    pub timing: Timing,
    /// Counts finished alignments.
    pub alignments: u8,
    /// What the last finished alignment found, to be kept in the settings.
    pub alignment: [Alignment; 2],
    /// What happened.
    pub events: EventCounters,
}

/// The fast half.
#[derive(Debug, Clone)]
pub struct Control {
    configuration: Configuration,
    report: Report,
}

impl Control {
    /// Disarmed, at power-up.
    #[must_use]
    pub fn new(_hardware: &Hardware, configuration: Configuration) -> Self {
        Self {
            configuration,
            report: Report {
                time: Instant::START,
                state: State::Disarmed,
                faults: Faults::NONE,
                first_fault: None,
                stopped: false,
                link_late: false,
                frequency: 0,
                direction: 0,
                motors: [MotorReport::default(); 2],
                bus_voltage: None,
                modulation: 0,
                timing: Timing::default(),
                alignments: 0,
                alignment: [Alignment::default(); 2],
                events: EventCounters::default(),
            },
        }
    }

    /// Takes over a new configuration; only while disarmed or faulted with the rotors at rest.
    /// Tells whether it did.
    pub fn configure(&mut self, configuration: &Configuration) -> bool {
        let idle = matches!(self.report.state, State::Disarmed | State::Faulted);
        if idle {
            self.configuration = *configuration;
        }
        idle
    }

    /// Latches a fault that the slow half found (settings).
    pub fn raise(&mut self, fault: Fault) {
        self.report.faults = self.report.faults.with(fault);
        self.report.first_fault.get_or_insert(fault);
    }

    /// One tick. Never panics.
    pub fn tick(&mut self, now: Instant, _sensors: &Sensors, _order: &Order) -> Actuation {
        self.report.time = now;
        Actuation::OFF
    }

    /// How it is, as of the last tick.
    #[must_use]
    pub fn report(&self) -> Report {
        self.report
    }
}
