//! Models that scatter as robots do that are built again from the same plan.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::Value;

use super::RobotModel;

/// Draws beyond this many standard deviations are drawn to it, so that no value leaves its allowed range.
const WIDEST_DRAW: f64 = 2.0;

/// Multiplies every number of a model's mechanics by its own `1 + share * normal`: how the same robot comes out when
/// it is built again. An impedance is scattered by its distance from 1, in which the floor's law is proportional. The same
/// for the same seed.
#[must_use]
pub fn scattered(model: &RobotModel, share: f64, seed: u64) -> RobotModel {
    if share == 0.0 {
        return model.clone();
    }
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut scatter = |value: f64| {
        let normal: f64 = StandardNormal.sample(&mut random);
        value * (1.0 + share * normal.clamp(-WIDEST_DRAW, WIDEST_DRAW))
    };
    let scattered = serde_json::to_value(model).ok().and_then(|mut tree| {
        scatter_numbers(&mut tree, &mut scatter);
        serde_json::from_value::<RobotModel>(tree).ok()
    });
    scattered.filter(|model| model.check().is_ok()).unwrap_or_else(|| model.clone())
}

fn scatter_numbers(tree: &mut Value, scatter: &mut dyn FnMut(f64) -> f64) {
    match tree {
        Value::Number(number) => {
            if let Some(value) = number.as_f64() {
                *tree = Value::from(scatter(value));
            }
        }
        Value::Array(items) => {
            items.iter_mut().for_each(|item| scatter_numbers(item, &mut *scatter))
        }
        Value::Object(entries) => {
            for (key, item) in entries.iter_mut() {
                match key.as_str() {
                    // A direction sign is not scattered; the electrical part varies with the robot's own seed.
                    "twist_hand" | "electrical" => {}
                    "impedance_touch" | "impedance_full" => {
                        scatter_numbers(item, &mut |value| 1.0 - scatter(1.0 - value));
                    }
                    _ => scatter_numbers(item, scatter),
                }
            }
        }
        Value::Null | Value::Bool(_) | Value::String(_) => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scatter_moves_every_number_but_direction_signs_and_stays_a_robot() {
        let model = RobotModel::named("W").unwrap();
        for seed in 0..50 {
            let other = scattered(&model, 0.02, seed);
            assert_ne!(other.plate.mass_g, model.plate.mass_g);
            assert_ne!(other.contact.stiffness_n_per_m, model.contact.stiffness_n_per_m);
            assert_eq!(other.legs.unwrap().fl.twist_hand, model.legs.unwrap().fl.twist_hand);
            assert!((other.legs.unwrap().rr.friction / 0.694 - 1.0).abs() <= 0.04 + 1e-12);
        }
    }
}
