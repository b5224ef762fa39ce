//! Estimates the pose between measurements, predicts it for the moment when a command arrives, and
//! adapts the motion of each mode to what is measured.
//!
//! The estimate is predicted with the mode table and corrected with every measured pose, with a gain
//! of `1 - exp(-dt / `[`FILTER_TIME`]`)`: the body shakes at up to 35 Hz, and the camera samples that
//! shaking. A pose far from the estimate means that the robot was moved by hand: it is used at once.
//!
//! The walk is chaotic and floors differ, so the means of the table are adapted while driving: after
//! each [`WINDOW`] of steady motion in one mode, its motion moves towards the measured one by the
//! share `WINDOW / `[`ADAPTATION_TIME`], within limits around the table. With an [`Experience`] in the place of a table, all
//! modes are adapted after each [`STRETCH`] of walking, steady or not, as the [`Belief`] says.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use flix_protocol::units::Instant;

use super::belief::Belief;
use super::experience::Experience;
use super::modes::{Mode, ModeTable, Spread};
use super::motion::{Gait, Motion, REST, Response, motions};
use super::moved::{Moved, between};
use super::pace::Pace;
use crate::pose::geometry::{PlanarPose, Twist, wrap};

/// Time constant of the pose filter, s: two periods of the slowest useful shaking (some 20 Hz).
const FILTER_TIME: f64 = 0.1;
/// Steady motion over which one adaptation of a mode is measured, s.
const WINDOW: f64 = 0.5;
/// Time in a mode after which its adapted motion is mostly measured, s.
const ADAPTATION_TIME: f64 = 4.0;
/// Walking from which a belief is corrected at once, s.
const STRETCH: f64 = 0.3;
/// Time over which poses are averaged at its ends, s: three periods of 30 Hz.
const END: f64 = 0.1;
/// A larger jump than this is a push, m.
const PUSHED_BY: f64 = 0.06;
/// A larger turn than this is a push, rad.
const TURNED_BY: f64 = 0.5;
/// Longest step of the prediction, s.
const STEP: f64 = 0.02;
/// Adapted motions stay within this many spreads of the table's mean, or these floors if larger.
const SPREADS: f64 = 3.0;
const SPEED_FLOOR: f64 = 0.02;
const YAW_FLOOR: f64 = 0.3;
const SHARE_OF_MEAN: f64 = 0.5;

/// Estimator of pose and motion; see the module's documentation.
#[derive(Debug, Clone)]
pub struct Estimator {
    motions: Vec<Motion>,
    /// As known at the beginning.
    known: Vec<Motion>,
    knowledge: Knowledge,
    response: Response,
    latency: Duration,
    gait: Gait,
    pose: PlanarPose,
    time: Option<Instant>,
    pending: VecDeque<(Instant, usize)>,
}

/// What the motions are adapted from.
#[derive(Debug, Clone)]
enum Knowledge {
    /// The modes of a table, and the start of the present window.
    Table { modes: Vec<Mode>, window: Option<(Instant, PlanarPose)> },
    /// What is believed, how fast the robot can therefore go on, and the present stretch.
    Experience { belief: Box<Belief>, pace: Box<Pace>, stretch: Vec<Moment> },
}

/// A measured pose, unfiltered, and the gait then.
#[derive(Debug, Clone, Copy)]
struct Moment {
    time: Instant,
    pose: PlanarPose,
    shares: [(usize, f64); 2],
}

impl Estimator {
    /// Creates an estimator for a robot at rest. `latency`: from sending a command until the robot
    /// obeys it.
    #[must_use]
    pub fn new(table: &ModeTable, response: Response, latency: Duration) -> Self {
        let knowledge = Knowledge::Table { modes: table.modes().to_vec(), window: None };
        Self::with(knowledge, motions(table), response, latency)
    }

    /// Creates an estimator that knows robots of the same kind, but not this one. Otherwise as [`Estimator::new`].
    #[must_use]
    pub fn experienced(
        experience: &Arc<Experience>,
        response: Response,
        latency: Duration,
    ) -> Self {
        let belief = Box::new(Belief::new(Arc::clone(experience)));
        let motions = motions(&experience.table());
        let pace = Box::new(Pace::new(&motions));
        let knowledge = Knowledge::Experience { belief, pace, stretch: Vec::new() };
        Self::with(knowledge, motions, response, latency)
    }

