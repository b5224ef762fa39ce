#![no_std]
#![forbid(unsafe_code)]
//! Motor control, shaker, supervisor and link of a Flix-Walker, without a chip.

pub mod control;
pub mod hardware;
