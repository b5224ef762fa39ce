//! What every measurement of motors begins with: rotors that stand, and the zero of the current sense.

use crate::fast::configuration::Configuration;
use crate::fast::tracker::Tracker;
use crate::units::{Counts, Speed};

/// Ticks over which the current zero is averaged: 0.1 s.
pub(crate) const ZERO_TICKS: u32 = 1 << 10;
/// Ticks that the rotor may take to come to rest beforehand: 2 s.
pub(crate) const LONGEST_REST_WAIT_TICKS: u32 = 20_000;
/// Ticks that both rotors must have been slow to count as at rest: 50 ms.
pub(crate) const STILL_TICKS: u32 = 500;
/// A rotor slower than this is at rest: 0.5 Hz.
pub(crate) const STILL: Speed = Speed::from_raw(214_748);

/// For how long both rotors have stood.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Stillness {
    ticks: u32,
}

impl Stillness {
    /// Looks at them once a tick; returns whether they have stood for long enough.
    pub(crate) fn look(&mut self, trackers: &[Tracker; 2]) -> bool {
        let still =
            trackers.iter().all(|tracker| tracker.settled() && tracker.speed().magnitude() < STILL);
        self.ticks = if still { self.ticks + 1 } else { 0 };
        self.ticks >= STILL_TICKS
    }
}

/// Averages what the amplifiers show at no current, over [`ZERO_TICKS`].
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ZeroMeter {
    sums: [[i32; 2]; 2],
}

impl ZeroMeter {
    /// Takes what the amplifiers of phases A and B show in one tick, top and bottom.
    pub(crate) fn add(&mut self, counts: [[Counts; 2]; 2]) {
        for (sum, count) in self.sums.iter_mut().flatten().zip(counts.as_flattened()) {
            *sum = sum.saturating_add(count.raw());
        }
    }

    /// Returns the zeros; `None` when one is further from its design than an amplifier that works can be.
    pub(crate) fn zeros(&self, configuration: &Configuration) -> Option<[[Counts; 2]; 2]> {
        let zeros =
            self.sums.map(|motor| motor.map(|sum| Counts::from_raw(sum / ZERO_TICKS as i32)));
        let off = |zero: &Counts| {
            (*zero - configuration.zero_design).magnitude() > configuration.zero_tolerance
        };
        (!zeros.as_flattened().iter().any(off)).then_some(zeros)
    }
}
