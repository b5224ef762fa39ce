//! Continuity of a stream of poses: a jump that no robot can make breaks the trust in the stream.
//!
//! Motion capture is not authenticated. Poses that an attacker sends beside the true ones are somewhere
//! else, so the two streams jump to and fro. A pose is trusted when each pose of the last
//! [`STEADY_TIME`] was within reach of the one before it, and of one that is [`ANCHOR_AGE`] old or the
//! next older; the reach in the time `dt` is [`REACH`]` + `[`FASTEST`]` * dt` and [`TURN`]` +
//! `[`FASTEST_TURN`]` * dt`. Two streams therefore contradict each other and neither is trusted, unless
//! they differ by less than the reach: beside a true stream of 100 poses per second a stranger can displace
//! the poses by 4 cm and 0.3 rad for long: the older pose keeps him from creeping away in many small steps. A burst between two
//! true poses can displace them by 10 cm; the next true one then breaks the trust for [`STEADY_TIME`]. A robot
//! that is carried to another place is trusted again [`STEADY_TIME`] after it was put down.

use std::time::Duration;

use flix_protocol::units::Instant;

use super::Pose;
use crate::pose::geometry::wrap;

/// Distance that is always within reach, m: noise and shaking of the body (5 mm), and 0.1 s of walking for
/// poses that waited in a queue and arrive at once.
pub const REACH: f64 = 0.03;
/// Turn that is always within reach, rad: noise, and 0.1 s of turning for poses that waited in a queue.
pub const TURN: f64 = 0.2;
/// Fastest motion of a robot, m/s: some five times the paper's fastest mode, above a gentle push.
pub const FASTEST: f64 = 1.0;
/// Fastest turn of a robot, rad/s: some five times the paper's fastest mode.
pub const FASTEST_TURN: f64 = 10.0;
/// Least age of the older pose that the next one has to be within reach of: the period of 100 poses per second.
pub const ANCHOR_AGE: Duration = Duration::from_millis(10);
/// Time without a jump after which a stream is trusted: 20 poses at 100 Hz, and twice the age at
/// which a pose is too old to steer by.
pub const STEADY_TIME: Duration = Duration::from_millis(200);
/// Longest time between two poses of a stream; a longer one breaks the trust as a jump does, so that a
/// pause does not widen the reach.
pub const LONGEST_GAP: Duration = STEADY_TIME;

/// Judges each pose of a stream by those before it. Takes constant memory; never panics.
#[derive(Debug, Clone, Default)]
pub struct Continuity {
    last: Option<(Instant, Pose)>,
    anchor: Option<(Instant, Pose)>,
    steady_since: Instant,
    jumps: u64,
}

impl Continuity {
    /// Takes the next pose of the stream and returns whether it is trusted.
    pub fn take(&mut self, time: Instant, pose: &Pose) -> bool {
        let is_reachable = |(before, previous): &(Instant, Pose)| {
            is_within_reach(previous, pose, time.since(*before).as_secs_f64())
        };
        let reachable = [&self.last, &self.anchor].into_iter().flatten().all(is_reachable);
        self.jumps += u64::from(!reachable);
        let before = self.last.replace((time, *pose));
        if !reachable || before.is_none_or(|(at, _)| time.since(at) > LONGEST_GAP) {
            self.steady_since = time;
            self.anchor = self.last;
        } else if self.anchor.is_none_or(|(at, _)| time.since(at) >= ANCHOR_AGE) {
            self.anchor = before;
        }
        time.since(self.steady_since) >= STEADY_TIME
    }

    /// Compares a pose that is not taken, as one is known whose picture was taken this much later or earlier: a true one that
    /// is late is within its reach, and one of a second stream is a jump.
    pub fn compare(&mut self, time: Instant, pose: &Pose, apart: Duration) {
        let seconds = apart.as_secs_f64();
        if self.last.is_some_and(|(_, last)| !is_within_reach(&last, pose, seconds)) {
            self.jumps += 1;
            self.steady_since = time;
        }
    }

