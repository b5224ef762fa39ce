//! Frames in the order in which they were sent: a network may deliver them late, twice, or not at all.

/// Frames by which a network may shuffle two of them: one that is farther back is of a stream that began anew.
pub(super) const SHUFFLED: i32 = 100;

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
}

impl Order {
    /// Takes the number of a frame.
    pub(super) fn take(&mut self, frame: i32) -> Arrival {
        let ahead = self.newest.map(|newest| i64::from(frame) - i64::from(newest));
        let missing = match ahead {
            Some(behind) if (-i64::from(SHUFFLED)..=0).contains(&behind) => {
                let place = 1 << behind.unsigned_abs();
                let is_new = self.seen & place == 0;
                self.seen |= place;
                return if is_new { Arrival::Late } else { Arrival::Again };
            }
            Some(ahead @ 1..) => {
                let shift = u32::try_from(ahead).unwrap_or(u32::MAX);
                self.seen = self.seen.checked_shl(shift).unwrap_or(0);
                ahead.unsigned_abs() - 1
            }
            // A stream that begins: none before it is missed.
            _ => {
                self.seen = u128::MAX;
                0
            }
        };
        self.seen |= 1;
        self.newest = Some(frame);
        Arrival::Newest { missing }
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
    fn a_stream_may_begin_anew_and_have_any_gap() {
        // What was sent before the first is not missed.
        assert_eq!(counted(&[500, 1, 2, 0]), (vec![500, 1, 2], 0, 1));
        assert_eq!(counted(&[0, 127, 255, 256]), (vec![0, 127, 255, 256], 126 + 127, 0));
        assert_eq!(counted(&[0, 100, 0, 1]), (vec![0, 100], 98, 1));
        let ends = [i32::MIN, i32::MAX, i32::MIN];
        assert_eq!(counted(&ends), (ends.to_vec(), u64::from(u32::MAX) - 1, 0));
    }
}
