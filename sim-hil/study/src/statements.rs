//! What the paper says in its sensitivity section (III-B), as claims that a robot meets or not.
//!
//! No calibration fits them: they are a held-out test.
//!
//! - Eighteen sentences are thirteen independent claims: where two are the mirror image of each other (front and rear
//!   load, friction -10 %, and the four that contradict themselves), they are one claim, which holds when both do and
//!   fails when one does. Eleven of them can be read one way.
//! - Two of the claims contradict themselves: the load section writes "negative lateral-axis direction (causing
//!   leftward drift)", while the metric section calls +y leftward. They are listed as the word says it; by the sign
//!   each is the opposite.
//! - A difference counts when its 95 % interval (Student's t, Welch's degrees of freedom, over the walks of each cell)
//!   leaves out zero.
//! - "Higher friction restores symmetry" needs an asymmetry to begin with: where the unchanged robot's is within its
//!   interval of zero, the claim is unclear.
//! - **Chance** is the share of all pairs of the grid for which the same sentence holds, said of that pair.

use super::modes::Component;
use super::sensitivity::{CONTROL, Change, find};
use super::sweep::Cell;
use flix_sim::experiment::walk::Spread;

/// A pair (f in Hz, theta in degrees).
type Pair = (f64, f64);

/// One of the paper's sentences, and what the robot does.
#[derive(Debug, Clone, PartialEq)]
pub struct Statement {
    /// In words.
    pub claim: String,
    /// What it compares, with the spread between seeds: before and after, in m/s or rad/s.
    pub values: [Spread; 2],
    /// Whether the robot does it.
    pub verdict: Verdict,
}

/// One or two sentences that say the same, and whether the robot does it.
#[derive(Debug, Clone, PartialEq)]
pub struct Claim {
    /// The sentences: one, or two that mirror each other.
    pub statements: Vec<Statement>,
    /// Whether all hold, or one fails.
    pub verdict: Verdict,
    /// Whether the paper's word and its sign contradict each other here.
    pub contradicts_itself: bool,
    /// Share of all pairs for which the same holds, 0 to 1.
    pub chance: f64,
}

/// Whether a robot does what the paper says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// It does.
    Holds,
    /// It does the opposite, or not.
    Fails,
    /// The interval of the difference holds zero, or there is one walk a cell: that has no interval.
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

/// Student's t at 97.5 % for 1, 2, 3 ... degrees of freedom; the last for all above.
const T_975: [f64; 30] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160,
    2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056,
    2.052, 2.048, 2.045, 2.042,
];

/// What is said of a variant at a pair.
#[derive(Debug, Clone, Copy)]
enum Says {
    /// A speed moves in the direction of the sign.
    Moves(f64),
    /// A speed grows, whatever its direction.
    Grows,
    /// At this f the speed times `sign` is largest at theta, or is not.
    Peaks { sign: f64, there: bool },
    /// The pair and its mirror image differ more (or less) than without the change.
    Differs { more: bool },
}

/// A sentence, of which robot and which speed it speaks.
#[derive(Debug, Clone, Copy)]
struct Sentence {
    change: Change,
    variant: &'static str,
    component: Component,
    says: Says,
    pair: Pair,
}

/// The walks of both changes, to be asked.
struct Asked<'a> {
    mass: &'a [Cell],
    friction: &'a [Cell],
}

