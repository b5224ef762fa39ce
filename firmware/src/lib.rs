#![no_std]
#![forbid(unsafe_code)]
//! Motor control, shaker, supervisor and link of a Flix-Walker, without a chip.

#[cfg(test)]
extern crate std;

pub mod board;
pub mod exchange;
pub mod fast;
pub mod hardware;
pub mod link;
#[cfg(feature = "net")]
pub mod mdns;
#[cfg(feature = "net")]
pub mod net;
pub mod provision;
pub mod robot;
pub mod settings;
pub mod trace;
