//! The program that runs, for what it writes.

use std::sync::OnceLock;

static PROGRAM: OnceLock<&str> = OnceLock::new();

/// States the name and version of the program; the first statement counts.
pub fn set(program: &'static str) {
    PROGRAM.get_or_init(|| program);
}

/// Returns name and version of the program as it [stated](set) them; `flix` and the version of this library where it stated none.
#[must_use]
pub fn get() -> &'static str {
    PROGRAM.get().unwrap_or(&concat!("flix ", env!("CARGO_PKG_VERSION")))
}

/// Returns the version alone.
#[must_use]
pub fn version() -> &'static str {
    get().rsplit(' ').next().unwrap_or_default()
}
