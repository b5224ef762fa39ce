//! The promises of the robot's software without a robot: one file each, one binary for all.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

#[path = "../board_choice.rs"]
mod choice;
#[path = "support/no_store.rs"]
mod no_store;
#[path = "support/rows.rs"]
mod rows;
#[path = "support/still.rs"]
mod still;

mod board_choice;
mod current_loop;
mod fuzz;
mod hand_over;
mod link;
