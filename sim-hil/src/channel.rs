//! A network that carries datagrams one way, in virtual time: late, out of order, twice, or not at all.
//!
//! Each datagram is delayed by `delay` and by up to `jitter` more, each on its own, so that a later one can
//! arrive earlier. All chance comes from a seed.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::time::Duration;

use flix_protocol::units::Instant;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::plant::sensor::unit;

/// How a network treats datagrams.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChannelParameters {
    /// Shortest time from end to end.
    pub delay: Duration,
    /// Up to so much more, evenly.
    pub jitter: Duration,
    /// Share of datagrams that never arrive, 0 to 1.
    pub loss: f64,
    /// Share of datagrams that arrive twice, 0 to 1.
    pub duplication: f64,
}

impl ChannelParameters {
    /// Arrives at once, all of it.
    pub const PERFECT: Self =
        Self { delay: Duration::ZERO, jitter: Duration::ZERO, loss: 0.0, duplication: 0.0 };

    /// A quiet Wi-Fi network in one room. Assumed: 1 to 4 ms each way, 1 % lost after the radio's own
    /// repetitions.
    pub const QUIET_WIFI: Self = Self {
        delay: Duration::from_millis(1),
        jitter: Duration::from_millis(3),
        loss: 0.01,
        duplication: 0.0,
    };
}

/// Datagrams under way in one direction.
#[derive(Debug, Clone)]
pub struct Channel {
    /// From now on.
    pub parameters: ChannelParameters,
    random: Xoshiro256PlusPlus,
    /// Earliest first; datagrams due at one moment in the order in which they were sent.
    under_way: BinaryHeap<Reverse<(Instant, u64, Vec<u8>)>>,
    sent: u64,
}

impl Channel {
    /// Nothing under way.
    #[must_use]
    pub fn new(parameters: ChannelParameters, seed: u64) -> Self {
        Self {
            parameters,
            random: Xoshiro256PlusPlus::seed_from_u64(seed),
            under_way: BinaryHeap::new(),
            sent: 0,
        }
    }

    /// Takes a datagram at one end.
    pub fn send(&mut self, now: Instant, datagram: &[u8]) {
        if unit(&mut self.random) < self.parameters.loss {
            return;
        }
        self.deliver(now, datagram);
        if unit(&mut self.random) < self.parameters.duplication {
            self.deliver(now, datagram);
        }
    }

    fn deliver(&mut self, now: Instant, datagram: &[u8]) {
        let wait = self.parameters.delay + self.parameters.jitter.mul_f64(unit(&mut self.random));
        self.under_way.push(Reverse((now + wait, self.sent, datagram.to_vec())));
        self.sent += 1;
    }

    /// The next datagram that has arrived at the other end by now.
    pub fn receive(&mut self, now: Instant) -> Option<Vec<u8>> {
        let Reverse((due, _, _)) = self.under_way.peek()?;
        if *due > now {
            return None;
        }
        self.under_way.pop().map(|Reverse((_, _, datagram))| datagram)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arrivals(parameters: ChannelParameters, seed: u64) -> Vec<(u64, u8)> {
        let mut channel = Channel::new(parameters, seed);
        let mut arrived = Vec::new();
        for millisecond in 0..1_000_u64 {
            let now = Instant::from_micros(millisecond * 1000);
            if millisecond < 200 {
                channel.send(now, &[millisecond as u8]);
            }
            while let Some(datagram) = channel.receive(now) {
                arrived.push((millisecond, datagram[0]));
            }
        }
        arrived
    }

    #[test]
    fn a_perfect_channel_delivers_all_at_once_and_in_order() {
        let expected: Vec<_> = (0..200).map(|sent| (sent, sent as u8)).collect();
        assert_eq!(arrivals(ChannelParameters::PERFECT, 1), expected);
    }

    #[test]
    fn every_datagram_arrives_within_delay_and_jitter() {
        let parameters = ChannelParameters {
            delay: Duration::from_millis(20),
            jitter: Duration::from_millis(30),
            ..ChannelParameters::PERFECT
        };
        let late: Vec<u64> =
            arrivals(parameters, 2).iter().map(|(at, sent)| at - u64::from(*sent)).collect();
        assert!(late.len() == 200 && late.iter().all(|late| (20..=50).contains(late)));
    }

    #[test]
    fn jitter_reorders_and_a_share_is_lost_or_doubled() {
        let parameters = ChannelParameters {
            jitter: Duration::from_millis(30),
            loss: 0.2,
            duplication: 0.5,
            ..ChannelParameters::PERFECT
        };
        let arrived = arrivals(parameters, 3);
        let mut distinct: Vec<u8> = arrived.iter().map(|(_, sent)| *sent).collect();
        let is_reordered = !distinct.is_sorted();
        distinct.sort_unstable();
        distinct.dedup();
        assert!(is_reordered && (140..180).contains(&distinct.len()));
        assert!(arrived.len() > distinct.len() + 50);
    }

    #[test]
    fn the_same_seed_treats_datagrams_the_same() {
        let of =
            |seed| arrivals(ChannelParameters { loss: 0.5, ..ChannelParameters::QUIET_WIFI }, seed);
        assert!(of(4) == of(4) && of(4) != of(5));
    }
}
