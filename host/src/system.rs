//! What differs between operating systems: files for their owner alone, signals, programs that end together, and whose
//! keys a terminal takes.

#[cfg(not(target_family = "wasm"))]
#[cfg_attr(unix, path = "system/unix.rs")]
#[cfg_attr(windows, path = "system/windows.rs")]
mod present;

#[cfg(not(target_family = "wasm"))]
pub use present::{
    PASSING_SOCKET_ERRORS, SIGNALS, create_private, create_private_folder, end_together,
    exposed_mode, has_keys, shell,
};

/// Returns whether a file is a named pipe.
#[cfg(unix)]
#[must_use]
pub fn is_pipe(kind: std::fs::FileType) -> bool {
    std::os::unix::fs::FileTypeExt::is_fifo(&kind)
}

/// Returns whether a file is a named pipe: elsewhere those are in no folder.
#[cfg(not(unix))]
#[must_use]
pub fn is_pipe(_kind: std::fs::FileType) -> bool {
    false
}
