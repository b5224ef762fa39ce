//! Robots as a controller meets them that has never seen them: worn feet, a load, other legs, a floor that falls.

use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::{Load, RobotModel};

/// Opens the name of a stranger; its seed follows.
pub const STRANGERS: &str = "stranger-";
/// Largest change of the friction of the left feet, and of the right ones, as a share (paper, section III-B).
const FRICTION: f64 = 0.58;
/// Mass of a load, g (paper, section III-B).
const LOAD_G: f64 = 50.0;
/// Distance of its centre from the edges of the plate, mm.
const FROM_EDGE_MM: f64 = 12.0;
/// Largest change of each stiffness and damping of each leg, as a share.
const LEG: f64 = 0.2;
/// Steepest floor, degrees.
pub const STEEPEST_DEG: f64 = 5.0;

/// Returns the seed of a stranger's name, `stranger-SEED`.
pub(super) fn seed_of(name: &str) -> Option<u64> {
    name.strip_prefix(STRANGERS)?.parse().ok()
}

/// Draws a stranger: this robot with other friction left and right (58 % up or down), 50 g somewhere on its plate, the
/// stiffness and damping of each leg 20 % up or down, on a floor that falls by up to 5 degrees in any direction; each
/// evenly distributed. The same for the same seed. A robot without legs only gets load and floor.
#[must_use]
pub fn stranger(model: &RobotModel, seed: u64) -> RobotModel {
    let mut source = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut within = |most: f64| most * (2.0 * source.random::<f64>() - 1.0);
    let mut model = RobotModel { name: format!("{STRANGERS}{seed}"), ..model.clone() };
    let sides = [1.0 + within(FRICTION), 1.0 + within(FRICTION)];
    for (index, leg) in model.legs.iter_mut().flat_map(|legs| legs.each_mut()).enumerate() {
        leg.friction *= sides[index % 2];
        for factor in [
            &mut leg.bend_stiffness_factor,
            &mut leg.twist_stiffness_factor,
            &mut leg.bend_damping_factor,
            &mut leg.twist_damping_factor,
        ] {
            *factor *= 1.0 + within(LEG);
        }
    }
    let half = |side_mm: f64| (0.5 * side_mm - FROM_EDGE_MM).max(0.0);
    let (x_mm, y_mm) = (within(half(model.plate.length_mm)), within(half(model.plate.width_mm)));
    model.load.push(Load { mass_g: LOAD_G, x_mm, y_mm, z_mm: 0.0 });
    model.contact.slope_deg = within(STEEPEST_DEG).abs();
    model.contact.downhill_deg = within(180.0);
    model
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strangers_stay_within_their_ranges_reach_for_the_ends_and_can_walk() {
        let model = RobotModel::named("W").unwrap();
        let own = model.legs.unwrap();
        let (mut least, mut most, mut steepest) = (1f64, 1f64, 0f64);
        for seed in 0..300 {
            let other = stranger(&model, seed);
            other.check().unwrap();
            other.check_walker().unwrap();
            let legs = other.legs.unwrap();
            let factor = |i: usize| legs.each()[i].friction / own.each()[i].friction;
            assert!((factor(0) - factor(2)).abs() < 1e-12 && (factor(0) - factor(1)).abs() > 0.0);
            (least, most) = (least.min(factor(0)), most.max(factor(1)));
            let stiffness = legs.rl.bend_stiffness_factor / own.rl.bend_stiffness_factor;
            assert!((0.8..=1.2).contains(&stiffness));
            steepest = steepest.max(other.contact.slope_deg);
            assert_eq!(other, stranger(&model, seed));
        }
        assert!((0.42..0.45).contains(&least) && (1.55..1.58).contains(&most), "{least} {most}");
        assert!((4.9..=5.0).contains(&steepest), "{steepest}");
    }
}
