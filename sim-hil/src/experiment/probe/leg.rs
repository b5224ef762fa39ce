//! One leg, clamped at its root, loaded at its tip and released: the paper's release test (section II-C).

use serde::Serialize;

use super::signal::extremes;
use super::{Clamp, ProbeError, eigenmodes, norm, require_legs};
use crate::model::RobotModel;
use crate::plant::{LegView, Mechanics, Plant, Wrench};

/// Time for which the released leg is watched, s.
const RING: f64 = 1.0;
/// Longest time that a loaded leg may take to rest, s, and its kinetic energy then, J.
const PATIENCE: f64 = 5.0;
const STILL: f64 = 1e-16;
/// Swings below this share of the first are lost in what is left of settling.
const FAINTEST: f64 = 1e-4;
/// Bend below which a leg counts as not loaded, as a share of its length, and twist, rad.
const UNBENT: f64 = 1e-9;
/// How far what is seen may be from an eigenmode to be its ring: share of its frequency, and of critical damping.
const SINGLE: f64 = 0.02;

/// Static deflection and ring-down of a leg's tip (end of its last segment). World axes: x forward, y left,
/// z up.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LegProbe {
    /// From the unloaded rest to the loaded one, mm.
    pub displacement_mm: [f64; 3],
    /// Rotation vector of the same, degrees.
    pub rotation_deg: [f64; 3],
    /// What is seen after the release, if that is the ring of a single eigenmode: none where several swing together to
    /// the end, or where nothing swings.
    pub ring_down: Option<RingDown>,
    /// Eigenmodes of the clamped leg in rising frequency.
    pub eigenmodes: Vec<RingDown>,
}

/// A damped oscillation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RingDown {
    /// Natural (undamped) frequency, Hz.
    pub frequency_hz: f64,
    /// Frequency that is seen: the natural one times sqrt(1 - damping_ratio^2), Hz.
    pub damped_frequency_hz: f64,
    /// Share of critical damping.
    pub damping_ratio: f64,
}

/// Loads the tip of one leg (in the order of [`crate::model::LEGS`]) with a wrench in world axes, waits
/// until it rests, releases it, and watches. The body is held, the floor taken away; the foot stays on.
///
/// # Errors
/// When the model is refused or has no legs, when the leg cannot bear the load, or when the load does not bend it.
pub fn leg(
    model: &RobotModel,
    leg: usize,
    load: Wrench,
    step: f64,
) -> Result<LegProbe, ProbeError> {
    require_legs(model)?;
    let mut plant = Plant::new(model)?;
    plant.load_clamped_leg(leg, Wrench::default(), step)?;
    let free = view(&plant, leg);
    plant.load_clamped_leg(leg, load, step).map_err(|_| ProbeError::Overloaded)?;
    let loaded = view(&plant, leg);
    let displacement: [f64; 3] = core::array::from_fn(|i| loaded.joints[3][i] - free.joints[3][i]);

    plant.set_tip_push(leg, Wrench::default());
    let twist = rotation_between(&free, &loaded);
    if norm(displacement) / TIP_REACH < UNBENT && norm(twist) < UNBENT {
        return Err(ProbeError::Still);
    }
    // The signal that shows the release best: along the displacement, or about the rotation.
    let bent = norm(displacement) / TIP_REACH > norm(twist);
    let mut signal = Vec::with_capacity((RING / step) as usize);
    for _ in 0..(RING / step) as usize {
        plant.step([0.0; 2], step)?;
        let now = view(&plant, leg);
        signal.push(if bent {
            (0..3).map(|i| (now.joints[3][i] - free.joints[3][i]) * displacement[i]).sum::<f64>()
        } else {
            let turned = rotation_between(&free, &now);
            (0..3).map(|i| turned[i] * twist[i]).sum::<f64>()
        });
    }
    let start = if bent { norm(displacement).powi(2) } else { norm(twist).powi(2) };
    let eigenmodes: Vec<RingDown> = eigenmodes(model, Clamp::Leg(leg))?
        .eigenmodes
        .iter()
        .map(|mode| RingDown {
            frequency_hz: mode.frequency_hz,
            damped_frequency_hz: mode.frequency_hz
                * (1.0 - mode.damping_ratio.powi(2)).max(0.0).sqrt(),
            damping_ratio: mode.damping_ratio,
        })
        .collect();
    let seen = ring_down(&signal, start, step);
    Ok(LegProbe {
        displacement_mm: displacement.map(|c| c * 1e3),
        rotation_deg: twist.map(f64::to_degrees),
        ring_down: seen.filter(|seen| eigenmodes.iter().any(|mode| seen.is_ring_of(mode))),
        eigenmodes,
    })
}

impl RingDown {
    fn is_ring_of(&self, mode: &Self) -> bool {
        (self.frequency_hz / mode.frequency_hz - 1.0).abs() < SINGLE
            && (self.damping_ratio - mode.damping_ratio).abs() < SINGLE
    }
}

/// Where the tip is, from its unloaded rest: m, and a rotation vector in rad. Body axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TipMotion {
    /// Displacement, m.
    pub position: [f64; 3],
    /// Rotation vector, rad.
    pub rotation: [f64; 3],
}

/// How the clamped leg is turned to gravity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Gravity {
    /// The beam lies level, clamped with the body's forward axis down.
    Across,
    /// The beam hangs down, as on the standing robot.
    Along,
}

impl Gravity {
    /// Pitch of the body, rad.
    const fn pitch(self) -> f64 {
        match self {
            Self::Across => core::f64::consts::FRAC_PI_2,
            Self::Along => 0.0,
        }
    }
}

