//! Pairs (f, theta) to steer with (paper, section III-C), beside those of the paper's table IV.
//!
//! ```text
//! P = (I'_mass + I'_friction) / 2               (equation 9)
//! ```
//!
//! Readings, as the text leaves them open:
//!
//! - I' is not defined ("the summed indices"). Here it is I (equation 8) of the component that the pair is chosen for.
//! - Pairs "with a heading speed below 0.05 m/s" are left out, of which turning and strafing want little. Both
//!   readings stand side by side: the speed of the motion's [own component](Exclusion::Own), yaw rates times
//!   [`LEVER`](super::modes::LEVER), and the [heading speed](Exclusion::Heading) by the word.
//! - "Minimal lateral and turning speeds" is read as at most half of the own component ([`MINIMAL`](super::modes::MINIMAL)); of a turn, whose
//!   forward speed is called favourable, the lateral speed alone. Pairs that do not keep to it come after those that do.
//! - +90 and -90 degrees are the same excitation half a period apart: where both were walked, -90 is left out.

use flix_host::nav::{self, ModeTable, ModeTableError};

use super::modes::{Component, classify};
use super::sensitivity::{find, index};
use super::sweep::Cell;
use flix_sim::rig::bench::setpoint;

/// The paper's least speed of a pair that is worth choosing, m/s.
pub const LEAST_SPEED: f64 = 0.05;

/// The pairs that are too slow to be chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exclusion {
    /// Those whose own component is slow.
    Own,
    /// Those that advance slowly, by the paper's word.
    Heading,
}

/// P and its standard error over the seeds (each left out once); one walk a cell has none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Robustness {
    /// P, with the sign of the speed.
    pub index: f64,
    /// Its standard error.
    pub spread: Option<f64>,
}

/// A pair with its index.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// The walks of the unchanged robot.
    pub cell: Cell,
    /// The component that dominates.
    pub component: Component,
    /// P of that component.
    pub robustness: Robustness,
    /// Whether it is fast enough to be chosen.
    pub fast: bool,
    /// Whether the other components are minimal.
    pub minimal: bool,
}

/// A row of the paper's table IV.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Selected {
    /// The paper's name of the mode.
    pub mode: &'static str,
    /// The paper's letter.
    pub letter: &'static str,
    /// Hz, degrees.
    pub pair: (f64, f64),
    /// Component that is meant.
    pub component: Component,
    /// Its sign.
    pub sign: f64,
}

impl Selected {
    /// Returns what such a motion is called.
    #[must_use]
    pub const fn word(&self) -> &'static str {
        self.component.word(self.sign)
    }
}

/// Table IV.
pub const TABLE_4: [Selected; 5] = {
    const fn row(
        mode: &'static str,
        letter: &'static str,
        pair: (f64, f64),
        component: Component,
        sign: f64,
    ) -> Selected {
        Selected { mode, letter, pair, component, sign }
    }
    [
        row("linear translation", "A'", (-30.0, 30.0), Component::Forward, 1.0),
        row("left turn", "E", (-30.0, 90.0), Component::Yaw, 1.0),
        row("right turn", "D", (30.0, 90.0), Component::Yaw, -1.0),
        row("left strafing", "C'", (30.0, 30.0), Component::Lateral, 1.0),
        row("right strafing", "B", (-30.0, -60.0), Component::Lateral, -1.0),
    ]
};

/// Computes P of one speed at one pair; none for pairs that were not walked.
#[must_use]
pub fn robustness(
    mass: &[Cell],
    friction: &[Cell],
    (f, theta): (f64, f64),
    component: Component,
) -> Option<Robustness> {
    let of = |without: Option<usize>| -> Option<f64> {
        let own = |cells| index(cells, f, theta, component, without);
        Some(0.5 * (own(mass)? + own(friction)?))
    };
    let seeds = find(mass, "baseline", f, theta)?.walks.len();
    let spread = (seeds > 1).then(|| {
        let each: Vec<f64> = (0..seeds).filter_map(|seed| of(Some(seed))).collect();
        let mean = each.iter().sum::<f64>() / seeds as f64;
        let square: f64 = each.iter().map(|one| (one - mean).powi(2)).sum();
        (square * (seeds - 1) as f64 / seeds as f64).sqrt()
    });
    Some(Robustness { index: of(None)?, spread })
}

