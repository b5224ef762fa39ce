//! Navigation: chooses the mode to walk in, from the pose of the robot and its task.
//!
//! Terms:
//! - A **mode** is a pair (f, theta) together with the motion that it causes ([`ModeTable`]).
//! - A **path** is followed by arc length ([`Path`]); the **path error** is the distance to its
//!   nearest point on the branch the robot is on.
//! - The **predictive** controller chooses among all modes by their predicted future
//!   (`predictive`); the **two-state** controller is the paper's (`two_state`).
//! - The **learned** controller searches as the predictive one does, but has no table: it begins with the
//!   [`Experience`] of many robots, keeps a belief about the one at hand, and judges by its pace and its outlook.
//! - The **estimator** predicts the pose for the moment when a command sent now is obeyed, by the latency of
//!   link and robot, and adapts the motion of each mode to what is measured.
//! - A **decision** is what to command now ([`Navigator::decide`]).
//! - **Identification** measures the motion of each mode ([`Identification`]).
//!
//! Everything here takes the time as an argument and returns what to do. [`Position`] and
//! [`PlanarPose`] fix frame and units: world frame ENU, metres, radians counter-clockwise.

mod bearing;
mod belief;
mod end_reason;
mod estimator;
mod experience;
mod footing;
mod identification;
mod modes;
mod motion;
mod moved;
mod navigator;
mod outlook;
mod pace;
mod path;
mod plausibility;
mod predictive;
mod two_state;
mod weights;

pub use crate::pose::geometry::{Area, NotAPosition, NotAnArea, PlanarPose, Position, Twist, wrap};
pub use end_reason::EndReason;
pub use estimator::mean_twist;
pub use experience::{Experience, ExperienceError, Factor, Walks};
pub(crate) use footing::Footing;
pub(crate) use identification::ENOUGH_MODES;
pub use identification::{Identification, IdentificationSettings, Stretch};
pub use modes::{Mode, ModeTable, ModeTableError, PAPER_PAIRS, Spread};
pub use motion::Response;
pub use navigator::{
    Approach, ControllerKind, Decision, JOINED_WITHIN, Navigator, NavigatorError, Progress,
    Repertoire, Resting, Settings, Task, UnknownController,
};
pub use path::{Path, PathError, Projection};
pub(crate) use plausibility::{Commanded, Plausibility};
pub use two_state::MissingTurn;

#[cfg(test)]
mod tests;
