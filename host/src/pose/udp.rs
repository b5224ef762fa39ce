//! Poses of any tracker, as datagrams: one pose each, as text.
//!
//! ```text
//! 0.51 -0.20 0.06 0 0 1.57                        x y z roll pitch yaw, with blanks or commas between
//! {"x": 0.51, "y": -0.20, "yaw": 1.57}            the same by name; z, roll and pitch may be left out, and are 0
//! ```
//!
//! Metres and radians, in the world frame ENU; the body's axes are forward, left, up (REP 103); yaw is counter-clockwise,
//! and turned first, then pitch, then roll. `"valid": false` marks a pose that the tracker does not trust. `"time": 12.345`
//! is when its picture was taken, seconds on any clock of the tracker's: with it a pose that comes out of order is none, and
//! one that comes late ([`LATE`](super::LATE)) is not trusted.
//!
//! Datagrams are not authenticated: those of the first sender alone are taken, until it is silent for
//! `SENDER_PATIENCE`, or for `PORT_PATIENCE` where another port of its computer goes on, and a stream that jumps is not
//! trusted ([`crate::pose::continuity`]). Of two senders either may be the tracker: while another one is heard, no pose is
//! trusted. With the tracker's address only its datagrams are looked at.

use std::f64::consts::TAU;
use std::fmt;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::time::Duration;

use flix_protocol::units::Instant;
use serde::Deserialize;

use crate::link::transient;

use super::order::Stamp;
use super::stream::Stream;
use super::{Picture, Pose, PoseError, PoseSample, PoseSource, Quaternion, Vector};

/// Silence of a sender after which another one is taken, and of all others after which it is trusted again.
const SENDER_PATIENCE: Duration = Duration::from_secs(2);
/// Longest datagram, bytes; longer ones are cut and therefore unreadable.
const LONGEST: usize = 512;
/// Most datagrams that one call of `poll` reads, so that a flood of them cannot keep the caller from its other work.
const DATAGRAMS_AT_ONCE: u32 = 256;

/// Silence of a port of the tracker's address after which another one of that address is taken: one picture of the slowest camera.
const PORT_PATIENCE: Duration = Duration::from_millis(100);
/// Farthest place and largest height that are in metres, m: no room with cameras is larger.
const ROOM: [f64; 3] = [100.0, 100.0, 10.0];
/// Largest yaw that is in radians: a tracker may count turns, up to two.
const MOST_YAW: f64 = 2.0 * TAU;

/// A number that states another unit than radians, metres and seconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WrongUnit {
    field: &'static str,
    value: i64,
    wanted: &'static str,
}

impl fmt::Display for WrongUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { field, value, wanted } = self;
        write!(f, "{field} is {value}, which is not in {wanted}: send {field} in {wanted}")
    }
}

/// Counts of the datagrams received so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct UdpStatistics {
    /// Poses of the sender.
    pub poses: u64,
    /// Poses among them that the tracker marked as not valid.
    pub untracked: u64,
    /// Datagrams of the sender that are no pose.
    pub unreadable: u64,
    /// The last number among them that is in another unit.
    pub unit: Option<WrongUnit>,
    /// Datagrams whose time is not after that of one before them, or far ahead: late, or twice, of a tracker that stands still,
    /// or not in seconds.
    pub out_of_order: u64,
    /// Most by which a pose came later than the fastest one.
    pub spread: Duration,
    /// Poses out of reach of the pose before them.
    pub jumps: u64,
    /// Datagrams of other senders; they were dropped.
    pub strangers: u64,
    /// Address of the last of these.
    pub stranger: Option<IpAddr>,
}

/// Sender of the poses.
#[derive(Debug, Clone, Copy)]
struct Sender {
    address: SocketAddr,
    /// When it was heard last.
    last: Instant,
    /// Whether it was heard once only.
    is_new: bool,
    /// Its port before.
    before: u16,
}

/// Receives the poses of a tracker.
#[derive(Debug)]
pub struct UdpSource {
    socket: UdpSocket,
    tracker: Option<IpAddr>,
    sender: Option<Sender>,
    /// When a second sender was heard last.
    doubted: Option<Instant>,
    stream: Stream,
    statistics: UdpStatistics,
}

