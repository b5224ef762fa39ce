//! Round trips and losses of a link.

use std::collections::VecDeque;
use std::time::Duration;

use flix_protocol::units::Instant;

use super::ANSWER_TIME;

/// Number of round trips stored: over a minute at the rate of the keep-alive.
const REMEMBERED: usize = 4096;

/// Statistics of a link, as its operator sees it.
///
/// A command is counted once it is [`ANSWER_TIME`] old, answered or not, so that the counts are of
/// the same commands.
#[derive(Debug, Clone, Default)]
pub struct Statistics {
    recent: VecDeque<Sent>,
    round_trips: VecDeque<Duration>,
    /// Of the commands that are counted.
    counted: VecDeque<Duration>,
    answered: u64,
    unanswered: u64,
}

#[derive(Debug, Clone)]
struct Sent {
    number: u32,
    at: Instant,
    round_trip: Option<Duration>,
}

impl Statistics {
    /// Records a command that was sent for the first time.
    pub(super) fn sent(&mut self, number: u32, at: Instant) {
        self.recent.push_back(Sent { number, at, round_trip: None });
    }

    /// Records a repeated command: its reply says nothing about time or loss.
    pub(super) fn repeated(&mut self, number: u32) {
        self.recent.retain(|sent| sent.number != number);
    }

    /// Records a reply.
    pub(super) fn replied(&mut self, number: u32, now: Instant) {
        let Some(sent) = self.recent.iter_mut().find(|sent| sent.number == number) else { return };
        if sent.round_trip.is_none() {
            let round_trip = now.since(sent.at);
            sent.round_trip = Some(round_trip);
            remember(&mut self.round_trips, round_trip);
        }
    }

    /// Counts the commands that are old enough.
    pub(super) fn expire(&mut self, now: Instant) {
        while self.recent.front().is_some_and(|sent| now.since(sent.at) >= ANSWER_TIME) {
            self.count_oldest();
        }
    }

    /// Counts all commands, because another session begins and no more replies can arrive.
    pub(super) fn abandon(&mut self) {
        while !self.recent.is_empty() {
            self.count_oldest();
        }
    }

    fn count_oldest(&mut self) {
        match self.recent.pop_front() {
            Some(Sent { round_trip: Some(round_trip), .. }) => {
                self.answered += 1;
                remember(&mut self.counted, round_trip);
            }
            Some(_) => self.unanswered += 1,
            None => {}
        }
    }

    /// Returns the number of commands with a reply within [`ANSWER_TIME`].
    #[must_use]
    pub const fn answered(&self) -> u64 {
        self.answered
    }

    /// Returns the number of commands without a reply within [`ANSWER_TIME`].
    #[must_use]
    pub const fn unanswered(&self) -> u64 {
        self.unanswered
    }

    /// Returns the share of commands without a reply, from 0 to 1.
    #[must_use]
    pub fn loss(&self) -> f64 {
        let sent = self.answered + self.unanswered;
        if sent == 0 { 0.0 } else { self.unanswered as f64 / sent as f64 }
    }

    /// Returns the newest round trip.
    #[must_use]
    pub fn last_round_trip(&self) -> Option<Duration> {
        self.round_trips.back().copied()
    }

    /// Returns the shortest of the stored round trips: what is left of it without waiting anywhere.
    #[must_use]
    pub(crate) fn shortest_round_trip(&self) -> Option<Duration> {
        self.round_trips.iter().min().copied()
    }

    /// Returns the round trip that this share (0 to 1) of the stored ones does not exceed.
    #[must_use]
    pub fn round_trip_quantile(&self, share: f64) -> Option<Duration> {
        quantile(self.round_trips.iter().copied().collect(), share)
    }

    /// Returns the round trip that this share (0 to 1) of the commands that [`Statistics::answered`] counts does not exceed.
    #[must_use]
    pub fn counted_quantile(&self, share: f64) -> Option<Duration> {
        quantile(self.counted.iter().copied().collect(), share)
    }
}

fn remember(round_trips: &mut VecDeque<Duration>, newest: Duration) {
    if round_trips.len() == REMEMBERED {
        round_trips.pop_front();
    }
    round_trips.push_back(newest);
}

/// Returns the nearest-rank quantile; `None` without values.
#[must_use]
pub fn quantile(mut values: Vec<Duration>, share: f64) -> Option<Duration> {
    let last = values.len().checked_sub(1)?;
    values.sort_unstable();
    let rank = (share.clamp(0.0, 1.0) * values.len() as f64).ceil() as usize;
    Some(values[rank.saturating_sub(1).min(last)])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(milliseconds: u64) -> Instant {
        Instant::from_micros(milliseconds * 1000)
    }

    #[test]
    fn quantiles_are_nearest_ranks() {
        let values = |count: u64| (1..=count).rev().map(Duration::from_millis).collect::<Vec<_>>();
        assert_eq!(quantile(values(100), 0.5), Some(Duration::from_millis(50)));
        assert_eq!(quantile(values(100), 0.99), Some(Duration::from_millis(99)));
        assert_eq!(quantile(values(100), 1.0), Some(Duration::from_millis(100)));
        assert_eq!(quantile(values(1), 0.0), Some(Duration::from_millis(1)));
        assert_eq!(quantile(Vec::new(), 0.5), None);
    }

    #[test]
    fn a_repeated_command_is_not_timed() {
        let mut statistics = Statistics::default();
        statistics.sent(1, at(0));
        statistics.repeated(1);
        statistics.replied(1, at(500));
        assert_eq!(statistics.last_round_trip(), None);
    }

    #[test]
    fn one_of_four_without_a_reply_is_a_loss_of_a_quarter() {
        let mut statistics = Statistics::default();
        for number in 0..4 {
            statistics.sent(number, at(u64::from(number)));
        }
        for number in [0, 1, 3] {
            statistics.replied(number, at(10));
        }
        statistics.expire(at(2000));
        assert!((statistics.loss() - 0.25).abs() < 1e-12);
    }

    #[test]
    fn memory_is_bounded_on_a_link_that_runs_for_days() {
        let mut statistics = Statistics::default();
        for number in 0..100_000 {
            statistics.sent(number, at(u64::from(number)));
            statistics.expire(at(u64::from(number)));
            if number % 3 == 0 {
                statistics.replied(number, at(u64::from(number)));
            }
        }
        assert!(statistics.recent.len() < 2000 && statistics.round_trips.len() <= REMEMBERED);
    }
}
