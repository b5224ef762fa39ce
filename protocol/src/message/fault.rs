//! Faults of the robot, and sets of them.

use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::names::names;

/// One thing that can go wrong. A fault is latched until it is cleared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[repr(u8)]
pub enum Fault {
    /// A phase current is above the limit of the hardware.
    OverCurrent,
    /// The battery is below its cut-off.
    UnderVoltage,
    /// The bus voltage is above the rating of the bridge.
    OverVoltage,
    /// A rotor turns faster than any command.
    OverSpeed,
    /// An encoder does not answer, or its readings contradict each other.
    EncoderLost,
    /// A rotor does not move at full current.
    Stall,
    /// f or theta is far from its reference for too long.
    PhaseLockLost,
    /// The fast loop was late too often.
    LoopOverrun,
    /// The motor did not follow its alignment: missing magnet, open or swapped phase.
    Alignment,
    /// The current sensors disagree, or read far from zero at rest.
    CurrentSense,
    /// The stored settings are unreadable; the defaults are in force, and the values of the motors count as assumed.
    Settings,
    /// A rotor shivers where it should rest: the loops that hold it are too quick for their encoders or motors.
    Shiver,
    /// The measured bus voltage contradicts the motors' back-EMF and duties.
    BusSense,
}

// In the order of their bits.
names!(Fault {
    OverCurrent: "over-current",
    UnderVoltage: "under-voltage",
    OverVoltage: "over-voltage",
    OverSpeed: "over-speed",
    EncoderLost: "encoder lost",
    Stall: "stall",
    PhaseLockLost: "phase lock lost",
    LoopOverrun: "loop overrun",
    Alignment: "alignment failed",
    CurrentSense: "current sense",
    Settings: "settings unreadable",
    Shiver: "shivers at rest",
    BusSense: "bus sense",
});

/// A set of faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, Schema)]
pub struct Faults(u16);

impl Faults {
    /// The empty set.
    pub const NONE: Self = Self(0);

    /// Returns the set with this fault added.
    #[must_use]
    pub const fn with(self, fault: Fault) -> Self {
        Self(self.0 | 1 << fault as u8)
    }

    /// Returns the faults of both sets.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Returns the set with this fault added where `is_present`; without a branch.
    #[must_use]
    pub const fn with_if(self, fault: Fault, is_present: bool) -> Self {
        Self(self.0 | (is_present as u16) << fault as u8)
    }

    /// Returns the set with this fault removed.
    #[must_use]
    pub const fn without(self, fault: Fault) -> Self {
        Self(self.0 & !(1 << fault as u8))
    }

    /// Returns whether the set contains this fault.
    #[must_use]
    pub const fn contains(self, fault: Fault) -> bool {
        self.0 & 1 << fault as u8 != 0
    }

    /// Returns whether the set is empty.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns the faults of the set, in the order of [`Fault::ALL`].
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
