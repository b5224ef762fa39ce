//! What holds the robot: the floor, hands, or soft cords.

use flix_host::pose::Quaternion;

use super::body::{BodyState, Wrench};

/// Natural frequency of the swing on the cords, Hz: at 20 Hz they are less than a thousandth of the robot's inertia.
const SWING_HZ: f64 = 0.5;
/// Damping ratio of the swing: at 20 Hz it changes an amplitude by less than 0.3 %.
const SWING_DAMPING: f64 = 0.05;

/// Mass, kg; centre of mass, m; inertia about it, xx xy xz yy yz zz, kg m^2: all in world axes.
type MassProperties = (f64, [f64; 3], [f64; 6]);

/// What the robot is held by, besides pushes.
#[derive(Clone, Copy, Debug)]
pub(super) enum Support {
    /// Nothing but the floor.
    Floor,
    /// Hands that hold it still.
    Hands {
        /// When they release it, s.
        until: f64,
    },
    /// Cords.
    Cords(Cords),
}

/// Soft cords that carry the whole robot at its centre of mass, wherever that is just now, and pull it back to where it
/// was hung, slowly: it swings once in two seconds, in all directions and about all axes. So it floats, and weight turns
/// nothing but its legs. They take the place of pushes on the body.
#[derive(Clone, Copy, Debug)]
pub struct Cords {
    /// Centre of mass, m, and orientation of the body when it was hung.
    place: [f64; 3],
    orientation: Quaternion,
    /// Acceleration of free fall, m/s^2.
    gravity: [f64; 3],
}

impl Cords {
    /// Hangs a robot of these mass properties where it is.
    pub(super) fn holding(
        (_, place, _): MassProperties,
        body: &BodyState,
        gravity: [f64; 3],
    ) -> Self {
        Self { place, orientation: body.orientation.into(), gravity }
    }

    /// Returns the wrench on the body at its origin.
    pub(super) fn pull(&self, properties: MassProperties, body: &BodyState) -> Wrench {
        let rate = core::f64::consts::TAU * SWING_HZ;
        let (stiffness, damping) = (rate * rate, 2.0 * SWING_DAMPING * rate);
        let (mass, centre, [xx, _, _, yy, _, zz]) = properties;
        let inertia = (xx + yy + zz) / 3.0;
        let BodyState { position, orientation, velocity, angular_velocity } = *body;
        let turned = Quaternion::from(orientation).after(self.orientation.inverse());
        let turned = turned.rotation_vector().coordinates();
        let force: [f64; 3] = core::array::from_fn(|i| {
            mass * (-self.gravity[i]
                - stiffness * (centre[i] - self.place[i])
                - damping * velocity[i])
        });
        let [x, y, z]: [f64; 3] = core::array::from_fn(|i| centre[i] - position[i]);
        let [fx, fy, fz] = force;
        // At the centre of mass, though it is given at the origin.
        let lever = [y * fz - z * fy, z * fx - x * fz, x * fy - y * fx];
        let torque = core::array::from_fn(|i| {
            lever[i] - inertia * (stiffness * turned[i] + damping * angular_velocity[i])
        });
        Wrench { force, torque }
    }
}

#[cfg(test)]
mod tests {
    use crate::model::{GRAVITY, RobotModel};
    use crate::plant::{Mechanics, Plant};

    fn robot() -> Plant {
        Plant::new(&RobotModel::named("W").unwrap()).unwrap()
    }

    #[test]
    fn a_robot_on_cords_hangs_where_it_was_hung_and_swings_slowly_about_it() {
        let mut plant = robot();
        plant.displace([0.2, 0.1, 0.0], 0.8);
        plant.hang(0.5);
        let place = plant.body().position;
        let away = |plant: &Plant| -> [f64; 3] {
            core::array::from_fn(|i| plant.body().position[i] - place[i])
        };
        (0..5_000).for_each(|_| plant.step([0.0; 2], 2e-4).unwrap());
        let still = away(&plant).into_iter().fold(0.0, |most: f64, it| most.max(it.abs()));
        assert!(still < 2e-3, "{:?}", away(&plant));

        plant.displace([0.01, 0.0, 0.0], 0.0);
        // Half a swing later it is on the other side.
        (0..5_000).for_each(|_| plant.step([0.0; 2], 2e-4).unwrap());
        let [x, ..] = away(&plant);
        assert!((-0.01..-0.006).contains(&x), "{:?}", away(&plant));
    }

    #[test]
    fn hands_release_the_robot_after_their_time() {
        let mut plant = robot();
        let stands = plant.body().position;
        plant.displace([0.3, 0.0, 0.0], 1.0);
        plant.hold(stands, 0.02, 0.5);
        let height = |plant: &Plant| plant.body().position[2] - stands[2];
        (0..2_500).for_each(|_| plant.step([0.0; 2], 2e-4).unwrap());
        assert!((height(&plant) - 0.02).abs() < 1e-12, "{}", height(&plant));
        (0..250).for_each(|_| plant.step([0.0; 2], 2e-4).unwrap());
        let fallen = 0.02 - height(&plant);
        assert!((fallen - 0.5 * GRAVITY * 0.05f64.powi(2)).abs() < 2e-4, "{fallen}");
    }
}
