#![no_std]
#![forbid(unsafe_code)]
//! Motor control, shaker, supervisor and link of a Flix-Walker, without a chip.

#[cfg(test)]
extern crate std;

mod alignment;
pub mod board;
pub mod control;
pub mod encoder;
mod fixed;
pub mod foc;
pub mod hardware;
pub mod link;
#[cfg(feature = "net")]
pub mod mdns;
#[cfg(feature = "net")]
pub mod net;
pub mod provision;
pub mod robot;
pub mod settings;
pub mod shaker;
pub mod supervisor;
pub mod trace;
