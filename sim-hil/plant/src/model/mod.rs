//! The robot as data: every geometric, mass, leg, foot, contact and electrical parameter, with its unit in its name.
//!
//! A [`RobotModel`] is read from TOML ([`RobotModel::from_toml`]) or taken by name
//! ([`RobotModel::named`]: `A`, `W`, `calibrated`, `flix`, `bench-fixed`, `bench-planar`, `random-SEED`, `stranger-SEED`, or a file). Unknown keys are refused, so a key
//! with another unit (`mass_kg` for `mass_g`) is too; every value has a range.
//!
//! Axes are FLU (x forward, y left, z up) about the **origin**: the middle of the plate, on its mid-plane,
//! which is also where the shaker's axis passes. Legs are named `fl fr rl rr`.
//!
//! The paper's error set X is here as `body.total_mass_g`, `body.offset_x_mm`, `body.offset_y_mm` and, per
//! leg, four factors on stiffness and damping and the tangential friction.

use serde::{Deserialize, Serialize};

pub mod electrical;
mod error;
pub mod links;
pub mod mjcf;
mod named;
mod random;
mod scatter;
mod shipped;
mod stranger;
pub mod urdf;
mod xml;

pub use electrical::{Electrical, SIMULATED_BOARD};
pub use error::ModelError;
use error::exactly;
pub use named::STRANGERS_PLAN;
pub use random::random;
pub use scatter::scattered;
pub use shipped::NAMES;
pub use stranger::{STEEPEST_DEG, STRANGERS, stranger};

/// The four legs, in the order of every array in this crate.
pub const LEGS: [&str; 4] = ["fl", "fr", "rl", "rr"];

/// Standard gravity, m/s^2 (the paper's simulator's value).
pub const GRAVITY: f64 = 9.81;

/// How the body's origin may move.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "joint", rename_all = "lowercase", deny_unknown_fields)]
pub enum Base {
    /// Not at all: a test stand.
    Fixed {},
    /// In the horizontal plane, against linear damping, and about the vertical axis.
    Planar {
        /// Resistance to motion, N s/m, 0 to 100.
        damping_n_s_m: f64,
        /// Resistance to turning, N m s/rad, 0 to 10.
        yaw_damping_n_m_s: f64,
    },
    /// Freely.
    Free {},
}

/// Total mass and where it deviates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// The whole robot without loads, g, 150 to 2000. Source: paper, section II-A (350).
    pub total_mass_g: f64,
    /// Forward offset of the core (error set X, m_x), mm, -30 to 30.
    #[serde(default)]
    pub offset_x_mm: f64,
    /// Leftward offset of the core (error set X, m_y), mm, -30 to 30.
    #[serde(default)]
    pub offset_y_mm: f64,
}

/// The carbon plate, centred on the origin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plate {
    /// Along x, mm, 10 to 1000. Source: paper, table II (220).
    pub length_mm: f64,
    /// Along y, mm, 10 to 1000. Source: paper, table II (120).
    pub width_mm: f64,
    /// Along z, mm, 0.1 to 50. Source: paper, table II (3.5).
    pub thickness_mm: f64,
    /// Mass, g, 0 to 1000. Source: paper, section II-A (16).
    pub mass_g: f64,
}

/// A solid box fixed to the plate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// Mass, g, 0 to 1000.
    pub mass_g: f64,
    /// Its centre, mm, -200 to 200.
    pub x_mm: f64,
    /// Its centre, mm, -200 to 200.
    #[serde(default)]
    pub y_mm: f64,
    /// Its centre, mm, -100 to 200.
    pub z_mm: f64,
    /// Its size along x, y, z, mm, each 0 to 200; zero is a point.
    #[serde(default, deserialize_with = "exactly")]
    pub size_mm: [f64; 3],
}

/// Motors and cage: they take what is left of the total mass.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Core {
    /// Its centre, mm, -100 to 100.
    pub x_mm: f64,
    /// Its centre, mm, -100 to 200.
    pub z_mm: f64,
    /// Its size along x, y, z, mm, each 0 to 200. Assumed: the paper gives none.
    #[serde(deserialize_with = "exactly")]
    pub size_mm: [f64; 3],
}

