//! The robot's small motions about where it stands: mass, stiffness and damping matrices.

use super::body::Wrench;
use super::pack::Pack;
use super::plant::Plant;
use super::spatial::{Spatial, Vec3};
use crate::plant::{Diverged, Mechanics};

/// Number of degrees of freedom with legs.
pub const FREEDOMS: usize = 32;

/// `M q'' + D q' + K q = 0` for small motions `q`, without contact and without the weight's small share.
///
/// Coordinates: the body's rotation about world x, y, z (0 to 2) and translation (3 to 5), the rotors top
/// and bottom (6, 7), then six hinges for each leg in the order of [`crate::model::LEGS`]: bend, twist,
/// bend, twist, bend, twist from the root. A bench stops after 8.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    /// Row-major square matrices of equal size, SI units.
    pub mass: Vec<Vec<f64>>,
    /// Hinge springs.
    pub stiffness: Vec<Vec<f64>>,
    /// Hinge dampers, and the planar base's.
    pub damping: Vec<Vec<f64>>,
    /// Velocities of the middles of both short sides of each sole by the coordinates: for each leg two
    /// points, for each point rows x, y, z. Setting them to zero pins the feet.
    pub sole_ends: Vec<Vec<f64>>,
}

impl Plant {
    /// Linearises about the present configuration.
    pub fn linearise(&self) -> Linear {
        let n = if self.has_legs() { FREEDOMS } else { 8 };
        // One column of motion a coordinate: velocities of every part when it moves at unit speed.
        let columns: Vec<_> = (0..n).map(|i| self.moving(i)).collect();
        let parts = self.parts();
        let mut mass = vec![vec![0.0; n]; n];
        for i in 0..n {
            for j in 0..n {
                mass[i][j] = parts
                    .iter()
                    .zip(columns[i].iter().zip(&columns[j]))
                    .map(|((inertia, _), (a, b))| a.dot(inertia.apply(*b)))
                    .sum();
            }
        }
        let mut stiffness = vec![vec![0.0; n]; n];
        let mut damping = vec![vec![0.0; n]; n];
        let mut sole_ends = Vec::new();
        for leg in 0..(n - 8) / 6 {
            let model = self.leg_model(leg);
            for j in 0..6 {
                let at = 8 + 6 * leg + j;
                stiffness[at][at] = model.stiffness[j];
                damping[at][at] = model.damping[j];
            }
            // Parts: body, two rotors, then three segments a leg; the foot moves with the third.
            let part = 3 + 3 * leg + 2;
            for point in self.sole_end_points(leg) {
                for axis in 0..3 {
                    sole_ends.push(
                        columns
                            .iter()
                            .map(|c| (c[part].linear + c[part].angular.cross(point)).0[axis])
                            .collect(),
                    );
                }
            }
        }
        Linear { mass, stiffness, damping, sole_ends }
    }

    /// Gives the body the velocity with which the whole has neither momentum nor angular momentum, so
    /// that in the air it shakes about where it is instead of tumbling away.
    pub fn balance_momentum(&mut self) {
        let linear = self.linearise();
        let speeds = self.rotor_speed();
        let mass = nalgebra::Matrix6::from_fn(|i, j| linear.mass[i][j]);
        let spinning = nalgebra::Vector6::from_fn(|i, _| {
            linear.mass[i][6] * speeds[0] + linear.mass[i][7] * speeds[1]
        });
        if let Some(factor) = mass.cholesky() {
            let v = factor.solve(&-spinning);
            self.state_mut().velocity =
                Spatial::new(Vec3([v[0], v[1], v[2]]), Vec3([v[3], v[4], v[5]]));
        }
    }

    /// Velocity of every part (in the order of [`Plant::parts`]) when one coordinate moves at unit speed.
    fn moving(&self, coordinate: usize) -> Vec<Spatial<f64>> {
        let mut still = self.clone();
        let s = still.state_mut();
        s.velocity = Spatial::zero();
        s.rotors[0].speed = 0.0;
        s.rotors[1].speed = 0.0;
        for speed in &mut s.legs[0].speed {
            *speed = Pack::all(&0.0);
        }
        match coordinate {
            0..6 => {
                let mut v = [0.0; 6];
                v[coordinate] = 1.0;
                s.velocity = Spatial::new(Vec3([v[0], v[1], v[2]]), Vec3([v[3], v[4], v[5]]));
            }
            6 | 7 => s.rotors[coordinate - 6].speed = 1.0,
            _ => {
                let (leg, hinge) = ((coordinate - 8) / 6, (coordinate - 8) % 6);
                s.legs[0].speed[hinge].set(leg, &1.0);
            }
        }
        still.parts().iter().map(|part| part.1).collect()
    }

    /// Middles of both short sides of a sole, from the body's origin.
    fn sole_end_points(&self, leg: usize) -> [Vec3<f64>; 2] {
        let Some(legs) = self.legs() else {
            return [Vec3::zero(); 2];
        };
        let view = &legs[leg];
        let [x, y, z] = view.foot_half.map(Vec3);
        let long = if x.dot(x) > y.dot(y) { x } else { y };
        let middle = Vec3(view.foot_center) - Vec3(self.body().position) - z;
        [middle + long, middle - long]
    }

    /// Steps until nothing moves faster than `still` J of kinetic energy for 50 ms, at most `seconds` long. Returns whether
    /// it came to that.
    ///
    /// # Errors
    /// If the motion diverges.
    pub fn settle(&mut self, step: f64, seconds: f64, still: f64) -> Result<bool, Diverged> {
        let quiet = (0.05 / step) as usize;
        let mut calm = 0;
        for i in 0..(seconds / step) as usize {
            self.step([0.0; 2], step)?;
            if i % 16 == 0 {
                calm = if self.energy().kinetic < still { calm + 16 } else { 0 };
                if calm > quiet {
                    return Ok(true);
                }
            }
        }
        Ok(false)
    }

    /// Loads a leg's tip with a steady wrench (world axes) while the body is held and the floor is taken away, and
    /// waits until it rests, at most 5 s. The plant is left there, loaded.
    ///
    /// # Errors
    /// If the motion diverges: the leg cannot bear the load.
    pub fn load_clamped_leg(
        &mut self,
        leg: usize,
        load: Wrench,
        step: f64,
    ) -> Result<(), Diverged> {
        self.clamp();
        self.set_tip_push(leg, load);
        self.settle(step, 5.0, 1e-16).map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::RobotModel;

    #[test]
    fn the_mass_matrix_is_symmetric_and_moves_the_whole_robot_as_one() {
        let p = Plant::new(&RobotModel::named("A").unwrap()).unwrap();
        let l = p.linearise();
        for i in 3..6 {
            assert!((l.mass[i][i] - 0.35).abs() < 1e-12);
        }
        for i in 0..FREEDOMS {
            for j in 0..i {
                assert!((l.mass[i][j] - l.mass[j][i]).abs() < 1e-15);
            }
        }
        assert_eq!(l.sole_ends.len(), 24);
    }
}
