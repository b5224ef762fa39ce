//! Limits of figures.

use serde::{Deserialize, Serialize};

/// The limit of a figure, in the figure's unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Limit {
    /// The largest value.
    AtMost(f64),
    /// The least value.
    AtLeast(f64),
    /// The largest magnitude.
    Within(f64),
    /// The only value.
    Exactly(f64),
}

impl Limit {
    /// Returns whether a value keeps the limit. NaN never does.
    #[must_use]
    pub fn holds(self, value: f64) -> bool {
        match self {
            Self::AtMost(most) => value <= most,
            Self::AtLeast(least) => value >= least,
            Self::Within(most) => value.abs() <= most,
            Self::Exactly(only) => value == only,
        }
    }

    /// Returns the limit itself.
    #[must_use]
    pub const fn bound(self) -> f64 {
        match self {
            Self::AtMost(bound)
            | Self::AtLeast(bound)
            | Self::Within(bound)
            | Self::Exactly(bound) => bound,
        }
    }
}

/// The worst value of a column that has a limit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figure {
    /// Name of the column, with its unit.
    pub name: String,
    /// The value nearest the limit or farthest beyond the limit.
    pub value: f64,
    /// The limit.
    pub limit: Limit,
    /// Whether the value keeps the limit.
    pub pass: bool,
}

impl Figure {
    /// Picks the worst of these values, the first that is NaN before all others; `None` of no values.
    #[must_use]
    pub fn worst(name: &str, limit: Limit, values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let badness = |value: f64| match limit {
            _ if value.is_nan() => f64::INFINITY,
            Limit::AtMost(_) => value,
            Limit::AtLeast(_) => -value,
            Limit::Within(_) => value.abs(),
            Limit::Exactly(only) => (value - only).abs(),
        };
        let worse = |one: f64, other: f64| if badness(other) > badness(one) { other } else { one };
        let value = values.into_iter().reduce(worse)?;
        Some(Self { name: name.to_owned(), value, limit, pass: limit.holds(value) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_value_is_judged_and_nan_is_worst_and_keeps_no_limit() {
        let worst = |limit, values: &[f64]| {
            let figure = Figure::worst("", limit, values.iter().copied()).unwrap();
            (figure.value, figure.pass)
        };
        assert_eq!(worst(Limit::AtMost(2.0), &[1.0, 2.0, -3.0]), (2.0, true));
        assert_eq!(worst(Limit::AtLeast(2.0), &[1.0, 2.0]), (1.0, false));
        assert_eq!(worst(Limit::Within(2.0), &[1.0, -3.0]), (-3.0, false));
        assert_eq!(worst(Limit::Exactly(2.0), &[2.0, 2.5]), (2.5, false));
        let limits = [Limit::AtMost(9.0), Limit::AtLeast(0.0), Limit::Within(9.0)];
        for limit in limits {
            let (value, pass) = worst(limit, &[1.0, f64::NAN, 2.0]);
            assert!(value.is_nan() && !pass, "{limit:?}");
        }
        assert_eq!(Figure::worst("", Limit::AtMost(1.0), []), None);
    }
}
