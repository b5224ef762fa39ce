//! What a calibration may change.
//!
//! The **open choices** are what the paper leaves open and what it publishes of legs and feet, left and right
//! alike; their ranges are those worth searching. The **unpublished** are the open choices without the single leg's
//! S* and the four frictions, which the paper publishes (sections II-C and III-B), and with the mass off the middle.
//! The **errors** are the paper's set X (equation 2): per leg four factors and the friction, the body's mass and its
//! two offsets, each relative to what the model had.

use flix_sim::model::{LEGS, Leg, Legs, RobotModel};

type Read = fn(&RobotModel, usize) -> f64;
type Write = fn(&mut RobotModel, usize, f64);

/// One number of the model that a search may choose.
#[derive(Clone)]
pub struct Unknown {
    /// Name with its unit.
    pub name: String,
    /// Lowest value searched.
    pub low: f64,
    /// Highest value searched.
    pub high: f64,
    /// Value of a model that is not yet changed.
    read: Read,
    /// Changes a model.
    write: Write,
    /// The leg, for what legs have of their own.
    leg: usize,
}

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
const IDENTIFIED: [f64; 4] = [1.062_072, 2.212_09, 0.0024, 0.001_83];

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

fn legs(model: &RobotModel) -> &Legs {
    model.legs.as_ref().expect("only models with legs are calibrated")
}

fn legs_mut(model: &mut RobotModel) -> &mut Legs {
    model.legs.as_mut().expect("only models with legs are calibrated")
}

fn pair_mut(model: &mut RobotModel, rear: bool) -> [&mut Leg; 2] {
    let [fl, fr, rl, rr] = legs_mut(model).each_mut();
    if rear { [rl, rr] } else { [fl, fr] }
}

