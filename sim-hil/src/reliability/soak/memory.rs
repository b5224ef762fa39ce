//! Memory of the process while robots soak.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Resident memory of this process, largest in the first and in the last quarter of the virtual time.
pub(super) struct Memory {
    total: u64,
    seconds: AtomicU64,
    early: AtomicU64,
    late: AtomicU64,
}

impl Memory {
    pub(super) fn new(total: Duration) -> Self {
        let [seconds, early, late] = [0, 0, 0].map(AtomicU64::new);
        Self { total: total.as_secs(), seconds, early, late }
    }

    /// Once a virtual second of any robot.
    pub(super) fn look(&self) {
        let seconds = self.seconds.fetch_add(1, Ordering::Relaxed);
        let quarter = match seconds * 4 / self.total.max(1) {
            0 => &self.early,
            3 => &self.late,
            _ => return,
        };
        if let Some(resident) = resident() {
            quarter.fetch_max(resident, Ordering::Relaxed);
        }
    }

    pub(super) fn growth(&self) -> Option<i64> {
        let [early, late] = [&self.early, &self.late].map(|size| size.load(Ordering::Relaxed));
        (early > 0 && late > 0).then(|| late as i64 - early as i64)
    }
}

/// Returns the resident memory of this process in bytes, where the system reports it (Linux).
fn resident() -> Option<u64> {
    /// Of every system that this is run on.
    const PAGE: u64 = 4_096;
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    Some(text.split(' ').nth(1)?.parse::<u64>().ok()? * PAGE)
}