    fn with(
        knowledge: Knowledge,
        motions: Vec<Motion>,
        response: Response,
        latency: Duration,
    ) -> Self {
        Self {
            known: motions.clone(),
            motions,
            knowledge,
            response,
            latency,
            gait: Gait::at_rest(),
            pose: PlanarPose::default(),
            time: None,
            pending: VecDeque::new(),
        }
    }

    /// Returns how fast the robot can go on, if that is known by experience.
    #[must_use]
    pub fn pace(&self) -> Option<&Pace> {
        match &self.knowledge {
            Knowledge::Table { .. } => None,
            Knowledge::Experience { pace, .. } => Some(pace),
        }
    }

    /// Sets the latency of the following commands.
    pub fn set_latency(&mut self, latency: Duration) {
        self.latency = latency;
    }

    /// Returns the motions as adapted so far, rest first.
    #[must_use]
    pub fn motions(&self) -> &[Motion] {
        &self.motions
    }

    /// Returns the response of the robot to commands.
    #[must_use]
    pub fn response(&self) -> &Response {
        &self.response
    }

    /// Returns the estimate at the time of the last pose; `None` before the first.
    #[must_use]
    pub fn pose(&self) -> Option<PlanarPose> {
        self.time.map(|_| self.pose)
    }

    /// Returns how the robot moves by its commands from the last pose until then: as known at the beginning, and, of a robot
    /// that is known by the experience of others, as believed now. `None` before the first pose.
    #[must_use]
    pub(crate) fn moved(&self, until: Instant) -> Option<[Moved; 2]> {
        let by = |motions: &[Motion]| between(&self.pose, &self.rolled(until, motions).0);
        let known = self.time.map(|_| by(&self.known))?;
        let believed = match &self.knowledge {
            // A table that was adapted to poses explains them, whoever's they are.
            Knowledge::Table { .. } => known,
            Knowledge::Experience { .. } => by(&self.motions),
        };
        Some([known, believed])
    }

    /// Records a command that is sent now.
    pub fn command(&mut self, now: Instant, mode: usize) {
        let last = self.pending.back().map_or(self.gait.mode(), |p| p.1);
        if mode != last {
            self.pending.push_back((now + self.latency, mode));
        }
    }

    /// Takes a trusted pose.
    pub fn observe(&mut self, time: Instant, measured: PlanarPose) {
        let Some(previous) = self.time else {
            (self.pose, self.time) = (measured, Some(time));
            return;
        };
        if time <= previous {
            return;
        }
        let elapsed = time.since(previous).as_secs_f64();
        (self.pose, self.gait) = self.predicted(time);
        while self.pending.front().is_some_and(|p| p.0 <= time) {
            self.pending.pop_front();
        }
        self.time = Some(time);
        if !self.correct(measured, elapsed) {
            self.forget_start();
        }
        self.adapt(time, measured);
    }

    /// Returns pose and gait at a later moment, if nothing new is commanded.
    #[must_use]
    pub fn predicted(&self, until: Instant) -> (PlanarPose, Gait) {
        self.rolled(until, &self.motions)
    }

    fn rolled(&self, until: Instant, motions: &[Motion]) -> (PlanarPose, Gait) {
        let (mut pose, mut gait) = (self.pose, self.gait);
        let Some(mut now) = self.time else {
            return (pose, gait);
        };
        let due = self.pending.iter().filter(|p| p.0 <= until);
        let roll = |pose: &mut PlanarPose, gait: &mut Gait, seconds: f64| {
            let steps = (seconds / STEP).ceil();
            for _ in 0..steps as u32 {
                gait.advance(pose, seconds / steps, motions, &self.response);
            }
        };
        for (moment, mode) in due {
            roll(&mut pose, &mut gait, moment.since(now).as_secs_f64());
            gait = gait.commanded(*mode, pose.heading, motions, &self.response);
            now = now.max(*moment);
        }
        roll(&mut pose, &mut gait, until.since(now).as_secs_f64());
        (pose, gait)
    }

