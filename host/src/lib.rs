#![forbid(unsafe_code)]
//! Drives, watches and records a Flix-Walker from a computer

pub mod cli;
pub mod keys;
pub mod plot;
