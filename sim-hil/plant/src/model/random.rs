//! Random robots: what a check should hold for that was tuned to none.

use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::{Electrical, FootAxis, Load, RobotModel};

/// Opens the name of a random robot; its seed follows.
const PREFIX: &str = "random-";

/// Returns the seed of a random robot's name, `random-SEED`.
pub(super) fn seed_of(name: &str) -> Option<u64> {
    name.strip_prefix(PREFIX)?.parse().ok()
}

/// Draws a robot: every number of its mechanics of its own, no two legs alike, and a load on every second one. It stands
/// on its feet and is accepted by [`RobotModel::check`]. The same for the same seed.
#[must_use]
pub fn random(seed: u64) -> RobotModel {
    let mut source = Xoshiro256PlusPlus::seed_from_u64(seed);
    loop {
        let model = draw(format!("{PREFIX}{seed}"), &mut source);
        // Feet that would touch are drawn again.
        if model.check().is_ok() {
            return model;
        }
    }
}

fn draw(name: String, source: &mut Xoshiro256PlusPlus) -> RobotModel {
    let mut within = |[low, high]: [f64; 2]| low + (high - low) * source.random::<f64>();
    let plan = RobotModel::named("W").expect("this model is shipped");
    let mut model = RobotModel { name, electrical: Electrical::default(), ..plan };
    draw_of(&mut model, &mut within, |key| key.contains("size_mm"));
    draw_of(&mut model, &mut within, |key| !key.contains("size_mm") && !key.starts_with("contact"));
    let is_across = within([-1.0, 1.0]) < 0.0;
    draw_of(&mut model, &mut within, |key| key.starts_with("contact"));
    if let Some(legs) = &mut model.legs {
        legs.foot.axis = if is_across { FootAxis::Across } else { FootAxis::Along };
        for leg in legs.each_mut() {
            leg.twist_hand = if leg.twist_hand < 0.0 { -1.0 } else { 1.0 };
        }
    }
    if within([-1.0, 1.0]) < 0.0 {
        model.load.push(Load {
            mass_g: within([10.0, 50.0]),
            x_mm: within([-60.0, 60.0]),
            y_mm: within([-40.0, 40.0]),
            z_mm: within([0.0, 30.0]),
        });
    }
    model
}

/// Draws the parameters with these keys, in their order.
fn draw_of(
    model: &mut RobotModel,
    within: &mut dyn FnMut([f64; 2]) -> f64,
    is_meant: fn(&str) -> bool,
) {
    for it in model.parameters() {
        if let Some(range) = it.drawn.filter(|_| is_meant(&it.key)) {
            *it.value = within(range);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn random_robots_differ_in_every_leg_are_the_same_for_a_seed_and_are_named() {
        for seed in 0..200 {
            let model = random(seed);
            assert_eq!(model, RobotModel::named(&model.name).unwrap());
            assert_ne!(model.contact, random(seed + 1).contact);
            let legs = model.legs.unwrap();
            for (one, other) in [(0, 1), (0, 2), (2, 3)] {
                assert_ne!(legs.each()[one].friction, legs.each()[other].friction);
            }
        }
    }
}
