#![forbid(unsafe_code)]
//! An emulated ESP32-C6 that runs the robot's image as it is flashed.
//!
//! [`chip::Chip`] is stepped by virtual time; serial port, network and pins are its inputs and outputs. Models are as
//! strict as the chip: a block without its clock takes no writes, a watchdog bites, flash bits only fall. What no model
//! knows ends the emulation with the register's name and the program counter.

pub mod air;
mod block;
pub mod chip;
mod cpu;
pub mod early;
pub mod fault;
pub mod flood;
pub mod image;
pub mod join;
pub mod journey;
pub mod live;
pub mod marks;
mod memory;
pub mod network;
pub mod pins;
pub mod power;
mod radio;
mod registers;
pub mod restart;
pub mod rig;
mod rom;
pub mod session;
mod soc;
pub mod start;

pub use block::mcpwm::Wave;
pub use block::spi::Transfer;
pub use block::{CYCLES_PER_SECOND, cycles, flash};
pub use radio::Times as RadioTimes;
pub use soc::{Outside, Pins};
