//! Commands of an operator, by any device.

use flix_protocol::message::{MAXIMUM_DIRECTION, MAXIMUM_FREQUENCY, Setpoint};
use flix_protocol::units::{Degrees, Hertz};

use super::paper_modes::PaperMode;

/// A command of the operator.
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
    Walk(PaperMode),
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
    /// for other actions than steps.
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
