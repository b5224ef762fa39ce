//! Drops: somebody holds the robot level over the floor and releases it; motion capture sees the rest.
//!
//! A drop begins where the height leaves that at which the robot was held. The release is found from the fall:
//! each picture at the depth `d` was taken `sqrt(2 d / g)` after it, and their mean counts. What does not fall freely, such
//! as a robot that a hand puts down, is no drop.

use std::collections::VecDeque;

use super::{Column, seconds};
use crate::pose::PoseSample;

/// Columns of `drops.csv`.
pub const COLUMNS: [Column; 4] = [
    Column::new("drop", 0),
    Column::new("height_mm", 3),
    Column::new("t_s", 6),
    Column::new("z_mm", 4),
];

/// Usual height of the soles over the floor, mm.
pub const HEIGHT: f64 = 20.0;
/// Heights that can be measured, mm.
pub const HEIGHTS: std::ops::RangeInclusive<f64> = 5.0..=100.0;

/// Acceleration of a fall, m/s^2.
const GRAVITY: f64 = 9.81;
/// Time after the touch that is kept, s: 0.1 s are needed.
const AFTER: f64 = 0.11;
/// Intervals of the identification from the touch on, s, and their number: each takes two pictures.
const INTERVAL: f64 = 4e-3;
const INTERVALS: usize = 25;
/// Age of the pictures, s, in which a robot that is held is still: the newest may show its fall already.
const STILL: std::ops::RangeInclusive<f64> = 0.1..=0.3;
/// How much its height may scatter then, m (standard deviation).
const STILL_WITHIN: f64 = 1e-3;
/// Share of the height from which on, and up to which, a fall is compared with a free one.
const COMPARED: std::ops::RangeInclusive<f64> = 0.25..=0.8;
/// Largest scatter of the moments of release that the pictures of one fall show, s (standard deviation).
const SCATTER: f64 = 4e-3;
/// Time for which pictures are kept, s.
const KEPT: f64 = 1.5;

/// Why a fall was no drop.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoDrop {
    /// It was put down.
    #[error("this was no free fall: release the robot at once")]
    NotFree,
    /// From elsewhere.
    #[error(
        "the robot fell by {fell:.0} mm, and the height is {height:.0} mm: hold the soles so high, or give --height"
    )]
    OtherHeight {
        /// How far its body fell, mm.
        fell: f64,
        /// How far it should have, mm.
        height: f64,
    },
    /// Too slow cameras.
    #[error(
        "{rate:.0} pictures a second of this drop, and 500 are needed without a gap: raise the rate of the cameras"
    )]
    FewPictures {
        /// Pictures a second.
        rate: f64,
    },
    /// The pictures carry no times.
    #[error(
        "the poses do not state when they were taken: stream NatNet 3.0 or later, or JSON with \"time\""
    )]
    NoTimes,
}

/// Drops under way; see the module's documentation.
#[derive(Debug, Clone)]
pub struct Drops {
    /// m.
    height: f64,
    recent: VecDeque<(f64, f64)>,
    /// Height at which the robot is held now, m.
    held: Option<f64>,
    /// When it left it, s.
    left: Option<f64>,
    drops: Vec<Vec<(f64, f64)>>,
}

impl Drops {
    /// Waits for drops with the soles `height_mm` over the floor.
    #[must_use]
    pub fn new(height_mm: f64) -> Self {
        let recent = VecDeque::new();
        Self { height: 1e-3 * height_mm, recent, held: None, left: None, drops: Vec::new() }
    }

    /// Returns the number of drops so far.
    #[must_use]
    pub fn count(&self) -> usize {
        self.drops.len()
    }

