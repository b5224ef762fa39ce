//! Shakes of a robot that hangs on cords: pictures of motion capture with the phase of the rotors at each.
//!
//! Each shake: wait until the rotors hold f and theta, let the start fade, record, come to rest. A shake with too few
//! pictures or with a gap in the telemetry is done again.
//!
//! # Clocks
//!
//! Pictures carry the time of the cameras, telemetry that of the robot. What arrives earliest, measured on the clock of
//! its sender, was on its way for the shortest time: it relates that clock to ours, and through ours the two to each
//! other. The earliest picture of ten seconds is taken to be on its way for no time, the earliest telemetry for half
//! the shortest round trip. What is wrong with that, a millisecond or less on a local network, is the "delay of the
//! cameras" that the identification finds.
//!
//! # Axes
//!
//! The axes are those of the body in its mean orientation during the shake. Positions count from their mean.

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use flix_protocol::message::{Setpoint, Telemetry};
use flix_protocol::units::Instant;

use super::{Column, seconds};
use crate::link::is_reached;
use crate::nav::{Decision, EndReason, Position, Resting};
use crate::pilot::Helm;
use crate::pose::{Picture, Pose, PoseSample, Quaternion, Vector};

/// Columns of `air.csv`.
pub const COLUMNS: [Column; 11] = [
    Column::new("test", 0),
    Column::new("f_hz", 3),
    Column::new("theta_deg", 3),
    Column::new("t_s", 6),
    Column::new("phase_deg", 2),
    Column::new("x_mm", 4),
    Column::new("y_mm", 4),
    Column::new("z_mm", 4),
    Column::new("rx_deg", 4),
    Column::new("ry_deg", 4),
    Column::new("rz_deg", 4),
];

/// Usual shakes: f in Hz and theta in degrees.
pub const SHAKES: [(f64, f64); 6] =
    [(20.0, 0.0), (20.0, 90.0), (28.0, 0.0), (28.0, 90.0), (35.0, 0.0), (35.0, 90.0)];
/// Slowest shake, Hz: below, the body's swing on its cords is not small.
pub const SLOWEST: f32 = 5.0;

/// Rest before each shake.
const PAUSE: Duration = Duration::from_secs(1);
/// Longest time in which the rotors reach f and theta.
const SPEED_PATIENCE: Duration = Duration::from_secs(5);
/// Time at speed that is not recorded: the legs' free vibration fades within 0.2 s.
const SETTLING: Duration = Duration::from_secs(1);
/// Time after the recorded one in which its last pictures and the telemetry after them arrive.
const TAIL: Duration = Duration::from_millis(200);
/// Shakes at one pair before it is given up.
const ATTEMPTS: u32 = 3;
/// Fewest pictures a second.
const FEWEST: f64 = 50.0;
/// Longest gap in the telemetry, s: the rotors turn evenly, and by less than half a turn more or less than commanded.
const LONGEST_GAP: f64 = 0.2;
/// Time over which the earliest datagrams are sought: many are needed, and clocks drift, by 0.02 ms a second at most.
const CLOCKS: Duration = Duration::from_secs(10);
/// Mean age of what telemetry reports when it is sent, s: the robot's fast half reports every millisecond.
const REPORT_AGE: f64 = 0.5e-3;
/// Largest turn about an axis, degrees: `air.csv` takes no larger one.
const LARGEST_TURN: f64 = 30.0;
/// Distance from where the robot hung first at which the run ends, m: it stands on a floor, or its cords are too long.
const REACH: f64 = 0.3;
/// A pose older than this interrupts a shake.
const POSE_DEADLINE: Duration = Duration::from_millis(500);
/// f below which the rotors are at rest, Hz.
const AT_REST: f32 = 1.0;

/// What to shake, and for how long.
#[derive(Debug, Clone)]
pub struct AirSettings {
    /// Pairs (f, theta).
    pub shakes: Vec<Setpoint>,
    /// Time that is recorded of each.
    pub time: Duration,
    /// Without trusted poses the run ends after this time.
    pub pose_patience: Duration,
}

/// One shake.
#[derive(Debug, Clone)]
pub struct Shake {
    /// f and theta.
    pub setpoint: Setpoint,
    /// For each picture: time (s), phase (degrees), position (mm), rotation vector (degrees).
    pub pictures: Vec<[f64; 8]>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Resting,
    SpeedingUp,
    Settling,
    Recording,
}

/// Another clock, as seen from ours.
#[derive(Debug, Clone, Default)]
struct Clock {
    /// When datagrams arrived, and by how much our clock was ahead then of theirs when they were sent, s.
    ahead: VecDeque<(Instant, f64)>,
}

