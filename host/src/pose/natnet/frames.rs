//! Judges the frames of a stream: order, delay, and trust in their poses.

use std::net::IpAddr;
use std::time::Duration;

use flix_protocol::units::Instant;

use super::missing::Missing;
use crate::pose::order::Stamp;
use crate::pose::stream::Stream;
use crate::pose::{Picture, Pose, PoseSample};

/// Counts of the frames received so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct NatNetStatistics {
    /// Datagrams of any kind from the server.
    pub datagrams: u64,
    /// Frames among them.
    pub frames: u64,
    /// Datagrams that could not be read.
    pub unreadable: u64,
    /// Frames without the robot's body.
    pub without_body: u64,
    /// Frames whose body was not tracked.
    pub untracked: u64,
    /// Frames that never came, by the gaps in their numbers.
    pub lost: u64,
    /// Poses out of reach of the pose before them.
    pub jumps: u64,
    /// Most by which a frame came later than the fastest one.
    pub spread: Duration,
    /// Datagrams from other addresses than the server's; they were dropped.
    pub strangers: u64,
    /// Address of the last of these.
    pub stranger: Option<IpAddr>,
}

/// Content of one datagram.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NatNetReading {
    /// Number of the frame.
    pub frame: i32,
    /// The robot's pose and whether it is tracked; `None`: the frame has no such body.
    pub body: Option<(Pose, bool)>,
    /// When the cameras were exposed, and when the frame was sent, in ticks of the server's clock; 0: not stated.
    pub ticks: [u64; 2],
    /// Whether the server says that its list of bodies has changed.
    pub is_list_changed: bool,
}

/// The frames of a stream.
#[derive(Debug, Default)]
pub(super) struct Frames {
    newest: Option<NatNetReading>,
    stream: Stream,
    missing: Missing,
    pub(super) statistics: NatNetStatistics,
}

/// Result of a frame.
#[derive(Debug)]
pub(super) struct Judged {
    /// The pose, if it is newer than all before it.
    pub(super) sample: Option<PoseSample>,
    /// Whether the numbers of the bodies may be others now.
    pub(super) is_doubtful: bool,
}

impl Frames {
    /// Takes a frame that came now, of a clock that makes so many ticks a second.
    pub(super) fn take(&mut self, now: Instant, reading: &NatNetReading, frequency: u64) -> Judged {
        let has_changed =
            reading.is_list_changed && self.newest.is_none_or(|newest| !newest.is_list_changed);
        let [exposed, sent] = reading.ticks.map(|ticks| time(ticks, frequency));
        // The server sends a recording, too, now: its numbers begin anew, and the time at which it sends goes on.
        let stamp = sent.map_or(Stamp::Number(reading.frame), Stamp::Time);
        let seen = reading.body.as_ref().filter(|(_, tracked)| *tracked).map(|(pose, _)| pose);
        // A recording that is paused is sent again and again.
        let newer = if self.newest.is_some_and(|newest| newest.frame == reading.frame) {
            self.stream.pass(now, Some(stamp), seen);
            None
        } else {
            self.stream.take(now, Some(stamp), exposed.or(sent), seen)
        };
        let statistics = &mut self.statistics;
        statistics.jumps = self.stream.jumps();
        let Some(newer) = newer else {
            let was_missed = u64::from(self.missing.take_late(reading.frame));
            statistics.frames += was_missed;
            statistics.lost -= was_missed;
            return Judged { sample: None, is_doubtful: has_changed };
        };
        let before = self.newest.replace(*reading);
        let is_back = before.is_some_and(|before| reading.frame < before.frame);
        statistics.spread = statistics.spread.max(newer.late);
        statistics.frames += 1;
        statistics.lost += self.missing.take(reading.frame);
        match reading.body {
            None => statistics.without_body += 1,
            Some((_, false)) => statistics.untracked += 1,
            Some((_, true)) => {}
        }
        let picture = exposed.map(|exposed| Picture {
            exposed,
            sent: sent.unwrap_or(exposed).max(exposed),
            late: newer.late,
        });
        let valid = newer.is_trusted;
        let sample = reading.body.map(|(pose, _)| PoseSample { time: now, pose, valid, picture });
        Judged { sample, is_doubtful: has_changed || is_back || newer.is_anew }
    }
}