    /// Returns whether the robot is held still, ready to be dropped.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.held.is_some() && self.left.is_none()
    }

    /// Returns the rows of the drops, numbered on from `last`.
    #[must_use]
    pub fn rows(&self, last: f64) -> Vec<Vec<f64>> {
        let height_mm = 1e3 * self.height;
        let numbered = self.drops.iter().enumerate();
        let rows = numbered.flat_map(|(index, drop)| {
            let number = last + index as f64 + 1.0;
            drop.iter().map(move |(t, z)| vec![number, height_mm, *t, 1e3 * z])
        });
        rows.collect()
    }

    /// Takes a pose; returns a verdict when a fall is over.
    ///
    /// # Errors
    /// When it was no drop, or the pose is of no use.
    pub fn observe(&mut self, sample: &PoseSample) -> Option<Result<(), NoDrop>> {
        sample.trusted()?;
        let Some(picture) = sample.picture else { return Some(Err(NoDrop::NoTimes)) };
        let (time, z) = (seconds(picture.exposed), sample.pose.position.z);
        if self.recent.back().is_some_and(|(newest, _)| time <= *newest) {
            return None;
        }
        self.recent.push_back((time, z));
        while self.recent.front().is_some_and(|(oldest, _)| time - oldest > KEPT) {
            self.recent.pop_front();
        }
        if let Some(left) = self.left {
            // Long enough that a slow release does not cut the end off.
            if time - left < touch(self.height) + AFTER {
                return None;
            }
            let held = self.held.take().unwrap_or(z);
            self.left = None;
            let verdict = self.drop_from(held);
            self.recent.clear();
            return Some(verdict.map(|drop| self.drops.push(drop)));
        }
        match self.held {
            Some(held) if held - z > COMPARED.start() * self.height => self.left = Some(time),
            _ => {
                self.held =
                    self.still(time).or(self.held.filter(|held| (held - z).abs() < self.height))
            }
        }
        None
    }

    /// Returns the mean height if the robot was still just now.
    fn still(&self, now: f64) -> Option<f64> {
        let (oldest, _) = self.recent.front()?;
        if now - oldest < *STILL.end() {
            return None;
        }
        let pictures = self.recent.iter().filter(|(at, _)| STILL.contains(&(now - at)));
        let (mean, deviation) = mean_and_deviation(pictures.map(|(_, z)| *z))?;
        (deviation <= STILL_WITHIN).then_some(mean)
    }

    /// Returns time since the release (s) and height (m) of the newest fall, from where the robot was held.
    fn drop_from(&self, held: f64) -> Result<Vec<(f64, f64)>, NoDrop> {
        let depths = (COMPARED.start() * self.height)..=(COMPARED.end() * self.height);
        // It never springs back to there.
        let last = self.recent.iter().rposition(|(_, z)| held - z < *depths.start());
        let falling = self.recent.iter().skip(last.ok_or(NoDrop::NotFree)? + 1);
        let falling = falling.take_while(|(_, z)| held - z <= *depths.end());
        let releases = falling.map(|(t, z)| t - (2.0 * (held - z) / GRAVITY).sqrt());
        let few = || NoDrop::FewPictures { rate: self.rate() };
        let (release, scatter) = mean_and_deviation(releases).ok_or_else(few)?;
        if scatter > SCATTER {
            return Err(NoDrop::NotFree);
        }
        let whole: Vec<(f64, f64)> = self
            .recent
            .iter()
            .map(|(t, z)| (t - release, *z))
            .filter(|(t, _)| (0.0..=touch(self.height) + AFTER).contains(t))
            .collect();
        let landed = whole.iter().rev().take_while(|(t, _)| *t > touch(self.height) + AFTER / 2.0);
        let (rest, _) = mean_and_deviation(landed.map(|(_, z)| *z)).ok_or_else(few)?;
        let fell = held - rest;
        // The legs give way by some millimetres, and the body springs back.
        if (fell - self.height).abs() > 5e-3 + 0.25 * self.height {
            return Err(NoDrop::OtherHeight { fell: 1e3 * fell, height: 1e3 * self.height });
        }
        let count =
            |from: f64| whole.iter().filter(|(t, _)| (from..from + INTERVAL).contains(t)).count();
        let mut after = (0..INTERVALS).map(|index| touch(self.height) + index as f64 * INTERVAL);
        let is_dense = count(0.0) >= 1 && after.all(|from| count(from) >= 2);
        if is_dense { Ok(whole) } else { Err(few()) }
    }

    /// Returns how many pictures a second there are.
    fn rate(&self) -> f64 {
        let span = self.recent.back().zip(self.recent.front()).map_or(0.0, |(b, a)| b.0 - a.0);
        (self.recent.len() as f64 - 1.0) / span.max(f64::MIN_POSITIVE)
    }
}

