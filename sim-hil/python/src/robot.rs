//! One robot with its own software, commanded over its link.

use std::sync::{Mutex, MutexGuard};
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
use crate::{locked, refused};

/// Slice of virtual time between two looks at who wants to interrupt.
const SLICE: Duration = Duration::from_millis(100);

/// Creates a robot that has just been powered up, and an operator who connects to it.
#[pyclass(frozen, module = "flixwalker")]
pub struct Robot {
    // In a box, since its vectors are aligned more strictly than Python aligns its objects; any thread may ask.
    operation: Mutex<Box<Operation<Plant>>>,
}

/// Tells Python what the robot did not do, in its own words.
fn failed(error: impl std::fmt::Display) -> PyErr {
    PyRuntimeError::new_err(error.to_string())
}

impl Robot {
    /// Waits, without the interpreter, until no other thread uses the robot.
    fn lock(&self, py: Python<'_>) -> MutexGuard<'_, Box<Operation<Plant>>> {
        locked(&self.operation, py)
    }
}

fn ask(operation: &mut Operation<Plant>, command: Command) -> PyResult<Outcome> {
    match operation.ask(command).map_err(failed)? {
        Outcome::Refused(refusal) => Err(failed(refusal)),
        outcome => Ok(outcome),
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
        Ok(Self { operation: Mutex::new(Box::new(Operation::new(robot, network))) })
    }

    fn arm(&self, py: Python<'_>) -> PyResult<()> {
        self.lock(py).arm().map_err(failed)
    }

    fn disarm(&self, py: Python<'_>) -> PyResult<()> {
        ask(&mut self.lock(py), Command::Disarm).map(drop)
    }

    fn drive(&self, py: Python<'_>, f_hz: f64, theta_deg: f64) -> PyResult<()> {
        let setpoint: Setpoint = setpoint(f_hz, theta_deg).map_err(refused)?;
        self.lock(py).hold(setpoint);
        Ok(())
    }

    fn run(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        if !(0.0..=1e5).contains(&seconds) {
            return Err(PyValueError::new_err(format!(
                "seconds is {seconds}: choose 0 to 100000 s"
            )));
        }
        let end = self.lock(py).now() + Duration::from_secs_f64(seconds);
        loop {
            let operation = &mut **self.lock(py);
            let left = end.since(operation.now()).min(SLICE);
            if left.is_zero() {
                return Ok(());
            }
            py.detach(|| operation.run(left, |_| {})).map_err(failed)?;
            py.check_signals()?;
        }
    }

    #[pyo3(signature = (name, value = None))]
    fn setting(&self, py: Python<'_>, name: &str, value: Option<f32>) -> PyResult<f64> {
        let known = name
            .try_into()
            .map_err(|_| PyValueError::new_err(format!("no setting is called {name:?}")))?;
        let command = match value {
            Some(value) => ParameterCommand::Set(known, value),
            None => ParameterCommand::Get(known),
        };
        let operation = &mut **self.lock(py);
        let now = operation.now();
        if !operation.client().is_connected(now) {
            operation.connect().map_err(failed)?;
        }
        match ask(operation, Command::Parameter(command))? {
            Outcome::Parameter(parameter) => Ok(f64::from(parameter.value)),
            _ => Err(failed("the robot answered something else than was asked")),
        }
    }

    #[getter]
    fn time(&self, py: Python<'_>) -> f64 {
        self.lock(py).now().as_micros() as f64 * 1e-6
    }

    #[getter]
    fn state(&self, py: Python<'_>) -> String {
        self.lock(py).robot.report().state.to_string()
    }

    #[getter]
    fn faults(&self, py: Python<'_>) -> String {
        self.lock(py).robot.report().faults.to_string()
    }

    #[getter]
    fn position(&self, py: Python<'_>) -> [f64; 3] {
        self.lock(py).robot.mechanics().body().position
    }

    #[getter]
    fn yaw(&self, py: Python<'_>) -> f64 {
        self.lock(py).robot.mechanics().body().yaw()
    }

    #[getter]
    fn f_hz(&self, py: Python<'_>) -> f64 {
        self.lock(py).robot.truth().frequency()
    }

    #[getter]
    fn theta_deg(&self, py: Python<'_>) -> f64 {
        let theta = self.lock(py).robot.truth().direction.to_degrees();
        // A line of force is the same half a turn further.
        (theta + 90.0).rem_euclid(180.0) - 90.0
    }

    #[getter]
    fn energy(&self, py: Python<'_>) -> f64 {
        self.lock(py).robot.electronics().battery().delivered()
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!("Robot {} at {:.3} s", self.state(py), self.time(py))
    }
}
