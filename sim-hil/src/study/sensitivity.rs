//! How robust each pair (f, theta) is against mass and friction that deviate (paper, section III-B), and which pairs
//! to use (section III-C).
//!
//! ```text
//! I = V_ref / RMSE(V_changed, V_ref)            for each of the three speeds (equation 8)
//! P = (I_mass + I_friction) / 2                 (equation 9)
//! ```
//!
//! V are means over the seeds; the RMSE is over the changed robots. I and P keep the sign of V_ref.
//!
//! The paper leaves out pairs "with a heading speed below 0.05 m/s", though turning and strafing want little of
//! it. It is read as the speed of the mode's own component, yaw rates times [`LEVER`](super::modes::LEVER).

use flix_host::nav::{self, ModeTable, ModeTableError};

use super::modes::{Component, classify};
use super::sweep::{Cell, Variant};
use crate::model::{Load, RobotModel};
use crate::rig::bench::setpoint;

/// Mass of the paper's load, g.
const LOAD_G: f64 = 50.0;
/// Distance of its centre from the edge, mm.
const FROM_EDGE_MM: f64 = 12.0;
/// Changes of the left feet's friction, percent.
const FRICTION_CHANGES: [i32; 4] = [-10, 10, -58, 58];
/// The paper's least speed of a pair that is worth choosing, m/s.
pub const LEAST_SPEED: f64 = 0.05;
/// What of the paper's robots is not in its index: a control of one statement.
pub const CONTROL: &str = "right friction -10 %";
/// Deviations below this are rounding, m/s or rad/s.
const NO_DEVIATION: f64 = 1e-9;

/// What is changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Change {
    /// 50 g at one of the four edges.
    Mass,
    /// Friction of the left feet.
    Friction,
}

/// Returns the robot as it is, then the changed ones.
#[must_use]
pub fn variants(model: &RobotModel, change: Change) -> Vec<Variant> {
    let mut all = vec![Variant { name: "baseline".to_owned(), model: model.clone() }];
    match change {
        Change::Mass => all.extend(loaded(model)),
        Change::Friction => {
            all.extend(FRICTION_CHANGES.map(|percent| slippery(model, "left", percent)));
            all.push(slippery(model, "right", -10));
        }
    }
    all
}

fn loaded(model: &RobotModel) -> [Variant; 4] {
    let (x, y) =
        (0.5 * model.plate.length_mm - FROM_EDGE_MM, 0.5 * model.plate.width_mm - FROM_EDGE_MM);
    [("front", x, 0.0), ("rear", -x, 0.0), ("left", 0.0, y), ("right", 0.0, -y)].map(
        |(name, x_mm, y_mm)| {
            let mut model = model.clone();
            model.load.push(Load { mass_g: LOAD_G, x_mm, y_mm, z_mm: 0.0 });
            Variant { name: format!("{name} load"), model }
        },
    )
}

fn slippery(model: &RobotModel, side: &str, percent: i32) -> Variant {
    let mut model = model.clone();
    if let Some(legs) = &mut model.legs {
        let [fl, fr, rl, rr] = legs.each_mut();
        for leg in if side == "left" { [fl, rl] } else { [fr, rr] } {
            leg.friction *= 1.0 + f64::from(percent) / 100.0;
        }
    }
    Variant { name: format!("{side} friction {percent:+} %"), model }
}

/// Returns the walks of one variant and one pair.
#[must_use]
pub fn find<'a>(cells: &'a [Cell], variant: &str, f_hz: f64, theta_deg: f64) -> Option<&'a Cell> {
    cells
        .iter()
        .find(|cell| cell.variant == variant && (cell.f_hz, cell.theta_deg) == (f_hz, theta_deg))
}

/// Computes I of one speed at one pair; `cells` are those of one change. None for pairs that were not walked.
#[must_use]
pub fn index(cells: &[Cell], f_hz: f64, theta_deg: f64, component: Component) -> Option<f64> {
    let reference = component.of(find(cells, "baseline", f_hz, theta_deg)?.mean());
    let squares: Vec<f64> = cells
        .iter()
        .filter(|cell| (cell.f_hz, cell.theta_deg) == (f_hz, theta_deg))
        .filter(|cell| cell.variant != "baseline" && cell.variant != CONTROL)
        .map(|cell| (component.of(cell.mean()) - reference).powi(2))
        .collect();
    let rmse = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    Some(reference / rmse.max(NO_DEVIATION))
}

/// A pair with its index.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// The walks of the unchanged robot.
    pub cell: Cell,
    /// The component that dominates.
    pub component: Component,
    /// P of that component, with its sign.
    pub index: f64,
    /// Whether it is fast enough to be chosen ([`LEAST_SPEED`]).
    pub fast: bool,
}

/// Computes P of one speed at one pair.
#[must_use]
pub fn robustness(
    mass: &[Cell],
    friction: &[Cell],
    (f, theta): (f64, f64),
    component: Component,
) -> Option<f64> {
    Some(0.5 * (index(mass, f, theta, component)? + index(friction, f, theta, component)?))
}

