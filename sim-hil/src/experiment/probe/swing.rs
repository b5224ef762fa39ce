//! The robot in the air under its shaker: what motion capture sees of its body and feet.

use flix_protocol::message::Setpoint;
use nalgebra::{Quaternion, UnitQuaternion};

use super::{ProbeError, require_legs};
use crate::model::{Base, GRAVITY, RobotModel};
use crate::plant::{Drive, Mechanics, Plant};

/// Signals of a [`Swing`]: the body's position x, y, z (m), its rotation vector about x, y, z (rad), and for each leg in
/// the order of [`crate::model::LEGS`] the position of its foot's centre (m).
pub const CHANNELS: usize = 18;

/// Motion of a robot that is shaken in the air, in axes of its body at rest that fall with it.
#[derive(Debug, Clone, PartialEq)]
pub struct Swing {
    /// When each sample was taken, s.
    pub times: Vec<f64>,
    /// How far the top rotor had turned clockwise, seen from above, from the line of force by then, rad.
    pub phases: Vec<f64>,
    /// [`CHANNELS`] signals.
    pub signals: Vec<Vec<f64>>,
}

/// Shakes the robot with ideal rotors while nothing holds it, for `run_in` seconds unseen, then for `seconds` with a
/// sample every `every` steps.
///
/// # Errors
/// When the model is refused or has no legs, or diverges.
pub fn swing(
    model: &RobotModel,
    setpoint: Setpoint,
    step: f64,
    (run_in, seconds): (f64, f64),
    every: usize,
) -> Result<Swing, ProbeError> {
    require_legs(model)?;
    let mut plant = Plant::new(&RobotModel { base: Base::Free {}, ..model.clone() })?;
    plant.set_floor(false);
    plant.set_drive(Drive::Ideal {
        frequency_hz: f64::from(setpoint.frequency().get()),
        theta_rad: f64::from(setpoint.direction().get()).to_radians(),
    });
    plant.balance_momentum();
    for _ in 0..(run_in / step) as usize {
        plant.step([0.0; 2], step)?;
    }
    let mut seen = Swing { times: vec![], phases: vec![], signals: vec![vec![]; CHANNELS] };
    for index in 0..(seconds / step) as usize {
        plant.step([0.0; 2], step)?;
        if index % every == 0 {
            seen.add(&plant);
        }
    }
    Ok(seen)
}

impl Swing {
    fn add(&mut self, plant: &Plant) {
        let (body, [top, bottom]) = (plant.body(), plant.rotor_angle());
        self.times.push(plant.time());
        self.phases.push(-0.5 * (top - bottom));
        let [w, x, y, z] = body.orientation;
        let turned = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let rotation: [f64; 3] = turned.scaled_axis().into();
        let feet = plant.legs().into_iter().flatten().flat_map(|leg| leg.foot_center);
        let values = body.position.into_iter().chain(rotation).chain(feet);
        let fallen = 0.5 * GRAVITY * plant.time().powi(2);
        for (channel, (signal, value)) in self.signals.iter_mut().zip(values).enumerate() {
            let is_height = channel % 3 == 2 && channel != 5;
            signal.push(if is_height { value + fallen } else { value });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::bench::setpoint;

    #[test]
    fn a_robot_in_the_air_shakes_about_where_it_is_for_a_second() {
        let model = RobotModel::named("W").unwrap();
        for theta in [0.0, 90.0] {
            let shake = setpoint(28.0, theta).unwrap();
            let seen = swing(&model, shake, 5e-4, (0.2, 1.0), 2).unwrap();
            for (signal, limit) in seen.signals[..6].iter().zip([0.01, 0.01, 0.01, 0.1, 0.1, 0.1]) {
                let start = signal[0];
                assert!(signal.iter().all(|value| (value - start).abs() < limit), "{theta}");
            }
        }
    }
}
