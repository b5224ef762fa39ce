//! The frames of the model's URDF as they stand.

use flix_host::pose::Pose;

use crate::model::RobotModel;
use crate::model::links::{BASE_LINK, links};
use crate::model::urdf::{Frame, frames, poses};
use crate::plant::{Mechanics, Plant};

/// Turns a plant into poses of frames.
#[derive(Debug, Clone)]
pub struct FrameView {
    frames: Vec<Frame>,
}

impl FrameView {
    /// Creates a view of plants of this model.
    #[must_use]
    pub fn new(model: &RobotModel) -> Self {
        Self { frames: frames(&links(model)) }
    }

    /// Returns the name of each frame, that of the frame that carries it, and its pose there; none is before its
    /// carrier. The body is carried by `world`.
    #[must_use]
    pub fn poses<'a>(&'a self, world: &'a str, plant: &Plant) -> Vec<(&'a str, &'a str, Pose)> {
        let body = plant.body();
        let body = Pose { position: body.position.into(), orientation: body.orientation.into() };
        let legs = plant.legs().into_iter().flatten().flat_map(|leg| leg.angles);
        let angles = plant.rotor_angle().into_iter().chain(legs);
        let carried = poses(&self.frames, angles)
            .map(|(frame, pose)| (frame.name.as_str(), frame.parent.as_str(), pose));
        std::iter::once((BASE_LINK, world, body)).chain(carried).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use flix_host::pose::{Quaternion, Vector};

    use super::*;
    use crate::model::LEGS;

    #[test]
    fn frames_stand_where_the_plant_says() {
        for name in ["flix", "random-7"] {
            let model = RobotModel::named(name).unwrap();
            let mut plant = Plant::new(&model).unwrap();
            for _ in 0..3000 {
                plant.step([2e-3, -2e-3], 1e-4).unwrap();
            }
            let view = FrameView::new(&model);
            let mut world = BTreeMap::new();
            for (child, parent, pose) in view.poses("map", &plant) {
                let Pose { position: Vector { x, y, z }, orientation } = pose;
                let placed = world.get(parent).map_or(([x, y, z], orientation), |carrier| {
                    let (at, turned): &([f64; 3], Quaternion) = carrier;
                    let on = turned.turn(pose.position);
                    ([at[0] + on.x, at[1] + on.y, at[2] + on.z], turned.after(orientation))
                });
                world.insert(child, placed);
            }
            let is_at = |name: &str, expected: [f64; 3]| {
                let off = [0, 1, 2].map(|axis| world[name].0[axis] - expected[axis]);
                assert!(off.iter().all(|c| c.abs() < 1e-9), "{name} is off by {off:?} m");
            };
            for (leg, seen) in LEGS.into_iter().zip(plant.legs().unwrap()) {
                assert!(seen.angles.iter().all(|angle| angle.abs() > 1e-6));
                for segment in 0..3 {
                    is_at(&format!("{leg}{segment}"), seen.joints[segment]);
                }
                is_at(&format!("{leg}_foot"), seen.foot_center);
            }
            let turned = world["base_link"].1.inverse().after(world["bottom"].1).heading();
            assert!((turned - plant.rotor_angle()[1]).sin().abs() < 1e-9);
        }
    }
}