    /// Returns the number of poses that were out of reach of the pose before them.
    #[must_use]
    pub const fn jumps(&self) -> u64 {
        self.jumps
    }
}

fn is_within_reach(from: &Pose, to: &Pose, seconds: f64) -> bool {
    let [x, y, z] = from.position.coordinates();
    let [to_x, to_y, to_z] = to.position.coordinates();
    let distance = ((to_x - x).powi(2) + (to_y - y).powi(2) + (to_z - z).powi(2)).sqrt();
    let turn = wrap(to.on_the_floor().heading - from.on_the_floor().heading).abs();
    // Jumps between poses that are not finite are not within reach.
    distance <= REACH + FASTEST * seconds && turn <= TURN + FASTEST_TURN * seconds
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::geometry::PlanarPose;

    fn at(milliseconds: u64) -> Instant {
        Instant::from_micros(milliseconds * 1000)
    }

    fn pose(x: f64, heading: f64) -> Pose {
        Pose::planar(PlanarPose { x, y: 0.3, heading }, 0.06)
    }

    /// A stream that stood at x = 0 for a second, 100 poses a second.
    fn steady() -> Continuity {
        let mut continuity = Continuity::default();
        for i in 0..=100 {
            continuity.take(at(i * 10), &pose(0.0, 0.0));
        }
        continuity
    }

    #[test]
    fn a_stream_is_trusted_when_it_was_steady_for_its_time() {
        let mut continuity = Continuity::default();
        let trusted = (0..).find(|i| continuity.take(at(i * 10), &pose(0.0, 0.0)));
        assert_eq!(trusted.map(|i| at(i * 10).since(Instant::START)), Some(STEADY_TIME));
    }

    #[test]
    fn a_robot_that_walks_and_turns_as_fast_as_it_can_stays_trusted() {
        let mut continuity = steady();
        for i in 1..500u32 {
            let t = f64::from(i) * 0.01;
            let shaken = 0.005 * (std::f64::consts::TAU * 31.0 * t).sin();
            let walking = pose(FASTEST * t + shaken, wrap(FASTEST_TURN * t));
            assert!(continuity.take(at(1000 + u64::from(i) * 10), &walking), "after {t} s");
        }
    }

    #[test]
    fn of_two_streams_that_contradict_each_other_neither_is_trusted() {
        for (x, heading) in [(0.1, 0.0), (-2.0, 0.0), (0.0, 0.7)] {
            let mut continuity = steady();
            for i in 1..300 {
                let now = 1000 + i * 10;
                assert!(!continuity.take(at(now), &pose(x, heading)), "the stranger's");
                assert!(!continuity.take(at(now + 5), &pose(0.0, 0.0)), "nor the true one");
            }
        }
    }

    #[test]
    fn the_first_of_two_streams_is_not_believed_either() {
        let mut continuity = Continuity::default();
        for i in 0..300 {
            assert!(!continuity.take(at(i * 10), &pose(1.0, 0.0)));
            assert!(!continuity.take(at(i * 10 + 5), &pose(0.0, 0.0)));
        }
    }

    #[test]
    fn a_robot_that_was_carried_is_trusted_again_where_it_stands() {
        let mut continuity = steady();
        let trusted = (0..).find(|i| continuity.take(at(1010 + i * 10), &pose(0.8, 1.0)));
        assert_eq!(trusted, Some(20));
        assert_eq!(continuity.jumps(), 1);
    }

    #[test]
    fn many_small_steps_lead_no_farther_than_one() {
        let mut continuity = steady();
        let trusted = (1..10_u32).map(|i| (0.02 * f64::from(i), 1000 + u64::from(i)));
        let trusted = trusted.filter(|(x, time)| continuity.take(at(*time), &pose(*x, 0.0)));
        assert_eq!(trusted.map(|(x, _)| x).collect::<Vec<_>>(), [0.02]);
    }

    #[test]
    fn a_pause_does_not_widen_the_reach() {
        let mut continuity = steady();
        assert!(!continuity.take(at(6000), &pose(1.0, 0.0)));
    }
}
