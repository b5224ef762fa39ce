//! What the robot promises, measured: its accuracy, and what it does when something goes wrong.

#[cfg(feature = "program")]
pub mod accuracy;
#[cfg(feature = "program")]
pub mod adversary;
pub mod case;
#[cfg(feature = "program")]
pub mod commission;
#[cfg(feature = "program")]
pub mod commissioned;
#[cfg(feature = "program")]
pub mod fault_matrix;
#[cfg(feature = "program")]
pub mod shiver;
#[cfg(feature = "program")]
pub mod soak;
#[cfg(feature = "program")]
pub mod wiring;
