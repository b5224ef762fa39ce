//! The simulated robot and its operator in one page of a browser, with nothing installed.
//!
//! [`World`] is the whole loop in virtual time: the robot's software on its plant, a network, the real client, and the
//! operator's side of `flix cockpit`, whose page this is. [`script`] runs it without a page, and returns the hash of
//! all states of the plant: the same bits in a browser and natively. [`page`] packs the page; `exports` is what a
//! WebAssembly host calls.

mod exports;
pub mod page;
pub mod script;
mod world;

pub use world::{Options, Trouble, World};
