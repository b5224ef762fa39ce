//! Promises over many seeds, faults and robots: minutes on two cores, so they are no part of `cargo test --workspace`.
//!
//! ```text
//! cargo test -p flix-sim --test statistics
//! ```
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

mod commission;
mod commissioned;
#[path = "../drawn_paths.rs"]
mod drawn_paths;
mod fault_matrix;
mod faults_by_name;
mod on_its_feet;
mod sequences;
mod strangers;
mod thirty_paths;
