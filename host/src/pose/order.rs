//! Pictures in the order in which they were taken: a network may deliver them late, twice, or not at all.
//!
//! A picture is next when its stamp is after the newest one, and no more than [`AHEAD`] ahead of the time that has passed
//! since. One slip ahead therefore does not shut out those after it. A stream began anew (its tracker started again, its clock
//! was set, a recording is played again) when [`ANEW`] pictures in a row ascend during [`ANEW_TIME`], none of them next: pictures
//! that waited in a queue come at once. Times that came before come from an echo or from a tracker that stands still, and
//! count for nothing.
//!
//! Frames that state no time are ordered by their numbers. Then nothing distinguishes an echo from a recording that is played again:
//! both go on after [`ANEW_TIME`], and a recording that is shorter does not. With times, a recording that repeats its old ones
//! goes on if it has more than [`REMEMBERED`] pictures.

use std::collections::VecDeque;
use std::time::Duration;

use flix_protocol::units::Instant;

/// Pictures in a row, each taken after the one before it, after which a stream began anew.
const ANEW: u32 = 10;
/// Shortest time in which they come.
const ANEW_TIME: Duration = Duration::from_millis(100);
/// Most by which the tracker's clock may get ahead of ours from one picture to the next: a network's delay, and a clock
/// with a resolution of tens of milliseconds.
const AHEAD: Duration = Duration::from_millis(100);
/// Times that are known again: of ten seconds at 100 Hz.
const REMEMBERED: usize = 1024;

/// Where a picture is in its stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Stamp {
    /// Its number, where no time is stated.
    Number(i32),
    /// When it was taken or sent, on the tracker's clock.
    Time(Instant),
}

/// When a picture came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Arrival {
    /// After all that were taken before it.
    Next,
    /// As the newest of a stream that began anew.
    Anew,
    /// After one that was taken later, or once more, or it is a slip.
    OutOfOrder,
}

/// Pictures out of order that may be of a stream that began anew.
#[derive(Debug, Clone, Copy)]
struct Row {
    since: Instant,
    last: Stamp,
    count: u32,
    /// Those in a row that came since and were taken before it: a network may shuffle few.
    behind: u32,
}

/// The pictures of a stream, and whether each has come. Takes constant memory; never panics.
#[derive(Debug, Default)]
pub(super) struct Order {
    /// The newest, and when it came.
    newest: Option<(Instant, Stamp)>,
    /// Times of the last that were in order.
    taken: VecDeque<Stamp>,
    row: Option<Row>,
}

impl Stamp {
    fn is_after(self, newest: Self, passed: Duration) -> bool {
        let is_slip = match (newest, self) {
            (Self::Time(newest), Self::Time(time)) => time.since(newest) > passed + AHEAD,
            _ => false,
        };
        self > newest && !is_slip
    }
}

impl Order {
    /// Takes a picture that came now.
    pub(super) fn take(&mut self, now: Instant, stamp: Stamp) -> Arrival {
        if self.taken.contains(&stamp) {
            return Arrival::OutOfOrder;
        }
        let is_next = self.newest.is_none_or(|(at, newest)| stamp.is_after(newest, now.since(at)));
        if !is_next && !self.is_anew(now, stamp) {
            return Arrival::OutOfOrder;
        }
        (self.newest, self.row) = (Some((now, stamp)), None);
        if matches!(stamp, Stamp::Time(_)) {
            self.taken.truncate(REMEMBERED - 1);
            self.taken.push_front(stamp);
        }
        if is_next { Arrival::Next } else { Arrival::Anew }
    }

    /// Returns the time between a picture and the newest, where both state theirs.
    pub(super) fn apart(&self, stamp: Stamp) -> Option<Duration> {
        match (self.newest?.1, stamp) {
            (Stamp::Time(newest), Stamp::Time(time)) => {
                Some(newest.since(time).max(time.since(newest)))
            }
            _ => None,
        }
    }