impl Clock {
    /// Takes a datagram: when it came, and when it was sent on the other clock.
    fn take(&mut self, arrived: Instant, sent: Instant) {
        self.ahead.push_back((arrived, seconds(arrived) - seconds(sent)));
        while self.ahead.front().is_some_and(|(oldest, _)| arrived.since(*oldest) > CLOCKS) {
            self.ahead.pop_front();
        }
    }

    /// Returns by how much our clock is ahead of it, s; 0 if nothing came.
    fn ahead(&self) -> f64 {
        self.ahead.iter().map(|(_, ahead)| *ahead).min_by(f64::total_cmp).unwrap_or_default()
    }
}

/// A pose with its times.
#[derive(Debug, Clone, Copy)]
struct Seen {
    arrived: Instant,
    /// On the clock of the cameras.
    exposed: Instant,
    pose: Pose,
}

/// Angles of the rotors with their time.
#[derive(Debug, Clone, Copy)]
struct Heard {
    /// On the robot's clock.
    time: Instant,
    /// Of top and bottom rotor, degrees clockwise from forward.
    angles: [f64; 2],
}

/// Why a shake is of no use.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Trouble {
    FewPictures { count: usize, wanted: usize },
    Silence,
    Turned { degrees: f64 },
}

impl fmt::Display for Trouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::FewPictures { count, wanted } => write!(
                f,
                "{count} trusted pictures of a shake, and {wanted} are needed: raise the rate of the cameras (250 Hz is \
                 plenty), and look whether all markers are in view"
            ),
            Self::Silence => write!(
                f,
                "telemetry stayed away for {LONGEST_GAP} s during a shake: see `flix link-test`"
            ),
            Self::Turned { degrees } => write!(
                f,
                "the robot turned by {degrees:.0} degrees during a shake, more than {LARGEST_TURN}: hang it on four cords"
            ),
        }
    }
}

/// Shakes under way; see the module's documentation.
#[derive(Debug, Clone)]
pub struct Air {
    settings: AirSettings,
    shakes: Vec<Shake>,
    phase: Phase,
    since: Option<Instant>,
    attempts: u32,
    is_at_rest: bool,
    is_at_speed: bool,
    start: Option<Position>,
    newest: Option<(Instant, Position)>,
    cameras: Clock,
    robot: Clock,
    seen: Vec<Seen>,
    heard: Vec<Heard>,
    stop: Option<EndReason>,
}

impl Air {
    /// Creates a run that has not begun.
    #[must_use]
    pub fn new(settings: AirSettings) -> Self {
        Self {
            settings,
            shakes: Vec::new(),
            phase: Phase::Resting,
            since: None,
            attempts: 0,
            is_at_rest: false,
            is_at_speed: false,
            start: None,
            newest: None,
            cameras: Clock::default(),
            robot: Clock::default(),
            seen: Vec::new(),
            heard: Vec::new(),
            stop: None,
        }
    }

    /// Returns the shakes that are whole.
    #[must_use]
    pub fn shakes(&self) -> &[Shake] {
        &self.shakes
    }

    /// Returns the number of all shakes.
    #[must_use]
    pub fn total(&self) -> usize {
        self.settings.shakes.len()
    }

    /// Returns the rows of the whole shakes, numbered on from `last`.
    #[must_use]
    pub fn rows(&self, last: f64) -> Vec<Vec<f64>> {
        let numbered = self.shakes.iter().enumerate();
        let rows = numbered.flat_map(|(index, shake)| {
            let f = f64::from(shake.setpoint.frequency().get());
            let theta = f64::from(shake.setpoint.direction().get());
            let test = last + index as f64 + 1.0;
            shake.pictures.iter().map(move |row| [&[test, f, theta], row.as_slice()].concat())
        });
        rows.collect()
    }

    fn setpoint(&self) -> Option<Setpoint> {
        self.settings.shakes.get(self.shakes.len()).copied()
    }

    fn enter(&mut self, now: Instant, phase: Phase) {
        if phase == Phase::SpeedingUp {
            self.seen.clear();
            self.heard.clear();
            self.is_at_speed = false;
        }
        (self.phase, self.since) = (phase, Some(now));
    }

    fn end(&mut self, stop: EndReason) -> Decision {
        self.stop = Some(stop.clone());
        Decision::Stopped(stop)
    }

