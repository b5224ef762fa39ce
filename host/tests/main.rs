//! The promises of the operator's library: one file each, one binary for all.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

mod support;
#[path = "support/walked.rs"]
mod walked;

mod arming;
mod cockpit;
mod connection;
mod link;
#[cfg(target_os = "linux")]
mod moving;
mod record;
