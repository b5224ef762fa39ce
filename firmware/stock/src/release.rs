/// The release of rustc whose library the driver is built around, and no other.
pub const RUSTC: &str = "1.95.0";
/// Names the variable that holds the path of `rust-lld` for the linker.
pub const LLD: &str = "XTENSA_LLD";