    fn wait_for_pose(&mut self, now: Instant, waited: Duration) -> Decision {
        if self.phase != Phase::Resting {
            self.enter(now, Phase::Resting);
        }
        if waited > self.settings.pose_patience {
            return self.end(EndReason::PoseLost { waited });
        }
        Decision::Rest(match self.newest {
            None => Resting::NoPoseYet,
            Some(_) => Resting::PoseTooOld,
        })
    }

    fn shake(&mut self, now: Instant, setpoint: Setpoint) -> Decision {
        let since = *self.since.get_or_insert(now);
        let passed = now.since(since);
        match self.phase {
            Phase::Resting if passed >= PAUSE && self.is_at_rest => {
                self.enter(now, Phase::SpeedingUp);
            }
            Phase::Resting => return Decision::Rest(Resting::Arrived),
            Phase::SpeedingUp if self.is_at_speed => self.enter(now, Phase::Settling),
            Phase::SpeedingUp if passed > SPEED_PATIENCE => {
                let (f, theta) = (setpoint.frequency(), setpoint.direction());
                return self.end(EndReason::Experiment(format!(
                    "the rotors do not reach {f} at {theta} within {} s: see the battery with `flix status`",
                    SPEED_PATIENCE.as_secs()
                )));
            }
            Phase::Settling | Phase::Recording if !self.is_at_speed => {
                self.enter(now, Phase::SpeedingUp);
            }
            Phase::Settling if passed >= SETTLING => self.enter(now, Phase::Recording),
            Phase::Recording if passed >= self.settings.time + TAIL => {
                let span = (since, self.settings.time);
                let behind = self.cameras.ahead() - self.robot.ahead() + REPORT_AGE;
                match pictures(&setpoint, span, behind, &self.seen, &self.heard) {
                    Ok(pictures) => {
                        self.shakes.push(Shake { setpoint, pictures });
                        self.attempts = 0;
                    }
                    Err(trouble) => {
                        self.attempts += 1;
                        if self.attempts == ATTEMPTS {
                            return self.end(EndReason::Experiment(trouble.to_string()));
                        }
                    }
                }
                self.enter(now, Phase::Resting);
                return Decision::Rest(Resting::Arrived);
            }
            _ => {}
        }
        Decision::Drive { mode: self.shakes.len(), setpoint }
    }
}

impl Helm for Air {
    fn observe(&mut self, sample: &PoseSample) {
        let Some(place) = sample.trusted() else { return };
        self.newest = Some((sample.time, place.position()));
        self.start.get_or_insert(place.position());
        match sample.picture {
            Some(Picture { exposed, sent, .. }) => {
                self.cameras.take(sample.time, sent);
                if self.phase == Phase::Recording {
                    self.seen.push(Seen { arrived: sample.time, exposed, pose: sample.pose });
                }
            }
            None => {
                self.stop.get_or_insert_with(|| {
                    EndReason::Experiment(
                        "the poses do not state when they were taken, and the phase of the rotors changes by 13 degrees a \
                         millisecond: stream NatNet 3.0 or later, or JSON with \"time\""
                            .to_owned(),
                    )
                });
            }
        }
    }

    fn hear(&mut self, telemetry: &Telemetry, sent: Instant) {
        self.robot.take(sent, telemetry.time);
        self.is_at_rest = telemetry.frequency.get().abs() < AT_REST;
        let Some(setpoint) = self.setpoint() else { return };
        self.is_at_speed = is_reached(telemetry, &setpoint);
        let is_newer = self.heard.last().is_none_or(|last| last.time < telemetry.time);
        if self.phase != Phase::Resting && is_newer {
            let angles = telemetry.motors.map(|motor| f64::from(motor.angle.get()));
            self.heard.push(Heard { time: telemetry.time, angles });
        }
    }

    fn decide(&mut self, now: Instant) -> Decision {
        if let Some(stop) = &self.stop {
            return Decision::Stopped(stop.clone());
        }
        let since = *self.since.get_or_insert(now);
        let Some(setpoint) = self.setpoint() else { return Decision::Finished };
        let age = now.since(self.newest.map_or(since, |(time, _)| time));
        if self.newest.is_none() || age > POSE_DEADLINE {
            return self.wait_for_pose(now, age);
        }
        let away =
            self.start.zip(self.newest).map_or(0.0, |(start, (_, at))| start.distance_to(at));
        if away > REACH {
            return self.end(EndReason::Experiment(format!(
                "the robot is {away:.2} m from where it hung: hang it on short cords, clear of the floor"
            )));
        }
        self.shake(now, setpoint)
    }
}

/// Returns an angle in [-180, 180) degrees.
fn wrapped(degrees: f64) -> f64 {
    (degrees + 180.0).rem_euclid(360.0) - 180.0
}

