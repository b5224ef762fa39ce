//! What is identified of a robot, and how well its plan is trusted beforehand.
//!
//! Each unknown is Gaussian about its value in the plan. All are counted in their own spreads, so that the plan is the
//! origin and the prior's covariance the identity.

use serde::Serialize;

use flix_sim::model::{LEGS, Load, RobotModel};

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
    /// Its key in the model.
    key: String,
}

/// Spread of stiffness and damping of a leg, as a share: what manufacture leaves open (paper, section II-D), doubled.
const LEG_SPREAD: f64 = 0.15;
/// Spread of a foot's friction, as a share.
const FRICTION_SPREAD: f64 = 0.25;
/// Spread of the floor's stiffness and damping, as a share alone.
const FLOOR: [f64; 2] = [0.0, 0.25];
/// What is on the body besides the plan: one mass, at first here, g and mm, with these spreads.
const LOAD: [(f64, f64); 4] = [(20.0, 12.0), (0.0, 30.0), (0.0, 20.0), (15.0, 10.0)];
/// No value of a model falls below this share of the plan.
const LEAST_SHARE: f64 = 0.2;

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

/// An unknown of the whole robot: name, kind, key in the model, spread of the prior in the key's unit and as a share of the
/// planned value, lowest value that makes sense as a share of it.
type Whole = (&'static str, Kind, &'static str, [f64; 2], Option<f64>);

const WHOLE: [Whole; 10] = [
    ("total_mass_g", Kind::Mass, "body.total_mass_g", [0.0, 0.02], Some(0.0)),
    ("core_offset_x_mm", Kind::Mass, "body.offset_x_mm", [2.0, 0.0], None),
    ("core_offset_y_mm", Kind::Mass, "body.offset_y_mm", [2.0, 0.0], None),
    ("core_z_mm", Kind::Mass, "core.z_mm", [2.0, 0.0], None),
    ("load_mass_g", Kind::Mass, "load.mass_g", [LOAD[0].1, 0.0], Some(0.0)),
    ("load_x_mm", Kind::Mass, "load.x_mm", [LOAD[1].1, 0.0], None),
    ("load_y_mm", Kind::Mass, "load.y_mm", [LOAD[2].1, 0.0], None),
    ("load_z_mm", Kind::Mass, "load.z_mm", [LOAD[3].1, 0.0], None),
    ("floor_stiffness_n_per_m", Kind::Floor, "contact.stiffness_n_per_m", FLOOR, Some(LEAST_SHARE)),
    ("floor_damping_n_s_per_m", Kind::Floor, "contact.damping_n_s_per_m", FLOOR, Some(LEAST_SHARE)),
];

/// Returns the plan with the unknown mass on it, and the unknowns.
#[must_use]
pub fn unknowns(plan: &RobotModel) -> (RobotModel, Vec<Unknown>) {
    let mut base = plan.clone();
    let [mass_g, x_mm, y_mm, z_mm] = LOAD.map(|(middle, _)| middle);
    base.load.push(Load { mass_g, x_mm, y_mm, z_mm });
    let mut all = Vec::new();
    let mut add = |name: String, kind, key: String, [spread, share]: [f64; 2], least, unit| {
        let Some(planned) = base.parameter(&key).map(|value| *value) else { return };
        let spread = spread + share * planned;
        let least = Option::map_or(least, f64::MIN, |share: f64| share * planned);
        all.push(Unknown { name, kind, planned, spread, least, unit, key });
    };
    let load = format!("load[{}].", plan.load.len());
    for (name, kind, key, spread, least) in WHOLE {
        add(name.to_owned(), kind, key.replace("load.", &load), spread, least, 1.0);
    }
    let Some(legs) = plan.legs else { return (base, all) };
    let (bend, twist) = (legs.bend_stiffness_n_m_rad, legs.twist_stiffness_n_m_rad);
    let (bends, twists) = (legs.bend_damping_n_m_s_rad, legs.twist_damping_n_m_s_rad);
    let own = [
        ("bend_stiffness_n_m_rad", Kind::Stiffness, "bend_stiffness_factor", LEG_SPREAD, bend),
        ("twist_stiffness_n_m_rad", Kind::Stiffness, "twist_stiffness_factor", LEG_SPREAD, twist),
        ("bend_damping_n_m_s_rad", Kind::Damping, "bend_damping_factor", LEG_SPREAD, bends),
        ("twist_damping_n_m_s_rad", Kind::Damping, "twist_damping_factor", LEG_SPREAD, twists),
        ("friction", Kind::Friction, "friction", FRICTION_SPREAD, 1.0),
    ];
    for leg in LEGS {
        for (name, kind, key, share, unit) in own {
            let (name, key) = (format!("{leg}_{name}"), format!("legs.{leg}.{key}"));
            add(name, kind, key, [0.0, share], Some(LEAST_SHARE), unit);
        }
    }
    (base, all)
}

/// Returns the model at a point of the unknowns, in spreads.
#[must_use]
pub fn apply(base: &RobotModel, unknowns: &[Unknown], point: &[f64]) -> RobotModel {
    let mut model = base.clone();
    let mut parameters = model.parameters();
    for (unknown, x) in unknowns.iter().zip(point) {
        if let Some(it) = parameters.iter_mut().find(|it| it.key == unknown.key) {
            *it.value = (unknown.planned + unknown.spread * x).max(unknown.least);
        }
    }
    model
}

/// Returns the values of a model, in the units of the names; the mass besides the plan is its last load.
#[must_use]
pub fn values(model: &RobotModel, unknowns: &[Unknown]) -> Vec<f64> {
    let mut model = model.clone();
    let read = |u: &Unknown| model.parameter(&u.key).map_or(f64::NAN, |value| u.unit * *value);
    unknowns.iter().map(read).collect()
}
