//! One walk: the robot shaken at a steady f and theta, and how fast it goes.
//!
//! At 30 Hz the shaking force is seven times the weight and the walk is chaotic: one run says little. So a
//! walk is repeated with its start disturbed ([`Plant::disturb`]) from several seeds, and reported as mean
//! and spread.

use std::f64::consts::PI;
use std::time::Duration;

use flix_host::link::{LinkError, RobotLink};
use flix_host::nav::{self, Twist, wrap};
use flix_protocol::message::Setpoint;
use flix_protocol::session::Key;
use flix_protocol::units::OutOfRange;
use rand::{RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::Serialize;

use crate::model::{GRAVITY, ModelError, RobotModel};
use crate::plant::{BodyState, Diverged, Drive, Mechanics, Plant};
use crate::rig::bench::setpoint;
use crate::rig::lossy_network::ChannelParameters;
use crate::rig::operation::{Operation, OperationError};
use crate::rig::simulated::{RobotParameters, SimulatedRobot};

/// Default step, s: the firmware's own 10 kHz tick.
pub const DEFAULT_STEP: f64 = 1e-4;
/// Time that the firmware has to come up to f and theta before the walk is measured, s: the promise of a
/// step of the setpoint.
const RUN_UP: Duration = Duration::from_millis(500);

/// What turns the rotors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum WalkDrive {
    /// The robot's own software, through an operator's link, motors and battery.
    Firmware,
    /// Exactly as commanded, as in the paper's simulation.
    Ideal,
}

/// Frequency f and direction theta of the shaking, as the ideal drive takes them: faster than the firmware allows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shaking {
    frequency_hz: f64,
    direction_deg: f64,
}

/// f or theta is no number or out of the range that is simulated.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "{frequency_hz} Hz at {direction_deg} degrees: the simulation shakes at -{fastest} to {fastest} Hz and -90 to 90 degrees",
    fastest = Shaking::FASTEST_HZ
)]
pub struct ShakingError {
    frequency_hz: f64,
    direction_deg: f64,
}

impl Shaking {
    /// Fastest shaking that is simulated, Hz: above the 100 Hz of the paper's discussion (section V-B), with some eighty
    /// steps of [`DEFAULT_STEP`] a turn.
    pub const FASTEST_HZ: f64 = 120.0;

    /// Checks f in Hz (-120 to 120) and theta in degrees (-90 to 90, positive to the right).
    ///
    /// # Errors
    /// When one is no number or out of its range.
    pub fn new(frequency_hz: f64, direction_deg: f64) -> Result<Self, ShakingError> {
        if frequency_hz.abs() <= Self::FASTEST_HZ && direction_deg.abs() <= 90.0 {
            Ok(Self { frequency_hz, direction_deg })
        } else {
            Err(ShakingError { frequency_hz, direction_deg })
        }
    }

    /// Returns the ideal drive.
    #[must_use]
    pub const fn drive(&self) -> Drive {
        Drive::Ideal { frequency_hz: self.frequency_hz, theta_rad: self.direction_deg.to_radians() }
    }

    /// Returns what is commanded of a robot.
    ///
    /// # Errors
    /// When f is above the firmware's 35 Hz.
    pub fn setpoint(&self) -> Result<Setpoint, OutOfRange> {
        setpoint(self.frequency_hz, self.direction_deg)
    }
}

impl From<Setpoint> for Shaking {
    fn from(setpoint: Setpoint) -> Self {
        Self {
            frequency_hz: setpoint.frequency().get().into(),
            direction_deg: setpoint.direction().get().into(),
        }
    }
}

/// What to walk.
#[derive(Debug, Clone, Copy)]
pub struct Walk {
    /// f and theta; the firmware takes up to 35 Hz.
    pub shaking: Shaking,
    /// Time that is measured, s.
    pub seconds: f64,
    /// What turns the rotors.
    pub drive: WalkDrive,
    /// Step, s; under the firmware at most its tick.
    pub step: f64,
    /// Heading at the start, rad, left positive; none: each seed starts at its own.
    pub heading: Option<f64>,
}

/// How a walk starts.
#[derive(Debug, Clone, Copy)]
pub struct Start {
    /// Of the disturbance.
    pub seed: u64,
    /// Heading, rad, left positive; none: each seed starts at its own.
    pub heading: Option<f64>,
}

