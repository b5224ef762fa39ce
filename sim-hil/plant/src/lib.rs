#![forbid(unsafe_code)]
//! The physics of a Flix-Walker.
//!
//! | module | what it holds |
//! |---|---|
//! | [`model`] | the robot as data: TOML with units in the names, ranges checked; MJCF for MuJoCo, URDF |
//! | [`plant`] | [`plant::mechanics`] (rotors, body, four soft legs, contact), [`plant::electronics`] (motors, bridges, battery, sensors) |
//!
//! A model file to a physics step: `model` (TOML, checked) -> `plant::mechanics::build` (constants and state) ->
//! `plant::mechanics::system` (one implicit step of the whole robot).

pub mod model;
pub mod plant;