    /// Pulls the estimate to a measured pose; returns false if the robot was moved by hand.
    fn correct(&mut self, measured: PlanarPose, elapsed: f64) -> bool {
        let turned = wrap(measured.heading - self.pose.heading);
        let pushed = self.pose.distance_to(measured.position()) > PUSHED_BY;
        if pushed || turned.abs() > TURNED_BY {
            self.pose = measured;
            return false;
        }
        let gain = 1.0 - (-elapsed / FILTER_TIME).exp();
        self.pose.x += gain * (measured.x - self.pose.x);
        self.pose.y += gain * (measured.y - self.pose.y);
        self.pose.heading += gain * turned;
        true
    }

    fn forget_start(&mut self) {
        match &mut self.knowledge {
            Knowledge::Table { window, .. } => *window = None,
            Knowledge::Experience { stretch, .. } => stretch.clear(),
        }
    }

    fn adapt(&mut self, now: Instant, measured: PlanarPose) {
        match &mut self.knowledge {
            Knowledge::Table { modes, window } => {
                let mode = self.gait.mode();
                if mode == REST || !self.gait.is_steady() {
                    *window = None;
                    return;
                }
                let (since, from) = *window.get_or_insert((now, self.pose));
                let seconds = now.since(since).as_secs_f64();
                if seconds >= WINDOW {
                    *window = Some((now, self.pose));
                    let measured = mean_twist(&from, &self.pose, seconds);
                    self.motions[mode].twist =
                        adapted(self.motions[mode].twist, measured, seconds, &modes[mode - 1]);
                }
            }
            Knowledge::Experience { belief, pace, stretch } => {
                // As near to the estimate as the shaking is: no jump from one turn to the next.
                let heading = self.pose.heading + wrap(measured.heading - self.pose.heading);
                let pose = PlanarPose { heading, ..measured };
                if stretch.last().is_some_and(|m| now.since(m.time).as_secs_f64() > END) {
                    stretch.clear();
                }
                let shares = self.gait.shares(&self.motions, &self.response);
                stretch.push(Moment { time: now, pose, shares });
                if now.since(stretch[0].time).as_secs_f64() >= STRETCH + END {
                    walked(stretch, belief);
                    belief.write_motions(heading, &mut self.motions);
                    **pace = Pace::new(&self.motions);
                    let kept = |m: &Moment| now.since(m.time).as_secs_f64() <= END;
                    stretch.retain(kept);
                }
            }
        }
    }
}

/// Corrects a belief by a stretch of walking.
fn walked(stretch: &[Moment], belief: &mut Belief) {
    let begin = stretch[0].time;
    let at = |moment: &Moment| moment.time.since(begin).as_secs_f64();
    let length = stretch.last().map_or(0.0, at);
    let mean = |part: &dyn Fn(f64) -> bool| {
        let part: Vec<&Moment> = stretch.iter().filter(|moment| part(at(moment))).collect();
        let of = |value: &dyn Fn(&Moment) -> f64| {
            part.iter().map(|moment| value(moment)).sum::<f64>() / part.len() as f64
        };
        let pose = PlanarPose {
            x: of(&|m| m.pose.x),
            y: of(&|m| m.pose.y),
            heading: of(&|m| m.pose.heading),
        };
        (of(&at), pose)
    };
    let (since, from) = mean(&|time| time <= END);
    let (until, to) = mean(&|time| time >= length - END);
    let between: Vec<&Moment> =
        stretch.iter().filter(|moment| (since..=until).contains(&at(moment))).collect();
    let seconds = until - since;
    if between.is_empty() || seconds < 0.5 * STRETCH {
        return;
    }
    let mut shares: Vec<(usize, f64)> = Vec::new();
    for (mode, share) in between.iter().flat_map(|moment| moment.shares) {
        let share = share / between.len() as f64;
        match shares.iter_mut().find(|(other, _)| *other == mode) {
            Some((_, sum)) => *sum += share,
            None => shares.push((mode, share)),
        }
    }
    let heading = 0.5 * (from.heading + to.heading);
    belief.observe(&shares, heading, mean_twist(&from, &to, seconds), seconds);
}