impl Start {
    /// Puts a robot there.
    ///
    /// # Errors
    /// When the model is refused or cannot walk.
    pub fn plant(&self, model: &RobotModel) -> Result<Plant, WalkError> {
        require_walker(model)?;
        let mut plant = Plant::new(model)?;
        plant.disturb(self.seed, false);
        plant.displace([0.0; 3], self.heading.unwrap_or_else(|| own_heading(self.seed)));
        Ok(plant)
    }
}

/// Result of one walk.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Walked {
    /// Mean speed along the body's own forward axis, m/s.
    pub forward_m_s: f64,
    /// Mean speed along the body's own leftward axis, m/s.
    pub lateral_m_s: f64,
    /// Mean yaw rate, rad/s, left positive.
    pub yaw_rad_s: f64,
    /// Energy spent while measured, J: from the battery, or by ideal motors on the rotors.
    pub energy_j: f64,
    /// Horizontal path of the body, smoothed over the shaking, m.
    pub path_m: f64,
    /// Energy over weight times path.
    pub cost_of_transport: f64,
    /// At its end the body stood upright, within 60 degrees.
    pub upright: bool,
}

impl Walked {
    /// Returns the mean motion.
    #[must_use]
    pub const fn motion(&self) -> Twist {
        Twist { forward: self.forward_m_s, lateral: self.lateral_m_s, yaw: self.yaw_rad_s }
    }
}

/// A speed over several walks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation between the walks; one walk has none.
    pub spread: Option<f64>,
}

impl Spread {
    /// Returns mean and sample standard deviation of at least one value.
    #[must_use]
    pub fn of(values: &[f64]) -> Self {
        let nav::Spread { mean, spread } = nav::Spread::of(values);
        Self { mean, spread: (values.len() > 1).then_some(spread) }
    }
}

impl From<Spread> for nav::Spread {
    /// The speed of a mode; the spread of one walk is assumed.
    fn from(Spread { mean, spread }: Spread) -> Self {
        spread.map_or_else(|| Self::of(&[mean]), |spread| Self { mean, spread })
    }
}