impl Asked<'_> {
    fn cells(&self, change: Change) -> &[Cell] {
        match change {
            Change::Mass => self.mass,
            Change::Friction => self.friction,
        }
    }

    fn speed(&self, of: &Sentence, variant: &str, (f, theta): Pair) -> Option<Spread> {
        let cell = find(self.cells(of.change), variant, f, theta)?;
        let [forward, lateral, yaw] = cell.spreads();
        Some(match of.component {
            Component::Forward => forward,
            Component::Lateral => lateral,
            Component::Yaw => yaw,
        })
    }

    fn seeds(&self) -> f64 {
        self.mass.first().map_or(1.0, |cell| cell.walks.len() as f64)
    }

    /// All pairs that were walked.
    fn pairs(&self) -> Vec<Pair> {
        let baseline = self.mass.iter().filter(|cell| cell.variant == "baseline");
        baseline.map(|cell| (cell.f_hz, cell.theta_deg)).collect()
    }

    /// Asks a sentence of its pair.
    fn ask(&self, it: &Sentence) -> Option<Statement> {
        let own = |variant: &str, pair| self.speed(it, variant, pair);
        let (what, at) = (kind(it.component), at(it.pair));
        let way = |sign: f64| if sign > 0.0 { "positive" } else { "negative" };
        let (claim, values, change, spreads) = match it.says {
            Says::Moves(sign) => {
                let (a, b) = (own("baseline", it.pair)?, own(it.variant, it.pair)?);
                let claim = format!("{what} speed at {at} goes {}", way(sign));
                (claim, [a, b], sign * (b.mean - a.mean), vec![a, b])
            }
            Says::Grows => {
                let (a, b) = (own("baseline", it.pair)?, own(it.variant, it.pair)?);
                let claim = format!("{what} speed at {at} grows");
                (claim, [a, b], b.mean.abs() - a.mean.abs(), vec![a, b])
            }
            Says::Peaks { sign, there } => {
                let here = own(it.variant, it.pair)?;
                let rival = self.rival(it, sign)?;
                let lead = sign * (here.mean - rival.mean);
                let has = if there { "has its" } else { "has no" };
                let claim = format!("{what} speed {has} {} peak over theta at {at}", way(sign));
                (claim, [rival, here], if there { lead } else { -lead }, vec![rival, here])
            }
            Says::Differs { more } => {
                let both = [it.pair, mirror(it.pair)];
                let [a, b] = both.map(|pair| own("baseline", pair));
                let [c, d] = both.map(|pair| own(it.variant, pair));
                let (a, b, c, d) = (a?, b?, c?, d?);
                let (before, after) = (a.mean - b.mean, c.mean - d.mean);
                let claim = format!(
                    "{what} speeds at {at} and {} differ {}",
                    self::at(both[1]),
                    if more { "more" } else { "less" }
                );
                let grown = after.abs() - before.abs();
                // Nothing to restore: no verdict.
                let nothing = !more && !self.is_clear(before, &[a, b]);
                let change = if nothing {
                    0.0
                } else if more {
                    grown
                } else {
                    -grown
                };
                let gap = |mean: f64, a: Spread, b: Spread| Spread {
                    mean: mean.abs(),
                    spread: a.spread.zip(b.spread).map(|(a, b)| a.hypot(b)),
                };
                (claim, [gap(before, a, b), gap(after, c, d)], change, vec![a, b, c, d])
            }
        };
        let verdict = match self.is_clear(change, &spreads) {
            false => Verdict::Unclear,
            true if change > 0.0 => Verdict::Holds,
            true => Verdict::Fails,
        };
        Some(Statement { claim: format!("{}: {claim}", it.variant), values, verdict })
    }

    /// The largest of a speed times `sign` over all other directions.
    fn rival(&self, it: &Sentence, sign: f64) -> Option<Spread> {
        let (f, theta) = it.pair;
        let others = self.pairs().into_iter().filter(|other| other.0 == f && other.1 != theta);
        others
            .filter_map(|other| self.speed(it, it.variant, other))
            .max_by(|a, b| (sign * a.mean).total_cmp(&(sign * b.mean)))
    }

    /// Whether the 95 % interval of a sum or difference of means leaves out zero.
    fn is_clear(&self, change: f64, means: &[Spread]) -> bool {
        let seeds = self.seeds();
        let squares: Option<Vec<f64>> =
            means.iter().map(|mean| mean.spread.map(|spread| spread * spread / seeds)).collect();
        let Some(squares) = squares else { return false };
        let variance: f64 = squares.iter().sum();
        let freedom = variance.powi(2) * (seeds - 1.0) / squares.iter().map(|s| s * s).sum::<f64>();
        // Whole degrees of freedom, from below; rounding takes none away.
        let row = if freedom.is_nan() { T_975.len() } else { (freedom + 1e-6) as usize };
        change.abs() > T_975[row.clamp(1, T_975.len()) - 1] * variance.sqrt()
    }

    /// Asks one or two sentences as one claim; none where a pair was not walked.
    fn claim(&self, sentences: &[Sentence], contradicts_itself: bool) -> Option<Claim> {
        let asked = |pair: Option<Pair>| -> Option<Vec<Statement>> {
            let mut next = pair;
            let moved = sentences.iter().map(|it| {
                let at = next.unwrap_or(it.pair);
                next = next.map(mirror);
                self.ask(&Sentence { pair: at, ..*it })
            });
            moved.collect()
        };
        let statements = asked(None)?;
        let everywhere: Vec<Verdict> = self
            .pairs()
            .into_iter()
            .filter_map(|pair| asked(Some(pair)))
            .map(|it| sum(&it))
            .collect();
        let held = everywhere.iter().filter(|verdict| **verdict == Verdict::Holds).count();
        Some(Claim {
            verdict: sum(&statements),
            statements,
            contradicts_itself,
            chance: held as f64 / everywhere.len() as f64,
        })
    }
}

