//! Accepts each counter once.

/// Largest distance behind the newest counter at which a datagram is distinguished from a replay.
pub const REPLAY_WINDOW: u64 = 128;

/// The set of the newest [`REPLAY_WINDOW`] counters that were seen (the idea of RFC 6479, in one
/// integer).
///
/// Counters run from 0 to `u64::MAX - 1`; `u64::MAX` is always refused, so that the window never
/// wraps. Never panics.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ReplayWindow {
    /// One more than the newest counter seen; 0 before the first.
    next: u64,
    /// Bit `i`: counter `next - 1 - i` was seen.
    seen: u128,
    /// How many different counters were seen.
    accepted: u64,
}

impl ReplayWindow {
    /// Creates a window that has seen no counter.
    #[must_use]
    pub const fn new() -> Self {
        Self { next: 0, seen: 0, accepted: 0 }
    }

    /// Returns whether this counter is new. Cheap: call it before the datagram is decrypted.
    #[must_use]
    pub const fn is_new(&self, counter: u64) -> bool {
        if counter >= self.next {
            return counter != u64::MAX;
        }
        let age = self.next - 1 - counter;
        age < REPLAY_WINDOW && self.seen >> age & 1 == 0
    }

    /// Records this counter, once the datagram is known to be authentic. Returns whether it was
    /// new; changes nothing when it was not.
    pub const fn accept(&mut self, counter: u64) -> bool {
        if !self.is_new(counter) {
            return false;
        }
        if counter >= self.next {
            let advance = counter - self.next + 1;
            self.seen = if advance < REPLAY_WINDOW { self.seen << advance } else { 0 };
            self.next = counter + 1;
        }
        self.seen |= 1 << (self.next - 1 - counter);
        self.accepted += 1;
        true
    }

    /// Returns how many counters up to the newest were not seen: lost, or still under way.
    #[must_use]
    pub const fn missing(&self) -> u64 {
        self.next - self.accepted
    }

    /// Returns how many different counters were seen.
    #[must_use]
    pub const fn accepted(&self) -> u64 {
        self.accepted
    }

    /// Returns the newest counter seen.
    #[must_use]
    pub const fn newest(&self) -> Option<u64> {
        self.next.checked_sub(1)
    }
}
