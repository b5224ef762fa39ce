//! What must never happen, and what must always be possible.

use std::fmt;

/// An invariant of every history.
#[derive(Clone, Copy, Debug, Hash, PartialEq, Eq)]
#[repr(u8)]
pub enum Invariant {
    /// Rotors begin to turn, and motors are armed or tried, only by an order that has not expired, of a person who was shown the
    /// last halt before the press, or of a program that awaited exactly this halt.
    I1,
    /// A stop or a disarm that was received is obeyed, and no older press undoes it.
    I2,
    /// Once no more halts come, a person's press can take effect from every state.
    I3,
    /// Only the holder of the session drives.
    I4,
    /// A person clears only stops and faults that the person was shown.
    I5,
    /// A client calls a stop acknowledged only after the robot has received it.
    I6,
    /// Only `Arm` arms.
    I7,
}

impl Invariant {
    /// Returns the sentence that a history breaks.
    pub const fn broken(self) -> &'static str {
        match self {
            Self::I1 => {
                "the robot moves by an order whose giver was not shown the last halt, or that has expired"
            }
            Self::I2 => {
                "a stop or disarm that was received is not obeyed, or an older press undoes it"
            }
            Self::I3 => "a press cannot take effect any more",
            Self::I4 => "the robot obeys an order of an operator without the session",
            Self::I5 => "a stop or fault is cleared by a person who was not shown it",
            Self::I6 => "a client calls a stop acknowledged that the robot has not received",
            Self::I7 => "an order other than Arm arms",
        }
    }
}

impl fmt::Display for Invariant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self:?}")
    }
}
