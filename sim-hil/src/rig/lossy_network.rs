//! A network that carries datagrams one way, in virtual time: late, out of order, twice, damaged, or not at all.
//!
//! Each datagram is delayed by `delay` and by up to `jitter` more, each on its own, so that a later one can
//! arrive earlier. All chance comes from a seed.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::time::Duration;

use flix_protocol::units::Instant;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

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
    /// Share of datagrams that arrive [`HELD_BACK`] later, behind those sent after them, 0 to 1.
    pub reordering: f64,
    /// Share of datagrams that arrive with one bit flipped, 0 to 1.
    pub corruption: f64,
    /// Times in which nothing arrives.
    pub bursts: Option<Bursts>,
    /// When what is due is let through.
    pub release: Release,
    /// Datagrams longer than this never arrive, bytes.
    pub longest: usize,
}

/// When a network lets datagrams through that are due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Release {
    /// At once.
    AtOnce,
    /// All from this time on, none before.
    From(Instant),
    /// One each time that so much has passed since the last one.
    OneEvery(Duration),
}

/// How much later a datagram arrives that others overtake: three at 50 Hz.
pub const HELD_BACK: Duration = Duration::from_millis(60);

/// Bursts in which all is lost. Each burst and each gap is from half to one and a half of its mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bursts {
    /// Mean length of a burst.
    pub length: Duration,
    /// Mean time between two bursts.
    pub gap: Duration,
}

impl ChannelParameters {
    /// Arrives at once, all of it.
    pub const PERFECT: Self = Self {
        delay: Duration::ZERO,
        jitter: Duration::ZERO,
        loss: 0.0,
        duplication: 0.0,
        reordering: 0.0,
        corruption: 0.0,
        bursts: None,
        release: Release::AtOnce,
        longest: usize::MAX,
    };

    /// Nothing arrives.
    pub const CUT: Self = Self { loss: 1.0, ..Self::PERFECT };

    /// A quiet Wi-Fi network in one room. Assumed: 1 to 4 ms each way, 1 % lost after the radio's own
    /// repetitions.
    pub const QUIET_WIFI: Self = Self {
        delay: Duration::from_millis(1),
        jitter: Duration::from_millis(3),
        loss: 0.01,
        ..Self::PERFECT
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
    taken: u64,
    /// When the last datagram was let through.
    released: Instant,
    /// Whether a burst is on, and until when that stays so.
    burst: (bool, Instant),
}

impl Channel {
    /// Creates a channel with nothing under way.
    #[must_use]
    pub fn new(parameters: ChannelParameters, seed: u64) -> Self {
        Self {
            parameters,
            random: Xoshiro256PlusPlus::seed_from_u64(seed),
            under_way: BinaryHeap::new(),
            sent: 0,
            taken: 0,
            released: Instant::START,
            burst: (true, Instant::START),
        }
    }

    /// Takes a datagram at one end.
    pub fn send(&mut self, now: Instant, datagram: &[u8]) {
        self.taken += 1;
        let is_lost = self.random.random::<f64>() < self.parameters.loss || self.is_in_burst(now);
        if is_lost || datagram.len() > self.parameters.longest {
            return;
        }
        self.deliver(now, datagram);
        if self.random.random::<f64>() < self.parameters.duplication {
            self.deliver(now, datagram);
        }
    }

    /// Returns how many datagrams it took, those among them that never arrive.
    #[must_use]
    pub fn taken(&self) -> u64 {
        self.taken
    }

    fn deliver(&mut self, now: Instant, datagram: &[u8]) {
        let mut wait =
            self.parameters.delay + self.parameters.jitter.mul_f64(self.random.random::<f64>());
        if self.happens(self.parameters.reordering) {
            wait += HELD_BACK;
        }
        let mut datagram = datagram.to_vec();
        if self.happens(self.parameters.corruption) {
            let bit = (self.random.random::<f64>() * (8 * datagram.len()) as f64) as usize;
            if let Some(byte) = datagram.get_mut(bit / 8) {
                *byte ^= 1 << (bit % 8);
            }
        }
        self.under_way.push(Reverse((now + wait, self.sent, datagram)));
        self.sent += 1;
    }

