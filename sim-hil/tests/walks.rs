//! The promises of the walking robot, and of what the documents cite: one file each, one binary for all.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

mod citations;
mod documents;
mod drawn_paths;
mod navigation;
mod whole_robot;
