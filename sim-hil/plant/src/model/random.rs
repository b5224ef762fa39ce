//! Random robots: what a check should hold for that was tuned to none.

use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::{
    Base, Block, Body, Contact, Core, Electrical, Foot, FootAxis, Leg, Legs, Load, Plate,
    RobotModel, Shaker,
};

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
    let mut within = |low: f64, high: f64| low + (high - low) * source.random::<f64>();
    let coin = |draw: f64| if draw < 0.0 { -1.0 } else { 1.0 };
    let mut sizes = |low: f64, high: f64| [(); 3].map(|()| within(low, high));
    let (battery, electronics, core) = (sizes(15.0, 45.0), sizes(15.0, 45.0), sizes(30.0, 60.0));
    let block = |side: f64, size_mm, within: &mut dyn FnMut(f64, f64) -> f64| Block {
        mass_g: within(20.0, 40.0),
        x_mm: side * within(60.0, 90.0),
        y_mm: within(-10.0, 10.0),
        z_mm: within(-5.0, 10.0),
        size_mm,
    };
    let leg = |within: &mut dyn FnMut(f64, f64) -> f64| Leg {
        twist_hand: coin(within(-1.0, 1.0)),
        friction: within(0.3, 1.0),
        bend_stiffness_factor: within(0.8, 1.25),
        twist_stiffness_factor: within(0.8, 1.25),
        bend_damping_factor: within(0.5, 1.5),
        twist_damping_factor: within(0.5, 1.5),
        foot_shift_mm: within(-12.0, 12.0),
    };
    RobotModel {
        name,
        base: Base::Free {},
        body: Body {
            total_mass_g: within(280.0, 450.0),
            offset_x_mm: within(-5.0, 5.0),
            offset_y_mm: within(-5.0, 5.0),
        },
        plate: Plate {
            length_mm: within(200.0, 240.0),
            width_mm: within(100.0, 140.0),
            thickness_mm: within(2.0, 5.0),
            mass_g: within(10.0, 25.0),
        },
        battery: block(1.0, battery, &mut within),
        electronics: block(-1.0, electronics, &mut within),
        core: Core { x_mm: within(-10.0, 10.0), z_mm: within(0.0, 40.0), size_mm: core },
        shaker: Shaker {
            mass_g: within(8.0, 14.0),
            arm_mm: within(20.0, 30.0),
            spacing_mm: within(15.0, 35.0),
            z_mm: within(0.0, 22.0),
            bell_inertia_g_cm2: within(0.0, 40.0),
        },
        legs: Some(Legs {
            root_x_mm: within(90.0, 115.0),
            root_y_mm: within(46.0, 60.0),
            length_mm: within(40.0, 60.0),
            width_mm: within(15.0, 25.0),
            thickness_mm: within(2.0, 4.0),
            mass_g: within(2.5, 6.0),
            hinge_deg: within(-90.0, 90.0),
            twist_deg: [within(-15.0, 15.0), within(25.0, 60.0), within(25.0, 60.0)],
            bend_stiffness_n_m_rad: within(0.9, 2.0),
            twist_stiffness_n_m_rad: within(1.2, 3.0),
            bend_damping_n_m_s_rad: within(0.002, 0.006),
            twist_damping_n_m_s_rad: within(0.002, 0.006),
            fl: leg(&mut within),
            fr: leg(&mut within),
            rl: leg(&mut within),
            rr: leg(&mut within),
            foot: Foot {
                length_mm: within(60.0, 90.0),
                width_mm: within(4.0, 10.0),
                height_mm: within(4.0, 12.0),
                mass_g: within(2.5, 6.0),
                axis: if within(-1.0, 1.0) < 0.0 { FootAxis::Across } else { FootAxis::Along },
            },
        }),
        contact: Contact {
            stiffness_n_per_m: within(1500.0, 8000.0),
            damping_n_s_per_m: within(40.0, 90.0),
            impedance_touch: within(0.85, 0.92),
            impedance_full: within(0.93, 0.97),
            impedance_width_mm: within(0.5, 2.0),
            torsional_friction_mm: within(1.0, 8.0),
            rolling_friction_mm: within(0.05, 0.5),
            slope_deg: 0.0,
            downhill_deg: 0.0,
        },
        electrical: Electrical::default(),
        load: (within(-1.0, 1.0) < 0.0)
            .then(|| Load {
                mass_g: within(10.0, 50.0),
                x_mm: within(-60.0, 60.0),
                y_mm: within(-40.0, 40.0),
                z_mm: within(0.0, 30.0),
            })
            .into_iter()
            .collect(),
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