impl UdpSource {
    /// Listens at this port of this computer's network card; the loopback address takes poses of this computer alone.
    /// With the address of the tracker, datagrams of all others are counted and dropped.
    ///
    /// # Errors
    /// When the port cannot be had.
    pub fn bind(interface: Ipv4Addr, port: u16, tracker: Option<IpAddr>) -> io::Result<Self> {
        let socket = UdpSocket::bind((interface, port))?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            socket,
            tracker,
            sender: None,
            doubted: None,
            stream: Stream::default(),
            statistics: UdpStatistics::default(),
        })
    }

    /// Returns the address at which it listens.
    ///
    /// # Errors
    /// When the system does not know it.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.socket.local_addr()
    }

    /// Returns counts of the datagrams received so far.
    #[must_use]
    pub fn statistics(&self) -> UdpStatistics {
        self.statistics
    }

    /// Judges a pose that came now; `None` when it is not newer than all before it.
    fn judge(&mut self, now: Instant, (pose, tracked, taken): Reading) -> Option<PoseSample> {
        let seen = tracked.then_some(&pose);
        let newer = self.stream.take(now, taken.map(Stamp::Time), taken, seen);
        let is_alone = self.doubted.is_none_or(|last| now.since(last) > SENDER_PATIENCE);
        let statistics = &mut self.statistics;
        statistics.jumps = self.stream.jumps();
        let Some(newer) = newer else {
            statistics.out_of_order += 1;
            return None;
        };
        statistics.spread = statistics.spread.max(newer.late);
        statistics.poses += 1;
        statistics.untracked += u64::from(!tracked);
        let picture = taken.map(|exposed| Picture { exposed, sent: exposed, late: newer.late });
        Some(PoseSample { time: now, pose, valid: newer.is_trusted && is_alone, picture })
    }

    /// Returns whether the datagrams of this address are taken. A tracker may send each from a port of its own: it comes from the
    /// named address, or from the address of the one before, and no port comes back.
    fn is_sender(&mut self, from: SocketAddr, now: Instant) -> bool {
        let may_be_it = self.tracker.is_none_or(|tracker| tracker == from.ip());
        let Some(sender) = self.sender.filter(|_| may_be_it) else {
            if may_be_it {
                self.sender = Some(Sender { address: from, last: now, is_new: true, before: 0 });
            } else {
                self.note_stranger(from, None);
            }
            return may_be_it;
        };
        let silent = now.since(sender.last);
        let is_same_host = sender.address.ip() == from.ip();
        let is_next_port = is_same_host
            && (self.tracker.is_some()
                || silent >= PORT_PATIENCE
                || (sender.is_new && from.port() != sender.before));
        let is_same = sender.address == from;
        if !(is_same || is_next_port || silent > SENDER_PATIENCE) {
            self.note_stranger(from, Some(now));
            return false;
        }
        if !is_same && silent >= PORT_PATIENCE {
            self.stream.forget_times();
        }
        let before = if is_same { sender.before } else { sender.address.port() };
        self.sender = Some(Sender { address: from, last: now, is_new: !is_same, before });
        true
    }

    /// Counts a datagram that is not taken. One that might be the tracker's makes it doubtful which of them is.
    fn note_stranger(&mut self, from: SocketAddr, doubted: Option<Instant>) {
        self.statistics.strangers += 1;
        self.statistics.stranger = Some(from.ip());
        self.doubted = doubted.or(self.doubted);
    }
}

