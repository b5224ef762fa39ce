//! One robot with its own software, commanded over its link.

use std::time::Duration;

use flix_host::link::RobotLink;
use flix_protocol::units::Instant;
use flix_sim::experiment::walk::Start;
use flix_sim::model::RobotModel;
use flix_sim::rig::bench::{bench_key, setpoint};
use flix_sim::rig::lossy_network::ChannelParameters;
use flix_sim::rig::operation::{Operation, OperationError};
use flix_sim::rig::simulated::{RobotParameters, SimulatedRobot};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde::{Deserialize, Serialize};

use crate::batch::{LARGEST_HEADING, whole_steps};
use crate::model::Model;
use crate::{Shared, number, optional_number, refused, seed_of};

/// Slice of virtual time between two looks at who wants to interrupt.
const SLICE: Duration = Duration::from_millis(100);
/// Of the robot's software: time passes by whole ones.
const TICK: Duration = Duration::from_micros(100);

/// What was asked of a robot.
#[derive(Clone, Debug, Serialize, Deserialize)]
enum Call {
    Arm,
    Disarm,
    /// f in Hz and theta in degrees.
    Drive(f64, f64),
    /// Microseconds.
    Run(u64),
    Setting(String, Option<f32>),
}

/// How a robot was made, and all that was asked of it: what it takes to make it again.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct State {
    release: String,
    model: RobotModel,
    seed: u64,
    heading: f64,
    latency: f64,
    loss: f64,
    calls: Vec<Call>,
}

struct Session {
    // In a box, since its vectors are aligned more strictly than Python aligns its objects.
    operation: Box<Operation>,
    state: State,
}

/// Creates a robot that has just been powered up, and an operator who connects to it.
#[pyclass(frozen, module = "flixwalker")]
pub struct Robot {
    // Any thread may ask.
    session: Shared<Session>,
}

/// Tells Python what the robot did not do, in its own words.
fn failed(error: impl std::fmt::Display) -> PyErr {
    PyRuntimeError::new_err(error.to_string())
}

fn setting(
    operation: &mut Operation,
    name: &str,
    value: Option<f32>,
) -> Result<f64, OperationError> {
    let now = operation.now();
    if !operation.client().is_connected(now) {
        operation.wait_until_connected()?;
    }
    let setting = match value {
        Some(value) => operation.set(name, value)?,
        None => operation.parameter(name)?,
    };
    Ok(setting.value.into())
}

impl Session {
    /// Powers a robot up, of which nothing has been asked.
    fn new(state: State) -> PyResult<Self> {
        let State { model, seed, heading, latency, loss, .. } = &state;
        if !(0.0..=10.0).contains(latency)
            || !(0.0..=0.9).contains(loss)
            || heading.is_nan()
            || heading.abs() > LARGEST_HEADING
        {
            return Err(PyValueError::new_err(format!(
                "heading {heading} rad, latency {latency} s, loss {loss}: choose -{LARGEST_HEADING} to {LARGEST_HEADING} rad, 0 to 10 s and 0 to 0.9"
            )));
        }
        let plant = Start { seed: *seed, heading: Some(*heading) }.plant(model).map_err(refused)?;
        let parameters =
            RobotParameters::of(&model.electrical, bench_key(), *seed).map_err(refused)?;
        let network = ChannelParameters {
            delay: Duration::from_secs_f64(*latency),
            loss: *loss,
            ..ChannelParameters::PERFECT
        };
        let robot = SimulatedRobot::new(parameters, plant);
        let operation = Box::new(Operation::new(robot, network));
        Ok(Self { operation, state: State { calls: Vec::new(), ..state } })
    }

    /// Makes a robot again. What it refused it refuses again.
    fn again(py: Python<'_>, bytes: &[u8]) -> PyResult<Self> {
        let state: State = serde_json::from_slice(bytes).map_err(|_| {
            PyValueError::new_err(
                "this is no state of a robot: keep what get_state returns as it is",
            )
        })?;
        let here = env!("CARGO_PKG_VERSION");
        if state.release != here {
            return Err(PyValueError::new_err(format!(
                "this state is of release {}, and this is {here}: run the robot again",
                state.release
            )));
        }
        let calls = state.calls.clone();
        let mut session = Self::new(state)?;
        for call in calls {
            let Call::Run(microseconds) = call else {
                let _ = session.ask(py, call);
                continue;
            };
            let end = session.operation.now() + Duration::from_micros(microseconds);
            while !session.left(end).is_zero() && session.run(py, session.left(end)).is_ok() {
                py.check_signals()?;
            }
        }
        Ok(session)
    }

    /// Returns how much of the time until then passes at once.
    fn left(&self, end: Instant) -> Duration {
        end.since(self.operation.now()).min(SLICE)
    }

    /// Asks for anything but time to pass, without the interpreter, and keeps that it was asked.
    fn ask(&mut self, py: Python<'_>, call: Call) -> PyResult<Option<f64>> {
        let operation = &mut *self.operation;
        self.state.calls.push(call.clone());
        py.detach(|| match call {
            Call::Arm => operation.arm().map_err(failed).map(|()| None),
            Call::Disarm => operation.disarm().map_err(failed).map(|()| None),
            Call::Drive(f_hz, theta_deg) => {
                operation.want(setpoint(f_hz, theta_deg).map_err(refused)?);
                Ok(None)
            }
            Call::Setting(name, value) => {
                setting(operation, &name, value).map_err(failed).map(Some)
            }
            Call::Run(_) => Ok(None),
        })
    }

