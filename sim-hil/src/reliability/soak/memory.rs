//! Memory of the process while a robot soaks.

use std::time::Duration;

/// Largest resident memory of this process in the first and in the last quarter of a scenario, bytes.
pub(super) struct Memory {
    /// Length of the scenario, s.
    length: u64,
    /// Virtual time that has passed, s.
    seconds: u64,
    early: u64,
    late: u64,
}

impl Memory {
    pub(super) fn new(length: Duration) -> Self {
        Self { length: length.as_secs().max(1), seconds: 0, early: 0, late: 0 }
    }

    /// Looks at the memory; call it once a virtual second.
    pub(super) fn look(&mut self) {
        let quarter = match self.seconds * 4 / self.length {
            0 => &mut self.early,
            3 => &mut self.late,
            _ => &mut 0,
        };
        *quarter = resident().unwrap_or(0).max(*quarter);
        self.seconds += 1;
    }

    /// Returns the growth in bytes, where the system reports the memory.
    pub(super) fn growth(&self) -> Option<f64> {
        (self.early > 0 && self.late > 0).then_some(self.late as f64 - self.early as f64)
    }
}

/// Returns the resident memory of this process in bytes, where the system reports it (Linux).
fn resident() -> Option<u64> {
    /// Of every system that this is run on.
    const PAGE: u64 = 4_096;
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    Some(text.split(' ').nth(1)?.parse::<u64>().ok()? * PAGE)
}
