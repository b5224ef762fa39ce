#![forbid(unsafe_code)]
//! Drives, watches and records a Flix-Walker from a computer

pub mod cli;
pub mod explain;
pub mod interrupt;
pub mod keys;
pub mod link;
pub mod nav;
pub mod pilot;
pub mod plot;
pub mod pose;
pub mod record;
pub mod teleop;
