//! Driving by hand in a terminal.
//!
//! Three pure parts and a thin shell: [`keyboard`] and [`gamepad`] convert keys and sticks to [`Action`](action::Action)s,
//! [`Cockpit`] keeps the state from actions and the reports of the link, and [`view`] draws it.
//! [`drive::Drive`] moves what link and poses report into it, for every kind of screen; [`screen`] owns the terminal and
//! the loop.

pub mod action;
pub mod cockpit;
#[cfg(feature = "program")]
pub mod drive;
pub mod floor;
#[cfg(feature = "program")]
pub mod gamepad;
#[cfg(feature = "program")]
pub mod keyboard;
pub mod scope;
#[cfg(feature = "program")]
pub mod screen;
pub mod settings;
#[cfg(feature = "program")]
pub mod view;

pub use cockpit::Cockpit;