    /// Asks chance only where there is one, so that a trouble that is absent changes no other.
    fn happens(&mut self, share: f64) -> bool {
        share > 0.0 && self.random.random::<f64>() < share
    }

    fn is_in_burst(&mut self, now: Instant) -> bool {
        let Some(bursts) = self.parameters.bursts else { return false };
        while self.burst.1 <= now {
            let is_on = !self.burst.0;
            let mean = if is_on { bursts.length } else { bursts.gap };
            let start = if self.burst.1 == Instant::START { now } else { self.burst.1 };
            self.burst = (is_on, start + mean.mul_f64(0.5 + self.random.random::<f64>()));
        }
        self.burst.0
    }

    /// Returns the next datagram that has arrived at the other end by now.
    pub fn receive(&mut self, now: Instant) -> Option<Vec<u8>> {
        let Reverse((due, _, _)) = self.under_way.peek()?;
        let is_let_through = match self.parameters.release {
            Release::AtOnce => true,
            Release::From(time) => now >= time,
            Release::OneEvery(interval) => now.since(self.released) >= interval,
        };
        if *due > now || !is_let_through {
            return None;
        }
        self.released = now;
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
    fn bursts_lose_all_for_their_length_and_nothing_between() {
        let bursts = Bursts { length: Duration::from_millis(20), gap: Duration::from_millis(40) };
        let parameters = ChannelParameters { bursts: Some(bursts), ..ChannelParameters::PERFECT };
        let arrived = arrivals(parameters, 5);
        let gaps: Vec<u64> = arrived
            .windows(2)
            .map(|pair| pair[1].0 - pair[0].0 - 1)
            .filter(|lost| *lost > 0)
            .collect();
        assert!(gaps.len() >= 2 && gaps.iter().all(|lost| (9..=31).contains(lost)), "{gaps:?}");
    }

    #[test]
    fn a_datagram_held_back_is_overtaken_by_those_of_60_ms() {
        let parameters = ChannelParameters { reordering: 0.2, ..ChannelParameters::PERFECT };
        let late: Vec<u64> =
            arrivals(parameters, 6).iter().map(|(at, sent)| at - u64::from(*sent)).collect();
        assert!(late.iter().all(|late| *late == 0 || *late == 60));
        assert!((20..60).contains(&late.iter().filter(|late| **late > 0).count()));
    }

    #[test]
    fn what_is_kept_is_released_from_a_time_on_or_one_by_one_in_its_order() {
        let release = |release| ChannelParameters { release, ..ChannelParameters::PERFECT };
        let burst = arrivals(release(Release::From(Instant::from_micros(500_000))), 8);
        let expected: Vec<_> = (0..200).map(|sent| (500, sent)).collect();
        assert_eq!(burst, expected);
        let trickle = arrivals(release(Release::OneEvery(Duration::from_millis(90))), 8);
        let expected: Vec<_> = (0..11).map(|sent| (90 * (sent + 1), sent as u8)).collect();
        assert_eq!(trickle, expected);
    }

    #[test]
    fn a_damaged_datagram_differs_in_one_bit() {
        let parameters = ChannelParameters { corruption: 1.0, ..ChannelParameters::PERFECT };
        let mut channel = Channel::new(parameters, 7);
        let sent = [0x5a; 40];
        channel.send(Instant::START, &sent);
        let arrived = channel.receive(Instant::START).unwrap();
        let flipped: u32 =
            arrived.iter().zip(sent).map(|(arrived, sent)| (arrived ^ sent).count_ones()).sum();
        assert_eq!((arrived.len(), flipped), (40, 1));
    }

    #[test]
    fn the_same_seed_treats_datagrams_the_same() {
        let of =
            |seed| arrivals(ChannelParameters { loss: 0.5, ..ChannelParameters::QUIET_WIFI }, seed);
        assert!(of(4) == of(4) && of(4) != of(5));
    }
}