/// Returns the time of so many ticks of a clock that makes so many a second; `None` where it is not stated.
fn time(ticks: u64, frequency: u64) -> Option<Instant> {
    let micros = (u128::from(ticks) * 1_000_000).checked_div(u128::from(frequency))?;
    let stated = u64::try_from(micros).ok().filter(|micros| *micros > 0)?;
    Some(Instant::from_micros(stated))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::Pose;
    use crate::pose::geometry::PlanarPose;

    const FREQUENCY: u64 = 10_000_000;
    const TICKS_PER_MILLISECOND: u64 = FREQUENCY / 1000;

    /// A frame with this number, sent then, ms.
    fn frame(frame: i32, sent: u64) -> NatNetReading {
        let pose = Pose::planar(PlanarPose::default(), 0.06);
        let sent = (1_000_000 + sent) * TICKS_PER_MILLISECOND;
        let ticks = [sent - 5 * TICKS_PER_MILLISECOND, sent];
        NatNetReading { frame, body: Some((pose, true)), ticks, is_list_changed: false }
    }

    /// The samples of frames that come at these times, ms, and the counts.
    fn samples(
        frames: impl IntoIterator<Item = (u64, NatNetReading)>,
    ) -> (Vec<PoseSample>, NatNetStatistics) {
        let mut stream = Frames::default();
        let samples = frames.into_iter().filter_map(|(now, reading)| {
            stream.take(Instant::from_micros(now * 1000), &reading, FREQUENCY).sample
        });
        (samples.collect(), stream.statistics)
    }

    #[test]
    fn poses_that_come_later_and_later_are_not_trusted_though_none_is_lost() {
        let lag = |t: u64| t.saturating_sub(8000).min(2000);
        let plain = (0..3000).map(|n| (n * 10 + lag(n * 10), frame(n as i32, n * 10)));
        // Where the exposure is not stated, by the time of sending.
        let unstated =
            plain.clone().map(|(now, it)| (now, NatNetReading { ticks: [0, it.ticks[1]], ..it }));
        for (samples, seen) in [samples(plain), samples(unstated)] {
            assert!(samples[100..820].iter().all(|it| it.valid));
            assert!(samples[821..].iter().all(|it| !it.valid), "{seen:?}");
            let spread = seen.spread.as_secs_f64();
            assert!(samples.len() == 3000 && (1.99..=2.0).contains(&spread), "{seen:?}");
        }
    }

    #[test]
    fn frames_count_once_however_they_come() {
        let burst =
            |n: u64| (n * 24..(n + 1) * 24).map(move |it| (n * 240, frame(it as i32, it * 10)));
        let (twice, seen) = samples((0..20).flat_map(|n| burst(n).chain(burst(n))));
        assert_eq!((twice.len(), seen.frames, seen.lost), (480, 480, 0));
        // Of 50, 14 come when the 30th has come.
        let late = (0..500_u64).flat_map(|n| {
            let burst = if n % 50 == 30 { n - 30..n - 16 } else { 0..0 };
            burst
                .chain((n % 50 >= 14).then_some(n))
                .map(move |it| (n * 10, frame(it as i32, it * 10)))
        });
        let (late, seen) = samples(late);
        // The first come before there is one that they could be missed after.
        assert_eq!((late.len(), seen.frames, seen.lost), (360, 500 - 14, 0));
    }

    #[test]
    fn a_second_stream_that_is_a_little_ahead_is_not_trusted() {
        let elsewhere = Pose::planar(PlanarPose { x: 0.5, y: 0.0, heading: 0.0 }, 0.06);
        let forged = |n: u64| NatNetReading {
            body: Some((elsewhere, true)),
            ..frame(n as i32 + 5, n * 10 + 50)
        };
        let (samples, seen) = samples(
            (0..500).flat_map(|n| [frame(n as i32, n * 10), forged(n)].map(|it| (n * 10, it))),
        );
        assert!(samples.iter().all(|it| !it.valid) && seen.jumps > 400, "{seen:?}");
    }

    #[test]
    fn a_recording_of_any_length_goes_on() {
        for length in [2, 10, 12, 50, 500] {
            let frames = (0..1000_u64).map(|n| (n * 10, frame((n % length) as i32, n * 10)));
            let (samples, seen) = samples(frames);
            assert_eq!((samples.len(), seen.lost), (1000, 0), "{length}");
        }
    }

    #[test]
    fn a_recording_that_is_paused_is_no_pose() {
        let (samples, _) = samples((0..100).map(|n| (n * 10, frame(7, n * 10))));
        assert_eq!(samples.len(), 1);
    }

    #[test]
    fn a_clock_that_cannot_be_read_does_not_stop_the_frames() {
        for frequency in [0, u64::MAX] {
            let mut stream = Frames::default();
            let mut take = |n: i32| {
                let now = Instant::from_micros(n as u64 * 10_000);
                stream.take(now, &frame(n, n as u64 * 10), frequency).sample
            };
            let samples: Vec<_> = (0..100).filter_map(&mut take).collect();
            assert!(samples.len() == 100 && samples[99].valid && samples[99].picture.is_none());
        }
    }

    #[test]
    fn a_server_that_starts_anew_is_followed_and_its_bodies_are_doubted() {
        let mut stream = Frames::default();
        let mut take = |now: u64, reading: NatNetReading| {
            let Judged { sample, is_doubtful } =
                stream.take(Instant::from_micros(now * 1000), &reading, FREQUENCY);
            (sample.is_some(), is_doubtful)
        };
        for n in 0..300 {
            assert_eq!(take(n * 10, frame(n as i32, 500_000 + n * 10)), (true, false));
        }
        // On a computer that starts anew, its clock does, too.
        let found: Vec<_> =
            (0..100).map(|n| take(4000 + n * 10, frame(n as i32, n * 10))).collect();
        assert_eq!(found.iter().position(|it| it.0), Some(10));
        assert!(found[10].1 && found[11..].iter().all(|it| *it == (true, false)), "{found:?}");
    }
}
