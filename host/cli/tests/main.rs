//! The promises of `flix`: one file each, one binary for all.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

#[path = "../../tests/support/mod.rs"]
mod support;
#[path = "../../tests/support/walked.rs"]
mod walked;

mod bad_inputs;
mod colours;
mod command_line;
mod hostile_records;
#[cfg(unix)]
mod provision;
mod teleop;
