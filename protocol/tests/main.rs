//! The promises of the protocol: one file each, one binary for all.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod ends;

mod adversary;
mod fuzz;
mod golden;
mod operators;
mod properties;
mod provision;
mod renewal;
mod session;
mod stop;
