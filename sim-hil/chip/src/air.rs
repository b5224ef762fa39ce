//! What the network does to a running robot: it goes away and comes back, and somebody floods it with forged datagrams.

use std::time::Duration;

use flix_host::link::RobotLink;
use serde::Serialize;

use crate::flood::Flood;
use crate::rig::{Rig, RigError};
use crate::session::{Hold, Times, hold, loop_failures};

/// How long the radio is gone.
const GONE: Duration = Duration::from_secs(5);
/// Sessions that are opened with a robot at rest, one after the other, and the pause between two, which is no multiple of the robot's
/// own periods.
const SESSIONS: usize = 100;
const PAUSE: Duration = Duration::from_micros(13_700);
/// What is held meanwhile: Hz, degrees.
const HELD: (f64, f64) = (20.0, 0.0);

/// Result of the network: what it did, and how the robot answered.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Air {
    /// The robot under the flood.
    pub flooded: Hold,
    /// Forged datagrams.
    pub forged: u64,
    /// Instructions that each costs.
    pub instructions_each: f64,
    /// Ticks missed during flood and silence.
    pub missed: u64,
    /// Longest gap meanwhile, microseconds.
    pub longest_gap_us: f64,
    /// From the moment the radio came back to a robot that is armed again, s.
    pub back_s: f64,
    /// From a client's first datagram to its session, with a robot at rest, ms: the 50th and the 99th of 100.
    pub connect_ms: [f64; 2],
}

impl Air {
    /// Returns what does not hold, in sentences.
    pub fn failures(&self) -> Vec<String> {
        let held = self.flooded.failures().into_iter();
        let timing = loop_failures(self.missed, self.longest_gap_us);
        held.chain(timing).map(|failure| format!("network: {failure}")).collect()
    }
}

/// Floods a provisioned robot, then takes its radio away and gives it back.
pub fn trouble(rig: &mut Rig, times: Times, seed: u64) -> Result<Air, RigError> {
    let current_limit = rig.setting("current_limit")?;
    rig.forget_seen();
    rig.arm_uncommissioned()?;
    hold(rig, HELD, times, current_limit)?;
    let quiet = instructions(rig, times.measure)?;
    rig.flood(Some(Flood::new(seed)));
    let before = rig.chip.counters().instructions;
    let from = rig.chip.now();
    let flooded = hold(rig, HELD, times, current_limit)?;
    let seconds = (rig.chip.now() - from).as_secs_f64();
    let busy = rig.chip.counters().instructions - before;
    let forged = rig.flood(None).map_or(0, |flood| flood.sent);
    let extra = busy as f64 - quiet * seconds;
    rig.chip.network.air.is_up = false;
    rig.run(GONE)?;
    rig.chip.network.air.is_up = true;
    let back = rig.chip.now();
    rig.until_log("connection to the network", "wi-fi: connected")?;
    rig.connect()?;
    rig.arm_uncommissioned()?;
    let back_s = (rig.chip.now() - back).as_secs_f64();
    let seen = rig.seen.clone();
    rig.disarm()?;
    let connect_ms = connect_times(rig)?;
    Ok(Air {
        flooded,
        forged,
        instructions_each: extra / forged.max(1) as f64,
        missed: seen.missed,
        longest_gap_us: seen.longest_gap_us,
        back_s,
        connect_ms,
    })
}

/// Opens [`SESSIONS`] and returns how long half and 99 of 100 of them took at most, ms.
fn connect_times(rig: &mut Rig) -> Result<[f64; 2], RigError> {
    let mut times = Vec::with_capacity(SESSIONS);
    for _ in 0..SESSIONS {
        let from = rig.chip.now();
        rig.connect()?;
        times.push(1e3 * (rig.chip.now() - from).as_secs_f64());
        rig.run(PAUSE)?;
    }
    times.sort_by(f64::total_cmp);
    Ok([times[SESSIONS / 2 - 1], times[SESSIONS * 99 / 100 - 1]])
}

/// Instructions a second in a robot that holds.
fn instructions(rig: &mut Rig, time: Duration) -> Result<f64, RigError> {
    let before = rig.chip.counters().instructions;
    rig.run(time)?;
    Ok((rig.chip.counters().instructions - before) as f64 / time.as_secs_f64())
}
