//! How the robot moved during a drive, where poses are known.

use std::time::Duration;

use flix_protocol::units::Instant;
use serde::Serialize;

use flix_host::nav::{PlanarPose, wrap};
use flix_host::pose::PoseSample;

/// Turn during a walk that is not a turning mode that is called a curve, degrees.
const CURVE_DEG: f64 = 10.0;
/// Longest time between two poses of a stream that goes on; of a drive without poses for longer it is said.
const GAP: Duration = Duration::from_millis(500);

/// How the robot moved, seen from where it stood.
#[derive(Debug, Clone, Copy)]
pub(super) struct Walked {
    first: PlanarPose,
    last: PlanarPose,
    /// Since then, rad to the left; whole turns count.
    turned: f64,
    began: Instant,
    ended: Instant,
    /// Time with poses.
    seen: Duration,
}

impl Walked {
    /// Takes a trusted pose; other poses leave everything as it is.
    pub(super) fn observe(walked: &mut Option<Self>, sample: &PoseSample) {
        let Some(pose) = sample.trusted() else { return };
        let time = sample.time;
        let it = walked.get_or_insert(Self {
            first: pose,
            last: pose,
            turned: 0.0,
            began: time,
            ended: time,
            seen: Duration::ZERO,
        });
        it.seen += Some(time.since(it.ended)).filter(|pause| *pause <= GAP).unwrap_or_default();
        it.turned += wrap(pose.heading - it.last.heading);
        (it.last, it.ended) = (pose, time);
    }

    /// Returns the displacement and the turn so far.
    pub(super) fn motion(&self) -> Motion {
        let (x, y) = (self.last.x - self.first.x, self.last.y - self.first.y);
        let (sin, cos) = self.first.heading.sin_cos();
        let seconds = self.ended.since(self.began).as_secs_f64();
        Motion {
            forward_m: x * cos + y * sin,
            left_m: y * cos - x * sin,
            turned_deg: self.turned.to_degrees(),
            seen_s: self.seen.as_secs_f64(),
            yaw_rate_rad_s: if seconds > 0.0 { self.turned / seconds } else { 0.0 },
        }
    }
}

/// Displacement in the axes of the body at the start; positive turns are to the left.
#[derive(Debug, Serialize)]
pub(super) struct Motion {
    forward_m: f64,
    left_m: f64,
    turned_deg: f64,
    yaw_rate_rad_s: f64,
    /// Time of the drive with poses, s.
    seen_s: f64,
}

impl Motion {
    /// Returns how it moved in a drive of so many seconds, and, where it should have gone straight and did not, or was not seen all
    /// the time, what to do.
    pub(super) fn describe(&self, is_turn: bool, seconds: f64) -> String {
        let Self { forward_m, left_m, turned_deg, yaw_rate_rad_s, seen_s } = self;
        let side = |value: &f64| if *value < 0.0 { "right" } else { "left" };
        let along = if *forward_m < 0.0 { "backward" } else { "forward" };
        let mut text = format!(
            "moved {:.3} m {along}, {:.3} m to the {}, turned {:.0} degrees to the {}\n",
            forward_m.abs(),
            left_m.abs(),
            side(left_m),
            turned_deg.abs(),
            side(turned_deg)
        );
        if seconds - seen_s > GAP.as_secs_f64() {
            text += &format!(
                "note: there were poses for {seen_s:.1} of {seconds:.1} s; `flix doctor` with the same --pose finds out why\n"
            );
        }
        if !is_turn && turned_deg.abs() > CURVE_DEG {
            text += &format!(
                "note: it curves at {:.2} rad/s; `flix teleop --pose ...` holds a heading (key h), \
                 `flix track` a path\n",
                yaw_rate_rad_s.abs()
            );
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flix_host::pose::Pose;

    #[test]
    fn a_walk_is_reported_from_where_it_began_with_whole_turns() {
        let at = |milliseconds: u64, x, y, heading| PoseSample {
            time: Instant::from_micros(milliseconds * 1000),
            pose: Pose::planar(PlanarPose { x, y, heading }, 0.06),
            valid: true,
            picture: None,
        };
        let mut walked = None;
        Walked::observe(&mut walked, &PoseSample { valid: false, ..at(0, 9.0, 9.0, 9.0) });
        // It faces left (+y), walks there, and turns left across the wrap.
        for (step, heading) in [(0, 1.5), (1, 2.8), (2, -2.2), (3, -0.9)] {
            let sample = at(500 * step, 1.0 - 0.01 * step as f64, 2.0 + 0.1 * step as f64, heading);
            Walked::observe(&mut walked, &sample);
        }
        let motion = walked.unwrap().motion();
        let turned = -0.9 + std::f64::consts::TAU - 1.5;
        for (value, expected) in [
            (motion.forward_m, 0.297_13),
            (motion.left_m, 0.051_15),
            (motion.turned_deg.to_radians(), turned),
            (motion.yaw_rate_rad_s, turned / 1.5),
        ] {
            assert!((value - expected).abs() < 1e-4, "{motion:?}");
        }
        assert!(
            motion.describe(false, 1.5).contains("curves at 2.59 rad/s"),
            "{}",
            motion.describe(false, 1.5)
        );
        assert!(!motion.describe(true, 1.5).contains("curves"));
        assert!(!motion.describe(true, 2.0).contains("poses for"));
        assert!(motion.describe(true, 7.0).contains("poses for 1.5 of 7.0 s"));
        let straight = Motion { turned_deg: 9.0, ..motion };
        assert!(!straight.describe(false, 1.5).contains("curves"));
    }
}
