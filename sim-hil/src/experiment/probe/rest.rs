//! The robot put down and left alone.

use serde::Serialize;

use super::{ProbeError, require_legs};
use crate::model::RobotModel;
use crate::plant::{BodyState, Mechanics, Plant};

/// Height above the soles' touch from which the robot is dropped, m.
const DROP: f64 = 0.02;
/// Time until the soles have touched, s.
const FALL: f64 = 0.1;
/// Longest time that settling may take, s.
const PATIENCE: f64 = 5.0;
/// Kinetic energy below which the robot is at rest, J.
const STILL: f64 = 1e-12;

/// Force of the floor on each foot, N, upwards.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FootLoads {
    /// Front left.
    pub fl: f64,
    /// Front right.
    pub fr: f64,
    /// Rear left.
    pub rl: f64,
    /// Rear right.
    pub rr: f64,
}

/// What a robot rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Posture {
    /// Its feet, upright.
    Feet,
    /// Neither: the plate stands on edge.
    Side,
    /// Upside down.
    Back,
}

impl Posture {
    fn of(body: &BodyState) -> Self {
        if body.is_upright() {
            Self::Feet
        } else if body.upward() < -0.5 {
            Self::Back
        } else {
            Self::Side
        }
    }
}

/// How the robot rests.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Rest {
    /// It came to rest within 5 s; otherwise height and loads are those of a moment.
    pub at_rest: bool,
    /// What it came to rest on.
    pub posture: Posture,
    /// Mid-plane of the plate above the floor, after a drop from 20 mm, mm.
    pub plate_height_mm: f64,
    /// Load of each foot, N.
    pub foot_loads_n: FootLoads,
    /// Mass with everything on it, g.
    pub mass_g: f64,
    /// Centre of mass with straight legs and rotors forward: from the plate's middle forward and to the left,
    /// and above the soles, mm.
    pub centre_of_mass_mm: [f64; 3],
    /// Moments of inertia about the centre of mass and axes parallel to x, y, z, kg m^2, same posture.
    pub inertia_kg_m2: [f64; 3],
    /// Off-diagonal elements of the same matrix: xy, xz, yz, kg m^2.
    pub inertia_off_diagonal_kg_m2: [f64; 3],
}

/// Drops the robot from 20 mm, waits until it rests, and weighs it.
///
/// # Errors
/// When the model is refused, has no legs, or diverges.
pub fn rest(model: &RobotModel, step: f64) -> Result<Rest, ProbeError> {
    require_legs(model)?;
    let mut plant = Plant::new(model)?;
    let (mass, center, inertia) = plant.mass_properties();
    plant.displace([0.0, 0.0, DROP], 0.0);
    // The fall itself: settling looks at kinetic energy, which is nothing at its start.
    for _ in 0..(FALL / step) as usize {
        plant.step([0.0; 2], step)?;
    }
    let at_rest = plant.settle(step, PATIENCE, STILL)?;
    let loads = plant.legs().map(|legs| legs.map(|leg| leg.floor_force[2])).unwrap_or_default();
    let [xx, xy, xz, yy, yz, zz] = inertia;
    Ok(Rest {
        at_rest,
        posture: Posture::of(&plant.body()),
        plate_height_mm: plant.body().position[2] * 1e3,
        foot_loads_n: FootLoads { fl: loads[0], fr: loads[1], rl: loads[2], rr: loads[3] },
        mass_g: mass * 1e3,
        centre_of_mass_mm: center.map(|c| c * 1e3),
        inertia_kg_m2: [xx, yy, zz],
        inertia_off_diagonal_kg_m2: [xy, xz, yz],
    })
}
