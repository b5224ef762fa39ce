//! What a calibration may change.
//!
//! The **open choices** are what the paper leaves open and what it publishes of legs and feet, left and right
//! alike; their ranges are those worth searching. The **unpublished** are the open choices without the single leg's
//! S* and the four frictions, which the paper publishes (sections II-C and III-B), and with the mass off the middle.
//! The **errors** are the paper's set X (equation 2): per leg four factors and the friction, the body's mass and its
//! two offsets, each relative to what the model had.

use flix_sim::model::{LEGS, Legs, RobotModel};

/// One number of the model that a search may choose.
#[derive(Clone)]
pub struct Unknown {
    /// Name with its unit.
    pub name: String,
    /// Lowest value searched.
    pub low: f64,
    /// Highest value searched.
    pub high: f64,
    effect: Effect,
}

/// How the value of an unknown changes a model.
#[derive(Clone)]
enum Effect {
    /// Sets each of these parameters to the value times its unit.
    Set(&'static [(&'static str, f64)]),
    /// Multiplies a parameter by the value.
    Times(String),
    /// Adds the value to a parameter.
    Plus(&'static str),
    /// Sets by what share the legs of a pattern are stiffer than the mean.
    Share(Pattern, [f64; 2]),
}
use Effect::{Plus, Set, Share, Times};

/// The numbers that a calibration fits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Fit {
    /// What the paper leaves open, and friction, stiffness and damping, left and right alike.
    Open,
    /// What the paper does not publish: friction, S* and its damping stay as the model has them.
    Unpublished,
    /// The paper's error set X.
    Errors,
    /// Both.
    Both,
}

/// Single-leg stiffness and damping before the whole robot is calibrated (paper, section II-C, S*):
/// bend and twist in N m/rad, bend and twist in N m s/rad.
static IDENTIFIED: [(&str, f64); 4] = [
    ("legs.bend_stiffness_n_m_rad", 1.062_072),
    ("legs.twist_stiffness_n_m_rad", 2.212_09),
    ("legs.bend_damping_n_m_s_rad", 0.0024),
    ("legs.twist_damping_n_m_s_rad", 0.001_83),
];

/// What the paper does not publish, with wider ranges than the open choices have, as stiffness and friction are given. The
/// shares of stiffness are a reading of equation 2's errors of stiffness, of which the paper publishes no value.
const UNPUBLISHED: [(&str, f64, f64); 19] = [
    ("hinge_deg", -90.0, -30.0),
    ("rotor_z_mm", 2.0, 24.0),
    ("core_x_mm", -5.0, 15.0),
    ("core_z_mm", 5.0, 45.0),
    ("battery_z_mm", -3.0, 10.0),
    ("contact_stiffness_n_per_m", 1500.0, 12000.0),
    ("contact_damping_n_s_per_m", 40.0, 105.0),
    ("front_stiffness_share", -0.3, 0.3),
    ("foot_mass_g", 2.0, 5.5),
    ("foot_height_mm", 4.0, 11.0),
    ("root_x_mm", 96.0, 112.0),
    ("root_y_mm", 47.0, 52.0),
    ("foot_shift_front_mm", -6.0, 15.0),
    ("foot_shift_rear_mm", -6.0, 15.0),
    ("mass_y_mm", -5.0, 5.0),
    ("left_stiffness_share", -0.2, 0.2),
    ("diagonal_stiffness_share", -0.2, 0.2),
    ("front_bend_share", -0.2, 0.2),
    ("diagonal_bend_share", -0.2, 0.2),
];

/// Only models with legs are calibrated.
const HAS_LEGS: &str = "a model without legs is refused before";

fn legs(model: &RobotModel) -> &Legs {
    model.legs.as_ref().expect(HAS_LEGS)
}

fn parameter<'a>(model: &'a mut RobotModel, key: &str) -> &'a mut f64 {
    model.parameter(key).expect(HAS_LEGS)
}

impl Effect {
    /// Returns the value of a model that is not yet changed.
    fn read(&self, model: &mut RobotModel) -> f64 {
        match self {
            Set(keys) => *parameter(model, keys[0].0) / keys[0].1,
            Times(_) => 1.0,
            Plus(_) => 0.0,
            Share(pattern, kind) => share(model, *pattern, *kind),
        }
    }