/// Two eccentric masses on one vertical axis through the origin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shaker {
    /// Each mass, g, 0.1 to 100. Source: paper, table II (12).
    pub mass_g: f64,
    /// Arm, mm, 1 to 100. Source: paper, table II (28).
    pub arm_mm: f64,
    /// Height of the top mass above the bottom one, mm, 0 to 100. Source: paper, table II (28).
    pub spacing_mm: f64,
    /// Height of the plane half-way between both above the origin, mm, -50 to 100. Open in the paper.
    pub z_mm: f64,
    /// Inertia of each motor's bell about the axis, g cm^2, 0 to 1000; half of it about any other, as of a thin ring.
    /// Open in the paper.
    #[serde(default)]
    pub bell_inertia_g_cm2: f64,
}

/// What the four legs share. The beam's dimensions set the segments, the standing height and the inertia, not the stiffness,
/// which is a field of its own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Legs {
    /// Forward distance of the roots from the centre, mm, 10 to 300.
    pub root_x_mm: f64,
    /// Sideward distance of the roots from the centre, mm, 10 to 300.
    pub root_y_mm: f64,
    /// Length of the beam, mm, 10 to 300. Source: paper, table II (50).
    pub length_mm: f64,
    /// Width of the beam, mm, 1 to 100. Source: paper, table II (20).
    pub width_mm: f64,
    /// Thickness of the beam, mm, 0.1 to 50. Source: paper, table II (3).
    pub thickness_mm: f64,
    /// Mass of a beam, g, 0.3 to 200.
    pub mass_g: f64,
    /// Direction of the first bending hinge, degrees from body x about z for the left legs, mirrored for the
    /// right ones, -180 to 180. Open in the paper.
    pub hinge_deg: f64,
    /// Twist about the beam between each segment and the one above it, degrees, each -180 to 180; a leg's
    /// `twist_hand` gives the direction sign. Source: paper, section II-C (0, 45, 45).
    #[serde(deserialize_with = "exactly")]
    pub twist_deg: [f64; 3],
    /// Stiffness of each bending hinge, N m/rad, 0.01 to 100. Source: paper, S* (1.062072).
    pub bend_stiffness_n_m_rad: f64,
    /// Stiffness of each twisting hinge, N m/rad, 0.01 to 100. Source: paper, S* (2.21209, read as the twist).
    pub twist_stiffness_n_m_rad: f64,
    /// Damping of each bending hinge, N m s/rad, 0 to 1. Source: paper, S* (0.0024).
    pub bend_damping_n_m_s_rad: f64,
    /// Damping of each twisting hinge, N m s/rad, 0 to 1. Source: paper, S* (0.00183).
    pub twist_damping_n_m_s_rad: f64,
    /// Front left.
    pub fl: Leg,
    /// Front right.
    pub fr: Leg,
    /// Rear left.
    pub rl: Leg,
    /// Rear right.
    pub rr: Leg,
    /// What the four feet share.
    pub foot: Foot,
}

impl Legs {
    /// Returns the legs in the order of [`LEGS`].
    pub fn each(&self) -> [&Leg; 4] {
        [&self.fl, &self.fr, &self.rl, &self.rr]
    }
    /// Returns the legs in the order of [`LEGS`], to change.
    pub fn each_mut(&mut self) -> [&mut Leg; 4] {
        [&mut self.fl, &mut self.fr, &mut self.rl, &mut self.rr]
    }
}

/// What differs between legs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Leg {
    /// Direction sign of the twist about the beam's axis (from root to foot): 1 or -1.
    pub twist_hand: f64,
    /// Tangential friction coefficient, 0.01 to 3. Source: paper, section III-B (0.508 fr, 0.646 fl, 0.553 rr,
    /// 0.451 rl; 0.54 on average).
    pub friction: f64,
    /// Factor on the bending stiffness (error set X), 0.1 to 10.
    #[serde(default = "one")]
    pub bend_stiffness_factor: f64,
    /// Factor on the twisting stiffness (error set X), 0.1 to 10.
    #[serde(default = "one")]
    pub twist_stiffness_factor: f64,
    /// Factor on the bending damping (error set X), 0 to 10.
    #[serde(default = "one")]
    pub bend_damping_factor: f64,
    /// Factor on the twisting damping (error set X), 0 to 10.
    #[serde(default = "one")]
    pub twist_damping_factor: f64,
    /// Shift of the foot along its long axis, outward (or forward) positive, mm, -40 to 40.
    #[serde(default)]
    pub foot_shift_mm: f64,
}