/// Simulates a clamped leg's tip after a load on it is released: at the release, then after every step. Load and motion
/// are in body axes.
///
/// # Errors
/// As [`leg`].
pub fn release(
    model: &RobotModel,
    leg: usize,
    load: Wrench,
    gravity: Gravity,
    step: f64,
    steps: usize,
) -> Result<Vec<TipMotion>, ProbeError> {
    require_legs(model)?;
    let mut plant = Plant::new(model)?;
    plant.pitch(gravity.pitch());
    let turn = nalgebra::Rotation3::from_axis_angle(&nalgebra::Vector3::y_axis(), gravity.pitch());
    let to_world = |v: [f64; 3]| (turn * nalgebra::Vector3::from(v)).into();
    let to_body = |v: [f64; 3]| (turn.inverse() * nalgebra::Vector3::from(v)).into();
    plant.load_clamped_leg(leg, Wrench::default(), step)?;
    let free = view(&plant, leg);
    let load = Wrench { force: to_world(load.force), torque: to_world(load.torque) };
    plant.load_clamped_leg(leg, load, step)?;
    plant.set_tip_push(leg, Wrench::default());
    let moved = |plant: &Plant| {
        let now = view(plant, leg);
        TipMotion {
            position: to_body(core::array::from_fn(|i| now.joints[3][i] - free.joints[3][i])),
            rotation: to_body(rotation_between(&free, &now)),
        }
    };
    let mut motion = vec![moved(&plant)];
    for _ in 0..steps {
        plant.step([0.0; 2], step)?;
        motion.push(moved(&plant));
    }
    Ok(motion)
}

/// Loads the tips of all four legs at once, each with its own wrench in world axes, while the body is held and the
/// floor is taken away: where they come to rest, from their unloaded rest.
///
/// # Errors
/// When the model is refused or has no legs, or when a leg cannot bear its load.
pub fn bend(
    model: &RobotModel,
    loads: [Wrench; 4],
    step: f64,
) -> Result<[TipMotion; 4], ProbeError> {
    require_legs(model)?;
    let mut plant = Plant::new(model)?;
    let mut resting = |loads: [Wrench; 4]| {
        loads.into_iter().enumerate().for_each(|(leg, load)| plant.set_tip_push(leg, load));
        plant.clamp();
        plant.settle(step, PATIENCE, STILL)?;
        Ok::<_, ProbeError>(core::array::from_fn::<_, 4, _>(|leg| view(&plant, leg)))
    };
    let free = resting([Wrench::default(); 4])?;
    let loaded = resting(loads)?;
    Ok(core::array::from_fn(|leg| TipMotion {
        position: core::array::from_fn(|i| loaded[leg].joints[3][i] - free[leg].joints[3][i]),
        rotation: rotation_between(&free[leg], &loaded[leg]),
    }))
}

/// A length that makes displacements and rotations comparable: that of a leg, m (paper, table II).
pub const TIP_REACH: f64 = 0.05;

fn view(plant: &Plant, leg: usize) -> LegView {
    plant.legs().map(|legs| legs[leg]).expect("asked only of models with legs")
}

/// Rotation vector that turns the first tip into the second, rad; exact below half a turn.
fn rotation_between(from: &LegView, to: &LegView) -> [f64; 3] {
    let axes = |view: &LegView| {
        nalgebra::Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(
            &view.axes[2].map(nalgebra::Vector3::from),
        ))
    };
    // By the quaternion: the rotation's own angle is the arc cosine of a number that rounding lifts above 1.
    nalgebra::UnitQuaternion::from_rotation_matrix(&(axes(to) * axes(from).inverse()))
        .scaled_axis()
        .into()
}

/// Period and decay of the last swings that are well above rounding: by then only the slowest-dying eigenmode is
/// left.
fn ring_down(signal: &[f64], start: f64, step: f64) -> Option<RingDown> {
    let swings: Vec<(f64, f64)> = extremes(signal)
        .into_iter()
        .take_while(|(_, height)| height.abs() > FAINTEST * start)
        .collect();
    let pairs = swings.len().checked_sub(1).filter(|pairs| *pairs >= 1)?;
    // The later half, in which the faster eigenmodes have died.
    let (first, last) = (swings[pairs / 2], swings[pairs]);
    let halves = (pairs - pairs / 2) as f64;
    let damped = core::f64::consts::TAU * halves / 2.0 / ((last.0 - first.0) * step);
    let decay = (first.1 / last.1).abs().ln() / ((last.0 - first.0) * step);
    let natural = damped.hypot(decay);
    Some(RingDown {
        frequency_hz: natural / core::f64::consts::TAU,
        damped_frequency_hz: damped / core::f64::consts::TAU,
        damping_ratio: decay / natural,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ring_down_of_two_modes_is_that_of_the_slower_dying_one() {
        let (omega, zeta) = (270.0, 0.3);
        let signal: Vec<f64> = (0..4000)
            .map(|i| {
                let t = f64::from(i) * 1e-4;
                let slow =
                    (-zeta * omega * t).exp() * (omega * (1.0f64 - zeta * zeta).sqrt() * t).cos();
                slow + 0.4 * (-260.0 * t).exp() * (900.0 * t).cos()
            })
            .collect();
        let found = ring_down(&signal, 1.0, 1e-4).unwrap();
        let expected = omega / core::f64::consts::TAU;
        assert!((found.frequency_hz / expected - 1.0).abs() < 0.005, "{found:?}");
        assert!((found.damping_ratio / zeta - 1.0).abs() < 0.01, "{found:?}");
    }
}
