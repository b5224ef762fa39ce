//! Remembers when recent datagrams were sent.

use core::time::Duration;

use heapless::Deque;

use crate::units::Instant;

/// Datagrams sent within this time of each other share one remembered moment, that of the first.
pub const SEND_SLOT: Duration = Duration::from_millis(16);
/// Oldest command of which the age is known at least, however many datagrams the robot sends.
pub const LONGEST_COMMAND_AGE: Duration = SEND_SLOT.saturating_mul(SLOTS as u32 - 1);

/// Moments that are remembered.
const SLOTS: usize = 64;

/// When the datagrams of one session were sent, as far as it matters for the age of commands.
///
/// The Accept is number 0, the sealed datagram with counter `n` is number `n + 1`. Whatever is not
/// remembered exactly (times below a millisecond, datagrams that share a slot) is rounded to earlier.
/// Never panics.
pub(super) struct SendTimes {
    /// When the Accept was first sent.
    opened: Instant,
    slots: Deque<Slot, SLOTS>,
}

/// The first datagram of a slot.
#[derive(Clone, Copy)]
struct Slot {
    number: u64,
    /// Milliseconds since the Accept.
    at: u64,
}

impl SendTimes {
    /// Begins with the Accept.
    pub(super) fn new(opened: Instant) -> Self {
        let mut slots = Deque::new();
        // An empty queue has room.
        let _ = slots.push_back(Slot { number: 0, at: 0 });
        Self { opened, slots }
    }

    /// Remembers that the datagram of this number was sent now; numbers count up.
    pub(super) fn sent(&mut self, number: u64, now: Instant) {
        // Some 600 million years.
        let at = now.since(self.opened).as_millis() as u64;
        let slot_ms = SEND_SLOT.as_millis() as u64;
        if self.slots.back().is_some_and(|newest| at.saturating_sub(newest.at) < slot_ms) {
            return;
        }
        if self.slots.is_full() {
            self.slots.pop_front();
        }
        // Room was just made.
        let _ = self.slots.push_back(Slot { number, at });
    }

    /// Returns a moment not after the sending of this datagram; `None` when that is too long ago.
    pub(super) fn moment(&self, number: u64) -> Option<Instant> {
        let slot = self.slots.iter().rev().find(|slot| slot.number <= number)?;
        Some(self.opened + Duration::from_millis(slot.at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OPENED: Instant = Instant::from_micros(7_000_123);

    fn after(milliseconds: u64) -> Instant {
        OPENED + Duration::from_millis(milliseconds)
    }

    /// One datagram each `interval` milliseconds, the first with the Accept; returns the last number.
    fn send(times: &mut SendTimes, interval: u64, until: u64) -> u64 {
        let numbers = 1..=until / interval;
        let last = *numbers.end();
        numbers.for_each(|number| times.sent(number, after(number * interval)));
        last
    }

    #[test]
    fn a_moment_is_at_most_one_slot_before_the_sending_and_never_after_it() {
        for interval in [1, 5, 16, 20, 50] {
            let mut times = SendTimes::new(OPENED);
            let last = send(&mut times, interval, 3_000);
            let known = LONGEST_COMMAND_AGE.as_millis() as u64 / interval;
            for number in last - known..=last {
                let rounded = after(number * interval).since(times.moment(number).unwrap());
                assert!(rounded < SEND_SLOT, "{interval} ms, {number}: {rounded:?}");
                assert!(times.moment(number).unwrap() <= after(number * interval));
            }
        }
    }

    #[test]
    fn what_is_longer_ago_than_the_slots_reach_is_unknown() {
        let mut times = SendTimes::new(OPENED);
        let last = send(&mut times, 20, 10_000);
        assert_eq!(times.moment(0), None);
        assert_eq!(times.moment(last - SLOTS as u64), None);
        assert_eq!(times.moment(last), Some(after(10_000)));
    }

    #[test]
    fn the_accept_is_remembered_until_others_push_it_out() {
        let times = SendTimes::new(OPENED);
        assert_eq!(times.moment(0), Some(OPENED));
    }

    /// A session whose keys are renewed goes on for as long as its operator wants.
    #[test]
    fn moments_are_as_exact_in_every_month_of_a_session() {
        for (number, milliseconds) in [
            (1, u64::from(u32::MAX) - 5),
            (1 << 31, u64::from(u32::MAX) + 1),
            (u64::from(u32::MAX) + 1, 40),
            (1 << 40, 1 << 42),
        ] {
            let mut times = SendTimes::new(OPENED);
            for later in 0..2 * SLOTS as u64 {
                times.sent(number + later, after(milliseconds + 20 * later));
            }
            for later in SLOTS as u64..2 * SLOTS as u64 {
                let moment = times.moment(number + later);
                assert_eq!(moment, Some(after(milliseconds + 20 * later)), "{number}, {later}");
            }
        }
    }
}