fn one() -> f64 {
    1.0
}

/// A rigid foot under the last segment, level when the robot stands.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Foot {
    /// Long side, mm, 1 to 300. Source: paper, table II (85).
    pub length_mm: f64,
    /// Short side, mm, 1 to 100. Source: paper, table II (5).
    pub width_mm: f64,
    /// Height, mm, 0.5 to 100. Assumed (5).
    pub height_mm: f64,
    /// Mass, g, 0 (a bare beam) to 200. Estimated for PLA (3).
    pub mass_g: f64,
    /// The way that the long side points when the robot stands. Open in the paper.
    pub axis: FootAxis,
}

/// Direction of a foot's long side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FootAxis {
    /// Along y.
    Across,
    /// Along x.
    Along,
}

/// Feet on the floor.
///
/// The law is the one of MuJoCo's documentation ("computation", constraint model) with its elliptic cone: the
/// penetration `r` of a corner obeys `R f = -(a + b v + k d(r) r)`, `f >= 0`, with `R = (1 - d(r))/d(r)` of the foot's
/// inverse apparent mass; `b` and `k` follow from the stiffness and the damping here. Friction is isotropic in the plane
/// and does not change the floor's softness.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Contact {
    /// Stiffness of one of a foot's four corners, pressed in by `impedance_width_mm` or more, N/m, 100 to 1e6.
    pub stiffness_n_per_m: f64,
    /// Its damping there, N s/m, 1 to 1e5.
    pub damping_n_s_per_m: f64,
    /// Impedance d at first touch, 0.1 to 0.999.
    pub impedance_touch: f64,
    /// Impedance d at full width, 0.1 to 0.999.
    pub impedance_full: f64,
    /// Penetration of full impedance, mm, 0.01 to 50.
    pub impedance_width_mm: f64,
    /// Torsional friction about the normal, mm, 0 to 100.
    pub torsional_friction_mm: f64,
    /// Rolling friction about both tangents, mm, 0 to 100.
    pub rolling_friction_mm: f64,
    /// Slope of the floor, degrees, 0 to 30. World z stays normal to the floor; weight leans.
    #[serde(default)]
    pub slope_deg: f64,
    /// Direction in which it falls, degrees from world x towards world y, -360 to 360.
    #[serde(default)]
    pub downhill_deg: f64,
}

/// An extra mass on the body.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Load {
    /// Mass, g, 0 to 2000.
    pub mass_g: f64,
    /// Where, mm, -300 to 300.
    pub x_mm: f64,
    /// Where, mm, -300 to 300.
    pub y_mm: f64,
    /// Where, mm, -300 to 300.
    #[serde(default)]
    pub z_mm: f64,
}

/// The whole robot, or a part of it on a stand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotModel {
    /// What reports call it.
    pub name: String,
    /// How the body may move.
    pub base: Base,
    /// Total mass and its offsets.
    pub body: Body,
    /// The plate.
    pub plate: Plate,
    /// The battery.
    pub battery: Block,
    /// The electronics.
    pub electronics: Block,
    /// Motors and cage.
    pub core: Core,
    /// The shaker.
    pub shaker: Shaker,
    /// The legs; a bench has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub legs: Option<Legs>,
    /// The floor's contact.
    pub contact: Contact,
    /// Motors, sensors, inverter, the battery's voltage: everything between software and rotors.
    #[serde(default, skip_serializing_if = "Electrical::is_assumed")]
    pub electrical: Electrical,
    /// Extra masses.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub load: Vec<Load>,
}

/// Adds fields, each with its allowed range and the range of random robots.
macro_rules! parameters {
    (@drawn) => { None };
    (@drawn $from:literal $until:literal) => { Some([$from, $until]) };
    ($add:ident, $prefix:expr, $of:expr; $($field:ident: $low:literal to $high:literal $(, $from:literal to $until:literal)?;)*) => {
        $($add(
            format!("{}{}", $prefix, stringify!($field)),
            &mut $of.$field,
            [$low, $high],
            parameters!(@drawn $($from $until)?),
        );)*
    };
}

