//! Whether a robot that is driven by its poses stands on its feet.
//!
//! A robot that somebody carries, or that has fallen, still obeys: its rotors turn beside a hand. Poses show it, so whoever
//! steers by them stops it. A tracker in the plane states neither tilt nor height, and shows nothing.

use std::time::Duration;

use flix_protocol::units::Instant;

use super::EndReason;
use crate::pose::{MOST_TILT, PoseSample};

/// Rise above the first pose from which a robot is carried, m: a jump of the markers of a walking robot is below 0.01 m.
const CARRIED: f64 = 0.05;
/// Time for which it must be so: longer than a few poses of swapped markers.
const LASTS: Duration = Duration::from_millis(100);

/// Watches the poses of a run.
#[derive(Debug, Clone, Default)]
pub struct Footing {
    /// Height of the first pose, m.
    ground: Option<f64>,
    /// Since when every pose shows a robot that is off its feet.
    off_since: Option<Instant>,
}

impl Footing {
    /// Takes a pose; returns why the robot has to stop, once it has been off its feet for 0.1 s.
    pub fn observe(&mut self, sample: &PoseSample) -> Option<EndReason> {
        if !sample.valid || !sample.pose.is_sound() {
            return None;
        }
        let (tilt, height) = (sample.pose.tilt(), sample.pose.position.z);
        let rise = height - *self.ground.get_or_insert(height);
        let stop = if tilt > MOST_TILT {
            EndReason::Tilted { degrees: tilt.to_degrees() }
        } else if rise > CARRIED {
            EndReason::Lifted { rise }
        } else {
            self.off_since = None;
            return None;
        };
        let since = *self.off_since.get_or_insert(sample.time);
        (sample.time.since(since) >= LASTS).then_some(stop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nav::PlanarPose;
    use crate::pose::Pose;

    fn sample(milliseconds: u64, height: f64, roll: f64) -> PoseSample {
        let mut pose = Pose::planar(PlanarPose::default(), height);
        let (sin, cos) = (roll / 2.0).sin_cos();
        (pose.orientation.x, pose.orientation.w) = (sin, cos);
        let time = Instant::from_micros(1_000 * milliseconds);
        PoseSample { time, pose, valid: true, picture: None }
    }

    /// What a second of poses after one on the floor leads to.
    fn after(height: f64, roll: f64) -> Option<EndReason> {
        let mut footing = Footing::default();
        assert_eq!(footing.observe(&sample(0, 0.06, 0.0)), None);
        (1..100).find_map(|number| footing.observe(&sample(10 * number, height, roll)))
    }

    #[test]
    fn a_robot_that_is_carried_or_lies_on_its_side_or_back_stops() {
        assert!(matches!(after(0.12, 0.0), Some(EndReason::Lifted { .. })));
        for roll in [1.1, -1.6, std::f64::consts::PI] {
            assert!(matches!(after(0.06, roll), Some(EndReason::Tilted { .. })), "{roll}");
        }
        assert_eq!((after(0.1, 0.0), after(0.02, 0.9)), (None, None), "it rocks and walks");
    }

    #[test]
    fn a_few_poses_of_swapped_markers_stop_nothing() {
        let mut footing = Footing::default();
        for number in 0..100 {
            let roll = if number % 10 < 9 { 3.0 } else { 0.0 };
            assert_eq!(footing.observe(&sample(10 * number, 0.06, roll)), None, "{number}");
        }
        let mut unseen = sample(2_000, 0.06, 3.0);
        unseen.valid = false;
        for _ in 0..100 {
            unseen.time = unseen.time + LASTS;
            assert_eq!(footing.observe(&unseen), None);
        }
    }

    #[test]
    fn it_stops_after_a_tenth_of_a_second_and_not_before() {
        let mut footing = Footing::default();
        let stops = (0..).find(|ms| footing.observe(&sample(*ms, 0.06, 2.0)).is_some());
        assert_eq!(stops, Some(100));
    }
}
