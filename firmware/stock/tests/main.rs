#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]
//! What the stand-ins promise: each instruction names its target, each literal is in reach, and all else is refused.

mod instructions;
mod linking;
mod literals;
mod objects;
mod pins;
