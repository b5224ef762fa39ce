//! What is wrong: each fault that currents, voltages and motion show, debounced.
//!
//! Faults that must be found within ticks (over-current, lost encoder, late loop) are looked for in
//! every tick by [`control`](crate::fast::control); those here build up slowly and are looked at in
//! one tick of [`DIAGNOSTIC_TICKS`].

use flix_protocol::message::{Fault, Faults};

use crate::fast::configuration::Configuration;
use crate::fast::foc::current::CurrentLoop;
use crate::fast::shaker::Shaker;
use crate::fast::tracker::Tracker;
use crate::fast::units::{Current, Speed, TURN_PER_DEGREE, Voltage, magnitude};

/// Consecutive samples above the limit that are an over-current: one alone may be a spike.
const OVER_CURRENT_TICKS: u32 = 2;
/// Ticks for which the bus must be too low: 20 ms, longer than a sag of one turn.
const UNDER_VOLTAGE_TICKS: u32 = 200;
/// Ticks for which the bus must be too high: 3.2 ms.
const OVER_VOLTAGE_TICKS: u32 = 32;
/// Ticks at the current limit without movement: 0.2 s.
const STALL_TICKS: u32 = 2_000;
/// Ticks without movement while f goes on: 20 ms.
const BLOCKED_TICKS: u32 = 200;
/// f goes on from here: 5 Hz.
const GOING_ON: Speed = Speed::from_centihertz(500);
/// Slower than this is no movement: 1 Hz.
const STALLED: Speed = Speed::from_centihertz(100);
/// Twice theta may be off by this much: 15 degrees of theta.
const LARGEST_SUM_ERROR: i32 = (30.0 * TURN_PER_DEGREE) as i32;
/// Ticks for which theta may be further off, or the phase slip: 0.1 s.
const UNLOCKED_TICKS: u32 = 1_000;
/// Ticks for which f may stay away from what is asked for with the motors at their limits: 1 s.
const DROOP_TICKS: u32 = 10_000;
/// f may be off by this much: 10 Hz. A walking body that swings against its rotors at 35 Hz takes up
/// to 8 Hz for a second (seen in simulation); theta is held meanwhile, and telemetry shows f.
const LARGEST_DROOP: Speed = Speed::from_centihertz(1_000);
/// Ticks for which a motor may differ from its model: 10 ms.
const RESIDUAL_TICKS: u32 = 100;
/// Ticks for which a phase must carry next to nothing while the others do: 0.1 s.
const OPEN_PHASE_TICKS: u32 = 1_000;
/// A phase is open when its peak is below this share of the largest, 2^-3.
const OPEN_PHASE_SHIFT: u32 = 3;
/// Peaks below this are not judged: 0.15 A.
const SIGNIFICANT_CURRENT: Current = Current::from_raw(9_830);
/// Peaks fade within 2^5 diagnoses, 50 ms, several electrical turns.
const PEAK_SHIFT: u32 = 5;
/// What builds up slowly is looked at in one tick of so many.
pub(crate) const DIAGNOSTIC_TICKS: u32 = 16;

/// Counts observations of a fault; falls at the same rate while it is not observed.
#[derive(Debug, Clone, Copy, Default)]
struct Debounce(u32);

impl Debounce {
    /// Counts an observation and returns whether `limit` is reached.
    #[inline(always)]
    const fn count(&mut self, wrong: bool, limit: u32) -> bool {
        if wrong {
            self.0 += (self.0 < limit) as u32;
        } else {
            self.0 = self.0.saturating_sub(1);
        }
        self.0 >= limit
    }

    /// Counts one diagnosis, for a limit in ticks.
    const fn diagnose(&mut self, wrong: bool, ticks: u32) -> bool {
        self.count(wrong, ticks / DIAGNOSTIC_TICKS)
    }
}

/// Adds those faults that were found.
#[inline(always)]
pub(crate) fn add<const N: usize>(mut faults: Faults, found: [(Fault, bool); N]) -> Faults {
    for (fault, is_present) in found {
        if is_present {
            core::hint::cold_path();
            faults = faults.with(fault);
        }
    }
    faults
}

/// What the monitor looks at.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Observation<'a> {
    /// Its limits.
    pub(crate) configuration: &'a Configuration,
    /// Battery side of the bridges, averaged.
    pub(crate) bus_voltage: Voltage,
    /// Top, bottom.
    pub(crate) trackers: &'a [Tracker; 2],
    /// Currents of phases A and B, top and bottom.
    pub(crate) currents: &'a [[Current; 2]; 2],
    /// Top, bottom.
    pub(crate) loops: &'a [CurrentLoop; 2],
    /// Whether the rotors are controlled,
    pub(crate) shaking: bool,
    /// by what,
    pub(crate) shaker: &'a Shaker,
    /// and the f that is asked for.
    pub(crate) target: Speed,
}