/// Returns how far the top rotor has turned clockwise from the line of force, degrees in [-180, 180): the bottom one
/// has turned as far the other way, and the mean of both is taken.
fn phase_of([top, bottom]: [f64; 2], theta: f64) -> f64 {
    let (by_top, by_bottom) = (top - theta, theta - bottom);
    wrapped(by_top + wrapped(by_bottom - by_top) / 2.0)
}

/// Returns the phase over time on the robot's clock, degrees and s, counted on over full turns.
fn phases(setpoint: &Setpoint, heard: &[Heard]) -> Vec<(f64, f64)> {
    let turning = 360.0 * f64::from(setpoint.frequency().get());
    let theta = f64::from(setpoint.direction().get());
    let mut course: Vec<(f64, f64)> = Vec::with_capacity(heard.len());
    for it in heard {
        let (time, angle) = (seconds(it.time), phase_of(it.angles, theta));
        let phase = course.last().map_or(angle, |(before, phase)| {
            let expected = phase + turning * (time - before);
            expected + wrapped(angle - expected)
        });
        course.push((time, phase));
    }
    course
}

/// Returns the phase at a time between two of the course that are not far apart.
fn interpolated(course: &[(f64, f64)], time: f64) -> Option<f64> {
    let after = course.partition_point(|(at, _)| *at < time).max(1);
    let ((t0, p0), (t1, p1)) = (course.get(after - 1)?, course.get(after)?);
    let is_near = t1 - t0 <= LONGEST_GAP && (*t0..=*t1).contains(&time);
    is_near.then(|| p0 + (p1 - p0) * (time - t0) / (t1 - t0).max(f64::MIN_POSITIVE))
}

/// Returns the mean of orientations that are near each other.
fn mean_orientation(poses: &[Pose]) -> Quaternion {
    let first = poses.first().map_or(Quaternion::about_z(0.0), |pose| pose.orientation);
    let mut sum = [0.0; 4];
    for pose in poses {
        let each = pose.orientation.components();
        // A quaternion and its negative are one rotation.
        let dot: f64 = each.iter().zip(first.components()).map(|(a, b)| a * b).sum();
        sum.iter_mut().zip(each).for_each(|(sum, q)| *sum += q * dot.signum());
    }
    let norm = sum.iter().map(|q| q * q).sum::<f64>().sqrt();
    sum.map(|q| q / norm).into()
}

