//! The paper's locomotion modes (Tables III and IV) and how a walk is scored against them.
//!
//! The tables give no speeds, only which component of the motion dominates. Components are compared as
//! speeds: forward, lateral (left positive), and the yaw rate (left positive) times [`LEVER`]. A walk
//! - has the right **sign** when the named component has it,
//! - is a **hit** when that component is also the largest of the three and exceeds [`LEAST_SPEED`].
//!
//! Section III-A asks for more: "minimal lateral or rotational movement" of a translation. A hit lets a robot translate along a
//! circle of 0.1 m. By the means of all walks, a mode
//! - is a **strict** hit when each other component is at most half of the named one ([`MINIMAL`]); of a turn, whose forward
//!   speed section III-C calls favorable, the lateral one alone;
//! - keeps its **heading**, where it is a strict translation, when it turns by 45 degrees in 8 s at most ([`KEPT_YAW`]).
//!
//! Table III lists Left Turn II and Right Strafing under the same pair; Right Strafing is taken from
//! Table IV.

use flix_host::nav::{PAPER_PAIRS, Twist};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

use super::sweep::Cell;

/// Makes a speed of a yaw rate, m: nearly the half length of the robot.
pub const LEVER: f64 = 0.1;
/// A mode slower than this is none, m/s.
pub const LEAST_SPEED: f64 = 0.01;
/// Largest share of the own component that a minimal one may have.
pub const MINIMAL: f64 = 0.5;
/// Largest mean yaw rate of a heading that is kept, rad/s: 45 degrees in 8 s.
pub const KEPT_YAW: f64 = std::f64::consts::FRAC_PI_4 / 8.0;

/// One of the three ways to move in a plane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Component {
    /// Along the body's x.
    Forward,
    /// Along the body's y, left positive.
    Lateral,
    /// About z, left positive.
    Yaw,
}

impl Component {
    /// All three, in the order of every array of components.
    pub const ALL: [Self; 3] = [Self::Forward, Self::Lateral, Self::Yaw];

    /// This component of a motion as a speed, m/s.
    #[must_use]
    pub fn of(self, motion: Twist) -> f64 {
        match self {
            Self::Forward => motion.forward,
            Self::Lateral => motion.lateral,
            Self::Yaw => LEVER * motion.yaw,
        }
    }

    /// Returns the largest of what should be minimal beside this component, m/s: both others, of a turn the lateral one.
    #[must_use]
    pub fn beside(self, motion: Twist) -> f64 {
        let minimal = |other: &Self| *other != self && (self, *other) != (Self::Yaw, Self::Forward);
        Self::ALL.into_iter().filter(minimal).map(|it| it.of(motion).abs()).fold(0.0, f64::max)
    }

    /// Returns whether what should be minimal beside this component is.
    #[must_use]
    pub fn is_alone(self, motion: Twist) -> bool {
        self.beside(motion) <= MINIMAL * self.of(motion).abs()
    }

    /// Returns what moving along it is called.
    #[must_use]
    pub const fn word(self, sign: f64) -> &'static str {
        match (self, sign < 0.0) {
            (Self::Forward, false) => "forward",
            (Self::Forward, true) => "backward",
            (Self::Lateral, false) => "strafe left",
            (Self::Lateral, true) => "strafe right",
            (Self::Yaw, false) => "turn left",
            (Self::Yaw, true) => "turn right",
        }
    }
}

/// Returns what a walk is called: its largest component, or `still` below [`LEAST_SPEED`].
#[must_use]
pub fn classify(motion: Twist) -> &'static str {
    let largest = Component::ALL
        .into_iter()
        .max_by(|a, b| a.of(motion).abs().total_cmp(&b.of(motion).abs()))
        .filter(|component| component.of(motion).abs() > LEAST_SPEED);
    largest.map_or("still", |component| component.word(component.of(motion)))
}

/// A pair (f, theta) and what the paper says that it does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PaperMode {
    /// Short name.
    pub name: String,
    /// Hz.
    pub f_hz: f64,
    /// Degrees, to the right.
    pub theta_deg: f64,
    /// The component that dominates.
    pub component: Component,
    /// Its sign, 1 or -1.
    pub sign: f64,
}

/// How a walk fits a mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Score {
    /// The named component has the right sign.
    pub sign: bool,
    /// It also dominates.
    pub hit: bool,
}

/// What dominates in each of [`PAPER_PAIRS`].
const MEANT: [(Component, f64); PAPER_PAIRS.len()] = [
    (Component::Forward, 1.0),
    (Component::Forward, 1.0),
    (Component::Yaw, 1.0),
    (Component::Yaw, 1.0),
    (Component::Yaw, -1.0),
    (Component::Yaw, -1.0),
    (Component::Lateral, 1.0),
    (Component::Lateral, 1.0),
    (Component::Lateral, -1.0),
];

