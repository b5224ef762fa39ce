//! Axes: position and text of the ticks, and the conversion of data to pixels.

use flix_host::system::text::fixed;

/// Scale of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Scale {
    /// Equal steps, equal lengths.
    #[default]
    Linear,
    /// Equal steps, equal lengths; ticks at parts of a turn.
    Degrees,
    /// Equal steps, equal lengths; ticks at whole numbers.
    Whole,
    /// Names at 1, 2 and so on.
    Names(&'static [&'static str]),
    /// Equal factors, equal lengths. Values at or below zero are not drawn.
    Logarithmic,
}

/// A range of values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Lowest value.
    pub low: f64,
    /// Highest value.
    pub high: f64,
}

impl Limits {
    /// Makes a range.
    #[must_use]
    pub const fn new(low: f64, high: f64) -> Self {
        Self { low, high }
    }

    /// Returns the difference between highest and lowest value.
    #[must_use]
    pub fn span(self) -> f64 {
        self.high - self.low
    }

    /// Returns the range with a margin on both sides.
    #[must_use]
    pub fn widened(self, margin: f64) -> Self {
        Self::new(self.low - margin, self.high + margin)
    }
}

/// One axis: a range of data on a range of pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axis {
    /// In the logarithm where the scale is logarithmic.
    limits: Limits,
    scale: Scale,
    from: f64,
    to: f64,
}

impl Axis {
    /// Makes the axis that shows `limits` (widened where they are equal) from pixel `from` to `to`.
    pub(super) fn new(limits: Limits, scale: Scale, from: f64, to: f64) -> Self {
        let Limits { low, high } = match scale {
            Scale::Linear | Scale::Degrees | Scale::Whole | Scale::Names(_) => limits,
            Scale::Logarithmic => {
                let log = |value: f64| value.max(f64::MIN_POSITIVE).log10();
                Limits::new(log(limits.low), log(limits.high))
            }
        };
        let limits = if low.is_finite() && high.is_finite() && low < high {
            Limits::new(low, high)
        } else {
            let middle = if low.is_finite() { low } else { 0.0 };
            Limits::new(middle, middle).widened((middle.abs() * 0.05).max(0.5))
        };
        Self { limits, scale, from, to }
    }

    /// Returns the pixel of a value; `None` where it has none.
    pub(super) fn pixel(&self, value: f64) -> Option<f64> {
        let value = match self.scale {
            Scale::Linear | Scale::Degrees | Scale::Whole | Scale::Names(_) => value,
            Scale::Logarithmic if value > 0.0 => value.log10(),
            Scale::Logarithmic => return None,
        };
        let pixel =
            self.from + (value - self.limits.low) / self.limits.span() * (self.to - self.from);
        pixel.is_finite().then_some(pixel)
    }

    /// Returns ticks at least `spacing` pixels apart: pixel and text.
    pub(super) fn ticks(&self, spacing: f64) -> Vec<(f64, String)> {
        let count = ((self.to - self.from).abs() / spacing).max(1.0);
        let least = self.limits.span() / count;
        let values = match self.scale {
            Scale::Linear => linear_ticks(self.limits, round_step(least)),
            Scale::Degrees => linear_ticks(self.limits, step_of_turn(least)),
            // Above 1, round steps are whole except 2.5.
            Scale::Whole => linear_ticks(self.limits, round_step(least.max(1.0)).ceil()),
            Scale::Names(names) => {
                (1..).zip(names).map(|(at, name)| (f64::from(at), (*name).to_owned())).collect()
            }
            Scale::Logarithmic => logarithmic_ticks(self.limits, count),
        };
        values
            .into_iter()
            .filter_map(|(value, text)| self.pixel(value).map(|pixel| (pixel, text)))
            .collect()
    }
}

/// Returns the range of finite values with a margin of `share` on both sides; `None` without values.
pub(super) fn range_of(
    values: impl Iterator<Item = f64>,
    scale: Scale,
    share: f64,
) -> Option<Limits> {
    let usable = values.filter(|v| v.is_finite() && (scale != Scale::Logarithmic || *v > 0.0));
    let (low, high) =
        usable.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return None;
    }
    Some(match scale {
        Scale::Linear | Scale::Degrees | Scale::Whole | Scale::Names(_) => {
            Limits::new(low, high).widened((high - low) * share)
        }
        Scale::Logarithmic => {
            let factor = (high / low).powf(share);
            Limits::new(low / factor, high * factor)
        }
    })
}

/// More ticks than fit any axis.
const MOST_TICKS: f64 = 1_000.0;

/// Returns the smallest round number that is not below `least`.
fn round_step(least: f64) -> f64 {
    let decade = 10f64.powf(least.log10().floor());
    [1.0, 2.0, 2.5, 5.0, 10.0]
        .iter()
        .map(|m| m * decade)
        .find(|s| *s >= least * (1.0 - 1e-9))
        .unwrap_or(10.0 * decade)
}

/// Returns the smallest part of a turn, degrees, that is not below `least`.
fn step_of_turn(least: f64) -> f64 {
    const PARTS: [f64; 7] = [10.0, 15.0, 30.0, 45.0, 90.0, 180.0, 360.0];
    let part = PARTS.into_iter().find(|part| *part >= least).filter(|_| least > 5.0);
    part.unwrap_or_else(|| round_step(least))
}

/// Room beyond the outermost ticks of angles, as a share of what is between them.
const BEYOND: f64 = 0.014;