    /// Lets time pass, without the interpreter, and keeps how much it was.
    fn run(&mut self, py: Python<'_>, duration: Duration) -> PyResult<()> {
        let before = self.operation.now();
        let operation = &mut *self.operation;
        let ran = py.detach(|| operation.run(duration, |_| {}));
        // A tick that failed fails again.
        let tried = u64::from(ran.is_err());
        let more = self.operation.now().since(before).as_micros() as u64 + tried;
        match self.state.calls.last_mut() {
            Some(Call::Run(microseconds)) => *microseconds += more,
            _ => self.state.calls.push(Call::Run(more)),
        }
        ran.map_err(failed)
    }
}

#[pymethods]
impl Robot {
    #[new]
    #[pyo3(signature = (model, seed = 0, heading = 0.0, latency = 0.005, loss = 0.0))]
    fn new(
        model: &Model,
        #[pyo3(from_py_with = seed_of)] seed: u64,
        #[pyo3(from_py_with = number)] heading: f64,
        #[pyo3(from_py_with = number)] latency: f64,
        #[pyo3(from_py_with = number)] loss: f64,
    ) -> PyResult<Self> {
        let session = Session::new(State {
            release: env!("CARGO_PKG_VERSION").to_owned(),
            model: model.0.clone(),
            seed,
            heading,
            latency,
            loss,
            calls: Vec::new(),
        })?;
        Ok(Self { session: Shared::new(session) })
    }

    #[staticmethod]
    fn from_state(py: Python<'_>, state: &[u8]) -> PyResult<Self> {
        Ok(Self { session: Shared::new(Session::again(py, state)?) })
    }

    fn get_state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let state = serde_json::to_vec(&self.session.lock(py)?.state).map_err(refused)?;
        Ok(PyBytes::new(py, &state))
    }

    fn set_state(&self, py: Python<'_>, state: &[u8]) -> PyResult<()> {
        let session = Session::again(py, state)?;
        *self.session.lock(py)? = session;
        Ok(())
    }

    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        Ok((py.get_type::<Self>().getattr("from_state")?, (self.get_state(py)?,)))
    }

    fn arm(&self, py: Python<'_>) -> PyResult<()> {
        self.session.lock(py)?.ask(py, Call::Arm).map(drop)
    }

    fn disarm(&self, py: Python<'_>) -> PyResult<()> {
        self.session.lock(py)?.ask(py, Call::Disarm).map(drop)
    }

    fn drive(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = number)] f_hz: f64,
        #[pyo3(from_py_with = number)] theta_deg: f64,
    ) -> PyResult<()> {
        // What cannot be is not kept.
        setpoint(f_hz, theta_deg).map_err(refused)?;
        self.session.lock(py)?.ask(py, Call::Drive(f_hz, theta_deg)).map(drop)
    }

    fn run(&self, py: Python<'_>, #[pyo3(from_py_with = number)] seconds: f64) -> PyResult<()> {
        if !(0.0..=1e5).contains(&seconds) {
            return Err(PyValueError::new_err(format!(
                "seconds is {seconds}: choose 0 to 100000 s"
            )));
        }
        let mut left = whole_steps(seconds, TICK.as_secs_f64())? as u32 * TICK;
        while !left.is_zero() {
            let slice = left.min(SLICE);
            self.session.lock(py)?.run(py, slice)?;
            left -= slice;
            py.check_signals()?;
        }
        Ok(())
    }

    #[pyo3(signature = (name, value = None))]
    fn setting(
        &self,
        py: Python<'_>,
        name: &str,
        #[pyo3(from_py_with = optional_number)] value: Option<f32>,
    ) -> PyResult<Option<f64>> {
        self.session.lock(py)?.ask(py, Call::Setting(name.to_owned(), value))
    }

    #[getter]
    fn time(&self, py: Python<'_>) -> PyResult<f64> {
        Ok(self.session.lock(py)?.operation.now().as_micros() as f64 * 1e-6)
    }

    #[getter(state)]
    fn state_of_software(&self, py: Python<'_>) -> PyResult<String> {
        Ok(self.session.lock(py)?.operation.robot.report().state.to_string())
    }

    #[getter]
    fn faults(&self, py: Python<'_>) -> PyResult<String> {
        Ok(self.session.lock(py)?.operation.robot.report().faults.to_string())
    }

    #[getter]
    fn position(&self, py: Python<'_>) -> PyResult<[f64; 3]> {
        Ok(self.session.lock(py)?.operation.robot.mechanics().body().position)
    }

    #[getter]
    fn yaw(&self, py: Python<'_>) -> PyResult<f64> {
        Ok(self.session.lock(py)?.operation.robot.mechanics().body().yaw())
    }

    #[getter]
    fn f_hz(&self, py: Python<'_>) -> PyResult<f64> {
        Ok(self.session.lock(py)?.operation.robot.truth().frequency())
    }

    #[getter]
    fn theta_deg(&self, py: Python<'_>) -> PyResult<f64> {
        let theta = self.session.lock(py)?.operation.robot.truth().direction.to_degrees();
        // A line of force is the same half a turn further.
        Ok((theta + 90.0).rem_euclid(180.0) - 90.0)
    }

    #[getter]
    fn energy(&self, py: Python<'_>) -> PyResult<f64> {
        Ok(self.session.lock(py)?.operation.robot.electronics().battery().delivered())
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("Robot {} at {:.3} s", self.state_of_software(py)?, self.time(py)?))
    }
}
