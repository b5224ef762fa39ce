//! Driving by hand in a terminal.
//!
//! Three pure parts and a thin shell: [`keyboard`] converts keys to [`Action`](keyboard::Action)s,
//! [`Cockpit`] keeps the state from actions and the reports of the link, and [`view`] draws it.
//! [`drive::Drive`] moves what link and poses report into it, for every kind of screen; [`screen`] owns the terminal and
//! the loop.

pub mod cockpit;
pub mod drive;
pub mod floor;
pub mod keyboard;
pub mod screen;
pub mod view;

pub use cockpit::Cockpit;
