//! What an alignment finds out about a motor, as the fast half uses it and the settings keep it.

use crate::fast::units::ElectricalAngle;

/// What alignment found out about one motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Alignment {
    /// Electrical angle at rotor angle zero.
    pub electrical_offset: ElectricalAngle,
    /// Whether the electrical angle falls when the rotor turns clockwise.
    pub reversed: bool,
    /// Whether the current amplifiers count down when current flows into the motor.
    pub current_inverted: bool,
    /// Error of the encoder by rotor angle, 2^-32 turn: cosine and sine of the first, then of the
    /// second harmonic.
    pub eccentricity: [i32; 4],
}
