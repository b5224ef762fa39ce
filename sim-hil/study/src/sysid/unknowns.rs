//! What is identified of a robot, and how well its plan is trusted beforehand.
//!
//! Each unknown is Gaussian about its value in the plan. All are counted in their own spreads, so that the plan is the
//! origin and the prior's covariance the identity.

use serde::Serialize;

use flix_sim::model::{LEGS, Leg, Load, RobotModel};

/// The experiments that an unknown shows in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// How heavy the body is, and where.
    Mass,
    /// Stiffness of a leg.
    Stiffness,
    /// Damping of a leg.
    Damping,
    /// Friction of a foot.
    Friction,
    /// Stiffness and damping of the floor.
    Floor,
}

impl Kind {
    /// All, in the order in which they become visible.
    pub const ALL: [Self; 5] =
        [Self::Mass, Self::Stiffness, Self::Damping, Self::Friction, Self::Floor];
}

/// One number of the model.
#[derive(Debug, Clone)]
pub struct Unknown {
    /// What it is called, with its unit.
    pub name: String,
    /// What it is about.
    pub kind: Kind,
    /// Its value in the plan.
    planned: f64,
    /// Standard deviation of the prior, in the unit of the model's field.
    spread: f64,
    /// Lowest value that makes sense.
    least: f64,
    /// What one in the model's field is in the unit of the name.
    unit: f64,
    /// The leg.
    leg: usize,
    place: fn(&mut RobotModel, usize) -> Option<&mut f64>,
}

/// Spread of stiffness and damping of a leg, as a share: what manufacture leaves open (paper, section II-D), doubled.
const LEG_SPREAD: f64 = 0.15;
/// Spread of a foot's friction, as a share.
const FRICTION_SPREAD: f64 = 0.25;
/// Spread of the floor's stiffness and damping, as a share.
const FLOOR_SPREAD: f64 = 0.25;
/// What is on the body besides the plan: one mass, at first here, g and mm, with these spreads.
const LOAD: [(f64, f64); 4] = [(20.0, 12.0), (0.0, 30.0), (0.0, 20.0), (15.0, 10.0)];
/// No value of a model falls below this share of the plan.
const LEAST_SHARE: f64 = 0.2;

fn leg(model: &mut RobotModel, leg: usize) -> Option<&mut Leg> {
    model.legs.as_mut()?.each_mut().into_iter().nth(leg)
}

impl Unknown {
    /// Returns the value at `x` spreads from the plan, in the unit of the name.
    #[must_use]
    pub fn value(&self, x: f64) -> f64 {
        self.unit * (self.planned + self.spread * x).max(self.least)
    }

    /// Returns the standard deviation in the unit of the name that is `x` in spreads.
    #[must_use]
    pub fn deviation(&self, x: f64) -> f64 {
        self.unit * self.spread * x
    }
}

