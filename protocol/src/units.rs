//! Physical quantities as types.
//!
//! A quantity is a finite `f32` in the unit that its type names. Constructors refuse NaN,
//! infinities and values outside the type's range, and so does deserialisation: every value that
//! exists is valid. The ranges here are physically sensible for a machine of this kind;
//! the range of a *command* is narrower and belongs to [`Setpoint`](crate::message::Setpoint).

use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// A number was refused as a quantity.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{quantity} {value} {unit} is outside {minimum} to {maximum} {unit}")]
pub struct OutOfRange {
    /// The quantity, for example `frequency`.
    pub quantity: &'static str,
    /// Symbol of the unit, for example `Hz`.
    pub unit: &'static str,
    /// The refused value, which may be NaN or infinite.
    pub value: f32,
    /// Smallest accepted value.
    pub minimum: f32,
    /// Largest accepted value.
    pub maximum: f32,
}

/// Checks a value against a closed range. NaN is outside every range.
pub(crate) fn within(
    quantity: &'static str,
    unit: &'static str,
    value: f32,
    minimum: f32,
    maximum: f32,
) -> Result<f32, OutOfRange> {
    if value >= minimum && value <= maximum {
        Ok(value)
    } else {
        Err(OutOfRange { quantity, unit, value, minimum, maximum })
    }
}

macro_rules! quantities {
    ($($(#[$documentation:meta])* $name:ident: $quantity:literal, $unit:literal, $minimum:literal ..= $maximum:literal;)*) => {$(
        $(#[$documentation])*
        #[doc = concat!("\n\nIn ", $unit, ", from ", stringify!($minimum), " to ", stringify!($maximum), ".")]
        #[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize, Schema)]
        #[serde(try_from = "f32", into = "f32")]
        pub struct $name(f32);

        impl $name {
            /// Zero.
            pub const ZERO: Self = Self(0.0);
            /// Symbol of the unit.
            pub const UNIT: &'static str = $unit;
            /// Smallest accepted value.
            pub const MINIMUM: Self = Self($minimum);
            /// Largest accepted value.
            pub const MAXIMUM: Self = Self($maximum);

            /// Checks a value.
            ///
            /// # Errors
            /// When `value` is NaN, infinite or outside the range of the type.
            pub fn new(value: f32) -> Result<Self, OutOfRange> {
                within($quantity, $unit, value, $minimum, $maximum).map(Self)
            }

            /// Returns the nearest value of the type; NaN becomes zero. For measurements, which
            /// must be reported whatever they are.
            #[must_use]
            pub const fn saturating(value: f32) -> Self {
                if value.is_nan() { Self(0.0) } else { Self(value.clamp($minimum, $maximum)) }
            }

            /// Returns the number, in the type's unit.
            #[must_use]
            pub const fn get(self) -> f32 {
                self.0
            }
        }

        impl TryFrom<f32> for $name {
            type Error = OutOfRange;
            fn try_from(value: f32) -> Result<Self, OutOfRange> {
                Self::new(value)
            }
        }

        impl From<$name> for f32 {
            fn from(quantity: $name) -> f32 {
                quantity.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Display::fmt(&self.0, f)?;
                f.write_str(concat!(" ", $unit))
            }
        }
    )*};
}

quantities! {
    /// A frequency, or turns per second. The sign of a shaking frequency is the direction of the rotors.
    Hertz: "frequency", "Hz", -1000.0 ..= 1000.0;
    /// An angle as people and the paper write it. Inside the fast loop angles are wrapping
    /// integers instead.
    Degrees: "angle", "deg", -360.0 ..= 360.0;
    /// An electric potential.
    Volts: "voltage", "V", -100.0 ..= 100.0;
    /// An electric current.
    Amperes: "current", "A", -100.0 ..= 100.0;
    /// A length.
    Metres: "length", "m", -1000.0 ..= 1000.0;
    /// A share of a whole.
    Ratio: "ratio", "1", 0.0 ..= 1.0;
}

/// A moment, in microseconds since the start of the robot (or of the program).
///
/// Moments of two machines cannot be compared.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Default,
    Serialize,
    Deserialize,
    Schema,
)]
pub struct Instant(u64);

impl Instant {
    /// The start.
    pub const START: Self = Self(0);

    /// Returns the moment this many microseconds after the start.
    #[must_use]
    pub const fn from_micros(microseconds: u64) -> Self {
        Self(microseconds)
    }

    /// Returns the microseconds since the start.
    #[must_use]
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// Returns the time since `earlier`; zero when `earlier` is later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> core::time::Duration {
        core::time::Duration::from_micros(self.0.saturating_sub(earlier.0))
    }
}

impl core::ops::Add<core::time::Duration> for Instant {
    type Output = Self;
    /// Saturates at the end of time, 584,000 years from the start.
    fn add(self, duration: core::time::Duration) -> Self {
        let microseconds = u64::try_from(duration.as_micros()).unwrap_or(u64::MAX);
        Self(self.0.saturating_add(microseconds))
    }
}
