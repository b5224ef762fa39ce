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

pub mod lane;
pub mod spatial;

mod block;
mod body;
mod build;
mod cords;
mod course;
mod leg;
mod linear;
mod pack;
mod plant;
mod system;

pub use block::{Block, Clock, Kept, Robots, has_long_vectors};
pub use body::{BodyState, Wrench};
pub use build::reference_contact;
pub use cords::Cords;
pub use linear::{FREEDOMS, Linear};
pub use pack::Pack;
pub use plant::{Drive, Energy, LegView, Plant};
pub use system::{multiply, rotation};