    fn write(&self, model: &mut RobotModel, value: f64) {
        match self {
            Set(keys) => {
                keys.iter().for_each(|(key, unit)| *parameter(model, key) = value * unit);
            }
            Times(key) => *parameter(model, key) *= value,
            Plus(key) => *parameter(model, key) += value,
            Share(pattern, kind) => set_share(model, *pattern, *kind, value),
        }
    }
}

/// Widest multiple of the ranges in which all values still are those of things (no mass below zero).
pub const WIDEST: f64 = 3.0;

/// Returns the unknowns of a fit, each range made `widen` times as wide about its middle (1 to [`WIDEST`]).
#[must_use]
pub fn unknowns(fit: Fit, widen: f64) -> Vec<Unknown> {
    let mut all = Vec::new();
    if fit != Fit::Errors {
        all.extend(open());
    }
    if fit != Fit::Open {
        all.extend(errors());
    }
    if fit == Fit::Unpublished {
        all.extend(uneven());
        let own = |unknown: Unknown| {
            let (_, low, high) =
                UNPUBLISHED.into_iter().find(|(name, ..)| *name == unknown.name)?;
            Some(Unknown { low, high, ..unknown })
        };
        all = all.into_iter().filter_map(own).collect();
    }
    for unknown in &mut all {
        let further = (widen - 1.0) / 2.0 * (unknown.high - unknown.low);
        unknown.low -= further;
        unknown.high += further;
    }
    all
}

/// What the paper leaves open.
fn open() -> Vec<Unknown> {
    let table: [(&str, f64, f64, Effect); 19] = [
        ("hinge_deg", -80.0, -60.0, Set(&[("legs.hinge_deg", 1.0)])),
        ("rotor_z_mm", 15.0, 22.0, Set(&[("shaker.z_mm", 1.0)])),
        ("core_x_mm", 5.0, 12.0, Set(&[("core.x_mm", 1.0)])),
        ("core_z_mm", 30.0, 45.0, Set(&[("core.z_mm", 1.0)])),
        ("battery_z_mm", -2.0, 10.0, Set(&[("battery.z_mm", 1.0), ("electronics.z_mm", 1.0)])),
        ("contact_stiffness_n_per_m", 4000.0, 7600.0, Set(&[("contact.stiffness_n_per_m", 1.0)])),
        ("contact_damping_n_s_per_m", 50.0, 95.0, Set(&[("contact.damping_n_s_per_m", 1.0)])),
        ("friction_front", 0.6, 0.8, Set(&[("legs.fl.friction", 1.0), ("legs.fr.friction", 1.0)])),
        ("friction_rear", 0.6, 0.8, Set(&[("legs.rl.friction", 1.0), ("legs.rr.friction", 1.0)])),
        ("bend_stiffness_factor", 1.0, 1.2, Set(&IDENTIFIED[..1])),
        ("twist_stiffness_factor", 0.6, 0.8, Set(&IDENTIFIED[1..2])),
        ("damping_factor", 1.5, 2.4, Set(&IDENTIFIED[2..])),
        ("front_stiffness_share", 0.1, 0.3, Share(Pattern::Front, STIFFNESS)),
        ("foot_mass_g", 4.0, 5.2, Set(&[("legs.foot.mass_g", 1.0)])),
        ("foot_height_mm", 9.0, 11.0, Set(&[("legs.foot.height_mm", 1.0)])),
        ("root_x_mm", 104.0, 110.0, Set(&[("legs.root_x_mm", 1.0)])),
        ("root_y_mm", 47.0, 51.0, Set(&[("legs.root_y_mm", 1.0)])),
        (
            "foot_shift_front_mm",
            -15.0,
            15.0,
            Set(&[("legs.fl.foot_shift_mm", 1.0), ("legs.fr.foot_shift_mm", 1.0)]),
        ),
        (
            "foot_shift_rear_mm",
            -15.0,
            15.0,
            Set(&[("legs.rl.foot_shift_mm", 1.0), ("legs.rr.foot_shift_mm", 1.0)]),
        ),
    ];
    table.into_iter().map(unknown).collect()
}

fn unknown((name, low, high, effect): (&str, f64, f64, Effect)) -> Unknown {
    Unknown { name: name.to_owned(), low, high, effect }
}