/// Returns the pictures that arrived for `time` from `begin` on; see [`Shake::pictures`]. `behind`: by how much the clock of
/// the cameras is behind that of the robot, s.
fn pictures(
    setpoint: &Setpoint,
    (begin, time): (Instant, Duration),
    behind: f64,
    seen: &[Seen],
    heard: &[Heard],
) -> Result<Vec<[f64; 8]>, Trouble> {
    let inside = seen.iter().filter(|it| (begin..begin + time).contains(&it.arrived));
    let taken: Vec<(f64, Pose)> =
        inside.map(|it| (seconds(it.exposed) + behind, it.pose)).collect();
    let wanted = (FEWEST * time.as_secs_f64()) as usize;
    if taken.len() < wanted {
        return Err(Trouble::FewPictures { count: taken.len(), wanted });
    }
    let course = phases(setpoint, heard);
    let poses: Vec<Pose> = taken.iter().map(|(_, pose)| *pose).collect();
    let to_body = mean_orientation(&poses).inverse();
    let share = 1.0 / poses.len() as f64;
    let middle = poses.iter().fold([0.0; 3], |sum, pose| {
        let place = pose.position.coordinates();
        core::array::from_fn(|i| sum[i] + share * place[i])
    });
    let first = taken[0].0;
    taken
        .iter()
        .map(|(at, pose)| {
            let phase = interpolated(&course, *at).ok_or(Trouble::Silence)?;
            let place = pose.position.coordinates();
            let off = Vector::from(core::array::from_fn::<f64, 3, _>(|i| place[i] - middle[i]));
            let [x, y, z] = to_body.turn(off).coordinates().map(|metres| 1e3 * metres);
            let turned = to_body.after(pose.orientation).rotation_vector().coordinates();
            let [rx, ry, rz] = turned.map(f64::to_degrees);
            let degrees = [rx, ry, rz].into_iter().fold(0.0, |most: f64, r| most.max(r.abs()));
            if degrees > LARGEST_TURN {
                return Err(Trouble::Turned { degrees });
            }
            Ok([at - first, phase, x, y, z, rx, ry, rz])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nav::PlanarPose;

    const TURNED: f64 = 0.7;

    fn at(seconds: f64) -> Instant {
        Instant::from_micros((seconds * 1e6) as u64)
    }

    /// A robot whose body moves forward with the cosine of the phase and turns with its sine, on a heading of its own. Its
    /// clock, and that of the cameras, began at other times than ours.
    fn shaken(setpoint: &Setpoint, rate: u32, telemetry: u32) -> (f64, Vec<Seen>, Vec<Heard>) {
        let (mut cameras, mut robot) = (Clock::default(), Clock::default());
        let phase = |t: f64| 360.0 * f64::from(setpoint.frequency().get()) * t + 17.0;
        let mut seen = |index: u32| {
            let t = f64::from(index) / f64::from(rate);
            let (sin, cos) = phase(t).to_radians().sin_cos();
            let place = PlanarPose {
                x: 1.0 + 2e-3 * cos * TURNED.cos(),
                y: 2.0 + 2e-3 * cos * TURNED.sin(),
                heading: TURNED + 0.01 * sin,
            };
            // Every seventh arrives late.
            let late = if index % 7 == 3 { 0.004 } else { 0.0 };
            let arrived = at(10.008 + t + late);
            cameras.take(arrived, at(900.008 + t));
            Seen { arrived, exposed: at(900.0 + t), pose: Pose::planar(place, 0.5) }
        };
        let mut heard = |index: u32| {
            let t = f64::from(index) / f64::from(telemetry);
            let late = if index.is_multiple_of(3) { 0.02 } else { 0.0 };
            let theta = f64::from(setpoint.direction().get());
            let angles = [theta + phase(t), theta - phase(t)].map(wrapped);
            robot.take(at(10.0 + t + late), at(77.0 + t));
            Heard { time: at(77.0 + t), angles }
        };
        let seen = (0..2 * rate).map(&mut seen).collect();
        let heard = (0..2 * telemetry).map(&mut heard).collect();
        (cameras.ahead() - robot.ahead(), seen, heard)
    }

    #[test]
    fn pictures_carry_the_phase_of_their_moment_and_axes_of_the_body() {
        for (f, theta) in [(35.0, 90.0), (-28.0, -60.0), (20.0, 0.0)] {
            let setpoint = Setpoint::saturating(f, theta);
            let (behind, seen, heard) = shaken(&setpoint, 250, 50);
            let span = (at(10.5), Duration::from_secs(1));
            let rows = pictures(&setpoint, span, behind, &seen, &heard).unwrap();
            assert!((249..=251).contains(&rows.len()), "{}", rows.len());
            for [t, phase, x, y, z, rx, ry, rz] in rows {
                let (sin, cos) = phase.to_radians().sin_cos();
                let off = [x - 2.0 * cos, y, z, rx, ry, rz - 0.01f64.to_degrees() * sin];
                let largest = off.iter().fold(0.0, |most: f64, off| most.max(off.abs()));
                assert!(largest < 0.02, "{f} {theta} at {t}: {off:?}");
            }
        }
    }

    #[test]
    fn the_phase_counts_from_the_commanded_end_of_the_line_of_force() {
        for (angles, theta, phase) in [
            ([100.0, 80.0], 90.0, 10.0),
            ([-170.0, -10.0], -90.0, -80.0),
            ([179.0, 1.0], 90.0, 89.0),
            ([-70.0, -110.0], 90.0, -160.0),
            ([-91.0, -89.0], -90.0, -1.0),
        ] {
            assert!((phase_of(angles, theta) - phase).abs() < 1e-9, "{angles:?} {theta}");
        }
    }

    #[test]
    fn a_shake_that_does_not_count_says_why() {
        let setpoint = Setpoint::saturating(28.0, 0.0);
        let span = (at(10.5), Duration::from_secs(1));
        let (behind, seen, heard) = shaken(&setpoint, 250, 50);
        let few = pictures(&setpoint, span, behind, &shaken(&setpoint, 40, 50).1, &heard);
        let is_few = matches!(few, Err(Trouble::FewPictures { count: 39..=41, wanted: 50 }));
        assert!(is_few, "{few:?}");
        let silent: Vec<Heard> = heard.iter().filter(|it| it.time < at(77.8)).copied().collect();
        assert_eq!(pictures(&setpoint, span, behind, &seen, &silent), Err(Trouble::Silence));
        let mut tumbled = seen;
        tumbled[200].pose.orientation = Quaternion::about_z(TURNED + 0.7);
        let turned = pictures(&setpoint, span, behind, &tumbled, &heard);
        assert!(matches!(turned, Err(Trouble::Turned { degrees: 39.0..41.0 })), "{turned:?}");
    }
}
