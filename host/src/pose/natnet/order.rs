//! Frames in the order in which they were sent: a network may deliver them late, twice, or not at all.

/// Frames by which a network may shuffle two of them: one that is farther back is of a stream that began anew.
pub(super) const SHUFFLED: i32 = 100;

/// Frames before the newest in a row, each sent after the one before it, after which a stream began anew: a recording that is
/// played again and again. No network shuffles so many.
const ANEW: u32 = 10;

/// When a frame came.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Arrival {
    /// Before all of larger numbers; so many between it and the newest have not come.
    Newest { missing: u64 },
    /// After one that was sent later.
    Late,
    /// Not for the first time.
    Again,
}

/// Which frames of a stream have come.
#[derive(Debug, Default)]
pub(super) struct Order {
    newest: Option<i32>,
    /// Bit n: the frame whose number is less than the newest by n has come, or is not missed.
    seen: u128,
    /// The last frame, where it was before the newest, and how many of those came in a row in the order in which they were sent.
    behind: Option<(i32, u32)>,
}

impl Order {
    /// Takes the number of a frame.
    pub(super) fn take(&mut self, frame: i32) -> Arrival {
        let ahead = self.newest.map(|newest| i64::from(frame) - i64::from(newest));
        let missing = match ahead {
            Some(behind)
                if (-i64::from(SHUFFLED)..=0).contains(&behind) && !self.is_anew(frame) =>
            {
                let place = 1 << behind.unsigned_abs();
                let is_new = self.seen & place == 0;
                self.seen |= place;
                return if is_new { Arrival::Late } else { Arrival::Again };
            }
            Some(ahead) if ahead > 0 => {
                let shift = u32::try_from(ahead).unwrap_or(u32::MAX);
                self.seen = self.seen.checked_shl(shift).unwrap_or(0);
                ahead.unsigned_abs() - 1
            }
            // A stream that begins, at first or anew: none before it is missed.
            _ => {
                self.seen = u128::MAX;
                0
            }
        };
        self.seen |= 1;
        (self.newest, self.behind) = (Some(frame), None);
        Arrival::Newest { missing }
    }

    /// Takes a frame before the newest, and returns whether the stream began anew.
    fn is_anew(&mut self, frame: i32) -> bool {
        let row = self.behind.map_or(0, |(last, row)| if frame > last { row + 1 } else { 0 });
        self.behind = Some((frame, row));
        row >= ANEW
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(frames: &[i32]) -> (Vec<i32>, u64, usize) {
        let (mut order, mut newest, mut lost, mut again) = (Order::default(), Vec::new(), 0, 0);
        for frame in frames {
            match order.take(*frame) {
                Arrival::Newest { missing } => {
                    newest.push(*frame);
                    lost += missing;
                }
                Arrival::Late => lost -= 1,
                Arrival::Again => again += 1,
            }
        }
        (newest, lost, again)
    }

    #[test]
    fn what_comes_late_is_not_lost_and_what_comes_twice_counts_once() {
        // Every fifth swapped with the next, every 20th late by ten, the 30th and the 31st lost, all twice.
        let mut frames: Vec<i32> = (7..207).filter(|it| !(30..32).contains(it)).collect();
        for at in (0..190).step_by(5) {
            frames.swap(at, at + 1);
        }
        for at in (0..180).step_by(20) {
            frames[at..=at + 10].rotate_left(1);
        }
        let twice: Vec<i32> = frames.iter().flat_map(|it| [*it, *it]).collect();
        let (newest, lost, again) = counted(&twice);
        assert!(newest.is_sorted_by(|one, next| one < next), "{newest:?}");
        assert_eq!((lost, again), (2, frames.len()));
    }

    #[test]
    fn a_recording_that_is_played_again_and_again_goes_on() {
        let round: Vec<i32> = (1000..1080).collect();
        let (newest, lost, _) = counted(&round.repeat(5));
        assert_eq!(lost, 0);
        assert!(newest.len() > 5 * (80 - 12), "{} of 400", newest.len());
    }

    #[test]
    fn a_stream_may_begin_anew_and_have_any_gap() {
        // What was sent before the first is not missed.
        assert_eq!(counted(&[500, 1, 2, 0]), (vec![500, 1, 2], 0, 1));
        assert_eq!(counted(&[0, 127, 255, 256]), (vec![0, 127, 255, 256], 126 + 127, 0));
        assert_eq!(counted(&[0, 100, 0, 1]), (vec![0, 100], 98, 1));
        let ends = [i32::MIN, i32::MAX, i32::MIN];
        assert_eq!(counted(&ends), (ends.to_vec(), u64::from(u32::MAX) - 1, 0));
    }
}