/// How the legs' stiffness differs beyond front and rear: what the paper's X has and publishes no value of.
fn uneven() -> Vec<Unknown> {
    let table = [
        ("left_stiffness_share", -0.2, 0.2, Share(Pattern::Left, STIFFNESS)),
        ("diagonal_stiffness_share", -0.2, 0.2, Share(Pattern::Diagonal, STIFFNESS)),
        ("front_bend_share", -0.2, 0.2, Share(Pattern::Front, BEND_OVER_TWIST)),
        ("diagonal_bend_share", -0.2, 0.2, Share(Pattern::Diagonal, BEND_OVER_TWIST)),
    ];
    table.map(unknown).into()
}

/// Two legs against the two others.
#[derive(Clone, Copy)]
enum Pattern {
    Front,
    Left,
    /// Front left and rear right.
    Diagonal,
}

impl Pattern {
    /// In the order of [`LEGS`].
    const fn signs(self) -> [f64; 4] {
        match self {
            Self::Front => [1.0, 1.0, -1.0, -1.0],
            Self::Left => [1.0, -1.0, 1.0, -1.0],
            Self::Diagonal => [1.0, -1.0, -1.0, 1.0],
        }
    }
}

/// Signs with which the factors of bend and twist stiffness count: both alike.
const STIFFNESS: [f64; 2] = [1.0, 1.0];
/// Bend against twist.
const BEND_OVER_TWIST: [f64; 2] = [1.0, -1.0];

/// Returns by what share the legs of a pattern are stiffer than the mean.
fn share(model: &RobotModel, pattern: Pattern, [bend, twist]: [f64; 2]) -> f64 {
    let legs = legs(model);
    let each = legs.each().into_iter().zip(pattern.signs());
    each.map(|(leg, sign)| {
        sign * (bend * leg.bend_stiffness_factor + twist * leg.twist_stiffness_factor) / 8.0
    })
    .sum()
}

/// Changes that share; whatever else differs between the legs stays.
fn set_share(model: &mut RobotModel, pattern: Pattern, [bend, twist]: [f64; 2], value: f64) {
    let change = value - share(model, pattern, [bend, twist]);
    let legs = model.legs.as_mut().expect(HAS_LEGS);
    for (leg, sign) in legs.each_mut().into_iter().zip(pattern.signs()) {
        leg.bend_stiffness_factor += change * sign * bend;
        leg.twist_stiffness_factor += change * sign * twist;
    }
}

/// The paper's error set X.
fn errors() -> Vec<Unknown> {
    let factors = [
        ("bend_stiffness", "bend_stiffness_factor"),
        ("twist_stiffness", "twist_stiffness_factor"),
        ("bend_damping", "bend_damping_factor"),
        ("twist_damping", "twist_damping_factor"),
        ("friction", "friction"),
    ];
    let of_leg = |leg| {
        factors.map(|(name, key)| Unknown {
            name: format!("{leg}_{name}_error"),
            low: 0.8,
            high: 1.2,
            effect: Times(format!("legs.{leg}.{key}")),
        })
    };
    let body = [
        ("mass_error", 0.95, 1.05, Times("body.total_mass_g".to_owned())),
        ("mass_x_mm", -5.0, 5.0, Plus("body.offset_x_mm")),
        ("mass_y_mm", -5.0, 5.0, Plus("body.offset_y_mm")),
    ];
    LEGS.into_iter().flat_map(of_leg).chain(body.map(unknown)).collect()
}

/// Converts a model to a point of the unit cube: 0 the lowest value of a range, 1 the highest. Values outside go to
/// the nearest wall.
#[must_use]
pub fn point(unknowns: &[Unknown], model: &RobotModel) -> Vec<f64> {
    let mut model = model.clone();
    let share = |u: &Unknown| (u.effect.read(&mut model) - u.low) / (u.high - u.low);
    unknowns.iter().map(share).map(|it| it.clamp(0.0, 1.0)).collect()
}

/// Returns the unknowns' values at a point of the unit cube, with as many digits as anybody could measure.
#[must_use]
pub fn values(unknowns: &[Unknown], point: &[f64]) -> Vec<f64> {
    let round = |value: f64| (value * 1e4).round() / 1e4;
    unknowns.iter().zip(point).map(|(u, x)| round(u.low + x * (u.high - u.low))).collect()
}

/// Returns the model at a point of the unit cube.
#[must_use]
pub fn apply(unknowns: &[Unknown], base: &RobotModel, point: &[f64]) -> RobotModel {
    let mut model = base.clone();
    for (unknown, value) in unknowns.iter().zip(values(unknowns, point)) {
        unknown.effect.write(&mut model, value);
    }
    model
}

