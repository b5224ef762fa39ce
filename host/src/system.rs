//! What differs between operating systems: files for their owner alone, signals, programs that end together, whose keys a
//! terminal takes, and the clock that goes on while the computer is suspended.

pub mod file;
#[cfg(not(target_family = "wasm"))]
pub mod interrupt;
pub mod number;
pub mod program;
pub mod text;

#[cfg(not(target_family = "wasm"))]
use std::time::Duration;

#[cfg(not(target_family = "wasm"))]
#[cfg_attr(unix, path = "system/unix.rs")]
#[cfg_attr(windows, path = "system/windows.rs")]
mod present;

#[cfg(not(target_family = "wasm"))]
pub use present::{
    ERRORS, PASSING_SOCKET_ERRORS, create_private, create_private_folder, data_from, end_together,
    exposed_mode, has_keys, keep_memory_private, listen, shell,
};

/// Measures time, that of a suspended computer too, which [`std::time::Instant`] leaves out on most systems: the robot and the
/// world go on meanwhile.
#[cfg(not(target_family = "wasm"))]
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    start: Duration,
}

#[cfg(not(target_family = "wasm"))]
impl Clock {
    /// Starts to measure.
    #[must_use]
    pub fn start() -> Self {
        Self { start: present::uptime() }
    }

    /// Returns the time since the start.
    #[must_use]
    pub fn elapsed(self) -> Duration {
        present::uptime().saturating_sub(self.start)
    }
}

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

/// Returns a new file with the mode of an old one, and its owner.
#[cfg(unix)]
fn take_after(new: std::fs::File, old: &std::fs::Metadata) -> std::io::Result<std::fs::File> {
    use std::os::unix::fs::{MetadataExt as _, fchown};
    let present = new.metadata()?;
    if (present.uid(), present.gid()) != (old.uid(), old.gid()) {
        fchown(&new, Some(old.uid()), Some(old.gid()))?;
    }
    new.set_permissions(old.permissions())?;
    Ok(new)
}

/// Returns a new file: elsewhere the folder gives it its owner.
#[cfg(not(unix))]
#[allow(clippy::unnecessary_wraps, reason = "as on other systems")]
fn take_after(new: std::fs::File, _old: &std::fs::Metadata) -> std::io::Result<std::fs::File> {
    Ok(new)
}

/// Raises a flag when it is dropped, also by a test that fails.
#[cfg(test)]
pub(crate) struct AtEnd<'a>(pub(crate) &'a std::sync::atomic::AtomicBool);

#[cfg(test)]
impl Drop for AtEnd<'_> {
    fn drop(&mut self) {
        self.0.store(true, std::sync::atomic::Ordering::Relaxed);
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    #[test]
    fn the_clock_counts_what_the_system_has_lived_and_slept() {
        // The kernel's own count, suspended time included, in hundredths of a second.
        let stated = || -> f64 {
            let text = std::fs::read_to_string("/proc/uptime").unwrap();
            text.split_whitespace().next().unwrap().parse().unwrap()
        };
        let (before, read, after) = (stated(), super::present::uptime().as_secs_f64(), stated());
        assert!((before - 0.01..=after + 0.02).contains(&read), "{before} {read} {after}");
    }
}
