//! The simulated robot's command line.
fn main() {}
