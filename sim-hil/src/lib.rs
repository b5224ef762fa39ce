#![forbid(unsafe_code)]
//! A simulated Flix-Walker under the robot's real software