#[cfg(test)]
mod tests {
    use super::*;

    fn walker() -> RobotModel {
        RobotModel::named("W").unwrap()
    }

    #[test]
    fn a_model_comes_back_from_its_own_point() {
        let unknowns = unknowns(Fit::Both, 1.0);
        let model = walker();
        let back = apply(&unknowns, &model, &point(&unknowns, &model));
        let off = |a: f64, b: f64| (a / b - 1.0).abs();
        assert!(off(legs(&back).bend_stiffness_n_m_rad, 1.2036) < 1e-3);
        assert_eq!(back.shaker.z_mm, model.shaker.z_mm);
        assert_eq!(legs(&back).rr.foot_shift_mm, legs(&model).rr.foot_shift_mm);
    }

    #[test]
    fn the_searched_ranges_are_of_robots_but_where_feet_would_touch() {
        let unknowns = unknowns(Fit::Both, 1.0);
        let corner = |at: f64| apply(&unknowns, &walker(), &vec![at; unknowns.len()]).check();
        assert!(corner(1.0).is_ok());
        assert!(corner(0.0).unwrap_err().to_string().contains("feet fl and fr"));
    }

    #[test]
    fn the_widest_ranges_keep_their_middles_and_hold_no_mass_or_stiffness_below_zero() {
        let usual = unknowns(Fit::Both, 1.0);
        for (wide, usual) in unknowns(Fit::Both, WIDEST).iter().zip(&usual) {
            let width = |u: &Unknown| u.high - u.low;
            assert!((width(wide) / width(usual) - WIDEST).abs() < 1e-9, "{}", wide.name);
            assert!((wide.low + wide.high - usual.low - usual.high).abs() < 1e-9, "{}", wide.name);
            // What may go below zero already does, or is a place or a share.
            let is_signed = ["x_mm", "y_mm", "z_mm", "share", "shift"];
            let is_signed = is_signed.iter().any(|part| wide.name.contains(part));
            assert!(is_signed || usual.low < 0.0 || wide.low > 0.0, "{}", wide.name);
        }
    }

    #[test]
    fn a_share_of_stiffness_leaves_every_other_difference_between_the_legs() {
        let mut model = walker();
        model.legs.as_mut().unwrap().fr.bend_stiffness_factor += 0.08;
        let all = [Pattern::Front, Pattern::Left, Pattern::Diagonal]
            .into_iter()
            .flat_map(|pattern| [(pattern, STIFFNESS), (pattern, BEND_OVER_TWIST)]);
        let shares = |model: &RobotModel| -> Vec<f64> {
            all.clone().map(|(pattern, kind)| share(model, pattern, kind)).collect()
        };
        let before = shares(&model);
        set_share(&mut model, Pattern::Left, BEND_OVER_TWIST, 0.1);
        let after = shares(&model);
        // The fourth is bend over twist on the left.
        assert!((after[3] - 0.1).abs() < 1e-12, "{after:?}");
        for (at, (before, after)) in before.iter().zip(&after).enumerate() {
            assert!(at == 3 || (before - after).abs() < 1e-12, "{at}: {before} {after}");
        }
    }

    #[test]
    fn a_fit_of_what_is_unpublished_keeps_the_papers_leg_and_friction() {
        let unknowns = unknowns(Fit::Unpublished, 1.0);
        assert_eq!(unknowns.len(), UNPUBLISHED.len());
        let published = |model: &RobotModel| {
            let legs = legs(model);
            let leg = [
                legs.bend_stiffness_n_m_rad,
                legs.twist_stiffness_n_m_rad,
                legs.bend_damping_n_m_s_rad,
                legs.twist_damping_n_m_s_rad,
            ];
            (leg, legs.each().map(|leg| leg.friction))
        };
        for at in [0.2, 0.9] {
            let found = apply(&unknowns, &walker(), &vec![at; unknowns.len()]);
            assert_eq!(published(&found), published(&walker()));
        }
    }

    #[test]
    fn every_unknown_changes_the_model_and_no_other_unknown_undoes_it() {
        let unknowns = unknowns(Fit::Both, 1.0);
        let middle = apply(&unknowns, &walker(), &vec![0.5; unknowns.len()]);
        for i in 0..unknowns.len() {
            let mut point = vec![0.5; unknowns.len()];
            point[i] = 0.9;
            assert_ne!(apply(&unknowns, &walker(), &point), middle, "{}", unknowns[i].name);
        }
    }
}
