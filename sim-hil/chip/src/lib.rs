#![forbid(unsafe_code)]
//! Runs the robot's image on an emulated ESP32-C6, with the simulated robot at its pins, and says what does not hold.

pub mod air;
pub mod flood;
pub mod join;
pub mod journey;
pub mod live;
pub mod pins;
pub mod power;
pub mod restart;
pub mod rig;
pub mod session;
pub mod start;
