//! When the robot must not go on.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// A rectangle that the robot's middle must not leave, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fence {
    /// West and south.
    pub low: (f64, f64),
    /// East and north.
    pub high: (f64, f64),
}

impl Fence {
    /// The box around these corners with a margin on all sides, m.
    #[must_use]
    pub fn around(((x0, y0), (x1, y1)): ((f64, f64), (f64, f64)), margin: f64) -> Self {
        Self { low: (x0 - margin, y0 - margin), high: (x1 + margin, y1 + margin) }
    }

    /// Whether a point is inside.
    #[must_use]
    pub fn holds(&self, (x, y): (f64, f64)) -> bool {
        (self.low.0..=self.high.0).contains(&x) && (self.low.1..=self.high.1).contains(&y)
    }
}

impl fmt::Display for Fence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { low, high } = self;
        write!(f, "{:.2},{:.2},{:.2},{:.2}", low.0, low.1, high.0, high.1)
    }
}

/// What was written is no fence.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("\"{0}\" is not a fence: write west,south,east,north in metres, such as -1,-0.7,1,0.7")]
pub struct NotAFence(String);

impl FromStr for Fence {
    type Err = NotAFence;

    fn from_str(text: &str) -> Result<Self, NotAFence> {
        let numbers: Option<Vec<f64>> = text
            .split(',')
            .map(|part| part.trim().parse().ok().filter(|n: &f64| n.is_finite()))
            .collect();
        match numbers.as_deref() {
            Some([x0, y0, x1, y1]) if x0 < x1 && y0 < y1 => {
                Ok(Self { low: (*x0, *y0), high: (*x1, *y1) })
            }
            _ => Err(NotAFence(text.to_owned())),
        }
    }
}

/// Why a run ended early. The robot stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stop {
    /// No trusted pose for as long as one waits.
    PoseLost {
        /// For how long.
        waited: Duration,
    },
    /// Outside the fence.
    OutsideFence {
        /// Where, m.
        at: (f64, f64),
        /// The fence.
        fence: Fence,
    },
    /// Too far from the path.
    OffPath {
        /// How far, m.
        error: f64,
        /// How far is allowed, m.
        limit: f64,
    },
}

impl fmt::Display for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PoseLost { waited } => write!(
                f,
                "no trusted pose for {:.1} s: is the robot in view of the cameras? `flix doctor` tells more",
                waited.as_secs_f64()
            ),
            Self::OutsideFence { at, fence } => write!(
                f,
                "the robot left the fence ({fence}) at {:.2},{:.2} m: carry it back, or give --fence",
                at.0, at.1
            ),
            Self::OffPath { error, limit } => write!(
                f,
                "the robot is {:.0} mm off its path, more than the {:.0} mm allowed: look for an \
                 obstacle, learn its modes again with `flix identify`, or raise --error-limit",
                error * 1e3,
                limit * 1e3
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fence_is_read_and_written_alike() {
        let fence: Fence = "-1,-0.7, 1,0.7".parse().unwrap();
        assert_eq!(fence.to_string().parse::<Fence>(), Ok(fence));
    }

    #[test]
    fn what_is_no_fence_is_refused() {
        for bad in ["", "1,2,3", "1,1,0,0", "0,0,nan,1", "a,b,c,d", "0,0,inf,1"] {
            assert!(bad.parse::<Fence>().is_err(), "{bad}");
        }
    }
}
