//! Identification of the mode table: drives each mode for some seconds and measures mean and spread
//! of its motion.
//!
//! The modes take turns, round after round, so that a warming motor or an emptying battery affects
//! all of them alike. The first [`SETTLING`] of each stretch does not count: the rotors ramp and the
//! gait settles. The rest is cut into windows of [`WINDOW`]. The motion of a stretch is the mean of
//! its windows, in the body frame; the spread of a mode is the standard deviation between its
//! stretches.
//!
//! A stretch ends early [`REACH`] from where the robot began, and ramping down takes up to 0.1 m more. Farther away than
//! [`FAR`] it walks back before the next stretch, and at the end, in modes that were known before or, once there are
//! enough, those identified so far.

use std::time::Duration;

use flix_protocol::message::{Setpoint, Telemetry};
use flix_protocol::units::Instant;

use super::end_reason::EndReason;
use super::estimator::mean_twist;
use super::modes::{Mode, ModeTable, ModeTableError, Spread};
use super::navigator::{Decision, Navigator, Resting, Settings, Task};
use super::plausibility::{Commanded, Plausibility};
use crate::link::is_reached;
use crate::pose::geometry::{Area, PlanarPose, Position, Twist, wrap};
use crate::pose::{PoseSample, rate};

/// Start of a stretch that does not count.
const SETTLING: Duration = Duration::from_millis(1000);
/// Length of a window: short enough that a turning robot's arc is nearly its chord.
const WINDOW: Duration = Duration::from_millis(250);
/// Rest between two stretches. It lasts until the poses stand: those of a robot at rest do.
const PAUSE: Duration = Duration::from_millis(700);

/// Time for which the poses stand before a stretch begins, s.
const STILL: f64 = 0.3;

/// Distance from the start at which a stretch ends early, m. Ramping down takes less than 0.1 m.
const REACH: f64 = 0.9;
/// A stretch that begins farther away ends early when it leads away by this much, m.
const OUTWARD: f64 = 0.05;
/// Distance from the start from which the robot walks back, m: the next stretch has half a metre.
const FAR: f64 = 0.4;
/// Distance from the start at which it has come back, m.
const BACK: f64 = 0.1;
/// Modes with which a robot can walk to a point: by then the turns are among them.
pub(crate) const ENOUGH_MODES: usize = 4;
/// Longest time of walking back; then the identification goes on from where the robot is.
const RETURN_PATIENCE: Duration = Duration::from_secs(60);

/// What to identify, and how.
#[derive(Debug, Clone)]
pub struct IdentificationSettings {
    /// Names and pairs of the modes.
    pub pairs: Vec<(String, Setpoint)>,
    /// Duration of each stretch.
    pub stretch: Duration,
    /// Stretches of each mode.
    pub rounds: u32,
    /// The robot must stay inside.
    pub fence: Area,
    /// A pose older than this stops the robot.
    pub pose_deadline: Duration,
    /// Without trusted poses the identification ends after this time.
    pub pose_patience: Duration,
    /// Voltage of the resting robot's battery, V, below which the identification ends; where the robot measures it.
    pub least_battery: Option<f32>,
    /// Modes in which the robot walks back; without them, those identified so far.
    pub known: Option<ModeTable>,
}

/// Motion that was measured in one stretch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stretch {
    /// Index of its pair in [`IdentificationSettings::pairs`].
    pub mode: usize,
    /// Mean motion in the body frame.
    pub motion: Twist,
    /// Time over which it was measured, a multiple of the window.
    pub time: Duration,
    /// Whether telemetry showed the rotors at the pair all that time; true without telemetry.
    pub at_speed: bool,
}

