//! Round trips and losses of a link.

use std::collections::VecDeque;
use std::time::Duration;

use flix_protocol::message::LinkQuality;
use flix_protocol::session::LinkHealth;
use flix_protocol::units::Instant;

use super::ANSWER_TIME;

/// Number of round trips stored: over a minute at the rate of the keep-alive.
const REMEMBERED: usize = 4096;

/// Statistics of a link, as its operator sees it.
///
/// The time of an order is from its sending to the telemetry that states it, less the time for which the robot had held it. An
/// order counts as lost where the order, or the robot's next datagram, does not arrive: each end counts the gaps in the other's
/// counters. Orders are counted once they are [`ANSWER_TIME`] old.
#[derive(Debug, Clone, Default)]
pub struct Statistics {
    recent: VecDeque<Sent>,
    round_trips: VecDeque<Duration>,
    /// Of the orders that are counted.
    counted: VecDeque<Duration>,
    orders: u64,
    /// To the robot, from the robot: of sessions that are over, and of the present one.
    ended: [Tally; 2],
    present: [Tally; 2],
}

#[derive(Debug, Clone)]
struct Sent {
    number: u64,
    at: Instant,
    round_trip: Option<Duration>,
}

/// Datagrams of one direction.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    sent: u64,
    lost: u64,
}

impl Statistics {
    /// Records an order that was sent as the datagram of this number.
    pub(super) fn sent(&mut self, number: u64, at: Instant) {
        self.recent.push_back(Sent { number, at, round_trip: None });
    }

    /// Records that telemetry states this order, which the robot had held for so long.
    pub(super) fn heard(&mut self, number: u64, now: Instant, held: Duration) {
        let Some(sent) = self.recent.iter_mut().find(|sent| sent.number == number) else { return };
        if sent.round_trip.is_none() {
            let round_trip = now.since(sent.at).saturating_sub(held);
            sent.round_trip = Some(round_trip);
            remember(&mut self.round_trips, round_trip);
        }
    }

    /// Counts the datagrams of this session that each end misses; `heard`: number of the newest order that the robot
    /// has looked at.
    pub(super) fn count(&mut self, robot: &LinkQuality, heard: u64, operator: &LinkHealth) {
        self.present = [
            Tally { sent: heard, lost: robot.lost.into() },
            Tally { sent: operator.accepted + operator.lost, lost: operator.lost },
        ];
    }

    /// Counts the orders that are old enough.
    pub(super) fn expire(&mut self, now: Instant) {
        while self.recent.front().is_some_and(|sent| now.since(sent.at) >= ANSWER_TIME) {
            self.count_oldest();
        }
    }

    /// Counts all orders, because another session begins.
    pub(super) fn abandon(&mut self) {
        while !self.recent.is_empty() {
            self.count_oldest();
        }
        self.ended = self.tallies();
        self.present = Default::default();
    }

    fn count_oldest(&mut self) {
        if let Some(sent) = self.recent.pop_front() {
            self.orders += 1;
            sent.round_trip.into_iter().for_each(|trip| remember(&mut self.counted, trip));
        }
    }

    fn tallies(&self) -> [Tally; 2] {
        let mut tallies = self.ended;
        for (tally, present) in tallies.iter_mut().zip(self.present) {
            tally.sent += present.sent;
            tally.lost += present.lost;
        }
        tallies
    }

    /// Returns the number of orders that are counted.
    #[must_use]
    pub const fn orders(&self) -> u64 {
        self.orders
    }

    /// Returns the number of orders that are counted and not lost.
    #[must_use]
    pub fn answered(&self) -> u64 {
        (self.orders as f64 * (1.0 - self.loss())).round() as u64
    }

    /// Returns the share of orders that are lost on the way or whose answer is, from 0 to 1.
    #[must_use]
    pub fn loss(&self) -> f64 {
        let arrives = |tally: Tally| match tally.sent {
            0 => 1.0,
            sent => 1.0 - (tally.lost as f64 / sent as f64).min(1.0),
        };
        let [to, from] = self.tallies().map(arrives);
        1.0 - to * from
    }

    /// Returns the newest round trip.
    #[must_use]
    pub fn last_round_trip(&self) -> Option<Duration> {
        self.round_trips.back().copied()
    }

    /// Returns the shortest of the stored round trips: the one with the least waiting.
    #[must_use]
    pub(crate) fn shortest_round_trip(&self) -> Option<Duration> {
        self.round_trips.iter().min().copied()
    }

    /// Returns the round trip that this share (0 to 1) of the stored ones does not exceed.
    #[must_use]
    pub fn round_trip_quantile(&self, share: f64) -> Option<Duration> {
        quantile(self.round_trips.iter().copied().collect(), share)
    }

    /// Returns the round trip that this share (0 to 1) of the orders that [`Statistics::orders`] counts does not exceed.
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

    fn quality(lost: u32) -> LinkQuality {
        LinkQuality { lost, ..LinkQuality::default() }
    }

    #[test]
    fn the_time_that_the_robot_holds_an_order_is_none_of_the_round_trip() {
        let mut statistics = Statistics::default();
        statistics.sent(1, at(0));
        statistics.heard(1, at(30), Duration::from_millis(12));
        // Stated again by the next telemetry.
        statistics.heard(1, at(50), Duration::from_millis(32));
        assert_eq!(statistics.last_round_trip(), Some(Duration::from_millis(18)));
    }

    #[test]
    fn a_loss_of_a_tenth_to_the_robot_and_a_fifth_back_is_one_of_28_percent_in_all_sessions() {
        let mut statistics = Statistics::default();
        let health = LinkHealth { accepted: 80, lost: 20, ..LinkHealth::default() };
        for session in 0..2 {
            (1..=100).for_each(|number| statistics.sent(number, at(20 * number)));
            statistics.count(&quality(10), 100, &health);
            assert!((statistics.loss() - 0.28).abs() < 1e-12, "{session}");
            statistics.abandon();
        }
        assert_eq!((statistics.orders(), statistics.answered()), (200, 144));
    }

    #[test]
    fn memory_is_bounded_on_a_link_that_runs_for_days() {
        let mut statistics = Statistics::default();
        for number in 0..100_000 {
            statistics.sent(number, at(number));
            statistics.expire(at(number));
            if number % 3 == 0 {
                statistics.heard(number, at(number), Duration::ZERO);
            }
        }
        assert!(statistics.recent.len() < 2000 && statistics.round_trips.len() <= REMEMBERED);
    }
}