/// Returns the range of angles, degrees, that shows `limits` and has a tick at both of its ends when it has room for
/// `count` ticks.
pub(super) fn ended_at_ticks(limits: Limits, count: f64) -> Limits {
    let limits = if limits.span() > 0.0 { limits } else { limits.widened(0.5) };
    let slack = BEYOND * limits.span();
    let mut ends = limits;
    // A wider range may need a longer step, and that a wider range; a turn is the longest.
    for _ in 0..4 {
        let step = step_of_turn(ends.span() * (1.0 + 2.0 * BEYOND) / count.max(1.0));
        let (low, high) = ((limits.low + slack) / step, (limits.high - slack) / step);
        ends = Limits::new(low.floor() * step, high.ceil() * step);
    }
    ends.widened(BEYOND * ends.span())
}

fn linear_ticks(Limits { low, high }: Limits, step: f64) -> Vec<(f64, String)> {
    // A range that is no range: of the least numbers there are, or of the greatest.
    if !step.is_normal() || (high - low) / step > MOST_TICKS {
        return Vec::new();
    }
    let decimals = decimals_of(step);
    let first = (low / step - 1e-9).ceil() as i64;
    let last = (high / step + 1e-9).floor() as i64;
    (first..=last).map(|i| i as f64 * step).map(|value| (value, number(value, decimals))).collect()
}

fn logarithmic_ticks(Limits { low, high }: Limits, count: f64) -> Vec<(f64, String)> {
    let decades = high - low;
    let mantissas: &[f64] = if decades * 3.0 <= count { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let every = (decades / count).ceil().max(1.0) as i32;
    (low.floor() as i32..=high.ceil() as i32)
        .filter(|exponent| exponent.rem_euclid(every) == 0)
        .flat_map(|exponent| mantissas.iter().map(move |m| m * 10f64.powi(exponent)))
        .filter(|value| (low - 1e-9..=high + 1e-9).contains(&value.log10()))
        .map(|value| (value, compact(value)))
        .collect()
}

fn decimals_of(step: f64) -> usize {
    (0..12)
        .find(|d| {
            let scaled = step * 10f64.powi(*d);
            (scaled - scaled.round()).abs() < 1e-6 * scaled
        })
        .map_or(12, |d| d as usize)
}

/// Returns a number with a true minus sign and no negative zero.
pub(super) fn number(value: f64, decimals: usize) -> String {
    fixed(value, decimals).replace('-', "\u{2212}")
}

/// Returns a number in as few characters as it needs: `0.001`, `20`, `1e6`.
fn compact(value: f64) -> String {
    if (1e-4..1e6).contains(&value) {
        number(value, decimals_of(value))
    } else {
        format!("{value:e}").replace('-', "\u{2212}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(axis: &Axis, spacing: f64) -> Vec<String> {
        axis.ticks(spacing).into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn linear_ticks_are_round_numbers_inside_the_range() {
        let axis = Axis::new(Limits::new(-0.31, 0.52), Scale::Linear, 0.0, 400.0);
        assert_eq!(texts(&axis, 80.0), ["\u{2212}0.2", "0.0", "0.2", "0.4"]);
    }

    #[test]
    fn a_heading_has_ticks_at_parts_of_a_turn() {
        let heading = |height| Axis::new(Limits::new(-185.0, 185.0), Scale::Degrees, 0.0, height);
        assert_eq!(texts(&heading(110.0), 34.0), ["\u{2212}180", "0", "180"]);
        assert_eq!(texts(&heading(220.0), 34.0), ["\u{2212}180", "\u{2212}90", "0", "90", "180"]);
    }

    #[test]
    fn a_range_of_angles_has_a_tick_at_both_ends() {
        let ticks = |low, high| {
            let range = ended_at_ticks(Limits::new(low, high), 110.0 / 34.0);
            texts(&Axis::new(range, Scale::Degrees, 110.0, 0.0), 34.0)
        };
        assert_eq!(ticks(-150.0, 180.3), ["\u{2212}180", "0", "180"]);
        assert_eq!(ticks(-35.0, 60.0), ["\u{2212}45", "0", "45", "90"]);
        assert_eq!(ticks(30.0, 30.0), ["29.5", "30.0", "30.5"]);
    }

    #[test]
    fn counts_have_ticks_at_whole_numbers_only() {
        let ticks =
            |high| texts(&Axis::new(Limits::new(0.0, high), Scale::Whole, 0.0, 900.0), 80.0);
        assert_eq!(ticks(1.0), ["0", "1"]);
        assert_eq!(ticks(24.0), ["0", "3", "6", "9", "12", "15", "18", "21", "24"]);
    }

    #[test]
    fn names_stand_at_their_numbers() {
        let axis = Axis::new(Limits::new(0.5, 2.5), Scale::Names(&["fl", "fr"]), 0.0, 200.0);
        assert_eq!(axis.ticks(80.0), [(50.0, "fl".to_owned()), (150.0, "fr".to_owned())]);
    }

    #[test]
    fn logarithmic_ticks_are_powers_of_ten_over_many_decades() {
        let axis = Axis::new(Limits::new(0.001, 100.0), Scale::Logarithmic, 0.0, 400.0);
        assert_eq!(texts(&axis, 60.0), ["0.001", "0.01", "0.1", "1", "10", "100"]);
    }

    #[test]
    fn an_empty_range_still_has_an_axis() {
        let axis = Axis::new(Limits::new(3.0, 3.0), Scale::Linear, 0.0, 100.0);
        assert_eq!(axis.pixel(3.0), Some(50.0));
    }

    #[test]
    fn values_without_a_logarithm_have_no_pixel() {
        let axis = Axis::new(Limits::new(0.1, 10.0), Scale::Logarithmic, 0.0, 100.0);
        assert_eq!((axis.pixel(0.0), axis.pixel(1.0)), (None, Some(50.0)));
    }
}
