//! The promises of `flix-sim` as it is typed: one file each, one binary for all.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

mod bad_inputs;
mod command_line;
