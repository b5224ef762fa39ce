//! What the paper says in its sensitivity section (III-B), as claims that a robot meets or not.
//!
//! No calibration fits them: they are a held-out test. Four claims contradict themselves: the load section writes
//! "negative lateral-axis direction (causing leftward drift)", while the metric section calls +y leftward. They
//! are listed as the word says it; by the sign each is the opposite.

use super::modes::Component;
use super::sensitivity::{CONTROL, find};
use super::sweep::Cell;
use crate::experiment::walk::Spread;
use crate::rig::bench::DIRECTIONS;

/// A claim, and what the robot does.
#[derive(Debug, Clone, PartialEq)]
pub struct Statement {
    /// In words.
    pub claim: String,
    /// What it compares, with the spread between seeds: before and after, in m/s or rad/s.
    pub values: [Spread; 2],
    /// Whether the robot does it.
    pub verdict: Verdict,
    /// Whether the paper's word and its sign contradict each other here.
    pub contradicts_itself: bool,
}

/// Whether a robot does what the paper says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It does.
    Holds,
    /// It does the opposite, or not.
    Fails,
    /// The difference is within two standard errors of nothing, or there is one walk a cell: that has no error.
    Unclear,
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Self::Holds => "holds",
            Self::Fails => "fails",
            Self::Unclear => "unclear",
        })
    }
}

/// Standard errors below which a difference is none.
const CLEAR: f64 = 2.0;

/// The walks of a study, to be asked.
struct Asked<'a>(&'a [Cell]);

impl Asked<'_> {
    fn speeds(
        &self,
        variant: &str,
        (f, theta): (f64, f64),
        component: Component,
    ) -> Option<Spread> {
        let cell = find(self.0, variant, f, theta)?;
        let [forward, lateral, yaw] = cell.spreads();
        Some(match component {
            Component::Forward => forward,
            Component::Lateral => lateral,
            Component::Yaw => yaw,
        })
    }

    fn seeds(&self) -> f64 {
        self.0.first().map_or(1.0, |cell| cell.walks.len() as f64)
    }

    /// That a variant moves a speed in the direction of `sign`.
    fn moves(
        &self,
        variant: &str,
        pair: (f64, f64),
        component: Component,
        sign: f64,
    ) -> Option<Statement> {
        let before = self.speeds("baseline", pair, component)?;
        let after = self.speeds(variant, pair, component)?;
        let (what, way) = (kind(component), if sign > 0.0 { "positive" } else { "negative" });
        Some(Statement {
            claim: format!("{variant}: {what} speed at {} goes {way}", at(pair)),
            verdict: self.verdict(sign * (after.mean - before.mean), before, after),
            values: [before, after],
            contradicts_itself: false,
        })
    }

    /// That a variant makes a speed larger, whatever its direction.
    fn grows(&self, variant: &str, pair: (f64, f64), component: Component) -> Option<Statement> {
        let before = self.speeds("baseline", pair, component)?;
        let after = self.speeds(variant, pair, component)?;
        Some(Statement {
            claim: format!("{variant}: {} speed at {} grows", kind(component), at(pair)),
            verdict: self.verdict(after.mean.abs() - before.mean.abs(), before, after),
            values: [before, after],
            contradicts_itself: false,
        })
    }

    /// That at this f a speed times `sign` is largest at theta under a variant, or is not.
    fn peaks(
        &self,
        variant: &str,
        (f, theta): (f64, f64),
        component: Component,
        sign: f64,
        there: bool,
    ) -> Option<Statement> {
        let own = self.speeds(variant, (f, theta), component)?;
        let rival = DIRECTIONS
            .iter()
            .filter(|other| **other != theta)
            .filter_map(|other| self.speeds(variant, (f, *other), component))
            .max_by(|a, b| (sign * a.mean).total_cmp(&(sign * b.mean)))?;
        let lead = sign * (own.mean - rival.mean);
        let is = if there { "has its" } else { "has no" };
        let way = if sign > 0.0 { "positive" } else { "negative" };
        Some(Statement {
            claim: format!(
                "{variant}: {} speed {is} {way} peak over theta at {}",
                kind(component),
                at((f, theta))
            ),
            verdict: self.verdict(if there { lead } else { -lead }, rival, own),
            values: [rival, own],
            contradicts_itself: false,
        })
    }

    /// That a variant makes two mirrored pairs differ more (or less) in a speed.
    fn differs(
        &self,
        variant: &str,
        pairs: [(f64, f64); 2],
        component: Component,
        more: bool,
    ) -> Option<Statement> {
        let gap = |variant: &str| {
            let [a, b] = pairs.map(|pair| self.speeds(variant, pair, component));
            let (a, b) = (a?, b?);
            Some(Spread { mean: (a.mean - b.mean).abs(), spread: both(a, b) })
        };
        let (before, after) = (gap("baseline")?, gap(variant)?);
        let sign = if more { 1.0 } else { -1.0 };
        Some(Statement {
            claim: format!(
                "{variant}: {} speeds at {} and {} differ {}",
                kind(component),
                at(pairs[0]),
                at(pairs[1]),
                if more { "more" } else { "less" }
            ),
            verdict: self.verdict(sign * (after.mean - before.mean), before, after),
            values: [before, after],
            contradicts_itself: false,
        })
    }

    fn verdict(&self, change: f64, before: Spread, after: Spread) -> Verdict {
        let error = both(before, after).map(|spread| spread / self.seeds().sqrt());
        if error.is_none_or(|error| change.abs() < CLEAR * error) {
            Verdict::Unclear
        } else if change > 0.0 {
            Verdict::Holds
        } else {
            Verdict::Fails
        }
    }
}

