//! A controller of one's own against the simulated robot: it turns towards a point, then walks to it.
//!
//! The controller is a [`Helm`]: it sees the poses of the cameras and decides what to command. Link, robot software
//! and plant are those of `flix-sim track`; with a real robot, `flix` runs the same helm.
//!
//! `cargo run --release -p flix-sim --example own-controller`

use std::error::Error;
use std::time::Duration;

use flix_host::nav::{Decision, PlanarPose, Position, Resting, wrap};
use flix_host::pilot::{Ending, Helm, Pilot};
use flix_host::pose::PoseSample;
use flix_protocol::message::Setpoint;
use flix_protocol::units::Instant;
use flix_sim::experiment::course::{Conditions, Course};
use flix_sim::model::RobotModel;
use flix_sim::rig::bench::setpoint;

/// Where the robot shall go, m.
const GOAL: Position = Position::new(0.3, 0.2);
/// Nearer than this it has arrived, m.
const ARRIVED: f64 = 0.05;
/// It walks while the goal lies within this angle of straight ahead, and turns otherwise, rad.
const AHEAD: f64 = 0.5;
/// Virtual time after which it gives up.
const PATIENCE: Duration = Duration::from_secs(60);
/// f in Hz and theta in degrees of each walking mode (paper, table IV).
const MODES: [(&str, f64, f64); 3] =
    [("forward", -30.0, 30.0), ("left", -30.0, 90.0), ("right", 30.0, 90.0)];

struct TurnThenWalk {
    setpoints: [Setpoint; 3],
    pose: Option<PlanarPose>,
}

impl Helm for TurnThenWalk {
    fn observe(&mut self, sample: &PoseSample) {
        if sample.valid {
            self.pose = Some(sample.pose.on_the_floor());
        }
    }

    fn decide(&mut self, _now: Instant) -> Decision {
        let Some(pose) = self.pose else { return Decision::Rest(Resting::NoPoseYet) };
        if pose.distance_to(GOAL) < ARRIVED {
            return Decision::Finished;
        }
        let bearing = wrap(pose.position().bearing_to(GOAL) - pose.heading);
        let mode = match bearing {
            _ if bearing.abs() < AHEAD => 0,
            _ if bearing > 0.0 => 1,
            _ => 2,
        };
        Decision::Drive { mode, setpoint: self.setpoints[mode] }
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut setpoints = [Setpoint::REST; 3];
    for (place, (_, f, theta)) in setpoints.iter_mut().zip(MODES) {
        *place = setpoint(f, theta)?;
    }
    let names = MODES.map(|(name, ..)| name.to_owned()).to_vec();
    let pilot = Pilot::new(TurnThenWalk { setpoints, pose: None }, names, None);
    let conditions = Conditions {
        model: RobotModel::named("W")?,
        seed: 1,
        latency: Duration::from_millis(20),
        loss: 0.05,
        start: PlanarPose::default(),
    };
    let mut course = Course::new(&conditions, pilot)?;
    loop {
        let ending = course.step()?;
        let seconds = course.now().as_micros() as f64 * 1e-6;
        if let Some(ending) = ending {
            let left = 1e3 * course.truth().distance_to(GOAL);
            println!("{ending} after {seconds:.1} s, {left:.0} mm from the goal");
            return Ok(());
        }
        if seconds > PATIENCE.as_secs_f64() {
            course.end(Ending::OutOfTime(PATIENCE));
        }
    }
}
