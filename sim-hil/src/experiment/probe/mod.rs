//! Probes of the mechanics: how it rests, bends, rings and shakes.
//!
//! Each probe takes a [`RobotModel`](crate::model::RobotModel), runs the plant itself, and returns
//! plain numbers whose names carry their units; `flix-sim` prints them as tables or JSON.

mod eigenmodes;
mod leg;
mod rest;
mod shake;
mod signal;
mod swing;

pub use eigenmodes::{Clamp, Eigenmode, Eigenmodes, eigenmodes};
pub use leg::{Gravity, LegProbe, RingDown, TIP_REACH, TipMotion, bend, leg, release};
pub use rest::{FootLoads, Posture, Rest, rest};
pub use shake::{ShakeBase, Shaken, shake};
pub use signal::{Component, lock_in};
pub use swing::{CHANNELS, Swing, swing};

use flix_protocol::units::OutOfRange;

use crate::model::ModelError;
use crate::plant::Diverged;

/// Why a probe has no result.
#[derive(Debug, thiserror::Error)]
pub enum ProbeError {
    /// The model is refused.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The plant's state is useless.
    #[error(transparent)]
    Diverged(#[from] Diverged),
    /// f or theta is out of range.
    #[error(transparent)]
    Setpoint(#[from] OutOfRange),
    /// The probe is about legs.
    #[error("the model {name} has no legs: choose one that has, for example A or W")]
    NoLegs {
        /// Name of the model.
        name: String,
    },
    /// The leg is bent beyond what its model describes.
    #[error(
        "the leg does not bear this load: give a smaller force or torque (the robot weighs some 3.4 N)"
    )]
    Overloaded,
    /// Nothing moved enough to measure.
    #[error("the leg did not ring: give a force or a torque large enough to bend it")]
    Still,
    /// The matrices of the model have no eigenmodes.
    #[error("the model {name} has no eigenmodes: its mass matrix cannot be inverted")]
    Singular {
        /// Name of the model.
        name: String,
    },
}

/// Refuses models without legs.
fn require_legs(model: &crate::model::RobotModel) -> Result<(), ProbeError> {
    if model.legs.is_some() { Ok(()) } else { Err(ProbeError::NoLegs { name: model.name.clone() }) }
}

/// Length of a vector.
fn norm(v: [f64; 3]) -> f64 {
    v.iter().map(|c| c * c).sum::<f64>().sqrt()
}