/// Returns the standard deviation of a sum or difference; `None` where one of both has one walk.
fn both(a: Spread, b: Spread) -> Option<f64> {
    a.spread.zip(b.spread).map(|(a, b)| a.hypot(b))
}

fn at((f, theta): (f64, f64)) -> String {
    format!("({f} Hz, {theta}\u{b0})")
}

const fn kind(component: Component) -> &'static str {
    match component {
        Component::Forward => "longitudinal",
        Component::Lateral => "lateral",
        Component::Yaw => "turning",
    }
}

/// Checks every claim that can be checked with the walks of both changes.
#[must_use]
pub fn statements(mass: &[Cell], friction: &[Cell]) -> Vec<Statement> {
    use Component::{Forward, Lateral, Yaw};
    let (mass, friction) = (Asked(mass), Asked(friction));
    let mut all = vec![
        mass.peaks("left load", (-35.0, 60.0), Forward, 1.0, true),
        mass.peaks("right load", (-35.0, 60.0), Forward, 1.0, false),
    ];
    for (variant, turns, drifts) in [("left load", -1.0, 1.0), ("right load", 1.0, -1.0)] {
        for f in [-35.0, 35.0] {
            let drift = mass.moves(variant, (f, 0.0), Lateral, drifts);
            all.push(drift.map(|drift| Statement { contradicts_itself: true, ..drift }));
        }
        all.push(mass.moves(variant, (-30.0, -60.0), Yaw, turns));
    }
    for variant in ["front load", "rear load"] {
        for pair in [(-35.0, -30.0), (35.0, 30.0)] {
            all.push(mass.grows(variant, pair, Yaw));
        }
    }
    let mirrored = [(35.0, -60.0), (-35.0, 60.0)];
    all.extend([
        friction.differs("left friction -58 %", mirrored, Forward, true),
        friction.differs("left friction +58 %", mirrored, Forward, false),
        friction.peaks("left friction -58 %", (35.0, 0.0), Lateral, 1.0, true),
        friction.peaks("left friction +58 %", (-35.0, 0.0), Lateral, -1.0, true),
        friction.moves("left friction -10 %", (30.0, 60.0), Yaw, 1.0),
        friction.moves(CONTROL, (-30.0, -60.0), Yaw, -1.0),
    ]);
    all.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use flix_host::nav::Twist;

    use super::*;

    fn cell(variant: &str, theta_deg: f64, laterals: [f64; 2]) -> Cell {
        let walks = laterals.map(|lateral| Twist { forward: 0.0, lateral, yaw: 0.0 }).to_vec();
        Cell { variant: variant.to_owned(), f_hz: 35.0, theta_deg, walks }
    }

    #[test]
    fn a_drift_in_the_named_direction_holds_and_the_opposite_fails() {
        let cells = [cell("baseline", 0.0, [0.0, 0.001]), cell("left load", 0.0, [-0.05, -0.051])];
        let asked = Asked(&cells);
        let verdict =
            |sign| asked.moves("left load", (35.0, 0.0), Component::Lateral, sign).unwrap().verdict;
        assert_eq!((verdict(-1.0), verdict(1.0)), (Verdict::Holds, Verdict::Fails));
    }

    #[test]
    fn a_drift_within_the_scatter_of_seeds_is_unclear() {
        let cells = [cell("baseline", 0.0, [-0.02, 0.02]), cell("left load", 0.0, [-0.03, 0.02])];
        let statement =
            Asked(&cells).moves("left load", (35.0, 0.0), Component::Lateral, -1.0).unwrap();
        assert_eq!(statement.verdict, Verdict::Unclear);
    }

    #[test]
    fn one_walk_a_cell_is_no_verdict() {
        let one = |variant, lateral| {
            let both = cell(variant, 0.0, [lateral, lateral]);
            Cell { walks: both.walks[..1].to_vec(), ..both }
        };
        let cells = [one("baseline", 0.0), one("left load", -0.05)];
        let statement =
            Asked(&cells).moves("left load", (35.0, 0.0), Component::Lateral, -1.0).unwrap();
        assert_eq!((statement.verdict, statement.values[1].spread), (Verdict::Unclear, None));
    }

    #[test]
    fn a_peak_is_sought_over_all_directions() {
        let cells = [
            cell("b", -30.0, [0.01, 0.011]),
            cell("b", 0.0, [0.03, 0.031]),
            cell("b", 30.0, [0.05, 0.051]),
        ];
        let verdict = |theta, there| {
            let asked = Asked(&cells);
            asked.peaks("b", (35.0, theta), Component::Lateral, 1.0, there).unwrap().verdict
        };
        assert_eq!((verdict(30.0, true), verdict(0.0, true)), (Verdict::Holds, Verdict::Fails));
        assert_eq!(verdict(0.0, false), Verdict::Holds);
    }
}
