//! What the robot's link promises, at the exact tick, on the shaker on a fixed base.
//!
//! One file a promise; [`bench`] puts datagrams into the robot with no network in between.
mod arming;
mod bad_datagrams;
mod bench;
mod encoders;
mod events;
mod failsafe_ladder;
mod freshness;
mod in_force;
mod operators;
mod refused_commands;
mod settings;
mod stop_latch;