/// The verdict on sentences that say the same.
fn sum(statements: &[Statement]) -> Verdict {
    let any = |verdict| statements.iter().any(|it| it.verdict == verdict);
    if any(Verdict::Fails) {
        Verdict::Fails
    } else if any(Verdict::Unclear) {
        Verdict::Unclear
    } else {
        Verdict::Holds
    }
}

const fn mirror((f, theta): Pair) -> Pair {
    (-f, -theta)
}

fn at((f, theta): Pair) -> String {
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
pub fn claims(mass: &[Cell], friction: &[Cell]) -> Vec<Claim> {
    use Component::{Forward, Lateral, Yaw};
    use Says::{Differs, Grows, Moves, Peaks};
    let of = |change| {
        move |variant, component, says, pair| Sentence { change, variant, component, says, pair }
    };
    let (load, slip) = (of(Change::Mass), of(Change::Friction));
    let (least, most) = ("left friction -58 %", "left friction +58 %");
    let peak = |sign, there| Peaks { sign, there };
    let drift = |f| {
        [
            load("left load", Lateral, Moves(1.0), (f, 0.0)),
            load("right load", Lateral, Moves(-1.0), (-f, 0.0)),
        ]
    };
    let turn = |variant| [(-35.0, -30.0), (35.0, 30.0)].map(|pair| load(variant, Yaw, Grows, pair));
    let slower = [
        slip("left friction -10 %", Yaw, Moves(1.0), (30.0, 60.0)),
        slip(CONTROL, Yaw, Moves(-1.0), (-30.0, -60.0)),
    ];
    let all: [(&[Sentence], bool); 13] = [
        (&[load("left load", Forward, peak(1.0, true), (-35.0, 60.0))], false),
        (&[load("right load", Forward, peak(1.0, false), (-35.0, 60.0))], false),
        (&drift(-35.0), true),
        (&drift(35.0), true),
        (&[load("left load", Yaw, Moves(-1.0), (-30.0, -60.0))], false),
        (&[load("right load", Yaw, Moves(1.0), (-30.0, -60.0))], false),
        (&turn("front load"), false),
        (&turn("rear load"), false),
        (&[slip(least, Forward, Differs { more: true }, (35.0, -60.0))], false),
        (&[slip(most, Forward, Differs { more: false }, (35.0, -60.0))], false),
        (&[slip(least, Lateral, peak(1.0, true), (35.0, 0.0))], false),
        (&[slip(most, Lateral, peak(-1.0, true), (-35.0, 0.0))], false),
        (&slower, false),
    ];
    let asked = Asked { mass, friction };
    all.iter().filter_map(|(sentences, contradicts)| asked.claim(sentences, *contradicts)).collect()
}

#[cfg(test)]
mod tests {
    use flix_host::nav::Twist;

    use super::*;

    /// Walks at (35 Hz, theta).
    fn cell(variant: &str, theta_deg: f64, laterals: &[f64]) -> Cell {
        let walk = |lateral: &f64| Twist { forward: 0.0, lateral: *lateral, yaw: 0.0 };
        let walks = laterals.iter().map(walk).collect();
        Cell { variant: variant.to_owned(), f_hz: 35.0, theta_deg, walks }
    }

    fn drift(sign: f64) -> Sentence {
        Sentence {
            change: Change::Mass,
            variant: "left load",
            component: Component::Lateral,
            says: Says::Moves(sign),
            pair: (35.0, 0.0),
        }
    }

    fn verdict(cells: &[Cell], sentence: Sentence) -> Verdict {
        Asked { mass: cells, friction: cells }.ask(&sentence).unwrap().verdict
    }

    #[test]
    fn a_drift_in_the_named_direction_holds_and_the_opposite_fails() {
        let cells = [
            cell("baseline", 0.0, &[0.0, 0.001, 0.002]),
            cell("left load", 0.0, &[-0.05, -0.051, -0.052]),
        ];
        assert_eq!(verdict(&cells, drift(-1.0)), Verdict::Holds);
        assert_eq!(verdict(&cells, drift(1.0)), Verdict::Fails);
    }

    #[test]
    fn a_drift_within_the_scatter_of_seeds_is_unclear() {
        let cells = [cell("baseline", 0.0, &[-0.02, 0.02]), cell("left load", 0.0, &[-0.03, 0.02])];
        assert_eq!(verdict(&cells, drift(-1.0)), Verdict::Unclear);
    }

    #[test]
    fn two_walks_need_a_difference_of_four_standard_errors() {
        // Two degrees of freedom: t = 4.303; the standard error of the difference is 0.001.
        let at = |drift: f64| {
            [
                cell("baseline", 0.0, &[-0.001, 0.001]),
                cell("left load", 0.0, &[drift - 0.001, drift + 0.001]),
            ]
        };
        let error = 0.002_f64.sqrt() * 0.001_f64.sqrt();
        assert_eq!(verdict(&at(4.2 * error), drift(1.0)), Verdict::Unclear);
        assert_eq!(verdict(&at(4.4 * error), drift(1.0)), Verdict::Holds);
    }

    #[test]
    fn one_walk_a_cell_is_no_verdict() {
        let cells = [cell("baseline", 0.0, &[0.0]), cell("left load", 0.0, &[-0.05])];
        assert_eq!(verdict(&cells, drift(-1.0)), Verdict::Unclear);
    }

    #[test]
    fn a_peak_is_sought_over_all_directions() {
        let mut cells: Vec<Cell> = [(-30.0, 0.01), (0.0, 0.03), (30.0, 0.05)]
            .iter()
            .map(|(theta, lateral)| cell("baseline", *theta, &[*lateral, lateral + 0.001]))
            .collect();
        cells.extend(
            cells.clone().into_iter().map(|it| Cell { variant: "left load".to_owned(), ..it }),
        );
        let peak = |theta, there| {
            let says = Says::Peaks { sign: 1.0, there };
            verdict(&cells, Sentence { says, pair: (35.0, theta), ..drift(1.0) })
        };
        assert_eq!((peak(30.0, true), peak(0.0, true)), (Verdict::Holds, Verdict::Fails));
        assert_eq!(peak(0.0, false), Verdict::Holds);
    }

    #[test]
    fn symmetry_is_restored_only_where_it_was_missing() {
        let pair = |variant: &str, left: f64, right: f64| {
            let at = |f_hz: f64, lateral: f64| Cell {
                f_hz,
                ..cell(variant, 0.0, &[lateral - 0.001, lateral, lateral + 0.001])
            };
            [at(35.0, left), at(-35.0, right)]
        };
        let less = Sentence { says: Says::Differs { more: false }, ..drift(1.0) };
        let robot = |left| [pair("baseline", left, 0.05), pair("left load", 0.051, 0.05)].concat();
        assert_eq!(verdict(&robot(0.1), less), Verdict::Holds);
        assert_eq!(verdict(&robot(0.05), less), Verdict::Unclear);
    }

    #[test]
    fn mirrored_sentences_are_one_claim_that_fails_with_either_of_them() {
        let both = |right: f64| {
            let cells = |variant: &str, left: f64, right: f64| {
                let at = |f_hz: f64, lateral: f64| Cell {
                    f_hz,
                    ..cell(variant, 0.0, &[lateral - 1e-4, lateral, lateral + 1e-4])
                };
                [at(35.0, left), at(-35.0, right)]
            };
            let all = [cells("baseline", 0.0, 0.0), cells("left load", 0.1, right)].concat();
            let asked = Asked { mass: &all, friction: &all };
            let second = Sentence { pair: (-35.0, 0.0), ..drift(-1.0) };
            asked.claim(&[drift(1.0), second], false).unwrap()
        };
        assert_eq!((both(-0.1).verdict, both(0.1).verdict), (Verdict::Holds, Verdict::Fails));
        // At one of the two pairs the claim holds, said of the other it does not.
        assert_eq!(both(-0.1).chance, 0.5);
    }

    #[test]
    fn the_paper_makes_eleven_independent_claims_that_can_be_read_one_way() {
        let grid = crate::sweep::grid();
        let names = [
            "baseline",
            "left load",
            "right load",
            "front load",
            "rear load",
            "left friction -58 %",
            "left friction +58 %",
            "left friction -10 %",
            CONTROL,
        ];
        let walked: Vec<Cell> = names
            .iter()
            .flat_map(|name| {
                grid.iter()
                    .map(|(f_hz, theta)| Cell { f_hz: *f_hz, ..cell(name, *theta, &[0.0; 2]) })
            })
            .collect();
        let claims = claims(&walked, &walked);
        let one_way = claims.iter().filter(|claim| !claim.contradicts_itself);
        assert_eq!((one_way.count(), claims.len()), (11, 13));
    }
}
