//! Frames that have not come, by their numbers.

/// The last frames, and whether each has come.
#[derive(Debug, Default)]
pub(super) struct Missing {
    newest: Option<i32>,
    /// Bit n: the frame whose number is less than the newest by n has come, or is not missed.
    seen: u128,
}

impl Missing {
    /// Takes the newest frame of a stream, and returns how many between it and the newest before have not come: none where
    /// the stream begins, at first or anew.
    pub(super) fn take(&mut self, frame: i32) -> u64 {
        let before = self.newest.replace(frame);
        let ahead = before.map_or(0, |before| i64::from(frame) - i64::from(before));
        if ahead <= 0 {
            self.seen = u128::MAX;
            return 0;
        }
        let shift = u32::try_from(ahead).unwrap_or(u32::MAX);
        self.seen = self.seen.checked_shl(shift).unwrap_or(0) | 1;
        ahead.unsigned_abs() - 1
    }

    /// Takes a frame out of order, and returns whether it was missed.
    pub(super) fn take_late(&mut self, frame: i32) -> bool {
        let behind = self.newest.map_or(-1, |newest| i64::from(newest) - i64::from(frame));
        let place = u32::try_from(behind).ok().and_then(|behind| 1_u128.checked_shl(behind));
        let is_missed = place.is_some_and(|place| self.seen & place == 0);
        self.seen |= place.unwrap_or(0);
        is_missed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_may_begin_anew_and_have_any_gap() {
        let missing = |frames: &[i32]| {
            let mut missing = Missing::default();
            frames.iter().map(|frame| missing.take(*frame)).sum::<u64>()
        };
        // Frames before the first count as not missing.
        assert_eq!(missing(&[500, 1, 2]), 0);
        assert_eq!(missing(&[0, 127, 255, 256]), 126 + 127);
        assert_eq!(missing(&[i32::MIN, i32::MAX, i32::MIN]), u64::from(u32::MAX) - 1);
    }

    #[test]
    fn a_late_frame_is_missed_once() {
        let mut missing = Missing::default();
        assert!(!missing.take_late(3), "before any other");
        missing.take(7);
        missing.take(10);
        let late = [8, 8, 9, 10, 11, 7, 6, i32::MIN].map(|frame| missing.take_late(frame));
        assert_eq!(late, [true, false, true, false, false, false, false, false]);
    }
}