impl RobotModel {
    /// Reads and checks a model.
    ///
    /// # Errors
    /// [`ModelError`] names the key, its value and its range.
    pub fn from_toml(text: &str) -> Result<Self, ModelError> {
        let model: Self = toml::from_str(text)?;
        model.check()?;
        Ok(model)
    }

    /// Returns the acceleration of free fall along the axes of the world, whose z is the floor's normal, m/s^2.
    #[must_use]
    pub fn gravity(&self) -> [f64; 3] {
        if self.contact.slope_deg == 0.0 {
            return [0.0, 0.0, -GRAVITY];
        }
        let (along, normal) = libm::sincos(self.contact.slope_deg.to_radians());
        let (y, x) = libm::sincos(self.contact.downhill_deg.to_radians());
        [GRAVITY * along * x, GRAVITY * along * y, -GRAVITY * normal]
    }

    /// Checks that the robot has legs and stands free.
    ///
    /// # Errors
    /// [`ModelError::NoWalker`] if it has none or is held.
    pub fn check_walker(&self) -> Result<(), ModelError> {
        if self.legs.is_none() || self.base != (Base::Free {}) {
            return Err(ModelError::NoWalker { name: self.name.clone() });
        }
        Ok(())
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] or [`ModelError::Impossible`] for the first bad key.
    pub fn check(&self) -> Result<(), ModelError> {
        let mut copy = self.clone();
        let parameters = copy.parameters().into_iter();
        let mut bounds: Vec<_> = parameters.map(|it| (it.key, *it.value, it.allowed)).collect();
        self.electrical.bounds(&mut |key, value, low, high| {
            bounds.push((key.to_owned(), value, [low, high]));
        });
        for (key, value, [low, high]) in bounds {
            if !(low..=high).contains(&value) {
                return Err(ModelError::OutOfRange { key, value, low, high });
            }
        }
        let core = self.core_mass_g();
        if core < 1.0 {
            return Err(ModelError::Impossible {
                key: "body.total_mass_g".to_owned(),
                value: self.body.total_mass_g,
                reason: format!(
                    "the parts weigh {:.1} g more than that allows; raise it",
                    1.0 - core
                ),
            });
        }
        if let Some(legs) = &self.legs {
            for (name, leg) in LEGS.iter().zip(legs.each()) {
                if leg.twist_hand.abs() != 1.0 {
                    return Err(ModelError::Impossible {
                        key: format!("legs.{name}.twist_hand"),
                        value: leg.twist_hand,
                        reason: "a twist is 1 or -1".to_owned(),
                    });
                }
            }
            self.check_feet_apart(legs)?;
        }
        self.electrical.check()
    }

    /// Mass of motors and cage: what the other parts leave of the total, g.
    pub fn core_mass_g(&self) -> f64 {
        let legs = self.legs.map_or(0.0, |l| 4.0 * (l.mass_g + l.foot.mass_g));
        self.body.total_mass_g
            - self.plate.mass_g
            - self.battery.mass_g
            - self.electronics.mass_g
            - 2.0 * self.shaker.mass_g
            - legs
    }

    /// Returns the centre of a foot in body axes when the legs are straight, m.
    pub fn foot_center(&self, legs: &Legs, leg: usize) -> [f64; 3] {
        let (x, y) = (LEG_SIDE[leg][0], LEG_SIDE[leg][1]);
        let shift = legs.each()[leg].foot_shift_mm;
        let (sx, sy) = match legs.foot.axis {
            FootAxis::Across => (0.0, shift * y),
            FootAxis::Along => (shift * x, 0.0),
        };
        [
            1e-3 * (x * legs.root_x_mm + sx),
            1e-3 * (y * legs.root_y_mm + sy),
            -1e-3 * (0.5 * self.plate.thickness_mm + legs.length_mm + 0.5 * legs.foot.height_mm),
        ]
    }

    /// Returns the height of the body's origin when the robot stands on straight legs, m; 0 without legs.
    pub fn standing_height(&self) -> f64 {
        self.legs.map_or(0.0, |l| {
            1e-3 * (0.5 * self.plate.thickness_mm + l.length_mm + l.foot.height_mm)
        })
    }

