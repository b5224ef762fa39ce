//! Delay of a stream of poses, by the tracker's own clock.
//!
//! A network that queues delivers poses late, in order, and none is lost: only the time at which their pictures were taken shows
//! it. Both clocks differ by an unknown time, and so the delay is known only from its least value: a delay from the very
//! start, or from a step of the tracker's clock on, cannot be seen. The least value creeps up by [`DRIFT`], as clocks drift
//! apart: a stream that stays late by 2 s is believed again after an hour.
//!
//! A stream that goes on with older pictures comes from a tracker whose clock was set back, or over another network that is
//! slower. Up to [`HELD`] it counts as late, for nothing shows which it is.

use std::time::Duration;

use flix_protocol::units::Instant;

use super::order::Arrival;

/// Time in which two clocks drift apart by a second: at 500 ppm, the most by which a system sets its clock slowly.
const DRIFT: u32 = 2000;
/// A later picture that was exposed earlier by more than this is of a recording, or the tracker's clock was set.
const STEP: Duration = Duration::from_millis(100);
/// Longest time for which a network keeps pictures back.
const HELD: Duration = Duration::from_secs(5);

/// Judges how late each pose of a stream comes. Takes constant memory; never panics.
#[derive(Debug, Clone, Default)]
pub(super) struct Delay {
    last: Option<Instant>,
    /// The least difference between both clocks, us, and when it was measured.
    least: Option<(Instant, i128)>,
}

impl Delay {
    /// Takes a pose that came now, of a picture that was taken then on the tracker's clock. Returns by how much later it came
    /// than the fastest one.
    pub(super) fn take(&mut self, now: Instant, exposed: Instant, arrival: Arrival) -> Duration {
        let most = if arrival == Arrival::Anew { HELD } else { STEP };
        let is_set = self.last.is_some_and(|last| last.since(exposed) > most);
        self.last = Some(exposed);
        let delay = i128::from(now.as_micros()) - i128::from(exposed.as_micros());
        let least = self.least.filter(|_| !is_set).map(|(at, least)| {
            let drifted = (now.since(at) / DRIFT).as_micros();
            least.saturating_add_unsigned(drifted)
        });
        match least {
            Some(least) if delay > least => {
                Duration::from_micros(u64::try_from(delay - least).unwrap_or(u64::MAX))
            }
            _ => {
                self.least = Some((now, delay));
                Duration::ZERO
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::LATE;

    fn at(milliseconds: f64) -> Instant {
        Instant::from_micros((milliseconds * 1e3).round() as u64)
    }

    /// The delays of pictures that come and were taken then, ms on each clock.
    fn delays(pictures: impl IntoIterator<Item = (f64, f64)>) -> Vec<Duration> {
        let mut delay = Delay::default();
        pictures
            .into_iter()
            .map(|(now, exposed)| delay.take(at(now), at(exposed), Arrival::Next))
            .collect()
    }

    fn hundredths(seconds: u32) -> impl Iterator<Item = f64> {
        (0..seconds * 100).map(|n| f64::from(n) * 10.0)
    }

    #[test]
    fn what_a_network_keeps_back_is_late() {
        // From 8 s on it keeps back more and more, up to 2 s, for ten minutes.
        let lag = |t: f64| ((t - 8000.0) / 5.0).clamp(0.0, 2000.0);
        let found = delays(hundredths(600).map(|t| (5e6 + t + lag(t), 777.0 + t)));
        assert!(found[..800].iter().all(Duration::is_zero));
        assert!(found[900..].iter().all(|it| *it >= LATE - Duration::from_millis(1)));
        let last = found.last().unwrap().as_secs_f64();
        assert!((1.7..=2.0).contains(&last), "{last} s");
    }

    #[test]
    fn clocks_that_drift_and_coarse_times_are_not_late() {
        for drift in [-100e-6, 0.0, 100e-6] {
            let coarse = |t: f64| (t / 10.0).floor() * 10.0;
            let taken = hundredths(7200).map(|t| (1e6 + t + 5.0, coarse(t * (1.0 + drift) + 3.0)));
            let most = delays(taken).into_iter().max().unwrap();
            assert!(most < LATE / 10, "{most:?}");
        }
    }

    #[test]
    fn it_begins_anew_when_the_clock_is_set() {
        for step in [-1e7, -900.0, -120.0, 900.0, 1e7] {
            let taken = |t: f64| 2e7 + t + if t < 2000.0 { 0.0 } else { step };
            let late = delays(hundredths(10).map(|t| (t, taken(t))));
            assert!(late.iter().all(Duration::is_zero), "{step} ms");
        }
    }

    #[test]
    fn a_stream_that_goes_on_with_older_pictures_is_late_unless_they_are_far_older() {
        for (back, late) in [(300.0, 400.0), (4900.0, 5000.0), (5100.0, 0.0), (1e7, 0.0)] {
            let mut delay = Delay::default();
            delay.take(at(0.0), at(2e7), Arrival::Next);
            let found = delay.take(at(100.0), at(2e7 - back), Arrival::Anew);
            assert_eq!((found.as_secs_f64() * 1e3).round(), late, "{back} ms");
        }
    }

    #[test]
    fn a_queue_that_is_read_at_once_is_late_but_for_its_end() {
        let mut delay = Delay::default();
        delay.take(at(0.0), at(0.0), Arrival::Next);
        let mut take = |t: f64| delay.take(at(2000.0), at(t + 10.0), Arrival::Next);
        let found: Vec<_> = hundredths(2).map(&mut take).collect();
        assert!(found[0] > LATE && found[178] > LATE && found[199].is_zero(), "{found:?}");
    }

    #[test]
    fn no_number_is_too_large() {
        let ends = [Instant::START, Instant::from_micros(u64::MAX)];
        let mut delay = Delay::default();
        for now in ends {
            for exposed in ends {
                delay.take(now, exposed, Arrival::Next);
                delay.take(now, exposed, Arrival::Anew);
            }
        }
        assert_eq!(delay.take(ends[1], ends[1], Arrival::Next), Duration::ZERO);
    }
}
