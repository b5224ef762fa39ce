//! Navigation: which mode the robot shall walk in, from where it is and where it should be.
//!
//! Terms:
//! - A **mode** is a pair (f, theta) together with what it does to the robot ([`ModeTable`]).
//! - A **path** is followed by arc length ([`Path`]); the **path error** is the distance to its
//!   nearest point on the branch the robot is on.
//! - The **predictive** controller chooses among all modes by their predicted future
//!   ([`predictive`]); the **two-state** controller is the paper's ([`two_state`]).
//! - A **decision** is what to command now ([`Navigator::decide`]).
//!
//! Everything here takes the time as an argument and returns what to do. World frame ENU, headings
//! counter-clockwise in rad, metres, seconds.

mod estimator;
mod geometry;
mod modes;
mod motion;
mod navigator;
mod path;
pub mod predictive;
mod safety;
mod survey;
pub mod two_state;

pub use estimator::{Estimator, mean_twist};
pub use geometry::{PlanarPose, Twist, wrap};
pub use modes::{Mode, ModeTable, ModeTableError, PAPER_PAIRS, Spread};
pub use motion::{Gait, Motion, REST, Response, motions};
pub use navigator::{
    ControllerKind, Decision, JOINED_WITHIN, Navigator, Progress, Resting, Settings, Task,
    UnknownController,
};
pub use path::{Path, PathError, PathPoint, Projection, SPACING};
pub use safety::{Fence, NotAFence, Stop};
pub use survey::{Survey, SurveySettings};

#[cfg(test)]
mod tests;
