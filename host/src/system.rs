//! What differs between operating systems: files for their owner alone, signals, programs that end together, and whose
//! keys a terminal takes.

#[cfg_attr(unix, path = "system/unix.rs")]
#[cfg_attr(windows, path = "system/windows.rs")]
mod present;

pub use present::{
    SIGNALS, create_private, create_private_folder, end_together, exposed_mode, has_keys, is_pipe,
    shell,
};
