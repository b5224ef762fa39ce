//! The five modes of the paper that people drive with.

use flix_protocol::message::Setpoint;

/// A walking mode, with the pair of the paper for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PaperMode {
    /// Linear translation.
    Forward,
    /// Turning to the left.
    LeftTurn,
    /// Turning to the right.
    RightTurn,
    /// Sideways to the left.
    StrafeLeft,
    /// Sideways to the right.
    StrafeRight,
}

impl PaperMode {
    /// All modes, in the order of the paper's Table IV.
    pub const ALL: [Self; 5] =
        [Self::Forward, Self::LeftTurn, Self::RightTurn, Self::StrafeLeft, Self::StrafeRight];

    /// Returns f in Hz and theta in degrees (paper, Table IV).
    #[must_use]
    pub const fn pair(self) -> (f64, f64) {
        match self {
            Self::Forward => (-30.0, 30.0),
            Self::LeftTurn => (-30.0, 90.0),
            Self::RightTurn => (30.0, 90.0),
            Self::StrafeLeft => (30.0, 30.0),
            Self::StrafeRight => (-30.0, -60.0),
        }
    }

    /// Returns the pair as a command.
    #[must_use]
    pub const fn setpoint(self) -> Setpoint {
        let (frequency, direction) = self.pair();
        Setpoint::saturating(frequency as f32, direction as f32)
    }

    /// Returns the name for people.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Forward => "forward",
            Self::LeftTurn => "left turn",
            Self::RightTurn => "right turn",
            Self::StrafeLeft => "strafe left",
            Self::StrafeRight => "strafe right",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_modes_are_those_of_table_iv() {
        let pairs = PaperMode::ALL.map(PaperMode::pair);
        let table = [(-30.0, 30.0), (-30.0, 90.0), (30.0, 90.0), (30.0, 30.0), (-30.0, -60.0)];
        assert_eq!(pairs, table);
    }
}
