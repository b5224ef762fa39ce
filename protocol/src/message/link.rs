//! How well the robot receives the operator.

use core::time::Duration;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::names::names;

/// How well the robot receives the operator, counted since power-up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, Schema)]
pub struct LinkQuality {
    /// Datagrams accepted.
    pub accepted: u32,
    /// Commands of the present session that did not arrive (gaps in the counter).
    pub lost: u32,
    /// Datagrams dropped, by reason.
    pub dropped: Dropped,
    /// Microseconds since the last valid command; `u32::MAX` when there was none.
    pub silence_us: u32,
    /// Age of the newest command at its arrival, fresh or late, microseconds; `u32::MAX` when it was
    /// older than the robot remembers, or there was none.
    pub age_us: u32,
    /// Commands that came too late to count, since power-up.
    pub late: u32,
    /// Received radio power, dBm; none where there is no radio or it does not report it.
    pub signal_dbm: Option<i8>,
}

impl LinkQuality {
    /// Returns the age of the newest command at its arrival; `None` when it was older than the robot
    /// remembers, or there was none.
    #[must_use]
    pub fn age(&self) -> Option<Duration> {
        (self.age_us != u32::MAX).then(|| Duration::from_micros(self.age_us.into()))
    }
}

/// Datagrams dropped since power-up, by [`DropReason`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, Schema)]
pub struct Dropped {
    /// See [`DropReason::Malformed`].
    pub malformed: u32,
    /// See [`DropReason::Version`].
    pub version: u32,
    /// See [`DropReason::Forged`].
    pub forged: u32,
    /// See [`DropReason::Replayed`].
    pub replayed: u32,
    /// See [`DropReason::Stale`].
    pub stale: u32,
    /// See [`DropReason::Session`].
    pub session: u32,
    /// See [`DropReason::Busy`].
    pub busy: u32,
    /// See [`DropReason::Unprovisioned`].
    pub unprovisioned: u32,
}

impl Dropped {
    /// Counts one more datagram. Stays at `u32::MAX` and does not wrap.
    pub const fn count(&mut self, reason: DropReason) {
        let counter = self.counter(reason);
        *counter = counter.saturating_add(1);
    }

    /// Returns how many datagrams were dropped for this reason.
    #[must_use]
    pub const fn get(mut self, reason: DropReason) -> u32 {
        *self.counter(reason)
    }

    /// Returns how many datagrams were dropped for any reason.
    #[must_use]
    pub fn total(&self) -> u64 {
        DropReason::ALL.into_iter().map(|reason| u64::from(self.get(reason))).sum()
    }

    const fn counter(&mut self, reason: DropReason) -> &mut u32 {
        match reason {
            DropReason::Malformed => &mut self.malformed,
            DropReason::Version => &mut self.version,
            DropReason::Forged => &mut self.forged,
            DropReason::Replayed => &mut self.replayed,
            DropReason::Stale => &mut self.stale,
            DropReason::Session => &mut self.session,
            DropReason::Busy => &mut self.busy,
            DropReason::Unprovisioned => &mut self.unprovisioned,
        }
    }
}

/// Why a datagram was dropped. Each reason has its counter in [`Dropped`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DropReason {
    /// It is not a datagram of this protocol: too short, too long, or of an unknown kind.
    Malformed,
    /// It is of another version of the protocol.
    Version,
    /// Its tag does not fit: another key, forged or damaged.
    Forged,
    /// It was received before, or is older than the replay window.
    Replayed,
    /// It is older than a command already obeyed (or a telemetry already shown).
    Stale,
    /// It is of a session that is not the present one.
    Session,
    /// It is of a second operator, while the first holds the session.
    Busy,
    /// The robot has no key yet.
    Unprovisioned,
}

names!(DropReason {
    Malformed: "malformed",
    Version: "other version",
    Forged: "forged",
    Replayed: "replayed",
    Stale: "stale",
    Session: "other session",
    Busy: "busy",
    Unprovisioned: "unprovisioned",
});
