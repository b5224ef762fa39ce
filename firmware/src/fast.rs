//! The fast half: encoders and currents in, duties out, 10,000 times a second, in integers alone.

mod aligner;
pub mod alignment;
pub mod configuration;
pub mod control;
pub mod foc;
mod monitor;
pub mod shaker;
pub mod supervisor;
pub mod tracker;
pub mod units;