/// Pairs of every kind of motion, most robust first; slow ones after all others.
#[must_use]
pub fn candidates(
    mass: &[Cell],
    friction: &[Cell],
    least: f64,
) -> Vec<(&'static str, Vec<Candidate>)> {
    let baseline = mass.iter().filter(|cell| cell.variant == "baseline");
    let mut kinds: Vec<(&'static str, Vec<Candidate>)> = Vec::new();
    for sign in [1.0, -1.0] {
        for component in Component::ALL {
            kinds.push((component.word(sign), Vec::new()));
        }
    }
    for cell in baseline {
        let word = classify(cell.mean());
        for component in Component::ALL {
            let speed = component.of(cell.mean());
            if component.word(speed) != word {
                continue;
            }
            let pair = (cell.f_hz, cell.theta_deg);
            let Some(index) = robustness(mass, friction, pair, component) else { continue };
            let candidate =
                Candidate { cell: cell.clone(), component, index, fast: speed.abs() >= least };
            if let Some((_, found)) = kinds.iter_mut().find(|(kind, _)| *kind == word) {
                found.push(candidate);
            }
        }
    }
    for (_, found) in &mut kinds {
        found.sort_by(|a, b| b.fast.cmp(&a.fast).then(b.index.abs().total_cmp(&a.index.abs())));
    }
    kinds.retain(|(_, found)| !found.is_empty());
    kinds
}

/// Returns the best pair of every kind as a mode table for `flix track`.
///
/// # Errors
/// When there is no mode at all.
pub fn mode_table(
    robot: &str,
    source: &str,
    kinds: &[(&'static str, Vec<Candidate>)],
) -> Result<ModeTable, ModeTableError> {
    let modes = kinds.iter().filter_map(|(kind, found)| {
        let cell = &found.first()?.cell;
        let [forward, lateral, yaw] = cell.spreads().map(Into::into);
        let name = match *kind {
            "turn left" => "left".to_owned(),
            "turn right" => "right".to_owned(),
            other => other.replace(' ', "-"),
        };
        let setpoint = setpoint(cell.f_hz, cell.theta_deg).ok()?;
        Some(nav::Mode { name, setpoint, forward, lateral, yaw })
    });
    ModeTable::new(robot, source, modes.collect())
}

#[cfg(test)]
mod tests {
    use flix_host::nav::Twist;

    use super::*;

    fn cell(variant: &str, f_hz: f64, forward: f64, yaw: f64) -> Cell {
        let walks = vec![Twist { forward, lateral: 0.0, yaw }];
        Cell { variant: variant.to_owned(), f_hz, theta_deg: 0.0, walks }
    }

    #[test]
    fn the_index_is_the_reference_over_the_root_mean_square_deviation() {
        let cells = [
            cell("baseline", 30.0, -0.1, 0.0),
            cell("front load", 30.0, -0.13, 0.0),
            cell("rear load", 30.0, -0.14, 0.0),
            cell(CONTROL, 30.0, 9.0, 0.0),
        ];
        let rmse = ((0.03f64.powi(2) + 0.04f64.powi(2)) / 2.0).sqrt();
        let found = index(&cells, 30.0, 0.0, Component::Forward).unwrap();
        assert!((found + 0.1 / rmse).abs() < 1e-9);
    }

    #[test]
    fn a_robust_slow_pair_comes_after_a_fast_one() {
        let cells = [
            cell("baseline", 30.0, 0.04, 0.0),
            cell("baseline", 35.0, 0.06, 0.0),
            cell("a", 30.0, 0.041, 0.0),
            cell("a", 35.0, 0.08, 0.0),
        ];
        let found = candidates(&cells, &cells, LEAST_SPEED);
        let order: Vec<f64> = found[0].1.iter().map(|c| c.cell.f_hz).collect();
        assert_eq!((found[0].0, order), ("forward", vec![35.0, 30.0]));
    }

    #[test]
    fn loads_lie_12_mm_inside_the_edges() {
        let model = RobotModel::named("W").unwrap();
        let [_, front, rear, left, right] = &variants(&model, Change::Mass)[..] else {
            panic!("five robots")
        };
        let at = |v: &Variant| (v.model.load[0].x_mm, v.model.load[0].y_mm);
        assert_eq!([at(front), at(rear)], [(98.0, 0.0), (-98.0, 0.0)]);
        assert_eq!([at(left), at(right)], [(0.0, 48.0), (0.0, -48.0)]);
        assert_eq!(left.model.load[0].mass_g, 50.0);
    }

    #[test]
    fn only_the_named_sides_friction_changes() {
        let model = RobotModel::named("W").unwrap();
        let all = variants(&model, Change::Friction);
        let friction = |name: &str| {
            let variant = all.iter().find(|v| v.name == name).unwrap();
            variant.model.legs.unwrap().each().map(|leg| leg.friction)
        };
        let [fl, fr, rl, rr] = friction("baseline");
        let agree = |name: &str, expected: [f64; 4]| {
            friction(name).iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12)
        };
        assert!(agree("left friction -58 %", [0.42 * fl, fr, 0.42 * rl, rr]));
        assert!(agree(CONTROL, [fl, 0.9 * fr, rl, 0.9 * rr]));
    }

    #[test]
    fn the_mode_table_names_what_a_tracker_asks_for() {
        let cells = [cell("baseline", 30.0, 0.0, 1.0), cell("a", 30.0, 0.0, 1.1)];
        let table = mode_table("W", "test", &candidates(&cells, &cells, LEAST_SPEED)).unwrap();
        assert_eq!(table.modes()[0].name, "left");
    }
}