/// Returns the plan with the unknown mass on it, and the unknowns.
#[must_use]
pub fn unknowns(plan: &RobotModel) -> (RobotModel, Vec<Unknown>) {
    type Place = fn(&mut RobotModel, usize) -> Option<&mut f64>;
    let mut base = plan.clone();
    let [mass_g, x_mm, y_mm, z_mm] = LOAD.map(|(middle, _)| middle);
    base.load.push(Load { mass_g, x_mm, y_mm, z_mm });
    let whole: [(&str, Kind, f64, f64, Place); 10] = [
        ("total_mass_g", Kind::Mass, 0.02 * plan.body.total_mass_g, 0.0, |m, _| {
            Some(&mut m.body.total_mass_g)
        }),
        ("core_offset_x_mm", Kind::Mass, 2.0, f64::MIN, |m, _| Some(&mut m.body.offset_x_mm)),
        ("core_offset_y_mm", Kind::Mass, 2.0, f64::MIN, |m, _| Some(&mut m.body.offset_y_mm)),
        ("core_z_mm", Kind::Mass, 2.0, f64::MIN, |m, _| Some(&mut m.core.z_mm)),
        ("load_mass_g", Kind::Mass, LOAD[0].1, 0.0, |m, _| Some(&mut m.load.last_mut()?.mass_g)),
        ("load_x_mm", Kind::Mass, LOAD[1].1, f64::MIN, |m, _| Some(&mut m.load.last_mut()?.x_mm)),
        ("load_y_mm", Kind::Mass, LOAD[2].1, f64::MIN, |m, _| Some(&mut m.load.last_mut()?.y_mm)),
        ("load_z_mm", Kind::Mass, LOAD[3].1, f64::MIN, |m, _| Some(&mut m.load.last_mut()?.z_mm)),
        (
            "floor_stiffness_n_per_m",
            Kind::Floor,
            FLOOR_SPREAD * plan.contact.stiffness_n_per_m,
            LEAST_SHARE * plan.contact.stiffness_n_per_m,
            |m, _| Some(&mut m.contact.stiffness_n_per_m),
        ),
        (
            "floor_damping_n_s_per_m",
            Kind::Floor,
            FLOOR_SPREAD * plan.contact.damping_n_s_per_m,
            LEAST_SHARE * plan.contact.damping_n_s_per_m,
            |m, _| Some(&mut m.contact.damping_n_s_per_m),
        ),
    ];
    let mut all: Vec<Unknown> = whole
        .into_iter()
        .filter_map(|(name, kind, spread, least, place)| {
            let planned = *place(&mut base, 0)?;
            let name = name.to_owned();
            Some(Unknown { name, kind, planned, spread, least, unit: 1.0, leg: 0, place })
        })
        .collect();
    let Some(legs) = plan.legs else { return (base, all) };
    let own: [(&str, Kind, f64, f64, Place); 5] = [
        (
            "bend_stiffness_n_m_rad",
            Kind::Stiffness,
            LEG_SPREAD,
            legs.bend_stiffness_n_m_rad,
            |m, i| Some(&mut leg(m, i)?.bend_stiffness_factor),
        ),
        (
            "twist_stiffness_n_m_rad",
            Kind::Stiffness,
            LEG_SPREAD,
            legs.twist_stiffness_n_m_rad,
            |m, i| Some(&mut leg(m, i)?.twist_stiffness_factor),
        ),
        (
            "bend_damping_n_m_s_rad",
            Kind::Damping,
            LEG_SPREAD,
            legs.bend_damping_n_m_s_rad,
            |m, i| Some(&mut leg(m, i)?.bend_damping_factor),
        ),
        (
            "twist_damping_n_m_s_rad",
            Kind::Damping,
            LEG_SPREAD,
            legs.twist_damping_n_m_s_rad,
            |m, i| Some(&mut leg(m, i)?.twist_damping_factor),
        ),
        ("friction", Kind::Friction, FRICTION_SPREAD, 1.0, |m, i| Some(&mut leg(m, i)?.friction)),
    ];
    for (index, leg_name) in LEGS.iter().enumerate() {
        for (name, kind, share, unit, place) in own {
            let Some(planned) = place(&mut base, index).map(|value| *value) else { continue };
            all.push(Unknown {
                name: format!("{leg_name}_{name}"),
                kind,
                planned,
                spread: share * planned,
                least: LEAST_SHARE * planned,
                unit,
                leg: index,
                place,
            });
        }
    }
    (base, all)
}

/// Returns the model at a point of the unknowns, in spreads.
#[must_use]
pub fn apply(base: &RobotModel, unknowns: &[Unknown], point: &[f64]) -> RobotModel {
    let mut model = base.clone();
    for (unknown, x) in unknowns.iter().zip(point) {
        if let Some(place) = (unknown.place)(&mut model, unknown.leg) {
            *place = (unknown.planned + unknown.spread * x).max(unknown.least);
        }
    }
    model
}

/// Returns the values of a model, in the units of the names; the mass besides the plan is its last load.
#[must_use]
pub fn values(model: &RobotModel, unknowns: &[Unknown]) -> Vec<f64> {
    let mut model = model.clone();
    let read = |u: &Unknown| (u.place)(&mut model, u.leg).map_or(f64::NAN, |v| u.unit * *v);
    unknowns.iter().map(read).collect()
}
