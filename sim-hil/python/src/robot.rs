//! One robot with its own software, commanded over its link.

use std::time::Duration;

use flix_protocol::message::{Command, Outcome, ParameterCommand, Setpoint};
use flix_sim::experiment::walk::Start;
use flix_sim::plant::Plant;
use flix_sim::rig::bench::{bench_key, setpoint};
use flix_sim::rig::channel::ChannelParameters;
use flix_sim::rig::operation::Operation;
use flix_sim::rig::robot::{RobotParameters, SimulatedRobot};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use crate::model::Model;
use crate::refused;

/// Slice of virtual time between two looks at who wants to interrupt.
const SLICE: Duration = Duration::from_millis(100);

/// Creates a robot that has just been powered up, and an operator who connects to it.
#[pyclass(module = "flixwalker", unsendable)]
pub struct Robot {
    // Its vectors are aligned more strictly than Python aligns its objects.
    operation: Box<Operation<Plant>>,
}

/// Tells Python what the robot did not do, in its own words.
fn failed(error: impl std::fmt::Display) -> PyErr {
    PyRuntimeError::new_err(error.to_string())
}

impl Robot {
    fn ask(&mut self, command: Command) -> PyResult<Outcome> {
        match self.operation.ask(command).map_err(failed)? {
            Outcome::Refused(refusal) => Err(failed(refusal)),
            outcome => Ok(outcome),
        }
    }
}

#[pymethods]
impl Robot {
    #[new]
    #[pyo3(signature = (model, seed = 0, heading = 0.0, latency = 0.005, loss = 0.0))]
    fn new(model: &Model, seed: u64, heading: f64, latency: f64, loss: f64) -> PyResult<Self> {
        if !(0.0..=10.0).contains(&latency) || !(0.0..=0.9).contains(&loss) || !heading.is_finite()
        {
            return Err(PyValueError::new_err(format!(
                "heading {heading} rad, latency {latency} s, loss {loss}: choose a number, 0 to 10 s and 0 to 0.9"
            )));
        }
        let plant = Start { seed, heading: Some(heading) }.plant(&model.0).map_err(refused)?;
        let parameters =
            RobotParameters::of(&model.0.electrical, bench_key(), seed).map_err(refused)?;
        let network = ChannelParameters {
            delay: Duration::from_secs_f64(latency),
            loss,
            ..ChannelParameters::PERFECT
        };
        let robot = SimulatedRobot::new(parameters, plant);
        Ok(Self { operation: Box::new(Operation::new(robot, network)) })
    }

    fn arm(&mut self) -> PyResult<()> {
        self.operation.arm().map_err(failed)
    }

    fn disarm(&mut self) -> PyResult<()> {
        self.ask(Command::Disarm).map(drop)
    }

    fn drive(&mut self, f_hz: f64, theta_deg: f64) -> PyResult<()> {
        let setpoint: Setpoint = setpoint(f_hz, theta_deg).map_err(refused)?;
        self.operation.hold(setpoint);
        Ok(())
    }

    fn run(&mut self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        if !(0.0..=1e5).contains(&seconds) {
            return Err(PyValueError::new_err(format!(
                "seconds is {seconds}: choose 0 to 100000 s"
            )));
        }
        let end = self.operation.now() + Duration::from_secs_f64(seconds);
        while self.operation.now() < end {
            let left = end.since(self.operation.now()).min(SLICE);
            self.operation.run(left, |_| {}).map_err(failed)?;
            py.check_signals()?;
        }
        Ok(())
    }

    #[pyo3(signature = (name, value = None))]
    fn setting(&mut self, name: &str, value: Option<f32>) -> PyResult<f64> {
        let known = name
            .try_into()
            .map_err(|_| PyValueError::new_err(format!("no setting is called {name:?}")))?;
        let command = match value {
            Some(value) => ParameterCommand::Set(known, value),
            None => ParameterCommand::Get(known),
        };
        let now = self.operation.now();
        if !self.operation.client().is_connected(now) {
            self.operation.connect().map_err(failed)?;
        }
        match self.ask(Command::Parameter(command))? {
            Outcome::Parameter(parameter) => Ok(f64::from(parameter.value)),
            _ => Err(failed("the robot answered something else than was asked")),
        }
    }

    #[getter]
    fn time(&self) -> f64 {
        self.operation.now().as_micros() as f64 * 1e-6
    }

    #[getter]
    fn state(&self) -> String {
        self.operation.robot.report().state.to_string()
    }

    #[getter]
    fn faults(&self) -> String {
        self.operation.robot.report().faults.to_string()
    }

    #[getter]
    fn position(&self) -> [f64; 3] {
        self.operation.robot.mechanics().body().position
    }

    #[getter]
    fn yaw(&self) -> f64 {
        self.operation.robot.mechanics().body().yaw()
    }

    #[getter]
    fn f_hz(&self) -> f64 {
        self.operation.robot.truth().frequency()
    }

    #[getter]
    fn theta_deg(&self) -> f64 {
        let theta = self.operation.robot.truth().direction.to_degrees();
        // A line of force is the same half a turn further.
        (theta + 90.0).rem_euclid(180.0) - 90.0
    }

    #[getter]
    fn energy(&self) -> f64 {
        self.operation.robot.electronics().battery().delivered()
    }

    fn __repr__(&self) -> String {
        format!("Robot {} at {:.3} s", self.state(), self.time())
    }
}
