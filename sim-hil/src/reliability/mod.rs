//! What the robot promises, measured: its accuracy, and what it does when something goes wrong.

pub mod accuracy;
pub mod adversary;
pub mod fault_matrix;
pub mod soak;