impl PoseSource for UdpSource {
    fn poll(&mut self, now: Instant) -> Result<Option<PoseSample>, PoseError> {
        let mut buffer = [0; LONGEST + 1];
        for _ in 0..DATAGRAMS_AT_ONCE {
            let Some((length, from)) = transient(self.socket.recv_from(&mut buffer))? else {
                return Ok(None);
            };
            if !self.is_sender(from, now) {
                continue;
            }
            match parse(&buffer[..length]) {
                Err(unit) => {
                    self.statistics.unreadable += 1;
                    self.statistics.unit = unit.or(self.statistics.unit);
                }
                Ok(reading) => {
                    if let Some(sample) = self.judge(now, reading) {
                        return Ok(Some(sample));
                    }
                }
            }
        }
        Ok(None)
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Named {
    x: f64,
    y: f64,
    #[serde(default)]
    z: f64,
    #[serde(default)]
    roll: f64,
    #[serde(default)]
    pitch: f64,
    yaw: f64,
    #[serde(default = "trusted")]
    valid: bool,
    time: Option<f64>,
}

const fn trusted() -> bool {
    true
}

/// Latest time that is taken from a tracker, s: a later one is a slip. Unix time stays far below it.
const LATEST: f64 = 1e11;

/// A pose, whether the tracker trusts it, and when it was taken on the tracker's clock, if it states that.
type Reading = (Pose, bool, Option<Instant>);

/// Returns the six numbers of a datagram, or those that it names; `None` when it holds others.
fn numbers(datagram: &[u8]) -> Option<Named> {
    let text = std::str::from_utf8(datagram).ok().filter(|text| text.len() <= LONGEST)?.trim();
    if text.starts_with('{') {
        return serde_json::from_str(text).ok();
    }
    let numbers =
        text.split(|c: char| c == ',' || c.is_whitespace()).filter(|word| !word.is_empty());
    let numbers: Vec<f64> = numbers.map(str::parse).collect::<Result<_, _>>().ok()?;
    let [x, y, z, roll, pitch, yaw] = numbers.try_into().ok()?;
    Some(Named { x, y, z, roll, pitch, yaw, valid: true, time: None })
}

impl Named {
    /// Returns a number that is too large for its unit.
    fn wrong_unit(&self) -> Option<WrongUnit> {
        let [x, y, z] = ROOM;
        [
            ("x", self.x, x, "metres"),
            ("y", self.y, y, "metres"),
            ("z", self.z, z, "metres"),
            ("roll", self.roll, TAU, "radians"),
            ("pitch", self.pitch, TAU, "radians"),
            ("yaw", self.yaw, MOST_YAW, "radians"),
            ("time", self.time.unwrap_or_default(), LATEST, "seconds"),
        ]
        .into_iter()
        .find(|(_, value, most, _)| value.is_finite() && value.abs() > *most)
        .map(|(field, value, _, wanted)| WrongUnit { field, value: value as i64, wanted })
    }
}

/// Returns the content of a datagram.
///
/// # Errors
/// When it is no pose, with the number that is in another unit if one is.
fn parse(datagram: &[u8]) -> Result<Reading, Option<WrongUnit>> {
    let named = numbers(datagram).ok_or(None)?;
    if let Some(unit) = named.wrong_unit() {
        return Err(Some(unit));
    }
    let Named { x, y, z, roll, pitch, yaw, valid, time } = named;
    let pose = Pose { position: Vector { x, y, z }, orientation: rotation(roll, pitch, yaw) };
    if !pose.is_sound() || time.is_some_and(|seconds| !(0.0..=LATEST).contains(&seconds)) {
        return Err(None);
    }
    let taken = time.map(|seconds| Instant::from_micros((seconds * 1e6) as u64));
    Ok((pose, valid, taken))
}

/// Returns the rotation by `roll` about x, then `pitch` about y, then `yaw` about z, rad, all about fixed axes.
fn rotation(roll: f64, pitch: f64, yaw: f64) -> Quaternion {
    let [(sr, cr), (sp, cp), (sy, cy)] = [roll, pitch, yaw].map(|angle| (angle / 2.0).sin_cos());
    Quaternion {
        x: sr * cp * cy - cr * sp * sy,
        y: cr * sp * cy + sr * cp * sy,
        z: cr * cp * sy - sr * sp * cy,
        w: cr * cp * cy + sr * sp * sy,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::geometry::PlanarPose;

    fn at(milliseconds: u64) -> Instant {
        Instant::from_micros(milliseconds * 1000)
    }

    /// A source on a real socket, and two trackers.
    fn wired() -> (UdpSource, [UdpSocket; 2]) {
        let source = UdpSource::bind(Ipv4Addr::LOCALHOST, 0, None).unwrap();
        let trackers = [(); 2].map(|()| {
            let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
            socket.connect(source.address().unwrap()).unwrap();
            socket
        });
        (source, trackers)
    }

    /// Sends a datagram and polls until it was taken in, as a pose or in the counts.
    fn deliver(
        source: &mut UdpSource,
        from: &UdpSocket,
        text: &str,
        now: Instant,
    ) -> Option<PoseSample> {
        let count = |source: &UdpSource| {
            let seen = source.statistics();
            seen.poses + seen.unreadable + seen.strangers + seen.out_of_order
        };
        let before = count(source);
        from.send(text.as_bytes()).unwrap();
        let deadline = std::time::Instant::now() + Duration::from_secs(10);
        loop {
            let sample = source.poll(now).unwrap();
            if count(source) > before {
                return sample;
            }
            assert!(std::time::Instant::now() < deadline, "the datagram does not arrive");
            std::thread::yield_now();
        }
    }

    /// An error of a network that is away, or of another socket, does not end the poses.
    #[test]
    fn an_error_that_passes_does_not_end_the_poses() {
        let (mut source, [tracker, _]) = wired();
        let nobody = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap();
        source.socket.connect(nobody).unwrap();
        source.socket.send(b"?").unwrap();
        assert_eq!(source.poll(at(0)).unwrap(), None);
        source.socket.connect(tracker.local_addr().unwrap()).unwrap();
        assert!(deliver(&mut source, &tracker, "0 0 0.06 0 0 0", at(1)).is_some());
    }

    #[test]
    fn a_pose_that_was_taken_before_the_newest_or_comes_again_is_none() {
        let (mut source, [tracker, _]) = wired();
        let mut seen = |time: f64, now| {
            let text = format!(r#"{{"x":0,"y":0,"yaw":0,"time":{time}}}"#);
            deliver(&mut source, &tracker, &text, at(now)).is_some()
        };
        assert!(seen(100.0, 0) && seen(100.02, 20));
        assert!(!seen(100.01, 30) && !seen(100.02, 40), "late, and of a tracker that stands still");
        assert!(seen(100.03, 50));
        // A tracker that began anew.
        let anew = (0..30).filter(|n| seen(3.0 + 0.01 * *n as f64, 60 + n * 10)).count();
        assert!(anew == 20 && !seen(3.0 + 0.01 * 29.0, 360));
        assert_eq!((source.statistics().poses, source.statistics().out_of_order), (23, 13));
    }

    /// The samples of pictures that arrive and were taken at these times, ms, in one place, and the counts.
    fn samples(pictures: impl IntoIterator<Item = (u64, u64)>) -> (Vec<PoseSample>, UdpStatistics) {
        let (mut source, [tracker, _]) = wired();
        let samples = pictures.into_iter().filter_map(|(now, taken)| {
            let text = format!(r#"{{"x":0,"y":0,"yaw":0,"time":{}}}"#, taken as f64 * 1e-3);
            deliver(&mut source, &tracker, &text, at(now))
        });
        (samples.collect(), source.statistics())
    }

    #[test]
    fn poses_that_come_later_and_later_are_not_trusted_though_none_is_lost() {
        let lag = |t: u64| t.saturating_sub(8000).min(2000);
        let (samples, seen) = samples((0..2000).map(|n| n * 10).map(|t| (t + lag(t), 777 + t)));
        assert_eq!((samples.len(), seen.out_of_order), (2000, 0));
        assert!(samples[100..820].iter().all(|it| it.valid));
        assert!(samples[821..].iter().all(|it| !it.valid));
    }

    #[test]
    fn poses_of_a_path_that_is_slower_and_of_a_clock_that_is_set_back_are_not_trusted() {
        for pace in [10, 20, 33] {
            for slower in [231, 503, 4001] {
                // The faster path breaks after 5 s; by clocks alone it is the same as one that is set back.
                let taken = |n: u64| 10_000 + n * pace - if n * pace < 5000 { 0 } else { slower };
                let (samples, _) = samples((0..10_000 / pace).map(|n| (n * pace, taken(n))));
                let before = 5000 / pace as usize;
                assert!(samples.len() > before + 50, "{pace} {slower}");
                assert!(samples[before - 10].valid);
                assert!(samples[before + 10..].iter().all(|it| !it.valid), "{pace} {slower}");
            }
        }
    }

    #[test]
    fn an_echo_is_no_pose() {
        let echo = |n: u64| n.checked_sub(120).map(|n| n * 10);
        let pictures = (0..500).flat_map(|n| [Some(n * 10), echo(n)].map(move |it| (n * 10, it)));
        let (samples, seen) = samples(pictures.filter_map(|(now, it)| Some((now, it?))));
        assert_eq!((samples.len(), seen.out_of_order), (500, 380));
    }

    #[test]
    fn a_tracker_that_repeats_two_pictures_has_no_pose() {
        let (samples, _) = samples((0..500).map(|n| (n * 10, 1000 + 1500 * (n % 2))));
        assert_eq!(samples.len(), 2);
    }

    #[test]
    fn a_time_far_ahead_costs_one_pose() {
        let slip = |n: u64| if n % 100 == 50 { 900 } else { 0 };
        let (samples, seen) = samples((0..500).map(|n| (n * 10, n * 10 + slip(n))));
        assert_eq!((samples.len(), seen.out_of_order), (495, 5));
        assert!(samples[100..].iter().all(|it| it.valid));
    }

    #[test]
    fn text_and_json_are_the_same_pose() {
        let expected = PlanarPose { x: 0.51, y: -0.2, heading: 1.57 };
        for text in [
            "0.51 -0.20 0.06 0 0 1.57",
            "0.51,-0.2, 0.06,0,0,1.57\n",
            r#"{"x": 0.51, "y": -0.2, "yaw": 1.57}"#,
            r#"{"x":0.51,"y":-0.2,"z":0.06,"roll":0.0,"pitch":0,"yaw":1.57,"valid":true}"#,
        ] {
            let (pose, valid, _) = parse(text.as_bytes()).unwrap();
            let floor = pose.on_the_floor();
            assert!(valid && floor.distance_to(expected.position()) < 1e-12, "{text}: {floor:?}");
            assert!((floor.heading - expected.heading).abs() < 1e-12, "{text}: {floor:?}");
        }
    }

    #[test]
    fn angles_turn_the_body_as_rep_103_says() {
        // Pitched by a quarter turn, forward points down; rolled by one, left points up.
        let quarter = std::f64::consts::FRAC_PI_2;
        let half = std::f64::consts::FRAC_1_SQRT_2;
        for (angles, [w, x, y, z]) in [
            ([0.0, quarter, 0.0], [half, 0.0, half, 0.0]),
            ([quarter, 0.0, 0.0], [half, half, 0.0, 0.0]),
            ([quarter, 0.0, quarter], [0.5, 0.5, 0.5, 0.5]),
        ] {
            let found = rotation(angles[0], angles[1], angles[2]).components();
            let error =
                found.iter().zip([w, x, y, z]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(error < 1e-12, "{angles:?}: {found:?}");
        }
    }

    #[test]
    fn what_is_no_pose_is_counted_and_never_used() {
        let (mut source, [tracker, _]) = wired();
        for text in [
            "",
            "1 2 3",
            "1 2 3 4 5 6 7",
            "a b c d e f",
            "NaN 0 0 0 0 0",
            "inf 0 0 0 0 0",
            "{}",
            "[1,2]",
            r#"{"x":1,"y":2}"#,
            r#"{"x":1,"y":2,"yaw":null}"#,
            r#"{"x":1,"y":2,"yaw":0,"speed":1}"#,
            r#"{"x":1,"y":2,"yaw":0,"time":-1}"#,
            r#"{"x":1,"y":2,"yaw":0,"time":1e300}"#,
            "0 0 0 0 0 90",
            "\u{0}",
        ] {
            assert_eq!(deliver(&mut source, &tracker, text, at(0)), None, "{text}");
        }
        let long = format!("0 0 0 0 0 0{}", " ".repeat(LONGEST));
        assert_eq!(deliver(&mut source, &tracker, &long, at(0)), None);
        assert_eq!(source.statistics().unreadable, 16);
    }

    #[test]
    fn a_tracker_may_state_when_the_picture_was_taken() {
        let taken = |text: &str| parse(text.as_bytes()).unwrap().2;
        assert_eq!(taken(r#"{"x":1,"y":2,"yaw":0,"time":12.5}"#), Some(at(12_500)));
        assert_eq!(taken(r#"{"x":1,"y":2,"yaw":0}"#), None);
    }

    #[test]
    fn a_steady_stream_is_trusted_and_a_jump_ends_that() {
        let (mut source, [tracker, _]) = wired();
        let mut send = |place: &str, now| deliver(&mut source, &tracker, place, now).unwrap().valid;
        let steady: Vec<bool> = (0..=30).map(|i| send("0 0 0.06 0 0 0", at(i * 10))).collect();
        assert!(!steady[0] && steady[30], "{steady:?}");
        assert!(!send("0.5 0 0.06 0 0 0", at(310)), "a jump");
        assert_eq!(source.statistics().jumps, 1);
    }

    #[test]
    fn while_two_send_neither_is_trusted() {
        let (mut source, [tracker, stranger]) = wired();
        let mut sent = |from: &UdpSocket, milliseconds: u64| {
            let sample = deliver(&mut source, from, "0 0 0.06 0 0 0", at(milliseconds));
            sample.is_some_and(|it| it.valid)
        };
        assert!((0..=30).map(|i| sent(&tracker, i * 10)).last().unwrap());
        assert!(!sent(&stranger, 305) && !sent(&tracker, 310));
        // Once the other has been silent.
        assert!((31..=260).map(|i| sent(&tracker, i * 10)).last().unwrap());
    }

    #[test]
    fn where_the_tracker_is_named_others_are_not_looked_at() {
        let named = |tracker: [u8; 4]| {
            let (mut source, [sender, _]) = wired();
            source.tracker = Some(tracker.into());
            deliver(&mut source, &sender, "0 0 0.06 0 0 0", at(0)).is_some()
        };
        assert!(named([127, 0, 0, 1]) && !named([127, 0, 0, 2]));
    }

    #[test]
    fn a_number_in_another_unit_is_named_and_two_turns_of_yaw_are_radians() {
        let heading = parse(b"0 0 0.06 0 0 7.0").unwrap().0.on_the_floor().heading;
        assert!((heading - (7.0 - TAU)).abs() < 1e-12, "{heading}");
        for (text, named) in [
            ("510 -200 60 0 0 1.57", "x is 510, which is not in metres"),
            ("5 3 60 0 0 1.57", "z is 60, which is not in metres"),
            ("0.5 0.2 0.06 0 0 90", "yaw is 90, which is not in radians"),
            ("0.5 0.2 0.06 0 -12 1", "pitch is -12, which is not in radians"),
            (r#"{"x":0,"y":0,"yaw":0,"time":1764455000000}"#, "which is not in seconds"),
        ] {
            let unit = parse(text.as_bytes()).unwrap_err().unwrap().to_string();
            assert!(unit.contains(named), "{text}: {unit}");
        }
    }

    #[test]
    fn a_tracker_that_sends_each_pose_from_another_port_is_one_sender() {
        for tracker in [None, Some([127, 0, 0, 1].into())] {
            let (mut source, _) = wired();
            source.tracker = tracker;
            let ports: Vec<UdpSocket> = (0..40)
                .map(|_| {
                    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
                    socket.connect(source.address().unwrap()).unwrap();
                    socket
                })
                .collect();
            let mut sent = ports.iter().zip(0..).map(|(port, number)| {
                deliver(&mut source, port, "0 0 0.06 0 0 0", at(10 * number)).unwrap().valid
            });
            assert!(sent.any(|is_trusted| is_trusted));
            assert_eq!(source.statistics().strangers, 0);
        }
    }

    #[test]
    fn a_second_sender_is_dropped_until_the_first_is_silent() {
        let (mut source, [tracker, stranger]) = wired();
        assert!(deliver(&mut source, &tracker, "0 0 0 0 0 0", at(0)).is_some());
        assert!(deliver(&mut source, &tracker, "0 0 0 0 0 0", at(10)).is_some());
        assert_eq!(deliver(&mut source, &stranger, "1 0 0 0 0 0", at(50)), None);
        assert_eq!(source.statistics().strangers, 1);
        assert!(deliver(&mut source, &stranger, "1 0 0 0 0 0", at(111)).is_some());
    }
}
