//! Driving by hand, in a terminal or a browser.
//!
//! [`Cockpit`] is the model behind both screens: it keeps the state from [`Action`](action::Action)s and the reports of the
//! link. `flix-cli` converts keys and sticks to actions, draws the state, and owns the terminal.

pub mod action;
mod attention;
pub mod cockpit;
pub mod floor;
pub mod page;
pub mod paper_modes;
pub mod scope;
pub mod settings;

pub use cockpit::Cockpit;
