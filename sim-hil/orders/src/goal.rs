//! Liveness: what a press has to reach once no more halts come. A goal is kept when a way to it is left from every state.

use crate::order::Word;

/// What a press has to reach.
#[derive(Clone, Copy, Debug, Hash, PartialEq, Eq)]
#[repr(u8)]
pub enum Goal {
    /// A press of arm: the robot is armed.
    Armed,
    /// A press of a walk on an armed robot: the rotors turn.
    Walking,
    /// A press of clear: neither stop nor fault is left.
    Cleared,
    /// A press of stop: the stop is latched, and the robot rests.
    Stopped,
    /// A stop from outside: likewise.
    StoppedFromOutside,
    /// A program's press of a trial: the program holds the permit of its next press.
    NextTrial,
}

impl Goal {
    /// All goals.
    pub const ALL: [Self; 6] = [
        Self::Armed,
        Self::Walking,
        Self::Cleared,
        Self::Stopped,
        Self::StoppedFromOutside,
        Self::NextTrial,
    ];

    /// Returns the word that is pressed.
    pub(crate) const fn word(self) -> Word {
        match self {
            Self::Armed => Word::Arm,
            Self::Walking => Word::Walk,
            Self::Cleared => Word::Clear,
            Self::Stopped => Word::Stop,
            Self::StoppedFromOutside => Word::StopFromOutside,
            Self::NextTrial => Word::Try,
        }
    }
}
