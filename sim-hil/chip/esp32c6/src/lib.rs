#![forbid(unsafe_code)]
//! An emulated ESP32-C6 that runs an image as it is flashed.
//!
//! [`chip::Chip`] is stepped by virtual time; serial port, network and pins are its inputs and outputs. Models are as
//! strict as the chip: a block without its clock takes no writes, a watchdog bites, flash bits only fall. What no model
//! knows ends the emulation with the register's name and the program counter.

mod block;
pub mod chip;
mod cpu;
pub mod early;
pub mod fault;
pub mod image;
pub mod marks;
mod memory;
pub mod network;
mod radio;
mod registers;
mod rom;
mod soc;

pub use block::mcpwm::Wave;
pub use block::spi::Transfer;
pub use block::{CYCLES_PER_SECOND, cycles, flash};
pub use radio::Times as RadioTimes;
pub use soc::{Outside, Pins};