/// An identification under way.
#[derive(Debug, Clone)]
pub struct Identification {
    settings: IdentificationSettings,
    stretches: Vec<Stretch>,
    current: u32,
    begun: Option<Instant>,
    /// When the present stretch ended; then the robot rests.
    ended: Option<Instant>,
    started: Option<Instant>,
    trusted: Option<(Instant, PlanarPose)>,
    window: Option<(Instant, PlanarPose)>,
    seen: Vec<Twist>,
    lost_speed: bool,
    /// Voltage of the battery as of the last rest, V.
    battery: Option<f32>,
    stop: Option<EndReason>,
    /// Where the robot began.
    start: Option<Position>,
    /// Distance from there at which the stretch began, m.
    from: f64,
    ends_early: bool,
    return_walk: Option<(Navigator, Instant)>,
    has_returned: bool,
    /// Age beyond which a pose is too old to walk by.
    pose_deadline: Duration,
    plausibility: Plausibility,
    walks: bool,
    /// The last stretch in which the robot stood.
    stood: Option<u32>,
}

impl Identification {
    /// Starts an identification.
    #[must_use]
    pub fn new(settings: IdentificationSettings) -> Self {
        Self {
            pose_deadline: settings.pose_deadline,
            settings,
            stretches: Vec::new(),
            current: 0,
            begun: None,
            ended: None,
            started: None,
            trusted: None,
            window: None,
            seen: Vec::new(),
            lost_speed: false,
            battery: None,
            stop: None,
            start: None,
            from: 0.0,
            ends_early: false,
            return_walk: None,
            has_returned: false,
            plausibility: Plausibility::default(),
            walks: false,
            stood: None,
        }
    }

    /// Returns the measured stretches, in the order in which they were driven. A stretch that was broken off is not
    /// among them.
    #[must_use]
    pub fn stretches(&self) -> &[Stretch] {
        &self.stretches
    }

    /// Returns the settings.
    #[must_use]
    pub fn settings(&self) -> &IdentificationSettings {
        &self.settings
    }

    /// Returns the number of stretches driven and of all stretches.
    #[must_use]
    pub fn progress(&self) -> (u32, u32) {
        (self.current, self.total())
    }

    /// Takes a pose; untrusted ones are not used.
    pub fn observe(&mut self, sample: &PoseSample) {
        let late = self.trusted.is_some_and(|(newest, _)| sample.time <= newest);
        let Some(pose) = sample.trusted().filter(|_| !late) else { return };
        if self.started.is_none() {
            self.plausibility = Plausibility::default();
        }
        let commanded = if self.walks { Commanded::Walks } else { Commanded::Moved([[0.0; 3]; 2]) };
        if !self.plausibility.observe(sample.time, pose, commanded) {
            return;
        }
        self.trusted = Some((sample.time, pose));
        self.start.get_or_insert(pose.position());
        if let Some((navigator, _)) = &mut self.return_walk {
            navigator.observe(sample);
        }
        let Some(begun) = self.begun else { return };
        let driven = sample.time.since(begun);
        if driven < SETTLING || self.ended.is_some() {
            self.window = None;
            return;
        }
        let (since, from) = *self.window.get_or_insert((sample.time, pose));
        let elapsed = sample.time.since(since);
        if elapsed >= WINDOW {
            let to =
                PlanarPose { heading: from.heading + wrap(pose.heading - from.heading), ..pose };
            self.seen.push(mean_twist(&from, &to, elapsed.as_secs_f64()));
            self.window = Some((sample.time, pose));
        }
    }

    /// Takes telemetry of this time.
    pub fn hear(&mut self, now: Instant, telemetry: &Telemetry) {
        let Some(begun) = self.begun.filter(|_| self.ended.is_none()) else {
            self.battery = telemetry.bus_voltage.map(|volts| volts.get());
            return;
        };
        let mode = self.current as usize % self.settings.pairs.len();
        let is_reached = is_reached(telemetry, &self.settings.pairs[mode].1);
        self.lost_speed |= now.since(begun) >= SETTLING && !is_reached;
    }

    /// Sets the time from one pose to the next, as measured.
    pub fn set_pose_period(&mut self, period: Duration) {
        self.pose_deadline = rate::deadline(self.settings.pose_deadline, period);
    }

