//! The simulated robot as boxes and arrows.

use flix_host::pose::{Pose, Quaternion};

use super::{Arrow, Force, Frame, Part};
use crate::model::links::orientation;
use crate::model::{LEGS, RobotModel};
use crate::plant::mechanics::spatial::Vec3;
use crate::plant::mechanics::{multiply, rotation};
use crate::plant::{Mechanics, Plant};

const PLATE: [u8; 3] = [70, 76, 88];
const CORE: [u8; 3] = [120, 126, 138];
const BATTERY: [u8; 3] = [60, 130, 90];
const ELECTRONICS: [u8; 3] = [44, 96, 150];
const ROTORS: [[u8; 3]; 2] = [[214, 128, 30], [170, 88, 20]];
const BEAM: [u8; 3] = [222, 222, 214];
const FOOT: [u8; 3] = [40, 110, 170];
const SHAKING: [u8; 3] = [200, 30, 30];
const CONTACT: [u8; 3] = [30, 140, 70];
/// Metres of arrow per newton.
const FORCE_SCALE: f64 = 0.004;
/// Half thickness and width of what is drawn of a rotor arm, m.
const ROTOR_HALF: [f64; 2] = [0.0045, 0.003];

/// Turns a plant into frames.
#[derive(Debug, Clone)]
pub struct RobotView {
    model: RobotModel,
}

impl RobotView {
    /// Creates a view of plants of this model.
    #[must_use]
    pub fn new(model: &RobotModel) -> Self {
        Self { model: model.clone() }
    }

    /// Returns what moves, in the order of [`RobotView::frame`].
    #[must_use]
    pub fn parts(&self) -> Vec<Part> {
        let m = &self.model;
        let half = |[x, y, z]: [f64; 3]| [x, y, z].map(|edge| 0.5e-3 * edge);
        let part = |name: String, half_size, colour| Part { name, half_size, colour };
        let plate = [m.plate.length_mm, m.plate.width_mm, m.plate.thickness_mm];
        let mut parts = vec![
            part("plate".into(), half(plate), PLATE),
            part("battery".into(), half(m.battery.size_mm), BATTERY),
            part("electronics".into(), half(m.electronics.size_mm), ELECTRONICS),
            part("core".into(), self.core_half(), CORE),
        ];
        for (name, colour) in ["top rotor", "bottom rotor"].into_iter().zip(ROTORS) {
            let arm = 0.5e-3 * m.shaker.arm_mm;
            parts.push(part(name.into(), [arm, ROTOR_HALF[0], ROTOR_HALF[1]], colour));
        }
        if let Some(legs) = &m.legs {
            for leg in LEGS {
                for segment in 1..=3 {
                    let size = [legs.width_mm, legs.length_mm / 3.0, legs.thickness_mm];
                    parts.push(part(format!("{leg} segment {segment}"), half(size), BEAM));
                }
                let size = [legs.foot.length_mm, legs.foot.width_mm, legs.foot.height_mm];
                parts.push(part(format!("{leg} foot"), half(size), FOOT));
            }
        }
        parts
    }

    /// Returns what pushes, in the order of [`RobotView::frame`].
    #[must_use]
    pub fn arrows(&self) -> Vec<Arrow> {
        let arrow = |name: &str, colour| Arrow { name: name.into(), colour, scale: FORCE_SCALE };
        let feet = self.model.legs.map_or(0, |_| 4);
        std::iter::once(arrow("shaking force", SHAKING))
            .chain(std::iter::repeat_n(arrow("contact force", CONTACT), feet))
            .collect()
    }

    /// Returns how it stands now.
    #[must_use]
    pub fn frame(&self, plant: &Plant, time: f64) -> Frame {
        let m = &self.model;
        let body = plant.body();
        let turn = rotation(body.orientation);
        let world = |mm: [f64; 3]| (Vec3(body.position) + turn.apply(Vec3(mm.map(|c| c * 1e-3)))).0;
        let fixed = |mm| Pose { position: world(mm).into(), orientation: body.orientation.into() };
        let mut poses = vec![
            fixed([0.0; 3]),
            fixed([m.battery.x_mm, m.battery.y_mm, m.battery.z_mm]),
            fixed([m.electronics.x_mm, m.electronics.y_mm, m.electronics.z_mm]),
            fixed([m.core.x_mm, 0.0, m.core.z_mm]),
        ];
        let heights = [0.5, -0.5].map(|side| m.shaker.z_mm + side * m.shaker.spacing_mm);
        for (angle, height) in plant.rotor_angle().into_iter().zip(heights) {
            let (sin, cos) = angle.sin_cos();
            let (half_sin, half_cos) = (0.5 * angle).sin_cos();
            let middle = 0.5 * m.shaker.arm_mm;
            poses.push(Pose {
                position: world([middle * cos, middle * sin, height]).into(),
                orientation: multiply(body.orientation, [half_cos, 0.0, 0.0, half_sin]).into(),
            });
        }
        let shaking = turn.apply(Vec3(plant.shaker_force())).0;
        let mut forces = vec![Force { at: world([0.0, 0.0, m.shaker.z_mm]), vector: shaking }];
        for leg in plant.legs().into_iter().flatten() {
            for segment in 0..3 {
                let (top, bottom) = (leg.joints[segment], leg.joints[segment + 1]);
                poses.push(Pose {
                    position: core::array::from_fn(|i| 0.5 * (top[i] + bottom[i])).into(),
                    orientation: from_axes(leg.axes[segment]),
                });
            }
            let axes = leg.foot_half.map(|half| {
                let length = half.iter().map(|c| c * c).sum::<f64>().sqrt();
                half.map(|c| c / length)
            });
            poses.push(Pose {
                position: leg.foot_center.into(),
                orientation: from_axes(long_first(axes, &leg.foot_half)),
            });
            forces.push(Force { at: leg.foot_center, vector: leg.floor_force });
        }
        Frame { time, poses, forces }
    }

    /// The core is drawn between plate and its own top, no larger than it is.
    fn core_half(&self) -> [f64; 3] {
        self.model.core.size_mm.map(|edge| 0.5e-3 * edge.min(40.0))
    }
}

/// The foot's axes with its long one first, still right-handed.
fn long_first(axes: [[f64; 3]; 3], half: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let length = |v: &[f64; 3]| v.iter().map(|c| c * c).sum::<f64>();
    if length(&half[0]) >= length(&half[1]) {
        axes
    } else {
        [axes[1], axes[0].map(|c| -c), axes[2]]
    }
}

/// Quaternion of a right-handed frame of unit vectors.
fn from_axes(axes: [[f64; 3]; 3]) -> Quaternion {
    let q = orientation(axes);
    Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }
}