fn leg_mut(model: &mut RobotModel, leg: usize) -> &mut Leg {
    let [fl, fr, rl, rr] = legs_mut(model).each_mut();
    match leg {
        0 => fl,
        1 => fr,
        2 => rl,
        _ => rr,
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
    let table: [(&str, f64, f64, Read, Write); 19] = [
        ("hinge_deg", -80.0, -60.0, |m, _| legs(m).hinge_deg, |m, _, v| legs_mut(m).hinge_deg = v),
        ("rotor_z_mm", 15.0, 22.0, |m, _| m.shaker.z_mm, |m, _, v| m.shaker.z_mm = v),
        ("core_x_mm", 5.0, 12.0, |m, _| m.core.x_mm, |m, _, v| m.core.x_mm = v),
        ("core_z_mm", 30.0, 45.0, |m, _| m.core.z_mm, |m, _, v| m.core.z_mm = v),
        (
            "battery_z_mm",
            -2.0,
            10.0,
            |m, _| m.battery.z_mm,
            |m, _, v| (m.battery.z_mm, m.electronics.z_mm) = (v, v),
        ),
        (
            "contact_stiffness_n_per_m",
            4000.0,
            7600.0,
            |m, _| m.contact.stiffness_n_per_m,
            |m, _, v| m.contact.stiffness_n_per_m = v,
        ),
        (
            "contact_damping_n_s_per_m",
            50.0,
            95.0,
            |m, _| m.contact.damping_n_s_per_m,
            |m, _, v| m.contact.damping_n_s_per_m = v,
        ),
        (
            "friction_front",
            0.6,
            0.8,
            |m, _| legs(m).fl.friction,
            |m, _, v| pair_mut(m, false).into_iter().for_each(|leg| leg.friction = v),
        ),
        (
            "friction_rear",
            0.6,
            0.8,
            |m, _| legs(m).rl.friction,
            |m, _, v| pair_mut(m, true).into_iter().for_each(|leg| leg.friction = v),
        ),
        (
            "bend_stiffness_factor",
            1.0,
            1.2,
            |m, _| legs(m).bend_stiffness_n_m_rad / IDENTIFIED[0],
            |m, _, v| legs_mut(m).bend_stiffness_n_m_rad = v * IDENTIFIED[0],
        ),
        (
            "twist_stiffness_factor",
            0.6,
            0.8,
            |m, _| legs(m).twist_stiffness_n_m_rad / IDENTIFIED[1],
            |m, _, v| legs_mut(m).twist_stiffness_n_m_rad = v * IDENTIFIED[1],
        ),
        (
            "damping_factor",
            1.5,
            2.4,
            |m, _| legs(m).bend_damping_n_m_s_rad / IDENTIFIED[2],
            |m, _, v| {
                legs_mut(m).bend_damping_n_m_s_rad = v * IDENTIFIED[2];
                legs_mut(m).twist_damping_n_m_s_rad = v * IDENTIFIED[3];
            },
        ),
        (
            "front_stiffness_share",
            0.1,
            0.3,
            |m, _| share(m, Pattern::Front, STIFFNESS),
            |m, _, v| set_share(m, Pattern::Front, STIFFNESS, v),
        ),
        (
            "foot_mass_g",
            4.0,
            5.2,
            |m, _| legs(m).foot.mass_g,
            |m, _, v| legs_mut(m).foot.mass_g = v,
        ),
        (
            "foot_height_mm",
            9.0,
            11.0,
            |m, _| legs(m).foot.height_mm,
            |m, _, v| legs_mut(m).foot.height_mm = v,
        ),
        ("root_x_mm", 104.0, 110.0, |m, _| legs(m).root_x_mm, |m, _, v| legs_mut(m).root_x_mm = v),
        ("root_y_mm", 47.0, 51.0, |m, _| legs(m).root_y_mm, |m, _, v| legs_mut(m).root_y_mm = v),
        (
            "foot_shift_front_mm",
            -15.0,
            15.0,
            |m, _| legs(m).fl.foot_shift_mm,
            |m, _, v| pair_mut(m, false).into_iter().for_each(|leg| leg.foot_shift_mm = v),
        ),
        (
            "foot_shift_rear_mm",
            -15.0,
            15.0,
            |m, _| legs(m).rl.foot_shift_mm,
            |m, _, v| pair_mut(m, true).into_iter().for_each(|leg| leg.foot_shift_mm = v),
        ),
    ];
    table
        .into_iter()
        .map(|(name, low, high, read, write)| Unknown {
            name: name.to_owned(),
            low,
            high,
            read,
            write,
            leg: 0,
        })
        .collect()
}

/// How the legs' stiffness differs beyond front and rear: what the paper's X has and publishes no value of.
fn uneven() -> Vec<Unknown> {
    let table: [(&str, Read, Write); 4] = [
        (
            "left_stiffness_share",
            |m, _| share(m, Pattern::Left, STIFFNESS),
            |m, _, v| set_share(m, Pattern::Left, STIFFNESS, v),
        ),
        (
            "diagonal_stiffness_share",
            |m, _| share(m, Pattern::Diagonal, STIFFNESS),
            |m, _, v| set_share(m, Pattern::Diagonal, STIFFNESS, v),
        ),
        (
            "front_bend_share",
            |m, _| share(m, Pattern::Front, BEND_OVER_TWIST),
            |m, _, v| set_share(m, Pattern::Front, BEND_OVER_TWIST, v),
        ),
        (
            "diagonal_bend_share",
            |m, _| share(m, Pattern::Diagonal, BEND_OVER_TWIST),
            |m, _, v| set_share(m, Pattern::Diagonal, BEND_OVER_TWIST, v),
        ),
    ];
    let own = |(name, read, write): (&str, Read, Write)| Unknown {
        name: name.to_owned(),
        low: -0.2,
        high: 0.2,
        read,
        write,
        leg: 0,
    };
    table.into_iter().map(own).collect()
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
    for (leg, sign) in legs_mut(model).each_mut().into_iter().zip(pattern.signs()) {
        leg.bend_stiffness_factor += change * sign * bend;
        leg.twist_stiffness_factor += change * sign * twist;
    }
}

/// The paper's error set X.
fn errors() -> Vec<Unknown> {
    let factors: [(&str, Write); 5] = [
        ("bend_stiffness", |m, leg, v| leg_mut(m, leg).bend_stiffness_factor *= v),
        ("twist_stiffness", |m, leg, v| leg_mut(m, leg).twist_stiffness_factor *= v),
        ("bend_damping", |m, leg, v| leg_mut(m, leg).bend_damping_factor *= v),
        ("twist_damping", |m, leg, v| leg_mut(m, leg).twist_damping_factor *= v),
        ("friction", |m, leg, v| leg_mut(m, leg).friction *= v),
    ];
    let mut all = Vec::new();
    for (leg, name) in LEGS.iter().enumerate() {
        all.extend(factors.map(|(what, write)| Unknown {
            name: format!("{name}_{what}_error"),
            low: 0.8,
            high: 1.2,
            read: |_, _| 1.0,
            write,
            leg,
        }));
    }
    let body: [(&str, f64, f64, f64, Write); 3] = [
        ("mass_error", 0.95, 1.05, 1.0, |m, _, v| m.body.total_mass_g *= v),
        ("mass_x_mm", -5.0, 5.0, 0.0, |m, _, v| m.body.offset_x_mm += v),
        ("mass_y_mm", -5.0, 5.0, 0.0, |m, _, v| m.body.offset_y_mm += v),
    ];
    all.extend(body.map(|(name, low, high, neutral, write)| Unknown {
        name: name.to_owned(),
        low,
        high,
        read: if neutral == 1.0 { |_, _| 1.0 } else { |_, _| 0.0 },
        write,
        leg: 0,
    }));
    all
}

/// Converts a model to a point of the unit cube: 0 the lowest value of a range, 1 the highest. Values outside go to
/// the nearest wall.
#[must_use]
pub fn point(unknowns: &[Unknown], model: &RobotModel) -> Vec<f64> {
    unknowns
        .iter()
        .map(|u| (((u.read)(model, u.leg) - u.low) / (u.high - u.low)).clamp(0.0, 1.0))
        .collect()
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
        (unknown.write)(&mut model, unknown.leg, value);
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
        legs_mut(&mut model).fr.bend_stiffness_factor += 0.08;
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
