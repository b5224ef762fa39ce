//! The models that come with the program.

/// Names of the models that come with the program.
pub const NAMES: [&str; 6] = ["A", "W", "calibrated", "flix", "bench-fixed", "bench-planar"];

/// Their files, in the same order.
pub(super) const SHIPPED: [&str; 6] = [
    include_str!("../../../models/A.toml"),
    include_str!("../../../models/W.toml"),
    include_str!("../../../models/calibrated.toml"),
    include_str!("../../../models/flix.toml"),
    include_str!("../../../models/bench-fixed.toml"),
    include_str!("../../../models/bench-planar.toml"),
];
