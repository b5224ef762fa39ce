//! Orders and permits, as far as they can be distinguished.
//!
//! A permit is a number on the wire. The model keeps its age only, because the robot compares permits for equality and a
//! program compares them for the next number.

/// Word of an order.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Word {
    /// Disarm, and stay disarmed. An idle client sends this word.
    #[default]
    Off,
    /// Client only, sent as `Off`: a program holds the permit of its next press.
    Next,
    /// Align the motors, then hold the rotors at rest.
    Arm,
    /// `Shake` with a frequency.
    Walk,
    /// `Shake` with the frequency zero.
    Rest,
    /// Do one trial.
    Try,
    /// Forget the stop and the faults.
    Clear,
    /// Latch the stop.
    Stop,
    /// Latch the stop by a datagram outside the session.
    StopFromOutside,
}

impl Word {
    /// Returns whether the word brings the rotors to rest and disarms, at any age.
    pub const fn calms(self) -> bool {
        matches!(self, Self::Off | Self::Next | Self::Stop | Self::StopFromOutside)
    }

    /// Returns whether the word begins something, so that a permit belongs to its order.
    pub const fn needs_permit(self) -> bool {
        matches!(self, Self::Arm | Self::Walk | Self::Try | Self::Clear)
    }

    /// Returns whether an armed robot stays armed. `Clear` is withheld there, and its robot rests.
    pub const fn keeps_armed(self) -> bool {
        matches!(self, Self::Arm | Self::Walk | Self::Rest | Self::Clear)
    }
}

/// Age of a permit: how often the robot has counted since.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Age {
    /// The robot's present permit.
    #[default]
    Present,
    /// The permit before the present permit; without programs any older permit.
    Previous,
    /// Any older permit.
    Older,
}

impl Age {
    /// Returns the age after one more count.
    pub const fn next(self) -> Self {
        match self {
            Self::Present => Self::Previous,
            Self::Previous | Self::Older => Self::Older,
        }
    }
}

/// An order with the ghosts that the invariants look at.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq, PartialOrd, Ord)]
pub struct Order {
    /// The word.
    pub word: Word,
    /// Age of the permit; `Present` where the word needs none.
    pub age: Age,
    /// Ghost: the robot has halted since the person was shown its state, for a reason that the person did not await.
    pub is_unseen: bool,
    /// Ghost: the order was too old when the robot last looked at it.
    pub is_expired: bool,
    /// Ghost: moment of the press; 0 where the client withdrew a wish.
    pub pressed: u8,
}

impl Order {
    /// Returns an order of `word` that no press caused.
    pub fn withdrawn(word: Word) -> Self {
        Self { word, ..Self::default() }
    }

    /// Returns the order as the client sends it.
    pub fn on_the_wire(self) -> Self {
        if self.word == Word::Next { Self::default() } else { self }
    }
}
