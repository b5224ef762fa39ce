//! The pictures of one tracker: their order, how late they come, and whether their poses are trusted.

use std::time::Duration;

use flix_protocol::units::Instant;

use super::continuity::Continuity;
use super::delay::Delay;
use super::order::{Arrival, Order, Stamp};
use super::{LATE, Pose};

/// Judge of a stream's pictures. Takes constant memory; never panics.
#[derive(Debug, Default)]
pub(super) struct Stream {
    order: Order,
    delay: Delay,
    continuity: Continuity,
}

/// A picture that is newer than all before it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Newer {
    /// Whether its stream began anew.
    pub(super) is_anew: bool,
    /// By how much later it came than the fastest one; none where it states no time.
    pub(super) late: Duration,
    /// Whether it has a pose that can be steered by.
    pub(super) is_trusted: bool,
}

impl Stream {
    /// Takes a picture that came now, with its order, its time of exposure, and its pose if the tracker trusts that. Returns
    /// `None` when it is not newer than all before it.
    pub(super) fn take(
        &mut self,
        now: Instant,
        stamp: Option<Stamp>,
        exposed: Option<Instant>,
        pose: Option<&Pose>,
    ) -> Option<Newer> {
        let arrival = stamp.map_or(Arrival::Next, |stamp| self.order.take(now, stamp));
        if arrival == Arrival::OutOfOrder {
            self.pass(now, stamp, pose);
            return None;
        }
        let late = exposed.map(|time| self.delay.take(now, time, arrival)).unwrap_or_default();
        let is_steady = pose.is_some_and(|pose| self.continuity.take(now, pose));
        let is_anew = arrival == Arrival::Anew;
        Some(Newer { is_anew, late, is_trusted: is_steady && late <= LATE })
    }

    /// Passes over a picture; one that is somewhere else than the newest breaks the trust.
    pub(super) fn pass(&mut self, now: Instant, stamp: Option<Stamp>, pose: Option<&Pose>) {
        if let Some((pose, apart)) = pose.zip(stamp.and_then(|stamp| self.order.apart(stamp))) {
            self.continuity.compare(now, pose, apart);
        }
    }

    /// Forgets order and delay: pictures from now on are timed by another clock.
    pub(super) fn forget_times(&mut self) {
        (self.order, self.delay) = (Order::default(), Delay::default());
    }

    /// Returns the number of poses that were out of reach of the pose before them.
    pub(super) const fn jumps(&self) -> u64 {
        self.continuity.jumps()
    }
}
