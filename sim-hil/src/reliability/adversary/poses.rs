//! Poses that somebody forges in the name of the motion capture, beside the true ones of a walking robot.
//!
//! He may send them at any time and as densely as he likes, and knows what was taken last: he jumps, stays near, or
//! creeps away from the truth as fast as the continuity check lets him.

use std::time::Duration;

use flix_host::nav::PlanarPose;
use flix_host::pose::Pose;
use flix_host::pose::continuity::{Continuity, FASTEST, REACH};
use flix_protocol::units::Instant;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::findings::Findings;
use super::kind::Kind;

/// From one true pose to the next.
const PERIOD: Duration = Duration::from_millis(10);
/// Most poses that are forged in a period.
const DENSEST: u32 = 20;
/// Radius of the circle on which the robot walks, m, and its speed there, m/s.
const RADIUS: f64 = 0.5;
const SPEED: f64 = 0.1;
/// Height of the markers, m.
const HEIGHT: f64 = 0.06;
/// Share of the reach that the forger uses.
const CAREFUL: f64 = 0.99;

/// What the forger does for a while.
#[derive(Debug, Clone, Copy)]
enum Trick {
    /// Lets the stream become steady.
    Waits,
    /// Places the robot somewhere else, so far away, m.
    Jumps(f64),
    /// Moves away from the pose that was taken last, as far as is within reach.
    Creeps,
}

/// Forges so many poses.
pub(super) fn run(seed: u64, poses: u64) -> Findings {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut stream = Continuity::default();
    let (mut forged, mut farthest_m) = (0, 0.0_f64);
    let (mut trick, mut ends, mut now) = (Trick::Waits, Instant::START, Instant::START);
    let (mut bearing, mut density) = (0.0_f64, 1);
    while forged < poses {
        if now >= ends {
            trick = match random.random_range(0..3) {
                0 => Trick::Waits,
                1 => Trick::Jumps(random.random_range(0.0..1.0)),
                _ => Trick::Creeps,
            };
            ends = now + Duration::from_millis(random.random_range(5..500));
            bearing = random.random_range(0.0..std::f64::consts::TAU);
            density = random.random_range(1..=DENSEST);
        }
        let truth = truth(now);
        let (mut x, mut y) = (truth.x, truth.y);
        let mut take = |at: Instant, pose: PlanarPose| {
            if stream.take(at, &Pose::planar(pose, HEIGHT)) {
                let distance = (pose.x - truth.x).hypot(pose.y - truth.y);
                farthest_m = farthest_m.max(distance);
            }
        };
        take(now, truth);
        let more = if matches!(trick, Trick::Waits) { 0 } else { density };
        let interval = PERIOD / (density + 1);
        for number in 1..=more {
            let step = match trick {
                Trick::Waits => 0.0,
                Trick::Jumps(distance) => {
                    if number == 1 {
                        distance
                    } else {
                        0.0
                    }
                }
                Trick::Creeps => CAREFUL * (REACH + FASTEST * interval.as_secs_f64()),
            };
            (x, y) = (x + step * bearing.cos(), y + step * bearing.sin());
            take(now + interval * number, PlanarPose { x, y, ..truth });
        }
        forged += u64::from(more);
        now = now + PERIOD;
    }
    let mut findings = Findings { pose_m: Some(farthest_m), ..Findings::default() };
    findings.count(Kind::ForgedPoses, forged);
    findings
}

/// Returns where the robot is.
fn truth(now: Instant) -> PlanarPose {
    let angle = now.as_micros() as f64 * 1e-6 * SPEED / RADIUS;
    PlanarPose {
        x: RADIUS * angle.cos(),
        y: RADIUS * angle.sin(),
        heading: flix_host::nav::wrap(angle + std::f64::consts::FRAC_PI_2),
    }
}

#[cfg(test)]
mod tests {
    use super::super::findings::POSE_LIMIT_M;
    use super::*;

    #[test]
    fn forged_poses_are_trusted_near_the_robot_alone_and_some_are() {
        let farthest = run(3, 300_000).pose_m.unwrap();
        assert!(farthest <= POSE_LIMIT_M, "{farthest}");
        // Else the forger did not try.
        assert!(farthest > REACH, "{farthest}");
    }
}
