//! Driving by hand in a terminal.
//!
//! Three pure parts and a thin shell: [`keyboard`] and [`gamepad`] convert keys and sticks to [`Action`](action::Action)s,
//! [`Cockpit`] keeps the state from actions and the reports of the link, and [`view`] draws it.
//! [`drive::Drive`] moves what link and poses report into it, for every kind of screen; [`screen`] owns the terminal and
//! the loop.

pub mod action;
pub mod cockpit;
pub mod floor;
pub mod scope;
pub mod settings;

pub use cockpit::Cockpit;
