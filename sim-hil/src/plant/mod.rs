//! The moving part: rotors on a base, and four soft legs under it.
//!
//! One kind of model serves every case (see [`crate::model::RobotModel`]): a tree whose base joint is
//! fixed, planar or free, with two rotors and, if the model has them, four legs of six hinges.
//!
//! # Equations
//!
//! Unknown is the acceleration `x` of the generalised velocities. The step is the implicit midpoint rule,
//! linearised: geometry and forces are taken at the predicted middle of the step, `q + h/2 v`, hinge
//! springs and dampers and the contact law also at the velocity and position that `x` will bring there:
//!
//! ```text
//! (M + h/2 D + h^2/4 K) x = tau - bias(q_m, v_m) - K q_m - D v + contact(q_m, v, x)
//! v' = v + h x        q' = q + h/2 (v + v')
//! ```
//!
//! It is of second order, adds no damping of its own, and is stable for any stiffness. `M` is never
//! formed: legs and rotors are eliminated towards the body (Featherstone's articulated bodies), the body's
//! six equations are solved, and the legs follow.
//!
//! # Axes
//!
//! World ENU with the floor at z = 0; body FLU with its origin in the middle of the plate. Rotor angles are
//! about body +z, relative to the body, zero along +x.

// Matrix algebra reads best with the indices and the symbols of its formulas.
#![allow(clippy::needless_range_loop, clippy::too_many_arguments)]

pub mod battery;
pub mod electronics;
pub mod inverter;
pub mod lane;
pub mod motor;
pub mod sensor;
pub mod spatial;

mod build;
mod leg;
mod linear;
mod pack;
mod robot;
mod system;

pub use linear::{FREEDOMS, Linear};
pub use robot::{BodyState, Drive, Energy, LegView, Plant, Wrench};

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
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