/// Returns the nine rows of Table III, with Right Strafing from Table IV.
#[must_use]
pub fn paper_modes() -> Vec<PaperMode> {
    PAPER_PAIRS
        .into_iter()
        .zip(MEANT)
        .map(|((name, f, theta), (component, sign))| PaperMode {
            name: name.to_owned(),
            f_hz: f64::from(f),
            theta_deg: f64::from(theta),
            component,
            sign,
        })
        .collect()
}

/// Invents a table: the same pairs, the same motions, dealt out at random. What a search reaches on it is
/// the level of chance.
#[must_use]
pub fn shuffled_modes(seed: u64) -> Vec<PaperMode> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut meant = MEANT;
    for last in (1..meant.len()).rev() {
        meant.swap(last, random.random_range(0..=last));
    }
    let mut modes = paper_modes();
    for (mode, (component, sign)) in modes.iter_mut().zip(meant) {
        mode.name = component.word(sign).replace(' ', "-");
        (mode.component, mode.sign) = (component, sign);
    }
    modes
}

impl PaperMode {
    /// The named component, positive when it has the right sign, and the largest of what it has to exceed:
    /// both other components and [`LEAST_SPEED`]; m/s.
    fn contest(&self, motion: Twist) -> (f64, f64) {
        let rival = Component::ALL
            .into_iter()
            .filter(|component| *component != self.component)
            .map(|component| component.of(motion).abs())
            .fold(LEAST_SPEED, f64::max);
        (self.sign * self.component.of(motion), rival)
    }

    /// Scores a walk.
    #[must_use]
    pub fn score(&self, motion: Twist) -> Score {
        let (own, rival) = self.contest(motion);
        Score { sign: own > 0.0, hit: own > rival }
    }

    /// Returns by how much a walk is a hit (positive) or misses (negative), as a share of the speeds involved: -1 to
    /// 1.
    #[must_use]
    pub fn margin(&self, motion: Twist) -> f64 {
        let (own, rival) = self.contest(motion);
        lead(own, rival)
    }

    /// Returns by how much a walk is strict, of a translation also by how much it keeps its heading: each -1 to 1.
    pub fn strict_margins(&self, motion: Twist) -> impl Iterator<Item = f64> {
        let own = MINIMAL * self.component.of(motion).abs();
        let heading = lead(KEPT_YAW, motion.yaw.abs());
        let translates = self.component != Component::Yaw;
        [lead(own, self.component.beside(motion))].into_iter().chain(translates.then_some(heading))
    }
}

/// Returns by how much a speed exceeds one that is not negative, as a share of both: -1 to 1.
#[must_use]
pub fn lead(own: f64, rival: f64) -> f64 {
    (own - rival) / (own.abs() + rival).max(f64::MIN_POSITIVE)
}

/// What a robot does where the paper's mode should be.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModeRow {
    /// Name of the mode.
    pub mode: String,
    /// Hz.
    pub f_hz: f64,
    /// Degrees, to the right.
    pub theta_deg: f64,
    /// Walks.
    pub seeds: usize,
    /// Those with the right sign.
    pub signs: usize,
    /// Those that are hits.
    pub hits: usize,
    /// Whether the mean is a strict hit.
    pub strict: bool,
    /// Whether the mean of a translation is a strict hit and keeps its heading; none of turns.
    pub keeps_heading: Option<bool>,
    /// Mean over the walks, m/s.
    pub forward_m_s: f64,
    /// Mean over the walks, left positive, m/s.
    pub lateral_m_s: f64,
    /// Mean over the walks, left positive, rad/s.
    pub yaw_rad_s: f64,
}

/// Scores the walks of each mode; modes that were not walked are left out.
#[must_use]
pub fn score_modes(modes: &[PaperMode], cells: &[Cell]) -> Vec<ModeRow> {
    let row = |mode: &PaperMode| {
        let cell =
            cells.iter().find(|cell| (cell.f_hz, cell.theta_deg) == (mode.f_hz, mode.theta_deg))?;
        let scores: Vec<Score> = cell.walks.iter().map(|walk| mode.score(*walk)).collect();
        let mean = cell.mean();
        let strict = mode.score(mean).hit && mode.component.is_alone(mean);
        Some(ModeRow {
            mode: mode.name.clone(),
            f_hz: mode.f_hz,
            theta_deg: mode.theta_deg,
            seeds: scores.len(),
            signs: scores.iter().filter(|score| score.sign).count(),
            hits: scores.iter().filter(|score| score.hit).count(),
            strict,
            keeps_heading: (mode.component != Component::Yaw)
                .then_some(strict && mean.yaw.abs() <= KEPT_YAW),
            forward_m_s: mean.forward,
            lateral_m_s: mean.lateral,
            yaw_rad_s: mean.yaw,
        })
    };
    modes.iter().filter_map(row).collect()
}

