//! The physics under the robot's software: what moves ([`mechanics`]) and what drives and measures it ([`electronics`]).
//!
//! The two meet in [`Mechanics`] alone: torques go one way, rotor angles and speeds the other.

pub mod electronics;
pub mod mechanics;

use serde::{Deserialize, Serialize};

pub use mechanics::{BodyState, Drive, Energy, FREEDOMS, LegView, Linear, Plant, Wrench};

/// The moving part as the electrical part sees it.
pub trait Mechanics {
    /// Advances by `dt` seconds under the motor torques (N m, on the rotor about body +z; the opposite
    /// acts on the body), `[top, bottom]`.
    ///
    /// # Errors
    /// [`Diverged`] if the motion leaves every sensible bound; the state is then useless.
    fn step(&mut self, motor_torque: [f64; 2], dt: f64) -> Result<(), Diverged>;
    /// Rotor angles relative to the body, about body +z (FLU, counter-clockwise positive), rad;
    /// `[top, bottom]`. They count on over full turns.
    fn rotor_angle(&self) -> [f64; 2];
    /// Rotor speeds relative to the body, rad/s.
    fn rotor_speed(&self) -> [f64; 2];
    /// Force of the two rotors on the body, body frame FLU, N: what a force sensor under the shaker would
    /// read, without weight. It is the value in the middle of the last step.
    fn shaker_force(&self) -> [f64; 3];
}

/// A step whose result is no motion of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[error(
    "the simulation diverged at {time:.4} s in {part}: take a smaller step or a less extreme model"
)]
pub struct Diverged {
    /// When, s.
    pub time: f64,
    /// Where.
    pub part: Part,
}

/// A part of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Part {
    /// The plate and all that is fixed to it.
    Body,
    /// The rotors: 0 top, 1 bottom.
    Rotor(usize),
    /// A leg, in the order of [`crate::model::LEGS`].
    Leg(usize),
}

impl core::fmt::Display for Part {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Part::Body => f.write_str("the body"),
            Part::Rotor(0) => f.write_str("the top rotor"),
            Part::Rotor(_) => f.write_str("the bottom rotor"),
            Part::Leg(i) => write!(f, "leg {}", crate::model::LEGS[*i]),
        }
    }
}