    /// Returns what to command now.
    pub fn decide(&mut self, now: Instant) -> Decision {
        let started = *self.started.get_or_insert(now);
        if let Some(stop) = &self.stop {
            return Decision::Stopped(stop.clone());
        }
        if let Some(stop) = self.doubt() {
            return self.end(stop);
        }
        let age = now.since(self.trusted.map_or(started, |(time, _)| time));
        if self.trusted.is_none() || age > self.pose_deadline {
            return self.wait_for_pose(age);
        }
        if let Some((_, pose)) = self.trusted
            && !self.settings.fence.contains(pose.position())
        {
            let (at, fence) = (pose.position(), self.settings.fence);
            return self.end(EndReason::OutsideFence { at, fence });
        }
        if let (Some(volts), Some(least)) = (self.battery, self.settings.least_battery)
            && self.begun.is_none()
            && self.current < self.total()
            && volts < least
        {
            return self.end(EndReason::Battery { volts, least });
        }
        let decision = self.walk_back(now).unwrap_or_else(|| self.drive(now));
        self.walks = matches!(decision, Decision::Drive { .. });
        decision
    }

    /// Returns why the poses cannot be those of the robot. One mode may fail to move a robot, and ends then; two in a row are
    /// no accident.
    fn doubt(&mut self) -> Option<EndReason> {
        let stop = self.plausibility.end()?;
        let stands = matches!(stop, EndReason::NotMoving { .. }) && self.begun.is_some();
        let stood = self.stood.replace(self.current);
        if !stands || stood.is_some_and(|before| before + 1 >= self.current) {
            return Some(stop);
        }
        self.ends_early = true;
        self.plausibility.trust_again();
        None
    }

    /// Distance from the start, m.
    fn away(&self) -> f64 {
        let place = self.trusted.map(|(_, pose)| pose.position());
        self.start.zip(place).map_or(0.0, |(start, place)| start.distance_to(place))
    }

    /// Between two stretches, leads a robot that is far from its start back to it.
    fn walk_back(&mut self, now: Instant) -> Option<Decision> {
        if self.return_walk.is_none() {
            let is_over = self.current >= self.total();
            let goes_back = self.begun.is_none()
                && !self.has_returned
                && (self.away() > FAR || is_over && self.away() > BACK);
            if !goes_back {
                return None;
            }
            self.has_returned = true;
            self.return_walk = self.navigator_to_start().map(|navigator| (navigator, now));
        }
        let (navigator, since) = self.return_walk.as_mut()?;
        let decision = navigator.decide(now);
        if decision == Decision::Finished || now.since(*since) > RETURN_PATIENCE {
            self.return_walk = None;
            return None;
        }
        Some(match decision {
            // The navigator counts the modes of its table. One that is none of the pairs comes after them.
            Decision::Drive { setpoint, .. } => {
                let pairs = &self.settings.pairs;
                let mode = pairs.iter().position(|pair| pair.1 == setpoint);
                Decision::Drive { mode: mode.unwrap_or(pairs.len()), setpoint }
            }
            Decision::Stopped(stop) => self.end(stop),
            other => other,
        })
    }

    fn navigator_to_start(&self) -> Option<Navigator> {
        let found = || self.table("", "").ok().filter(|it| it.modes().len() >= ENOUGH_MODES);
        let table = self.settings.known.clone().or_else(found)?;
        let task = Task::Reach { point: self.start?, stay: false };
        let settings = Settings {
            fence: self.settings.fence,
            pose_deadline: self.pose_deadline,
            pose_patience: self.settings.pose_patience,
            arrival_radius: BACK / 2.0,
            return_radius: BACK,
            ..Settings::for_task(&task)
        };
        Navigator::new(task, &table, settings).ok()
    }

    fn drive(&mut self, now: Instant) -> Decision {
        if self.current >= self.total() {
            return Decision::Finished;
        }
        let away = self.away();
        if self.begun.is_none() {
            (self.from, self.ends_early, self.lost_speed) = (away, false, false);
        }
        self.ends_early |= away > REACH.max(self.from + OUTWARD);
        let begun = *self.begun.get_or_insert(now);
        let driven = now.since(begun);
        if driven < self.settings.stretch && !self.ends_early {
            let mode = self.current as usize % self.settings.pairs.len();
            return Decision::Drive { mode, setpoint: self.settings.pairs[mode].1 };
        }
        let ended = *self.ended.get_or_insert(now);
        if now.since(ended) >= PAUSE && self.plausibility.stands_for(now, STILL) {
            self.keep_stretch();
        }
        Decision::Rest(Resting::Arrived)
    }

