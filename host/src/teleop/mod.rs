//! Driving by hand in a terminal.
//!
//! Three pure parts and a thin shell: [`keyboard`] turns keys into [`Action`](keyboard::Action)s,
//! [`Cockpit`] turns actions and what the link reports into a state, and [`view`] draws that state.
//! [`screen`] owns the terminal and the loop.

pub mod cockpit;
pub mod keyboard;
pub mod screen;
pub mod view;

pub use cockpit::Cockpit;
