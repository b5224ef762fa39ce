//! How robust each pair (f, theta) is against mass and friction that deviate (paper, section III-B).
//!
//! ```text
//! I = V_ref / RMSE(V_changed, V_ref)            for each of the three speeds (equation 8)
//! ```
//!
//! V are means over the seeds; the RMSE is over the changed robots. I keeps the sign of V_ref.

use super::modes::Component;
use super::sweep::{Cell, Variant};
use flix_sim::model::{Load, RobotModel};

/// Mass of the paper's load, g.
const LOAD_G: f64 = 50.0;
/// Distance of its centre from the edge, mm.
const FROM_EDGE_MM: f64 = 12.0;
/// Changes of the left feet's friction, percent.
const FRICTION_CHANGES: [i32; 4] = [-10, 10, -58, 58];
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

/// Computes I of one speed at one pair, with one of the seeds left out if asked; `cells` are those of one change. None
/// for pairs that were not walked.
#[must_use]
pub fn index(
    cells: &[Cell],
    f_hz: f64,
    theta_deg: f64,
    component: Component,
    without: Option<usize>,
) -> Option<f64> {
    let mean = |cell: &Cell| {
        let walks = cell.walks.iter().enumerate().filter(|(seed, _)| Some(*seed) != without);
        let speeds: Vec<f64> = walks.map(|(_, walk)| component.of(*walk)).collect();
        speeds.iter().sum::<f64>() / speeds.len() as f64
    };
    let reference = mean(find(cells, "baseline", f_hz, theta_deg)?);
    let squares: Vec<f64> = cells
        .iter()
        .filter(|cell| (cell.f_hz, cell.theta_deg) == (f_hz, theta_deg))
        .filter(|cell| cell.variant != "baseline" && cell.variant != CONTROL)
        .map(|cell| (mean(cell) - reference).powi(2))
        .collect();
    let rmse = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    Some(reference / rmse.max(NO_DEVIATION))
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
        let found = index(&cells, 30.0, 0.0, Component::Forward, None).unwrap();
        assert!((found + 0.1 / rmse).abs() < 1e-9);
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
}