    /// Ends the stretch; the next one begins with the next decision.
    fn keep_stretch(&mut self) {
        let mode = self.current as usize % self.settings.pairs.len();
        if !self.seen.is_empty() {
            let share = 1.0 / self.seen.len() as f64;
            let time = WINDOW * self.seen.len() as u32;
            let sum = self.seen.drain(..).fold(Twist::REST, Twist::plus);
            let at_speed = !self.lost_speed;
            self.stretches.push(Stretch { mode, motion: sum.scaled(share), time, at_speed });
        }
        self.current += 1;
        (self.begun, self.ended, self.window) = (None, None, None);
        self.has_returned = false;
    }

    fn wait_for_pose(&mut self, waited: Duration) -> Decision {
        // A stretch with a hole is driven again.
        (self.begun, self.ended, self.window) = (None, None, None);
        self.seen.clear();
        if waited > self.settings.pose_patience {
            return self.end(EndReason::PoseLost { waited });
        }
        let reason = if self.trusted.is_none() { Resting::NoPoseYet } else { Resting::PoseTooOld };
        Decision::Rest(reason)
    }

    fn end(&mut self, stop: EndReason) -> Decision {
        self.stop = Some(stop.clone());
        Decision::Stopped(stop)
    }

    fn total(&self) -> u32 {
        self.settings.rounds * self.settings.pairs.len() as u32
    }

    /// Returns the identified table; modes without a single stretch are left out.
    ///
    /// # Errors
    /// When no mode was identified, or a speed is not credible.
    pub fn table(&self, robot: &str, source: &str) -> Result<ModeTable, ModeTableError> {
        let motions = |mode: usize| -> Vec<Twist> {
            let own = self.stretches.iter().filter(|stretch| stretch.mode == mode);
            own.map(|stretch| stretch.motion).collect()
        };
        let pairs = self.settings.pairs.iter().enumerate();
        let driven = pairs.map(|(mode, pair)| (pair, motions(mode))).filter(|(_, m)| !m.is_empty());
        let modes = driven.map(|((name, setpoint), motions)| Mode {
            name: name.clone(),
            setpoint: *setpoint,
            forward: spread(&motions, |t| t.forward),
            lateral: spread(&motions, |t| t.lateral),
            yaw: spread(&motions, |t| t.yaw),
        });
        ModeTable::new(robot, source, modes.collect())
    }
}

/// Returns mean and standard deviation of one component.
fn spread(motions: &[Twist], component: fn(&Twist) -> f64) -> Spread {
    let Spread { mean, spread } = Spread::of(&motions.iter().map(component).collect::<Vec<_>>());
    // A ten-thousandth is far below what can be measured, and keeps the file readable.
    let rounded = |v: f64| (v * 1e4).round() / 1e4;
    Spread { mean: rounded(mean), spread: rounded(spread) }
}

#[cfg(test)]
mod tests {
    use flix_protocol::units::Volts;

    use super::super::modes::tests::model_w;
    use super::*;
    use crate::pose::Pose;
    use crate::walked::telemetry;

    fn identified(rounds: u32) -> Identification {
        identified_from(PlanarPose::default(), rounds, Duration::from_secs(4)).0
    }