/// Returns when the soles touch, s after the release.
fn touch(height: f64) -> f64 {
    (2.0 * height / GRAVITY).sqrt()
}

/// Returns mean and standard deviation; none of less than two numbers.
fn mean_and_deviation(numbers: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let all: Vec<f64> = numbers.collect();
    let share = 1.0 / all.len() as f64;
    let mean = share * all.iter().sum::<f64>();
    let square = share * all.iter().map(|number| (number - mean).powi(2)).sum::<f64>();
    (all.len() > 1).then_some((mean, square.sqrt()))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use flix_protocol::units::Instant;

    use super::*;
    use crate::nav::PlanarPose;
    use crate::pose::{Picture, Pose};

    /// Height of the body's middle over the floor when it stands, m.
    const STANDS: f64 = 0.06;

    /// Shows a course of heights over the floor from pictures so many a second; returns the verdicts.
    fn shown(drops: &mut Drops, rate: u64, course: impl Fn(f64) -> f64) -> Vec<Result<(), NoDrop>> {
        let verdicts = (0..2 * rate).filter_map(|index| {
            let exposed = Instant::from_micros(5_000_000 + index * 1_000_000 / rate);
            let pose =
                Pose::planar(PlanarPose::default(), STANDS + course(index as f64 / rate as f64));
            let picture = Some(Picture { exposed, sent: exposed, late: Duration::ZERO });
            drops.observe(&PoseSample { time: exposed, pose, valid: true, picture })
        });
        verdicts.collect()
    }

    /// Held at a height until one second, then released; it stays where it lands.
    fn fall(height: f64) -> impl Fn(f64) -> f64 {
        move |t| (height - 0.5 * GRAVITY * (t - 1.0).max(0.0).powi(2)).max(0.0)
    }

    #[test]
    fn a_drop_is_cut_out_from_its_release_to_a_tenth_after_the_touch() {
        let mut drops = Drops::new(20.0);
        assert_eq!(shown(&mut drops, 1000, fall(0.02)), [Ok(())]);
        let rows = drops.rows(7.0);
        assert_eq!(rows[0][..2], [8.0, 20.0]);
        for row in &rows {
            let fallen = STANDS + fall(0.02)(1.0 + row[2]);
            assert!((row[3] - 1e3 * fallen).abs() < 0.3, "{row:?}");
        }
        let last = rows.last().map(|row| row[2]);
        assert!(rows[0][2] < 1e-3 && last.is_some_and(|t| t > touch(0.02) + 0.1), "{last:?}");
    }

    #[test]
    fn what_is_no_drop_says_why() {
        let lowered = |t: f64| (0.02 - 0.1 * (t - 1.0).max(0.0)).max(0.0);
        assert_eq!(shown(&mut Drops::new(20.0), 1000, lowered), [Err(NoDrop::NotFree)]);
        let high = shown(&mut Drops::new(20.0), 1000, fall(0.04));
        assert!(
            matches!(high[..], [Err(NoDrop::OtherHeight { fell: 39.0..41.0, .. })]),
            "{high:?}"
        );
        let slow = shown(&mut Drops::new(20.0), 250, fall(0.02));
        assert!(matches!(slow[..], [Err(NoDrop::FewPictures { rate: 240.0..260.0 })]), "{slow:?}");
        let lifted = |t: f64| 0.02 * t.min(1.0);
        assert_eq!(shown(&mut Drops::new(20.0), 1000, lifted), []);
    }
}
