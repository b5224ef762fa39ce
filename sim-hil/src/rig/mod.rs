//! The test rig: a simulated robot, its network and cameras, what breaks in it, and the operators who drive it.
//!
//! Nothing in the robot's software or in the operator's client knows that it is simulated. All chance comes from seeds.

pub mod bench;
#[cfg(not(target_family = "wasm"))]
pub mod dhcp_server;
pub mod hardware_fault;
pub mod lossy_network;
pub mod motion_capture;
#[cfg(not(target_family = "wasm"))]
pub mod network_task;
pub mod operation;
pub mod shipped_mode_tables;
pub mod simulated;
pub mod wiring_fault;