    /// Identifies a robot that moves exactly as the table of model W. Returns also where it was, over
    /// time.
    fn identified_from(
        start: PlanarPose,
        rounds: u32,
        stretch: Duration,
    ) -> (Identification, Vec<Position>) {
        let table = model_w();
        let mut identification = Identification::new(IdentificationSettings {
            pairs: table.modes().iter().map(|m| (m.name.clone(), m.setpoint)).collect(),
            stretch,
            rounds,
            fence: "-3,-3,3,3".parse().unwrap(),
            pose_deadline: Duration::from_millis(100),
            pose_patience: Duration::from_secs(2),
            least_battery: None,
            known: None,
        });
        let mut pose = start;
        let mut places = Vec::new();
        for step in 0..200_000 {
            let now = Instant::from_micros(step * 5000);
            match identification.decide(now) {
                Decision::Drive { mode, .. } => {
                    pose = pose.moved(table.modes()[mode].twist(), 0.005);
                }
                Decision::Rest(_) => {}
                Decision::Finished | Decision::Stopped(_) => break,
            }
            let sample = PoseSample {
                time: now,
                pose: Pose::planar(pose, 0.05),
                valid: true,
                picture: None,
            };
            identification.observe(&sample);
            places.push(pose.position());
        }
        (identification, places)
    }

    #[test]
    fn the_robot_stays_within_a_metre_and_comes_back() {
        let start = PlanarPose { x: 0.7, y: -0.4, heading: 1.0 };
        let (identification, places) = identified_from(start, 2, Duration::from_secs(8));
        assert_eq!(identification.progress(), (18, 18));
        let away = |place: &Position| place.distance_to(start.position());
        let farthest = places.iter().map(away).fold(0.0, f64::max);
        assert!(farthest < 1.0, "{farthest} m");
        assert!(places.last().map(away).unwrap() <= BACK, "{:?}", places.last());
    }

    #[test]
    fn poses_that_stand_still_end_the_identification() {
        let mut identification = identified(1);
        identification.current = 0;
        let (_, stands) = identification.trusted.unwrap();
        let end = (0..20_000).find_map(|step| {
            let now = Instant::from_micros(2_000_000_000 + step * 5000);
            let pose = Pose::planar(stands, 0.05);
            identification.observe(&PoseSample { time: now, pose, valid: true, picture: None });
            match identification.decide(now) {
                Decision::Stopped(stop) => Some(stop),
                _ => None,
            }
        });
        assert!(matches!(end, Some(EndReason::NotMoving { .. })), "{end:?}");
    }

    #[test]
    fn identifies_the_speeds_that_the_robot_has() {
        let table = identified(2).table("w", "test").unwrap();
        for (found, true_mode) in table.modes().iter().zip(model_w().modes()) {
            let (l, t) = (found.twist(), true_mode.twist());
            let error = (l.forward - t.forward).abs() + (l.lateral - t.lateral).abs();
            assert!(error < 2e-3 && (l.yaw - t.yaw).abs() < 2e-2, "{}: {l:?} {t:?}", found.name);
        }
    }

    #[test]
    fn all_modes_take_their_turn_in_every_round() {
        assert_eq!(identified(3).progress(), (27, 27));
    }

    #[test]
    fn a_battery_that_is_low_at_rest_ends_the_identification_and_one_that_sags_while_walking_does_not()
     {
        let ending = |volts, is_walking: bool| {
            let mut identification = identified(1);
            (identification.current, identification.settings.least_battery) = (0, Some(9.9));
            let now = Instant::from_micros(2_000_000_000);
            let pose = Pose::planar(identification.trusted.unwrap().1, 0.05);
            identification.observe(&PoseSample { time: now, pose, valid: true, picture: None });
            if is_walking {
                assert!(matches!(identification.decide(now), Decision::Drive { .. }));
            }
            let bus_voltage = Some(Volts::saturating(volts));
            identification.hear(now, &Telemetry { bus_voltage, ..telemetry(0.0) });
            identification.decide(now)
        };
        let low = EndReason::Battery { volts: 9.5, least: 9.9 };
        assert_eq!(ending(9.5, false), Decision::Stopped(low));
        assert!(matches!(ending(10.5, false), Decision::Drive { .. }));
        assert!(matches!(ending(9.5, true), Decision::Drive { .. }));
    }

    #[test]
    fn lost_poses_end_the_identification() {
        let mut identification = identified(1);
        identification.current = 0;
        let end = identification.decide(Instant::from_micros(2_000_000_000));
        assert!(matches!(end, Decision::Stopped(EndReason::PoseLost { .. })), "{end:?}");
    }
}
