//! Lets each counter through once.

/// How far behind the newest counter a datagram may come and still be told from a replay.
pub const REPLAY_WINDOW: u64 = 128;

/// Which of the newest [`REPLAY_WINDOW`] counters were seen (RFC 6479's idea, in one integer).
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
    /// Nothing seen yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { next: 0, seen: 0, accepted: 0 }
    }

    /// Whether this counter is new. Call before spending time on the datagram.
    #[must_use]
    pub const fn is_new(&self, counter: u64) -> bool {
        if counter >= self.next {
            return counter != u64::MAX;
        }
        let age = self.next - 1 - counter;
        age < REPLAY_WINDOW && self.seen >> age & 1 == 0
    }

    /// Remembers this counter; call once the datagram is known to be authentic. Returns whether it
    /// was new; changes nothing when not.
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

    /// How many counters up to the newest were never seen: lost, or still on the way.
    #[must_use]
    pub const fn missing(&self) -> u64 {
        self.next - self.accepted
    }

    /// How many different counters were seen.
    #[must_use]
    pub const fn accepted(&self) -> u64 {
        self.accepted
    }

    /// The newest counter seen.
    #[must_use]
    pub const fn newest(&self) -> Option<u64> {
        self.next.checked_sub(1)
    }
}