/// Returns the motion of a mode, moved towards a measured one.
fn adapted(mut twist: Twist, measured: Twist, seconds: f64, known: &Mode) -> Twist {
    let gain = (seconds / ADAPTATION_TIME).min(1.0);
    twist.forward = pulled(twist.forward, measured.forward, gain, known.forward, SPEED_FLOOR);
    twist.lateral = pulled(twist.lateral, measured.lateral, gain, known.lateral, SPEED_FLOOR);
    twist.yaw = pulled(twist.yaw, measured.yaw, gain, known.yaw, YAW_FLOOR);
    twist
}

fn pulled(present: f64, measured: f64, gain: f64, known: Spread, floor: f64) -> f64 {
    let room = (SPREADS * known.spread).max(SHARE_OF_MEAN * known.mean.abs()).max(floor);
    (present + gain * (measured - present)).clamp(known.mean - room, known.mean + room)
}

/// Returns the constant motion in the body frame that leads from one pose to the other in `seconds`.
#[must_use]
pub fn mean_twist(from: &PlanarPose, to: &PlanarPose, seconds: f64) -> Twist {
    let turn = to.heading - from.heading;
    let (sin, cos) = (from.heading + turn / 2.0).sin_cos();
    let (dx, dy) = ((to.x - from.x) / seconds, (to.y - from.y) / seconds);
    Twist { forward: cos * dx + sin * dy, lateral: cos * dy - sin * dx, yaw: turn / seconds }
}

#[cfg(test)]
mod tests {
    use super::super::modes::tests::model_w;
    use super::*;

    const RESPONSE: Response =
        Response { frequency_ramp: 60.0, direction_slew: 360.0, settling: 0.1 };
    const LEFT: usize = 3;

    fn at(seconds: f64) -> Instant {
        Instant::from_micros((seconds * 1e6) as u64)
    }

    fn estimator() -> Estimator {
        let mut estimator = Estimator::new(&model_w(), RESPONSE, Duration::from_millis(50));
        estimator.observe(at(0.0), PlanarPose::default());
        estimator
    }

    #[test]
    fn a_command_changes_nothing_before_its_latency_has_passed() {
        let mut estimator = estimator();
        estimator.command(at(0.0), LEFT);
        assert_eq!(estimator.predicted(at(0.05)).0, PlanarPose::default());
        assert!(estimator.predicted(at(1.5)).0.heading > 0.5);
    }

    #[test]
    fn a_push_is_used_at_once() {
        let mut estimator = estimator();
        let pushed = PlanarPose { x: 0.4, y: -0.1, heading: 2.0 };
        estimator.observe(at(0.01), pushed);
        assert_eq!(estimator.pose(), Some(pushed));
    }

    #[test]
    fn shaking_in_the_poses_is_smoothed() {
        let mut estimator = estimator();
        let mut worst = 0f64;
        for i in 1..400 {
            let t = f64::from(i) * 0.005;
            let shaking = 0.003 * (std::f64::consts::TAU * 30.0 * t).sin();
            estimator.observe(at(t), PlanarPose { x: shaking, y: 0.0, heading: 0.0 });
            worst = worst.max(estimator.pose().unwrap().x.abs());
        }
        assert!(worst < 0.0006, "{worst}");
    }

    #[test]
    fn a_mode_that_turns_slower_than_its_table_is_adapted() {
        let mut estimator = estimator();
        estimator.command(at(0.0), LEFT);
        let mut pose = PlanarPose::default();
        for i in 1..1200 {
            pose = pose.moved(Twist { forward: 0.0, lateral: 0.0, yaw: 1.5 }, 0.01);
            estimator.observe(at(f64::from(i) * 0.01), pose);
        }
        let adapted = estimator.motions()[LEFT].twist.yaw;
        assert!((adapted - 1.5).abs() < 0.1, "{adapted}");
    }

    #[test]
    fn the_mean_motion_of_an_arc_is_the_arcs() {
        let twist = Twist { forward: 0.1, lateral: 0.02, yaw: 0.7 };
        let from = PlanarPose { x: 1.0, y: 2.0, heading: 2.5 };
        let found = mean_twist(&from, &from.moved(twist, 0.5), 0.5);
        assert!((found.forward - 0.1).abs() < 1e-9 && (found.lateral - 0.02).abs() < 1e-9);
    }
}
