#![forbid(unsafe_code)]
//! A simulated Flix-Walker under the robot's real software

pub mod model;
pub mod plant;
pub mod view;