    fn check_feet_apart(&self, legs: &Legs) -> Result<(), ModelError> {
        let (sx, sy) = legs.foot.size_xy_mm();
        for (a, one) in LEGS.iter().enumerate() {
            for (b, other) in LEGS.iter().enumerate().take(a) {
                let (p, q) = (self.foot_center(legs, a), self.foot_center(legs, b));
                let apart = (1e3 * (p[0] - q[0]).abs() >= sx) || (1e3 * (p[1] - q[1]).abs() >= sy);
                if !apart {
                    return Err(ModelError::Impossible {
                        key: "legs.foot.length_mm".to_owned(),
                        value: legs.foot.length_mm,
                        reason: format!(
                            "the feet {other} and {one} lie inside each other; shorten them or move the roots apart",
                        ),
                    });
                }
            }
        }
        Ok(())
    }

    /// Returns every number of the mechanics by its key in a file of the model.
    pub fn parameters(&mut self) -> Vec<Parameter<'_>> {
        let mut all = Vec::new();
        let mut add = |key: String, value, allowed, drawn| {
            all.push(Parameter { key, value, allowed, drawn });
        };
        if let Base::Planar { damping_n_s_m, yaw_damping_n_m_s } = &mut self.base {
            add("base.damping_n_s_m".to_owned(), damping_n_s_m, [0.0, 100.0], None);
            add("base.yaw_damping_n_m_s".to_owned(), yaw_damping_n_m_s, [0.0, 10.0], None);
        }
        parameters! { add, "body.", self.body;
            total_mass_g: 150.0 to 2000.0, 280.0 to 450.0;
            offset_x_mm: -30.0 to 30.0, -5.0 to 5.0;
            offset_y_mm: -30.0 to 30.0, -5.0 to 5.0;
        }
        parameters! { add, "plate.", self.plate;
            length_mm: 10.0 to 1000.0, 200.0 to 240.0;
            width_mm: 10.0 to 1000.0, 100.0 to 140.0;
            thickness_mm: 0.1 to 50.0, 2.0 to 5.0;
            mass_g: 0.0 to 1000.0, 10.0 to 25.0;
        }
        for (name, block, x) in [
            ("battery", &mut self.battery, [60.0, 90.0]),
            ("electronics", &mut self.electronics, [-60.0, -90.0]),
        ] {
            parameters!(add, format_args!("{name}."), block; mass_g: 0.0 to 1000.0, 20.0 to 40.0;);
            add(format!("{name}.x_mm"), &mut block.x_mm, [-200.0, 200.0], Some(x));
            parameters! { add, format_args!("{name}."), block;
                y_mm: -200.0 to 200.0, -10.0 to 10.0;
                z_mm: -100.0 to 200.0, -5.0 to 10.0;
            }
            for (axis, size) in ["x", "y", "z"].iter().zip(&mut block.size_mm) {
                add(format!("{name}.size_mm ({axis})"), size, [0.0, 200.0], Some([15.0, 45.0]));
            }
        }
        parameters! { add, "core.", self.core;
            x_mm: -100.0 to 100.0, -10.0 to 10.0;
            z_mm: -100.0 to 200.0, 0.0 to 40.0;
        }
        for (axis, size) in ["x", "y", "z"].iter().zip(&mut self.core.size_mm) {
            add(format!("core.size_mm ({axis})"), size, [0.0, 200.0], Some([30.0, 60.0]));
        }
        parameters! { add, "shaker.", self.shaker;
            mass_g: 0.1 to 100.0, 8.0 to 14.0;
            arm_mm: 1.0 to 100.0, 20.0 to 30.0;
            spacing_mm: 0.0 to 100.0, 15.0 to 35.0;
            z_mm: -50.0 to 100.0, 0.0 to 22.0;
            bell_inertia_g_cm2: 0.0 to 1000.0, 0.0 to 40.0;
        }
        if let Some(legs) = &mut self.legs {
            parameters! { add, "legs.", legs;
                root_x_mm: 10.0 to 300.0, 90.0 to 115.0;
                root_y_mm: 10.0 to 300.0, 46.0 to 60.0;
                length_mm: 10.0 to 300.0, 40.0 to 60.0;
                width_mm: 1.0 to 100.0, 15.0 to 25.0;
                thickness_mm: 0.1 to 50.0, 2.0 to 4.0;
                mass_g: 0.3 to 200.0, 2.5 to 6.0;
                hinge_deg: -180.0 to 180.0, -90.0 to 90.0;
            }
            let drawn = [[-15.0, 15.0], [25.0, 60.0], [25.0, 60.0]];
            for (i, (twist, drawn)) in legs.twist_deg.iter_mut().zip(drawn).enumerate() {
                add(format!("legs.twist_deg[{i}]"), twist, [-180.0, 180.0], Some(drawn));
            }
            parameters! { add, "legs.", legs;
                bend_stiffness_n_m_rad: 0.01 to 100.0, 0.9 to 2.0;
                twist_stiffness_n_m_rad: 0.01 to 100.0, 1.2 to 3.0;
                bend_damping_n_m_s_rad: 0.0 to 1.0, 0.002 to 0.006;
                twist_damping_n_m_s_rad: 0.0 to 1.0, 0.002 to 0.006;
            }
            let each = [&mut legs.fl, &mut legs.fr, &mut legs.rl, &mut legs.rr];
            for (name, leg) in LEGS.iter().zip(each) {
                parameters! { add, format_args!("legs.{name}."), leg;
                    twist_hand: -1.0 to 1.0, -1.0 to 1.0;
                    friction: 0.01 to 3.0, 0.3 to 1.0;
                    bend_stiffness_factor: 0.1 to 10.0, 0.8 to 1.25;
                    twist_stiffness_factor: 0.1 to 10.0, 0.8 to 1.25;
                    bend_damping_factor: 0.0 to 10.0, 0.5 to 1.5;
                    twist_damping_factor: 0.0 to 10.0, 0.5 to 1.5;
                    foot_shift_mm: -40.0 to 40.0, -12.0 to 12.0;
                }
            }
            parameters! { add, "legs.foot.", legs.foot;
                length_mm: 1.0 to 300.0, 60.0 to 90.0;
                width_mm: 1.0 to 100.0, 4.0 to 10.0;
                height_mm: 0.5 to 100.0, 4.0 to 12.0;
                mass_g: 0.0 to 200.0, 2.5 to 6.0;
            }
        }
        parameters! { add, "contact.", self.contact;
            stiffness_n_per_m: 100.0 to 1e6, 1500.0 to 8000.0;
            damping_n_s_per_m: 1.0 to 1e5, 40.0 to 90.0;
            impedance_touch: 0.1 to 0.999, 0.85 to 0.92;
            impedance_full: 0.1 to 0.999, 0.93 to 0.97;
            impedance_width_mm: 0.01 to 50.0, 0.5 to 2.0;
            torsional_friction_mm: 0.0 to 100.0, 1.0 to 8.0;
            rolling_friction_mm: 0.0 to 100.0, 0.05 to 0.5;
            slope_deg: 0.0 to 30.0;
            downhill_deg: -360.0 to 360.0;
        }
        for (i, load) in self.load.iter_mut().enumerate() {
            parameters! { add, format_args!("load[{i}]."), load;
                mass_g: 0.0 to 2000.0;
                x_mm: -300.0 to 300.0;
                y_mm: -300.0 to 300.0;
                z_mm: -300.0 to 300.0;
            }
        }
        all
    }

    /// Returns the number of a key; `None` without such a key, as of legs that the model does not have.
    pub fn parameter(&mut self, key: &str) -> Option<&mut f64> {
        self.parameters().into_iter().find(|it| it.key == key).map(|it| it.value)
    }
}

/// A number of the model. Its unit is the end of its key.
#[derive(Debug)]
pub struct Parameter<'a> {
    /// Path in a file of the model, for example `legs.fl.friction`.
    pub key: String,
    /// Value in the model.
    pub value: &'a mut f64,
    /// Lowest and highest value that a model may have.
    pub allowed: [f64; 2],
    /// Range of random robots; `None` for parameters that are not drawn.
    pub(crate) drawn: Option<[f64; 2]>,
}

/// Sign of x and y of each leg's root.
pub const LEG_SIDE: [[f64; 2]; 4] = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];

impl Foot {
    /// Returns the size along body x and y when the robot stands, mm.
    pub fn size_xy_mm(&self) -> (f64, f64) {
        match self.axis {
            FootAxis::Across => (self.width_mm, self.length_mm),
            FootAxis::Along => (self.length_mm, self.width_mm),
        }
    }
}
