#![forbid(unsafe_code)]
//! A simulated Flix-Walker under the robot's real software

pub mod accuracy;
pub mod adversary;
pub mod channel;
pub mod cli;
pub mod course;
pub mod fault;
pub mod measure;
pub mod model;
pub mod mujoco;
pub mod operation;
pub mod plant;
pub mod probe;
pub mod robot;
pub mod soak;
pub mod study;
pub mod validate;
pub mod view;
pub mod walk;