    /// Takes a picture out of order, and returns whether the stream began anew.
    fn is_anew(&mut self, now: Instant, stamp: Stamp) -> bool {
        let row = match self.row {
            Some(row) if stamp > row.last => {
                Row { last: stamp, count: row.count + 1, behind: 0, ..row }
            }
            Some(row) if row.behind < ANEW => Row { behind: row.behind + 1, ..row },
            _ => Row { since: now, last: stamp, count: 0, behind: 0 },
        };
        self.row = Some(row);
        row.last == stamp && row.count >= ANEW && now.since(row.since) >= ANEW_TIME
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time(milliseconds: u64) -> Stamp {
        Stamp::Time(Instant::from_micros(milliseconds * 1000))
    }

    /// The pictures that are newer than all before them, of those that come then, ms.
    fn newer(pictures: impl IntoIterator<Item = (u64, Stamp)>) -> Vec<Stamp> {
        let mut order = Order::default();
        let mut is_newer = |now: u64, stamp| {
            order.take(Instant::from_micros(now * 1000), stamp) != Arrival::OutOfOrder
        };
        pictures.into_iter().filter(|(now, it)| is_newer(*now, *it)).map(|it| it.1).collect()
    }

    #[test]
    fn what_comes_late_or_twice_is_not_newer() {
        // Every fifth swapped with the next, every 20th late by ten, all twice.
        let mut sent: Vec<u64> = (0..200).collect();
        for at in (0..190).step_by(5) {
            sent.swap(at, at + 1);
        }
        for at in (0..180).step_by(20) {
            sent[at..=at + 10].rotate_left(1);
        }
        let pictures = (0..).map(|n| n * 10).zip(sent).flat_map(|it| [it, it]);
        for stamp in [|n| time(5000 + n * 10), |n| Stamp::Number(n as i32 - 100)] {
            let newer = newer(pictures.clone().map(|(now, n)| (now, stamp(n))));
            assert!(newer.is_sorted_by(|one, next| one < next), "{newer:?}");
            assert!(newer.len() > 140, "{}", newer.len());
        }
    }

    #[test]
    fn what_comes_once_more_in_one_go_is_not_newer() {
        // 24 pictures are kept back and sent together, twice.
        let burst = |n: u64| (n * 24..(n + 1) * 24).map(move |it| (n * 240, it));
        let pictures = (0..20).flat_map(|n| burst(n).chain(burst(n)));
        for stamp in [|n| time(5000 + n * 10), |n| Stamp::Number(n as i32)] {
            let newer = newer(pictures.clone().map(|(now, n)| (now, stamp(n))));
            assert_eq!(newer, (0..480).map(stamp).collect::<Vec<_>>());
        }
    }

    #[test]
    fn what_comes_late_in_one_go_is_not_newer() {
        // Of 50, 14 come when the 30th has come.
        let late = |n: u64| n % 50 < 14;
        let pictures = (0..500_u64).flat_map(|n| {
            let burst = if n % 50 == 30 { n - 30..n - 16 } else { 0..0 };
            let now = (!late(n)).then_some(n);
            burst.chain(now).map(move |it| (n * 10, it))
        });
        for stamp in [|n| time(5000 + n * 10), |n| Stamp::Number(n as i32)] {
            let newer = newer(pictures.clone().map(|(now, n)| (now, stamp(n))));
            assert_eq!(newer, (0..500).filter(|n| !late(*n)).map(stamp).collect::<Vec<_>>());
        }
    }

    #[test]
    fn an_echo_is_not_newer_even_while_it_comes_alone() {
        // The stream is away for half a second, and its echo is not.
        let pictures = (0..400_u64).flat_map(|n| {
            let echo = n.checked_sub(120);
            let alone = (200..250).contains(&n);
            (!alone).then_some(n).into_iter().chain(echo).map(move |it| (n * 10, time(it * 10)))
        });
        assert_eq!(newer(pictures).len(), 350);
    }

    #[test]
    fn pictures_that_alternate_are_not_newer() {
        let newer = newer((0..2000).map(|n| (n * 10, time(1000 + 1500 * (n % 2)))));
        assert_eq!(newer, [time(1000), time(2500)]);
    }

    #[test]
    fn a_slip_shuts_out_nothing() {
        for slip in [-3_600_000, -900, 101, 900, 3_600_000] {
            let stamp = |n: i64| {
                let slip = if n % 100 == 50 { slip } else { 0 };
                time((10_000_000 + n * 10 + slip) as u64)
            };
            let newer = newer((0..1000).map(|n| (n * 10, stamp(n as i64))));
            assert_eq!(newer.len(), 990, "{slip} ms");
        }
    }

    #[test]
    fn a_first_picture_far_ahead_shuts_out_a_tenth_of_a_second() {
        let stamp = |n| time(if n == 0 { 1_000_000_000 } else { n * 10 });
        assert_eq!(newer((0..100).map(|n| (n * 10, stamp(n)))).len(), 1 + 99 - 10);
    }

    #[test]
    fn a_clock_that_is_set_costs_a_tenth_of_a_second() {
        for step in [-5_000_000, -903, -157, 157, 903, 5_000_000] {
            let stamp = |n: i64| (10_000_003 + n * 10 + if n < 100 { 0 } else { step }) as u64;
            let found = newer((0..200).map(|n| (n * 10, time(stamp(n as i64)))));
            assert_eq!(found.len(), 190, "{step} ms");
            // Over a network that shuffles, too.
            let shuffled = (0..200).map(|n| (n * 10, time(stamp(n as i64 ^ 1))));
            assert!(newer(shuffled).len() > 80, "{step} ms");
        }
    }

    #[test]
    fn a_pause_and_coarse_times_shut_out_nothing() {
        let paused = (0..100).map(|n| n * 10 + if n < 50 { 0 } else { 7000 });
        assert_eq!(newer(paused.map(|now| (now, time(now)))).len(), 100);
        assert_eq!(newer((0..300).map(|n| (n * 7, time(n * 7 / 10 * 10)))).len(), 210);
        assert_eq!(newer((0..300).map(|n| (n * 10, time(n / 100 * 1000)))).len(), 3);
    }

    #[test]
    fn a_recording_that_is_played_again_goes_on() {
        let numbers = (0..400).map(|n| (n * 10, Stamp::Number(1000 + n as i32 % 80)));
        assert_eq!(newer(numbers).len(), 400 - 4 * 10);
        let times = (0..6000).map(|n| (n * 10, time(n % 1500 * 10)));
        assert_eq!(newer(times).len(), 6000 - 3 * 10);
    }

    #[test]
    fn numbers_may_have_any_gap() {
        let numbers = [i32::MIN, -1, 0, 127, 5000, i32::MAX].map(Stamp::Number);
        assert_eq!(newer(numbers.map(|it| (0, it))), numbers);
    }
}
