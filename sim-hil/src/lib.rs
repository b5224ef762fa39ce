#![forbid(unsafe_code)]
//! A simulated Flix-Walker under the robot's real software

pub mod cli;
pub mod experiment;
pub mod model;
pub mod plant;
pub mod reliability;
pub mod rig;
pub mod study;
pub mod view;
