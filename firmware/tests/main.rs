//! The promises of the robot's software without a robot: one file each, one binary for all.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

#[path = "../board_choice.rs"]
mod choice;
#[path = "support/ends.rs"]
mod ends;
#[path = "support/known_motors.rs"]
mod known_motors;
#[path = "support/rows.rs"]
mod rows;
#[path = "support/still.rs"]
mod still;

mod board_choice;
mod current_loop;
mod fuzz;
mod hand_over;
mod link;
