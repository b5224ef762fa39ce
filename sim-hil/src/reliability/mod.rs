//! What the robot promises, measured: its accuracy, and what it does when something goes wrong.

#[cfg(not(target_family = "wasm"))]
pub mod accuracy;
#[cfg(not(target_family = "wasm"))]
pub mod adversary;
#[cfg(not(target_family = "wasm"))]
pub mod commission;
#[cfg(not(target_family = "wasm"))]
pub mod commissioned_accuracy;
#[cfg(not(target_family = "wasm"))]
pub mod demonstration;
pub mod fault_cases;
#[cfg(not(target_family = "wasm"))]
pub mod fault_matrix;
#[cfg(not(target_family = "wasm"))]
pub mod shiver;
#[cfg(not(target_family = "wasm"))]
pub mod soak;
#[cfg(not(target_family = "wasm"))]
pub mod unknown_motors;
#[cfg(not(target_family = "wasm"))]
pub mod wiring;
