//! How often poses come.

use std::collections::VecDeque;
use std::time::Duration;

use flix_protocol::units::Instant;

/// Fewest poses a second by which a robot walks: at 0.1 m/s, 10 mm from one to the next.
pub const FEWEST: f64 = 10.0;
/// Poses a second from which more make a run no better.
pub const PLENTY: f64 = 50.0;
/// Excess of a period over that of [`FEWEST`] which is noise of its measurement.
const NOISE: f64 = 1.05;
/// Newest poses that are looked at.
const KEPT: usize = 16;
/// Fewest that tell the rate.
const TELLING: usize = 6;

/// Rate of a stream of poses.
#[derive(Debug, Clone, Default)]
pub struct PoseRate {
    times: VecDeque<Instant>,
}

impl PoseRate {
    /// Takes the time of a pose, trusted or not.
    pub fn observe(&mut self, time: Instant) {
        if self.times.len() == KEPT {
            self.times.pop_front();
        }
        self.times.push_back(time);
    }

    /// Returns the mean time from one pose to the next without the longest pause, in which poses may have been lost; `None` of too
    /// few poses.
    #[must_use]
    pub fn period(&self) -> Option<Duration> {
        let count = self.times.len();
        let (first, last) = self.times.front().zip(self.times.back())?;
        if count < TELLING {
            return None;
        }
        let gaps = self.times.iter().zip(self.times.iter().skip(1));
        let longest = gaps.map(|(one, next)| next.since(*one)).max().unwrap_or_default();
        Some((last.since(*first) - longest) / (count as u32 - 2))
    }

    /// Returns the poses a second; `None` of too few poses.
    #[must_use]
    pub fn rate(&self) -> Option<f64> {
        self.period().map(|period| 1.0 / period.as_secs_f64())
    }
}

/// Returns the cost of so few poses a second; `None` where they are enough.
#[must_use]
pub fn cost(rate: f64) -> Option<String> {
    (rate * NOISE < PLENTY).then(|| {
        format!(
            "{rate:.0} poses a second: the robot turns into its path up to {:.0} ms later than with {PLENTY:.0} or more",
            1e3 / rate
        )
    })
}

/// Returns the age beyond which a pose is too old to walk by: this one, or 2.5 periods of slow poses.
#[must_use]
pub fn deadline(least: Duration, period: Duration) -> Duration {
    least.max(period * 5 / 2)
}

/// Returns whether this many poses a second are too few to walk by.
#[must_use]
pub fn is_too_low(rate: f64) -> bool {
    rate * NOISE < FEWEST
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rate(ms: impl IntoIterator<Item = u64>) -> Option<f64> {
        let mut rate = PoseRate::default();
        ms.into_iter().for_each(|ms| rate.observe(Instant::from_micros(1_000 * ms)));
        rate.rate()
    }

    #[test]
    fn a_rate_is_told_from_six_poses_and_a_pause_does_not_change_the_rate() {
        assert_eq!(rate((0..5).map(|n| 100 * n)), None);
        assert_eq!(rate((0..6).map(|n| 100 * n)), Some(10.0));
        let paused = (0..40).map(|n| 20 * n + if n > 30 { 3_000 } else { 0 });
        assert!((rate(paused).unwrap() - 50.0).abs() < 1e-9);
        // Three at once, as a network that queues delivers 100 a second.
        let bursts = rate((0..60).map(|n| n / 3 * 30)).unwrap();
        assert!((70.0..140.0).contains(&bursts), "{bursts}");
    }

    #[test]
    fn fewer_than_ten_poses_a_second_are_too_few() {
        assert!(is_too_low(9.0) && is_too_low(9.4));
        assert!(!is_too_low(9.6) && !is_too_low(10.0));
    }
}
