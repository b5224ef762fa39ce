//! The command pair and its range.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::units::{Degrees, Hertz, OutOfRange, within};

/// Largest shaking frequency that may be commanded, of either sign (paper, section V-B: "below 35 Hz").
pub const MAXIMUM_FREQUENCY: Hertz = Hertz::saturating(35.0);
/// Largest shaking direction that may be commanded, to either side (paper, section II-E: [-90, 90] degrees).
pub const MAXIMUM_DIRECTION: Degrees = Degrees::saturating(90.0);

/// The pair that selects how the robot moves: shaking frequency f and direction theta.
///
/// f is in [-35, 35] Hz, positive when the top rotor turns clockwise seen from above; theta in
/// [-90, 90] degrees from forward, positive to the right.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
pub struct Setpoint {
    frequency: Hertz,
    direction: Degrees,
}

impl Setpoint {
    /// Standing still: f = 0, theta = 0.
    pub const REST: Self = Self { frequency: Hertz::ZERO, direction: Degrees::ZERO };

    /// Checks a pair against the range of a command.
    ///
    /// # Errors
    /// When f or theta is out of range.
    pub fn new(frequency: Hertz, direction: Degrees) -> Result<Self, OutOfRange> {
        let setpoint = Self { frequency, direction };
        setpoint.check().map(|()| setpoint)
    }

    /// Checks a pair of plain numbers, in Hz and degrees.
    ///
    /// # Errors
    /// When one is not a number or out of range.
    pub fn from_numbers(frequency: f32, direction: f32) -> Result<Self, OutOfRange> {
        Self::new(Hertz::new(frequency)?, Degrees::new(direction)?)
    }

    /// Returns the nearest pair that may be commanded to these numbers, in Hz and degrees. NaN
    /// becomes zero.
    #[must_use]
    pub const fn saturating(frequency: f32, direction: f32) -> Self {
        let (f, theta) = (MAXIMUM_FREQUENCY.get(), MAXIMUM_DIRECTION.get());
        Self {
            frequency: Hertz::saturating(frequency.clamp(-f, f)),
            direction: Degrees::saturating(direction.clamp(-theta, theta)),
        }
    }

    /// Returns the pair with f = 0 and the same theta.
    #[must_use]
    pub const fn at_rest(self) -> Self {
        Self { frequency: Hertz::ZERO, ..self }
    }

    /// Checks a received pair, which can be out of range. The robot does so before it moves, and
    /// answers with the range.
    ///
    /// # Errors
    /// When f or theta is out of range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        let (f, theta) = (MAXIMUM_FREQUENCY.get(), MAXIMUM_DIRECTION.get());
        within("shaking frequency", Hertz::UNIT, self.frequency.get(), -f, f)?;
        within("shaking direction", Degrees::UNIT, self.direction.get(), -theta, theta)?;
        Ok(())
    }

    /// Returns f, in [-35, 35] Hz.
    #[must_use]
    pub const fn frequency(&self) -> Hertz {
        self.frequency
    }

    /// Returns theta, in [-90, 90] degrees.
    #[must_use]
    pub const fn direction(&self) -> Degrees {
        self.direction
    }
}