/// What was observed but is not sure yet.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Monitor {
    over_current: Debounce,
    under_voltage: Debounce,
    over_voltage: Debounce,
    stall: [Debounce; 2],
    blocked: [Debounce; 2],
    unlocked: Debounce,
    droop: Debounce,
    residual: Debounce,
    open_phase: [Debounce; 2],
    /// Fading peaks of the phase currents.
    peaks: [[Current; 3]; 2],
}

impl Monitor {
    /// Starts anew, but for over-current, as the rotors begin to be controlled.
    pub(crate) fn restart(&mut self) {
        *self = Self { over_current: self.over_current, ..Self::default() };
    }

    /// Counts a tick in which a phase carried too much, or not; returns whether that is a fault.
    #[inline(always)]
    pub(crate) const fn over_current(&mut self, excess: bool) -> bool {
        self.over_current.count(excess, OVER_CURRENT_TICKS)
    }

    /// Adds the faults whose cause is there now, but for those that every tick looks for.
    pub(crate) fn faults(&mut self, faults: Faults, observation: &Observation<'_>) -> Faults {
        let Observation { configuration, bus_voltage, trackers, .. } = *observation;
        let fast = |tracker: &Tracker| tracker.speed().magnitude() > configuration.over_speed;
        let low = bus_voltage < configuration.under_voltage;
        let high = bus_voltage > configuration.over_voltage;
        let found = [
            (Fault::OverSpeed, trackers.iter().any(fast)),
            (Fault::UnderVoltage, self.under_voltage.diagnose(low, UNDER_VOLTAGE_TICKS)),
            (Fault::OverVoltage, self.over_voltage.diagnose(high, OVER_VOLTAGE_TICKS)),
        ];
        let faults = add(faults, found);
        if observation.shaking { self.shaking_faults(faults, observation) } else { faults }
    }

    /// Adds the faults that show only while the rotors are controlled.
    fn shaking_faults(&mut self, faults: Faults, observation: &Observation<'_>) -> Faults {
        let Observation { configuration, trackers, loops, shaker, target, .. } = *observation;
        let pressed = shaker.limited();
        let going_on = shaker.frequency().magnitude() > GOING_ON;
        let mut stalled = false;
        let counts = self.stall.iter_mut().zip(&mut self.blocked);
        for (tracker, (stall, blocked)) in trackers.iter().zip(counts) {
            let still = tracker.speed().magnitude() < STALLED;
            stalled |= stall.diagnose(still && pressed, STALL_TICKS)
                | blocked.diagnose(still && going_on, BLOCKED_TICKS);
        }
        let unlocked = shaker.slipping() || magnitude(shaker.sum_error()) > LARGEST_SUM_ERROR;
        let droop = (target - shaker.frequency()).magnitude();
        let lost = self.unlocked.diagnose(unlocked, UNLOCKED_TICKS)
            | self.droop.diagnose(pressed && droop > LARGEST_DROOP, DROOP_TICKS);
        let off = loops.iter().any(|current_loop| {
            let residual = current_loop.residual();
            residual.d.magnitude().max(residual.q.magnitude()) > configuration.largest_residual
        });
        let found = [
            (Fault::Stall, stalled),
            (Fault::PhaseLockLost, lost),
            (Fault::Alignment, self.open_phase(observation.currents, going_on)),
            (Fault::CurrentSense, self.residual.diagnose(off, RESIDUAL_TICKS)),
        ];
        add(faults, found)
    }

    /// Whether a phase carries next to nothing while its motor turns and the others carry.
    fn open_phase(&mut self, currents: &[[Current; 2]; 2], going_on: bool) -> bool {
        let mut found = false;
        for ((peaks, debounce), [a, b]) in
            self.peaks.iter_mut().zip(&mut self.open_phase).zip(*currents)
        {
            for (peak, current) in peaks.iter_mut().zip([a, b, a + b]) {
                let faded = *peak - Current::from_raw(peak.raw() >> PEAK_SHIFT);
                *peak = faded.max(current.magnitude());
            }
            let [a, b, c] = *peaks;
            let (least, most) = (a.min(b).min(c), a.max(b).max(c));
            let open = going_on
                && most > SIGNIFICANT_CURRENT
                && least.raw() < most.raw() >> OPEN_PHASE_SHIFT;
            found |= debounce.diagnose(open, OPEN_PHASE_TICKS);
        }
        found
    }
}
