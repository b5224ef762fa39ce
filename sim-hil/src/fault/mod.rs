//! Things that go wrong, put around what works: around the link ([`crate::channel`]), between software and
//! hardware ([`hardware`]), and all of them over all modes at all times ([`matrix`]).
//!
//! Nothing in the robot's software or in the operator's client knows of them. All chance comes from seeds.

pub mod hardware;
pub mod matrix;
