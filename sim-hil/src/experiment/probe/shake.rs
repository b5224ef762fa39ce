//! The shaker at a steady frequency: forces on the body, and what the body makes of them.

use flix_host::nav::wrap;
use flix_protocol::message::Setpoint;
use serde::Serialize;

use super::signal::lock_in;
use super::{ProbeError, require_legs};
use crate::model::{Base, RobotModel};
use crate::plant::{Drive, Mechanics, Plant};

/// Time after which the start is forgotten in the air and on the floor, s.
const RUN_IN: f64 = 1.0;
/// Time that is measured, at least, s; rounded up to whole periods.
const MEASURED: f64 = 1.0;

/// What the body stands on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum ShakeBase {
    /// A test stand: the body is held.
    Fixed,
    /// Nothing: the body floats, legs and all.
    Air,
    /// Its own feet.
    Floor,
}

/// Amplitudes of the component at the shaking frequency, body axes for force and torque (x forward, y left,
/// z up), world axes for the body's motion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Shaken {
    /// Of the body's origin, mm.
    pub displacement_mm: [f64; 3],
    /// Roll, pitch, yaw, degrees.
    pub rotation_deg: [f64; 3],
    /// Of the two rotors on the body, without their weight, N.
    pub force_n: [f64; 3],
    /// Of the two rotors on the body about the shaker's middle, their weight included, N m.
    pub torque_nm: [f64; 3],
    /// Largest force along the line of force, N.
    pub peak_force_along_n: f64,
    /// Largest force across it, N.
    pub peak_force_across_n: f64,
}

/// Turns the rotors ideally and measures.
///
/// # Errors
/// When the model is refused, has no legs to stand on, or diverges.
pub fn shake(
    model: &RobotModel,
    setpoint: Setpoint,
    base: ShakeBase,
    step: f64,
) -> Result<Shaken, ProbeError> {
    let mut model = model.clone();
    match base {
        ShakeBase::Fixed => model.base = Base::Fixed {},
        ShakeBase::Air => model.base = Base::Free {},
        ShakeBase::Floor => {
            require_legs(&model)?;
            model.base = Base::Free {};
        }
    }
    let mut plant = Plant::new(&model)?;
    plant.set_floor(base == ShakeBase::Floor);
    let frequency = f64::from(setpoint.frequency().get());
    let theta = f64::from(setpoint.direction().get()).to_radians();
    plant.set_drive(Drive::Ideal { frequency_hz: frequency, theta_rad: theta });

    if base == ShakeBase::Air {
        plant.balance_momentum();
    }

    // A whole number of steps a period, so that whole periods are sampled.
    let rate = frequency.abs();
    let steps_a_period = (1.0 / (rate * step)).ceil().max(1.0);
    let step = if rate > 0.0 { 1.0 / (rate * steps_a_period) } else { step };
    let run_in = if base == ShakeBase::Fixed { 0.0 } else { RUN_IN };
    for _ in 0..(run_in / step) as usize {
        plant.step([0.0; 2], step)?;
    }
    let count = if rate > 0.0 {
        ((MEASURED * rate).ceil() * steps_a_period) as usize
    } else {
        (MEASURED / step) as usize
    };
    let mut samples: [Vec<f64>; 12] = core::array::from_fn(|_| Vec::with_capacity(count));
    let (mut along, mut across) = (0.0f64, 0.0f64);
    let mut yaw = plant.body().yaw();
    for _ in 0..count {
        plant.step([0.0; 2], step)?;
        let (body, wrench) = (plant.body(), plant.shaker_wrench());
        yaw += wrap(body.yaw() - yaw);
        let [roll, pitch] = roll_pitch(body.orientation);
        let rotation = [roll, pitch, yaw];
        let values = [body.position, rotation, wrench.force, wrench.torque];
        for (series, value) in samples.iter_mut().zip(values.into_iter().flatten()) {
            series.push(value);
        }
        // The line of force points theta to the right of forward.
        let (sin, cos) = theta.sin_cos();
        along = along.max((wrench.force[0] * cos - wrench.force[1] * sin).abs());
        across = across.max((wrench.force[0] * sin + wrench.force[1] * cos).abs());
    }
    let times: Vec<f64> = (0..count).map(|index| index as f64 * step).collect();
    let phases: Vec<f64> = times.iter().map(|time| core::f64::consts::TAU * rate * time).collect();
    let found = lock_in(&times, &phases, &samples).unwrap_or_default();
    let amplitude = |first: usize, scale: f64| -> [f64; 3] {
        let of =
            |i: usize| found.get(first + i).map_or(0.0, |found| scale * found.cos.hypot(found.sin));
        core::array::from_fn(of)
    };
    Ok(Shaken {
        displacement_mm: amplitude(0, 1e3),
        rotation_deg: amplitude(3, 1f64.to_degrees()),
        force_n: amplitude(6, 1.0),
        torque_nm: amplitude(9, 1.0),
        peak_force_along_n: along,
        peak_force_across_n: across,
    })
}

/// Roll and pitch of a body, rad.
fn roll_pitch([w, x, y, z]: [f64; 4]) -> [f64; 2] {
    let sine = 2.0 * (w * y - z * x);
    [(2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y)), sine.clamp(-1.0, 1.0).asin()]
}
