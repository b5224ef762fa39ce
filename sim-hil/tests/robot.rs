//! The promises of the robot on its plant, link and network: one file each, one binary for all.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

mod bench_supply;
mod commission;
mod electrical_plant;
mod failing_electronics;
mod holds_frequency_and_direction;
mod link;
mod network_task;
mod operator_reaches_robot;
mod scope;
mod settles_within_half_a_second;
mod shiver;
mod voltage_mode;