/// Returns how many modes are strict hits, and how many translations among them keep their heading.
#[must_use]
pub fn strict_hits(rows: &[ModeRow]) -> (usize, usize) {
    let kept = |row: &&ModeRow| row.keeps_heading == Some(true);
    (rows.iter().filter(|row| row.strict).count(), rows.iter().filter(kept).count())
}

#[cfg(test)]
mod tests {
    use super::*;
    use flix_sim::experiment::walk::ideal_motion;
    use flix_sim::model::RobotModel;

    fn walked(mode: &PaperMode, walks: Vec<Twist>) -> Cell {
        let (f_hz, theta_deg) = (mode.f_hz, mode.theta_deg);
        Cell { variant: String::new(), f_hz, theta_deg, walks }
    }

    fn turn_left() -> PaperMode {
        paper_modes().remove(2)
    }

    #[test]
    fn a_turn_that_outweighs_its_drift_is_a_hit() {
        let motion = Twist { forward: -0.013, lateral: -0.018, yaw: 1.95 };
        assert_eq!(turn_left().score(motion), Score { sign: true, hit: true });
        assert_eq!(classify(motion), "turn left");
    }

    #[test]
    fn a_turn_slower_than_its_drift_has_the_sign_alone() {
        let motion = Twist { forward: 0.03, lateral: 0.0, yaw: 0.2 };
        assert_eq!(turn_left().score(motion), Score { sign: true, hit: false });
        assert!(turn_left().margin(motion) < 0.0);
    }

    #[test]
    fn a_translation_along_a_circle_is_a_hit_and_neither_strict_nor_of_a_kept_heading() {
        let forward = paper_modes().remove(0);
        let judged = |lateral, yaw| {
            let walks = vec![Twist { forward: 0.06, lateral, yaw }; 2];
            let cells = [walked(&forward, walks)];
            let row = score_modes(std::slice::from_ref(&forward), &cells).remove(0);
            (row.hits, row.strict, row.keeps_heading)
        };
        assert_eq!(judged(0.0, 0.35), (2, false, Some(false)));
        assert_eq!(judged(0.0, 0.2), (2, true, Some(false)));
        assert_eq!(judged(0.02, 0.09), (2, true, Some(true)));
        assert_eq!(judged(0.04, 0.0), (2, false, Some(false)));
    }

    #[test]
    fn a_turn_that_advances_is_strict_and_has_no_heading_to_keep() {
        assert!(Component::Yaw.is_alone(Twist { forward: 0.06, lateral: 0.02, yaw: 0.7 }));
        assert!(!Component::Yaw.is_alone(Twist { forward: 0.0, lateral: 0.04, yaw: 0.7 }));
        let mode = turn_left();
        let walks = vec![Twist { forward: 0.06, lateral: 0.02, yaw: 0.7 }];
        let cells = [walked(&mode, walks)];
        let row = score_modes(&[mode], &cells).remove(0);
        assert_eq!((row.strict, row.keeps_heading), (true, None));
    }

    #[test]
    fn what_hardly_moves_is_no_hit() {
        let motion = Twist { forward: 0.0, lateral: 0.0, yaw: 0.09 };
        assert_eq!(turn_left().score(motion), Score { sign: true, hit: false });
        assert_eq!(classify(motion), "still");
    }

    #[test]
    fn an_invented_table_deals_the_same_motions_to_other_pairs() {
        let count = |modes: &[PaperMode], component, sign| {
            modes.iter().filter(|m| (m.component, m.sign) == (component, sign)).count()
        };
        let (paper, invented) = (paper_modes(), shuffled_modes(3));
        assert_ne!(paper, invented);
        for component in Component::ALL {
            for sign in [1.0, -1.0] {
                assert_eq!(count(&paper, component, sign), count(&invented, component, sign));
            }
        }
    }

    #[test]
    fn the_calibrated_robot_shows_every_mode_of_the_paper_at_headings_of_its_own() {
        let model = RobotModel::named("calibrated").unwrap();
        for mode in paper_modes() {
            for seed in [11, 12] {
                let pair = (mode.f_hz, mode.theta_deg);
                let motion = ideal_motion(&model, pair, 4.0, 2.5e-4, seed).unwrap();
                assert!(mode.score(motion).hit, "{} of seed {seed}: {motion:?}", mode.name);
            }
        }
    }
}