/// Pairs of every kind of motion, most robust first; those with more than minimal other components after all others,
/// slow ones last.
#[must_use]
pub fn candidates(
    mass: &[Cell],
    friction: &[Cell],
    least: f64,
    exclusion: Exclusion,
) -> Vec<(&'static str, Vec<Candidate>)> {
    let baseline = mass.iter().filter(|cell| cell.variant == "baseline");
    let mut kinds: Vec<(&'static str, Vec<Candidate>)> = Vec::new();
    for sign in [1.0, -1.0] {
        for component in Component::ALL {
            kinds.push((component.word(sign), Vec::new()));
        }
    }
    for cell in baseline {
        let is_again = cell.theta_deg == -90.0 && find(mass, "baseline", cell.f_hz, 90.0).is_some();
        if is_again {
            continue;
        }
        let mean = cell.mean();
        let word = classify(mean);
        for component in Component::ALL {
            let speed = component.of(mean);
            if component.word(speed) != word {
                continue;
            }
            let pair = (cell.f_hz, cell.theta_deg);
            let Some(robustness) = robustness(mass, friction, pair, component) else { continue };
            let fast = match exclusion {
                Exclusion::Own => speed.abs() >= least,
                Exclusion::Heading => mean.forward >= least,
            };
            let minimal = component.is_alone(mean);
            let candidate = Candidate { cell: cell.clone(), component, robustness, fast, minimal };
            if let Some((_, found)) = kinds.iter_mut().find(|(kind, _)| *kind == word) {
                found.push(candidate);
            }
        }
    }
    let order = |it: &Candidate| (!it.fast, !it.minimal);
    for (_, found) in &mut kinds {
        found.sort_by(|a, b| {
            let robust = |it: &Candidate| it.robustness.index.abs();
            order(a).cmp(&order(b)).then(robust(b).total_cmp(&robust(a)))
        });
    }
    kinds.retain(|(_, found)| !found.is_empty());
    kinds
}

/// Returns the pairs of a kind that are worth a choice: the fast ones, or all where nothing is fast.
#[must_use]
pub fn worthwhile(found: &[Candidate]) -> &[Candidate] {
    let fast = found.partition_point(|candidate| candidate.fast);
    if fast == 0 { found } else { &found[..fast] }
}

/// Returns the place of a pair of table IV among the fast pairs of its kind, from 1; none where it is slow or moves in
/// another way.
#[must_use]
pub fn rank(kinds: &[(&'static str, Vec<Candidate>)], selected: &Selected) -> Option<usize> {
    let (_, found) = kinds.iter().find(|(kind, _)| *kind == selected.word())?;
    let is_it = |it: &Candidate| (it.cell.f_hz, it.cell.theta_deg) == selected.pair;
    Some(found.iter().position(|it| it.fast && is_it(it))? + 1)
}

/// Returns the best pair of every kind that a robot can drive (35 Hz at most) as a mode table for `flix track`.
///
/// # Errors
/// When there is no mode at all.
pub fn mode_table(
    robot: &str,
    source: &str,
    kinds: &[(&'static str, Vec<Candidate>)],
) -> Result<ModeTable, ModeTableError> {
    let modes = kinds.iter().filter_map(|(kind, found)| {
        let drivable = |it: &Candidate| {
            let setpoint = setpoint(it.cell.f_hz, it.cell.theta_deg).ok()?;
            Some((it.cell.clone(), setpoint))
        };
        let (cell, setpoint) = found.iter().find_map(drivable)?;
        let [forward, lateral, yaw] = cell.spreads().map(Into::into);
        let name = match *kind {
            "turn left" => "left".to_owned(),
            "turn right" => "right".to_owned(),
            other => other.replace(' ', "-"),
        };
        Some(nav::Mode { name, setpoint, forward, lateral, yaw })
    });
    ModeTable::new(robot, source, modes.collect())
}

#[cfg(test)]
mod tests {
    use flix_host::nav::Twist;

    use super::*;

    fn cell(variant: &str, f_hz: f64, motion: Twist) -> Cell {
        Cell { variant: variant.to_owned(), f_hz, theta_deg: 0.0, walks: vec![motion] }
    }

    /// Walks of the robot as it is, and changed by a tenth or as much as `changed`.
    fn walked(motions: &[(f64, [f64; 3], f64)]) -> Vec<Cell> {
        let twist = |[forward, lateral, yaw]: [f64; 3], by: f64| Twist {
            forward: by * forward,
            lateral: by * lateral,
            yaw: by * yaw,
        };
        let both = |(f, motion, changed): &(f64, [f64; 3], f64)| {
            [cell("baseline", *f, twist(*motion, 1.0)), cell("a", *f, twist(*motion, *changed))]
        };
        motions.iter().flat_map(both).collect()
    }

    fn order(kinds: &[(&'static str, Vec<Candidate>)]) -> Vec<f64> {
        kinds[0].1.iter().map(|candidate| candidate.cell.f_hz).collect()
    }

    #[test]
    fn a_robust_slow_pair_comes_after_a_fast_one() {
        let cells = walked(&[(30.0, [0.04, 0.0, 0.0], 1.01), (35.0, [0.06, 0.0, 0.0], 1.3)]);
        let found = candidates(&cells, &cells, LEAST_SPEED, Exclusion::Own);
        assert_eq!((found[0].0, order(&found)), ("forward", vec![35.0, 30.0]));
        assert_eq!(worthwhile(&found[0].1).len(), 1);
    }

    #[test]
    fn slow_pairs_are_listed_where_nothing_is_fast() {
        let cells = walked(&[(30.0, [0.04, 0.0, 0.0], 1.01), (35.0, [0.03, 0.0, 0.0], 1.3)]);
        let found = candidates(&cells, &cells, LEAST_SPEED, Exclusion::Own);
        assert_eq!(worthwhile(&found[0].1).len(), 2);
    }

    #[test]
    fn a_pair_with_minimal_other_speeds_comes_before_a_more_robust_one() {
        let cells = walked(&[(30.0, [0.1, 0.06, 0.0], 1.01), (35.0, [0.1, 0.04, 0.0], 1.3)]);
        assert_eq!(order(&candidates(&cells, &cells, LEAST_SPEED, Exclusion::Own)), [35.0, 30.0]);
    }

    #[test]
    fn a_turn_on_the_spot_is_fast_by_its_own_component_and_left_out_by_the_word() {
        let cells = walked(&[(-30.0, [0.0, 0.0, 1.5], 1.1)]);
        let fast = |exclusion| candidates(&cells, &cells, LEAST_SPEED, exclusion)[0].1[0].fast;
        assert!(fast(Exclusion::Own) && !fast(Exclusion::Heading));
    }

    #[test]
    fn the_spread_of_the_index_is_that_between_seeds() {
        let walks = |speeds: [f64; 3]| {
            speeds.map(|forward| Twist { forward, lateral: 0.0, yaw: 0.0 }).to_vec()
        };
        let cells = |changed| {
            [("baseline", [0.1; 3]), ("a", changed)].map(|(variant, speeds)| Cell {
                walks: walks(speeds),
                ..cell(variant, 30.0, Twist::default())
            })
        };
        let of = |changed| {
            let cells = cells(changed);
            robustness(&cells, &cells, (30.0, 0.0), Component::Forward).unwrap()
        };
        assert!(of([0.11; 3]).spread.unwrap() < 1e-9);
        // Left out once: 0.1 over 0.02, 0.015 and 0.01.
        let each = [0.1 / 0.025, 0.1 / 0.02, 0.1 / 0.015];
        let mean = each.iter().sum::<f64>() / 3.0;
        let square = each.iter().map(|one| (one - mean).powi(2)).sum::<f64>();
        let spread = of([0.11, 0.12, 0.13]).spread.unwrap();
        assert!((spread - (square * 2.0 / 3.0).sqrt()).abs() < 1e-9, "{spread}");
    }

    #[test]
    fn the_papers_pair_has_a_rank_among_those_of_its_kind() {
        let mut cells = walked(&[(-30.0, [0.1, 0.0, 0.0], 1.3), (35.0, [0.1, 0.0, 0.0], 1.1)]);
        cells.iter_mut().for_each(|cell| cell.theta_deg = 30.0);
        let kinds = candidates(&cells, &cells, LEAST_SPEED, Exclusion::Own);
        assert_eq!(rank(&kinds, &TABLE_4[0]), Some(2));
        assert_eq!(rank(&kinds, &TABLE_4[1]), None);
    }

    #[test]
    fn the_mode_table_names_what_a_tracker_asks_for() {
        let cells = walked(&[(30.0, [0.0, 0.0, 1.0], 1.1)]);
        let kinds = candidates(&cells, &cells, LEAST_SPEED, Exclusion::Own);
        assert_eq!(mode_table("W", "test", &kinds).unwrap().modes()[0].name, "left");
    }

    #[test]
    fn the_mode_table_has_the_best_pair_that_the_robots_motors_reach() {
        let cells = walked(&[(100.0, [0.0, 0.0, 2.0], 1.01), (30.0, [0.0, 0.0, 1.0], 1.1)]);
        let kinds = candidates(&cells, &cells, LEAST_SPEED, Exclusion::Own);
        assert_eq!(kinds.iter().find(|kind| kind.0 == "turn left").unwrap().1[0].cell.f_hz, 100.0);
        let table = mode_table("W", "test", &kinds).unwrap();
        assert_eq!(table.modes()[0].setpoint.frequency().get(), 30.0);
        let above = candidates(&cells[..1], &cells[..1], LEAST_SPEED, Exclusion::Own);
        assert!(matches!(mode_table("W", "test", &above), Err(ModeTableError::Empty)));
    }
}
