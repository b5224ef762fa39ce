//! One robot with its own software, commanded over its link.

use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

use flix_host::link::RobotLink;
use flix_protocol::message::Command;
use flix_protocol::units::Instant;
use flix_sim::experiment::walk::Start;
use flix_sim::model::RobotModel;
use flix_sim::plant::Plant;
use flix_sim::rig::bench::{bench_key, setpoint};
use flix_sim::rig::lossy_network::ChannelParameters;
use flix_sim::rig::operation::{Operation, OperationError};
use flix_sim::rig::simulated::{RobotParameters, SimulatedRobot};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde::{Deserialize, Serialize};

use crate::model::Model;
use crate::{locked, refused};

/// Slice of virtual time between two looks at who wants to interrupt.
const SLICE: Duration = Duration::from_millis(100);

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
    operation: Box<Operation<Plant>>,
    state: State,
}

/// Creates a robot that has just been powered up, and an operator who connects to it.
#[pyclass(frozen, module = "flixwalker")]
pub struct Robot {
    // Any thread may ask.
    session: Mutex<Session>,
}

/// Tells Python what the robot did not do, in its own words.
fn failed(error: impl std::fmt::Display) -> PyErr {
    PyRuntimeError::new_err(error.to_string())
}

fn setting(
    operation: &mut Operation<Plant>,
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
        if !(0.0..=10.0).contains(latency) || !(0.0..=0.9).contains(loss) || !heading.is_finite() {
            return Err(PyValueError::new_err(format!(
                "heading {heading} rad, latency {latency} s, loss {loss}: choose a number, 0 to 10 s and 0 to 0.9"
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
            Call::Disarm => operation.ask(Command::Disarm).map_err(failed).map(|_| None),
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

impl Robot {
    /// Waits, without the interpreter, until no other thread uses the robot.
    fn lock(&self, py: Python<'_>) -> MutexGuard<'_, Session> {
        locked(&self.session, py)
    }
}

#[pymethods]
impl Robot {
    #[new]
    #[pyo3(signature = (model, seed = 0, heading = 0.0, latency = 0.005, loss = 0.0))]
    fn new(model: &Model, seed: u64, heading: f64, latency: f64, loss: f64) -> PyResult<Self> {
        let session = Session::new(State {
            release: env!("CARGO_PKG_VERSION").to_owned(),
            model: model.0.clone(),
            seed,
            heading,
            latency,
            loss,
            calls: Vec::new(),
        })?;
        Ok(Self { session: Mutex::new(session) })
    }

    #[staticmethod]
    fn from_state(py: Python<'_>, state: &[u8]) -> PyResult<Self> {
        Ok(Self { session: Mutex::new(Session::again(py, state)?) })
    }

    fn get_state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let state = serde_json::to_vec(&self.lock(py).state).map_err(refused)?;
        Ok(PyBytes::new(py, &state))
    }

    fn set_state(&self, py: Python<'_>, state: &[u8]) -> PyResult<()> {
        let session = Session::again(py, state)?;
        *self.lock(py) = session;
        Ok(())
    }

    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        Ok((py.get_type::<Self>().getattr("from_state")?, (self.get_state(py)?,)))
    }

    fn arm(&self, py: Python<'_>) -> PyResult<()> {
        self.lock(py).ask(py, Call::Arm).map(drop)
    }

    fn disarm(&self, py: Python<'_>) -> PyResult<()> {
        self.lock(py).ask(py, Call::Disarm).map(drop)
    }

    fn drive(&self, py: Python<'_>, f_hz: f64, theta_deg: f64) -> PyResult<()> {
        // What cannot be is not kept.
        setpoint(f_hz, theta_deg).map_err(refused)?;
        self.lock(py).ask(py, Call::Drive(f_hz, theta_deg)).map(drop)
    }

    fn run(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        if !(0.0..=1e5).contains(&seconds) {
            return Err(PyValueError::new_err(format!(
                "seconds is {seconds}: choose 0 to 100000 s"
            )));
        }
        let end = self.lock(py).operation.now() + Duration::from_secs_f64(seconds);
        loop {
            let mut session = self.lock(py);
            let left = session.left(end);
            if left.is_zero() {
                return Ok(());
            }
            session.run(py, left)?;
            drop(session);
            py.check_signals()?;
        }
    }

    #[pyo3(signature = (name, value = None))]
    fn setting(&self, py: Python<'_>, name: &str, value: Option<f32>) -> PyResult<Option<f64>> {
        self.lock(py).ask(py, Call::Setting(name.to_owned(), value))
    }

    #[getter]
    fn time(&self, py: Python<'_>) -> f64 {
        self.lock(py).operation.now().as_micros() as f64 * 1e-6
    }

    #[getter(state)]
    fn state_of_software(&self, py: Python<'_>) -> String {
        self.lock(py).operation.robot.report().state.to_string()
    }

    #[getter]
    fn faults(&self, py: Python<'_>) -> String {
        self.lock(py).operation.robot.report().faults.to_string()
    }

    #[getter]
    fn position(&self, py: Python<'_>) -> [f64; 3] {
        self.lock(py).operation.robot.mechanics().body().position
    }

    #[getter]
    fn yaw(&self, py: Python<'_>) -> f64 {
        self.lock(py).operation.robot.mechanics().body().yaw()
    }

    #[getter]
    fn f_hz(&self, py: Python<'_>) -> f64 {
        self.lock(py).operation.robot.truth().frequency()
    }

    #[getter]
    fn theta_deg(&self, py: Python<'_>) -> f64 {
        let theta = self.lock(py).operation.robot.truth().direction.to_degrees();
        // A line of force is the same half a turn further.
        (theta + 90.0).rem_euclid(180.0) - 90.0
    }

    #[getter]
    fn energy(&self, py: Python<'_>) -> f64 {
        self.lock(py).operation.robot.electronics().battery().delivered()
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!("Robot {} at {:.3} s", self.state_of_software(py), self.time(py))
    }
}
