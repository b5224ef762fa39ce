//! The first moments of the image: both bridges off and the tasks' watchdog on, before anything that takes time (flash, radio,
//! a chip that is refused).

use std::time::Duration;

use serde::Serialize;

use crate::CYCLES_PER_SECOND;
use crate::chip::Chip;
use crate::cycles;
use crate::robot::Robot;

/// All of it is done so soon after the image's first instruction: the HAL sets up the clocks in 1.2 ms, and flash and radio
/// come later.
const LATEST: Duration = Duration::from_millis(2);

/// Cycles from the image's first instruction on; `None` for what did not happen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Start {
    enables: Option<u64>,
    phases: Option<u64>,
    watchdog: Option<u64>,
}

/// The same in microseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Report {
    /// Until each bridge's enable is driven low.
    pub enables_low_us: Option<f64>,
    /// Until each phase is.
    pub phases_low_us: Option<f64>,
    /// Until the tasks' watchdog runs.
    pub watchdog_us: Option<f64>,
}

impl Start {
    /// Looks at how a chip started last.
    #[must_use]
    pub fn of(chip: &Chip<Robot>) -> Self {
        let last = |pins: &[u32]| {
            let after: Option<Vec<u64>> = pins.iter().map(|pin| chip.low_after(*pin)).collect();
            after?.into_iter().max()
        };
        let bridges = Robot::bridge_pins();
        let enables: Vec<u32> = bridges.iter().filter_map(|(_, enable)| *enable).collect();
        let phases: Vec<u32> = bridges.iter().flat_map(|(phases, _)| *phases).collect();
        Self {
            enables: last(&enables),
            phases: last(&phases),
            watchdog: chip.counters().slow_watchdog_after_cycles,
        }
    }

    /// Returns the figures.
    #[must_use]
    pub fn report(&self) -> Report {
        let us = |cycles: Option<u64>| Some(cycles? as f64 * 1e6 / CYCLES_PER_SECOND as f64);
        Report {
            enables_low_us: us(self.enables),
            phases_low_us: us(self.phases),
            watchdog_us: us(self.watchdog),
        }
    }

    /// Returns what does not hold, in sentences.
    #[must_use]
    pub fn failures(&self) -> Vec<String> {
        let Report { enables_low_us, phases_low_us, watchdog_us } = self.report();
        let is_late = |after: Option<u64>| after.is_none_or(|after| after > cycles(LATEST));
        let mut failures = Vec::new();
        if is_late(self.enables) || is_late(self.phases) {
            failures.push(format!(
                "after a start the bridges' pins float: enables are low after {enables_low_us:?} us, phases after \
                 {phases_low_us:?} us"
            ));
        } else if self.enables > self.phases {
            failures.push("after a start a phase is driven before the enables are low".to_owned());
        }
        if is_late(self.watchdog) {
            failures.push(format!("the tasks' watchdog starts after {watchdog_us:?} us"));
        }
        failures
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Enables after 1, phases after 1.1 and the watchdog after 1.2 ms.
    const GOOD: Start =
        Start { enables: Some(160_000), phases: Some(176_000), watchdog: Some(192_000) };

    #[test]
    fn a_good_start_passes() {
        assert_eq!(GOOD.failures(), [""; 0]);
        assert_eq!(GOOD.report().phases_low_us, Some(1_100.0));
    }

    #[test]
    fn what_is_late_never_done_or_done_in_another_order_is_told() {
        let late = Some(cycles(LATEST) + 1);
        for (start, words) in [
            (Start { enables: late, ..GOOD }, "pins float"),
            (Start { enables: None, ..GOOD }, "pins float"),
            (Start { phases: late, ..GOOD }, "pins float"),
            (Start { phases: None, ..GOOD }, "pins float"),
            (Start { phases: Some(1), ..GOOD }, "before the enables"),
            (Start { watchdog: late, ..GOOD }, "watchdog"),
            (Start { watchdog: None, ..GOOD }, "watchdog"),
        ] {
            let failures = start.failures();
            assert!(matches!(&failures[..], [one] if one.contains(words)), "{failures:?}");
        }
    }
}
