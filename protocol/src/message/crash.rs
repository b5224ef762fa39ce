//! Report of the run before the last start: how it ended, and its last fault.

use core::fmt;

use heapless::{String, Vec};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{Fault, Faults, ResetReason, State};
use crate::units::{Amperes, Degrees, Hertz, Instant, Volts};

/// Longest kept part of a panic message, bytes.
pub const PANIC_MESSAGE_LENGTH: usize = 96;
/// Most program counters that are kept.
pub const PROGRAM_COUNTERS: usize = 12;

/// Beginning of a panic message.
pub type PanicMessage = String<PANIC_MESSAGE_LENGTH>;
/// Addresses in the robot's program, innermost call first.
pub type ProgramCounters = Vec<u32, PROGRAM_COUNTERS>;

/// A build of the firmware: the first 8 bytes of the SHA-256 of its ELF file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
pub struct BuildId(pub [u8; 8]);

impl BuildId {
    /// Takes the first 8 bytes of a SHA-256; `None` when all are zero, as in an image without a build id.
    #[must_use]
    pub fn of(sha256: &[u8; 32]) -> Option<Self> {
        let first = *sha256.first_chunk()?;
        (sha256 != &[0; 32]).then_some(Self(first))
    }
}

impl fmt::Display for BuildId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// State of the robot when its last fault was latched.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
pub struct FaultSummary {
    /// When the first of the faults was latched, on the clock of the run in which it was.
    pub time: Instant,
    /// All faults that were latched together.
    pub faults: Faults,
    /// The first of them: the cause of the rest.
    pub first_fault: Option<Fault>,
    /// State of the supervisor just before.
    pub state: State,
    /// f just before.
    pub frequency: Hertz,
    /// theta just before.
    pub direction: Degrees,
    /// Currents of top and bottom motor just before.
    pub currents: [MotorCurrents; 2],
    /// Voltage on the battery side of the bridges just before; none where the board does not measure it.
    pub bus_voltage: Option<Volts>,
}

/// Currents of one motor in the frame of its rotor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
pub struct MotorCurrents {
    /// Direct current, which makes no torque.
    pub direct: Amperes,
    /// Quadrature current, which makes torque.
    pub quadrature: Amperes,
}

/// Report of the run before the last start, kept when that run met a fault or did not end by power-off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
pub struct CrashReport {
    /// Reset that ended the run.
    pub reset: ResetReason,
    /// Beginning of the panic message; empty when it was no panic.
    pub message: PanicMessage,
    /// Where the program was, innermost call first; empty when the chip does not know.
    pub counters: ProgramCounters,
    /// Version of the firmware that ran; empty when it is unknown.
    pub version: String<16>,
    /// Build of the firmware that ran; `None` when its image does not state it.
    pub build: Option<BuildId>,
    /// How long the run lasted: exact for a panic, otherwise up to a second too short; `None` when it is unknown.
    pub uptime: Option<Instant>,
    /// The last fault of the run.
    pub fault: Option<FaultSummary>,
}
