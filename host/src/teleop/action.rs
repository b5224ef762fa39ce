//! What an operator can command, by whatever device.

use flix_protocol::message::{MAXIMUM_DIRECTION, MAXIMUM_FREQUENCY, Setpoint};
use flix_protocol::units::{Degrees, Hertz};

/// A walking mode, with the pair of the paper for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
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

impl Mode {
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

/// What the operator commands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// Stop now; the stop is latched.
    Stop,
    /// Arm.
    Arm,
    /// Ramp down and disarm.
    Disarm,
    /// Clear stop and faults.
    Clear,
    /// Walk in this mode.
    Walk(Mode),
    /// Ramp down, and stay armed.
    Rest,
    /// Change f by this step, Hz.
    Frequency(f32),
    /// Change theta by this step, degrees.
    Direction(f32),
    /// Hold the present heading, or end that.
    HoldHeading,
    /// Disarm, then leave.
    Quit,
    /// Stop, then leave.
    Interrupt,
}

impl Action {
    /// Returns a setpoint after this step of f, rounded to tenths of a hertz, or of theta, both within their ranges; nothing
    /// for what is no step.
    #[must_use]
    pub fn step(self, from: Setpoint) -> Option<Setpoint> {
        let (frequency, direction) = match self {
            Self::Frequency(step) => (step, 0.0),
            Self::Direction(step) => (0.0, step),
            _ => return None,
        };
        let within = |value: f32, most: f32| value.clamp(-most, most);
        // Rounding errors of many fine steps do not add up.
        let frequency = (10.0 * (from.frequency().get() + frequency)).round() / 10.0;
        let direction = from.direction().get() + direction;
        Setpoint::new(
            Hertz::saturating(within(frequency, MAXIMUM_FREQUENCY.get())),
            Degrees::saturating(within(direction, MAXIMUM_DIRECTION.get())),
        )
        .ok()
    }
}

/// Step of f, Hz: coarse, and fine with shift.
pub const FREQUENCY_STEPS: [f32; 2] = [1.0, 0.1];
/// Step of theta, degrees: coarse, and fine with shift.
pub const DIRECTION_STEPS: [f32; 2] = [5.0, 1.0];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_modes_are_those_of_table_iv() {
        let pairs = Mode::ALL.map(Mode::pair);
        let table = [(-30.0, 30.0), (-30.0, 90.0), (30.0, 90.0), (30.0, 30.0), (-30.0, -60.0)];
        assert_eq!(pairs, table);
    }
}