/// Why there was no walk.
#[derive(Debug, thiserror::Error)]
pub enum WalkError {
    /// The model is refused.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The plant's state is useless.
    #[error(transparent)]
    Diverged(#[from] Diverged),
    /// The firmware refuses f or theta.
    #[error("{0}; the ideal drive shakes faster")]
    Setpoint(#[from] OutOfRange),
    /// The robot's software did not do as it was commanded.
    #[error(transparent)]
    Operation(#[from] OperationError),
}

/// Refuses a model that cannot walk.
///
/// # Errors
/// When it has no legs or does not stand free.
pub fn require_walker(model: &RobotModel) -> Result<(), WalkError> {
    Ok(model.check_walker()?)
}

/// Walks once. `watch` sees the plant after every step that is measured.
///
/// # Errors
/// See [`WalkError`].
pub fn walk(
    model: &RobotModel,
    walk: &Walk,
    seed: u64,
    watch: impl FnMut(&Plant),
) -> Result<Walked, WalkError> {
    let mut plant = Start { seed, heading: walk.heading }.plant(model)?;
    plant.set_longest_step(walk.step);
    match walk.drive {
        WalkDrive::Ideal => ideally(plant, walk, watch),
        WalkDrive::Firmware => {
            let parameters = RobotParameters::of(&model.electrical, Key::new([0x5a; 32]), seed)?;
            by_firmware(SimulatedRobot::new(parameters, plant), walk, watch)
        }
    }
}

/// Walks once with the ideal drive from a heading of its own, at f (Hz) and theta (degrees) for `seconds`, and returns
/// the mean motion; none when the walk did not come about.
#[must_use]
pub fn ideal_motion(
    model: &RobotModel,
    (f_hz, theta_deg): (f64, f64),
    seconds: f64,
    step: f64,
    seed: u64,
) -> Option<Twist> {
    let shaking = Shaking::new(f_hz, theta_deg).ok()?;
    let what = Walk { shaking, seconds, drive: WalkDrive::Ideal, step, heading: None };
    Some(walk(model, &what, seed, |_| {}).ok()?.motion())
}

/// Returns the heading at which a walk of this seed starts, rad: anywhere in -pi to pi, so that nothing is scored at
/// one heading alone.
fn own_heading(seed: u64) -> f64 {
    PI * (2.0 * Xoshiro256PlusPlus::seed_from_u64(seed).random::<f64>() - 1.0)
}

fn ideally(
    mut plant: Plant,
    walk: &Walk,
    mut watch: impl FnMut(&Plant),
) -> Result<Walked, WalkError> {
    plant.set_drive(walk.shaking.drive());
    let mut odometer = Odometer::start(&plant);
    let work = plant.energy().motor_work;
    for _ in 0..(walk.seconds / walk.step).round() as usize {
        plant.step([0.0; 2], walk.step)?;
        odometer.add(&plant.body(), walk.step);
        watch(&plant);
    }
    Ok(odometer.finish(&plant.body(), plant.energy().motor_work - work))
}

fn by_firmware(
    robot: SimulatedRobot,
    walk: &Walk,
    mut watch: impl FnMut(&Plant),
) -> Result<Walked, WalkError> {
    let setpoint = walk.shaking.setpoint()?;
    let mut operation = Operation::new(robot, ChannelParameters::QUIET_WIFI);
    operation.arm()?;
    operation.want(setpoint);
    operation.run(RUN_UP, |_| {})?;
    let mut odometer = Odometer::start(operation.robot.mechanics());
    let spent = operation.robot.electronics().battery().delivered();
    let end = operation.now() + Duration::from_secs_f64(walk.seconds);
    while operation.now() < end {
        operation.tick()?;
        odometer.add(&operation.robot.mechanics().body(), crate::plant::electronics::TICK);
        watch(operation.robot.mechanics());
    }
    let report = operation.robot.report();
    if !report.faults.is_empty() {
        let faulted = LinkError::Faulted { first: report.first_fault, all: report.faults };
        return Err(OperationError::Link(faulted).into());
    }
    let spent = operation.robot.electronics().battery().delivered() - spent;
    Ok(odometer.finish(&operation.robot.mechanics().body(), spent))
}

/// Sums up motion in the body's own axes.
#[derive(Debug, Clone)]
pub(super) struct Odometer {
    weight: f64,
    position: [f64; 2],
    yaw: f64,
    seconds: f64,
    forward: f64,
    left: f64,
    turned: f64,
    /// Where the smoothed path was sampled last, and when.
    mark: ([f64; 2], f64),
    path: f64,
}

/// Interval of the smoothed path, s: long against the shaking, short against any turn.
const PATH_INTERVAL: f64 = 0.25;

impl Odometer {
    pub(super) fn start(plant: &Plant) -> Self {
        let (mass, ..) = plant.mass_properties();
        let body = plant.body();
        let position = [body.position[0], body.position[1]];
        Self {
            weight: mass * GRAVITY,
            position,
            yaw: body.yaw(),
            seconds: 0.0,
            forward: 0.0,
            left: 0.0,
            turned: 0.0,
            mark: (position, 0.0),
            path: 0.0,
        }
    }

    pub(super) fn add(&mut self, body: &BodyState, interval: f64) {
        let turn = wrap(body.yaw() - self.yaw);
        let (sin, cos) = (self.yaw + 0.5 * turn).sin_cos();
        let [dx, dy] = [body.position[0] - self.position[0], body.position[1] - self.position[1]];
        self.forward += cos * dx + sin * dy;
        self.left += cos * dy - sin * dx;
        self.turned += turn;
        self.seconds += interval;
        self.position = [body.position[0], body.position[1]];
        self.yaw = body.yaw();
        if self.seconds - self.mark.1 >= PATH_INTERVAL {
            self.close_path();
        }
    }

    fn close_path(&mut self) {
        let [dx, dy] = [self.position[0] - self.mark.0[0], self.position[1] - self.mark.0[1]];
        self.path += dx.hypot(dy);
        self.mark = (self.position, self.seconds);
    }

    pub(super) fn finish(mut self, body: &BodyState, energy: f64) -> Walked {
        self.close_path();
        Walked {
            forward_m_s: self.forward / self.seconds,
            lateral_m_s: self.left / self.seconds,
            yaw_rad_s: self.turned / self.seconds,
            energy_j: energy,
            path_m: self.path,
            cost_of_transport: energy / (self.weight * self.path),
            upright: body.is_upright(),
        }
    }
}
