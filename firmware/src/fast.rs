//! The fast half: encoders and currents in, duties out, 10,000 times a second, in integers alone.
//!
//! The way of a tick, which [`control`] puts together:
//!
//! ```text
//! encoders -> tracker -> rotor angles and speeds ----------------------------+
//! Asked ----> supervisor (armed? fresh? faults?) -> shaker (f, theta -> currents) -> foc -> duties
//!                 ^                                 or aligner (finds the electrical angles), or trial (measures)
//!             monitor (what is wrong)
//! ```
//!
//! [`configuration`] converts the settings to fixed point; [`units`](crate::units) has a type for each quantity.
//! [`margin`] alone is floating point: the slow half asks it before the robot arms.

mod aligner;
pub mod configuration;
pub mod control;
#[cfg(test)]
mod ends;
pub mod exchange;
pub mod foc;
mod headroom;
pub mod interval;
pub mod margin;
mod monitor;
pub mod reference;
mod shaker;
mod standstill_and_zero;
pub(crate) mod supervisor;
mod tracker;
mod trial;
