//! Thousands of robots, read and commanded as arrays.

use std::time::{Duration, Instant};

use flix_sim::batch::{Batch as Engine, Precision};
use flix_sim::experiment::walk::Start;
use flix_sim::plant::Plant;
use numpy::ndarray::Dimension;
use numpy::{
    PyArray, PyArray1, PyArray2, PyArrayMethods as _, PyReadonlyArray1, PyReadonlyArray2,
    PyReadwriteArray, PyUntypedArrayMethods as _,
};
use pyo3::exceptions::{PyIndexError, PyUserWarning, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::model::Model;
use crate::{Pool, Shared, interruptible, number, refused};

/// Creates robots that stand still at the origin, shaken at 0 Hz.
#[pyclass(frozen, subclass, module = "flixwalker")]
pub struct Batch {
    // Any thread may ask while another runs the robots.
    engine: Shared<Engine>,
    pool: Shared<Pool>,
    #[pyo3(get)]
    position: Py<PyArray2<f64>>,
    #[pyo3(get)]
    orientation: Py<PyArray2<f64>>,
    #[pyo3(get)]
    velocity: Py<PyArray2<f64>>,
    #[pyo3(get)]
    angular_velocity: Py<PyArray2<f64>>,
    #[pyo3(get)]
    yaw: Py<PyArray1<f64>>,
    #[pyo3(get)]
    energy: Py<PyArray1<f64>>,
    #[pyo3(get)]
    alive: Py<PyArray1<bool>>,
}

/// A value for each robot, or one for all.
fn each(values: &PyReadonlyArray1<'_, f64>, robots: usize, what: &str) -> PyResult<Vec<f64>> {
    let values: Vec<f64> = values.as_array().iter().copied().collect();
    if let Some(bad) = values.iter().find(|value| !value.is_finite()) {
        return Err(PyValueError::new_err(format!(
            "{what} holds {bad}: every value has to be a number"
        )));
    }
    match values.len() {
        1 => Ok(vec![values[0]; robots]),
        n if n == robots => Ok(values),
        n => Err(PyValueError::new_err(format!(
            "{what} has {n} values: give 1 or {robots}, one a robot"
        ))),
    }
}

/// Opens an array of the batch of this shape for writing.
fn open<'py, T: numpy::Element, D: Dimension>(
    py: Python<'py>,
    array: &Py<PyArray<T, D>>,
    shape: &[usize],
) -> PyResult<PyReadwriteArray<'py, T, D>> {
    let array = array.bind(py);
    if array.shape() != shape {
        return Err(PyValueError::new_err(format!(
            "an array of this batch was given the shape {:?}: give it {shape:?} again, and reshape a copy",
            array.shape()
        )));
    }
    array.try_readwrite().map_err(|_| {
        PyValueError::new_err("an array of this batch has been made read-only: copy it instead")
    })
}

/// The robots asked for, all if none are named.
fn chosen(engine: &Engine, robots: Option<Vec<i64>>) -> PyResult<Vec<usize>> {
    let len = engine.len();
    let Some(robots) = robots else { return Ok((0..len).collect()) };
    robots
        .into_iter()
        .map(|robot| {
            usize::try_from(robot).ok().filter(|robot| *robot < len).ok_or_else(|| {
                PyIndexError::new_err(format!("robot {robot}: this batch has 0 to {}", len - 1))
            })
        })
        .collect()
}

impl Batch {
    /// Writes what the robots do now into the arrays.
    ///
    /// # Errors
    /// If somebody has made one of them read-only, or given it another shape.
    fn show(&self, py: Python<'_>, engine: &Engine) -> PyResult<()> {
        let n = engine.len();
        let (mut position, mut orientation) =
            (open(py, &self.position, &[n, 3])?, open(py, &self.orientation, &[n, 4])?);
        let (mut velocity, mut angular) =
            (open(py, &self.velocity, &[n, 3])?, open(py, &self.angular_velocity, &[n, 3])?);
        let mut yaw = open(py, &self.yaw, &[n])?;
        let mut energy = open(py, &self.energy, &[n])?;
        let mut alive = open(py, &self.alive, &[n])?;
        let (mut position, mut orientation) = (position.as_array_mut(), orientation.as_array_mut());
        let (mut velocity, mut angular) = (velocity.as_array_mut(), angular.as_array_mut());
        let (mut yaw, mut energy, mut alive) =
            (yaw.as_array_mut(), energy.as_array_mut(), alive.as_array_mut());
        for robot in 0..engine.len() {
            let body = engine.body(robot);
            for axis in 0..3 {
                position[[robot, axis]] = body.position[axis];
                velocity[[robot, axis]] = body.velocity[axis];
                angular[[robot, axis]] = body.angular_velocity[axis];
            }
            for part in 0..4 {
                orientation[[robot, part]] = body.orientation[part];
            }
            yaw[robot] = body.yaw();
            energy[robot] = engine.motor_work(robot);
            alive[robot] = engine.diverged(robot).is_none();
        }
        Ok(())
    }
}

#[pymethods]
impl Batch {
    #[new]
    #[pyo3(signature = (models, precision = "single", threads = None, state = None))]
    fn new(
        py: Python<'_>,
        models: Vec<Model>,
        precision: &str,
        threads: Option<usize>,
        state: Option<&[u8]>,
    ) -> PyResult<Self> {
        let precision = match precision {
            "single" => Precision::Single,
            "double" => Precision::Double,
            other => {
                return Err(PyValueError::new_err(format!(
                    "precision is {other:?}: choose \"single\" or \"double\""
                )));
            }
        };
        if models.is_empty() && state.is_none() {
            return Err(PyValueError::new_err("a batch needs one model at least"));
        }
        let mut pool = Pool::new(threads)?;
        let models = models.into_iter().map(|model| model.0).collect();
        let state = state.map(<[u8]>::to_vec);
        let (pool, engine) = interruptible(py, move |_| {
            let create = || match state {
                Some(state) => Engine::restored(&state).map_err(|error| error.to_string()),
                None => Engine::new(models, precision).map_err(|error| error.to_string()),
            };
            let engine = pool.install(create);
            (pool, engine)
        })?;
        let engine = engine?.map_err(refused)?;
        let n = engine.len();
        let rows = |columns| PyArray2::zeros(py, [n, columns], false).unbind();
        let batch = Self {
            engine: Shared::new(engine),
            pool: Shared::new(pool),
            position: rows(3),
            orientation: rows(4),
            velocity: rows(3),
            angular_velocity: rows(3),
            yaw: PyArray1::zeros(py, n, false).unbind(),
            energy: PyArray1::zeros(py, n, false).unbind(),
            alive: PyArray1::zeros(py, n, false).unbind(),
        };
        batch.show(py, &*batch.engine.lock(py)?)?;
        Ok(batch)
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        Ok(self.engine.lock(py)?.len())
    }

    /// How many threads it was made for.
    #[getter]
    fn threads(&self, py: Python<'_>) -> PyResult<Option<usize>> {
        Ok(self.pool.lock(py)?.threads)
    }

    fn get_state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let engine = self.engine.lock(py)?;
        Ok(PyBytes::new(py, &py.detach(|| engine.state())))
    }

    fn set_state(&self, py: Python<'_>, state: &[u8]) -> PyResult<()> {
        let (state, mut pool) = (state.to_vec(), Pool::new(self.threads(py)?)?);
        let restored = interruptible(py, move |_| pool.install(|| Engine::restored(&state)))?;
        let restored = restored?.map_err(refused)?;
        let mut engine = self.engine.lock(py)?;
        self.show(py, &engine)?;
        if restored.len() != engine.len() {
            return Err(PyValueError::new_err(format!(
                "this state is of {} robots: this batch has {}",
                restored.len(),
                engine.len()
            )));
        }
        *engine = restored;
        self.show(py, &engine)
    }

    #[getter]
    fn time(&self, py: Python<'_>) -> PyResult<f64> {
        Ok(self.engine.lock(py)?.time())
    }

    fn model(&self, py: Python<'_>, #[pyo3(from_py_with = number)] robot: i64) -> PyResult<Model> {
        let engine = self.engine.lock(py)?;
        let robot = chosen(&engine, Some(vec![robot]))?[0];
        Ok(Model(engine.model(robot).clone()))
    }

    #[pyo3(signature = (seeds, robots = None, models = None, positions = None, headings = None))]
    fn reset(
        &self,
        py: Python<'_>,
        seeds: Vec<u64>,
        robots: Option<Vec<i64>>,
        models: Option<Vec<Model>>,
        positions: Option<PyReadonlyArray2<'_, f64>>,
        headings: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<()> {
        // What is given may be an array of this batch, which is written at the end.
        let positions = positions.map(|positions| positions.as_array().to_owned());
        let robots = {
            let engine = self.engine.lock(py)?;
            self.show(py, &engine)?;
            chosen(&engine, robots)?
        };
        let wrong = |what: &str, n: usize| {
            PyValueError::new_err(format!(
                "{n} {what} for {} robots: give one a robot",
                robots.len()
            ))
        };
        if seeds.len() != robots.len() {
            return Err(wrong("seeds", seeds.len()));
        }
        if let Some(models) = models.as_ref().filter(|models| models.len() != robots.len()) {
            return Err(wrong("models", models.len()));
        }
        if let Some(positions) = positions.as_ref().filter(|p| p.shape() != [robots.len(), 2]) {
            return Err(PyValueError::new_err(format!(
                "positions have the shape {:?}: give ({}, 2)",
                positions.shape(),
                robots.len()
            )));
        }
        let is_near = |at: &&f64| at.abs() <= FARTHEST;
        if let Some(bad) = positions.iter().flatten().find(|at| !is_near(at)) {
            return Err(PyValueError::new_err(format!(
                "positions hold {bad}: choose -{FARTHEST} to {FARTHEST} m"
            )));
        }
        let headings =
            headings.map(|headings| each(&headings, robots.len(), "headings")).transpose()?;
        if let Some(bad) = headings.iter().flatten().find(|heading| heading.abs() > LARGEST_HEADING)
        {
            return Err(PyValueError::new_err(format!(
                "headings hold {bad}: choose -{LARGEST_HEADING} to {LARGEST_HEADING} rad"
            )));
        }
        let mut plants = Vec::new();
        for (i, robot) in robots.iter().enumerate() {
            if i % LOOK == 0 {
                py.check_signals()?;
            }
            let model = match &models {
                Some(models) => models[i].0.clone(),
                None => self.engine.lock(py)?.model(*robot).clone(),
            };
            let heading = Some(headings.as_ref().map_or(0.0, |headings| headings[i]));
            let mut plant: Plant =
                Start { seed: seeds[i], heading }.plant(&model).map_err(refused)?;
            if let Some(at) = &positions {
                plant.displace([at[[i, 0]], at[[i, 1]], 0.0], 0.0);
            }
            plants.push((*robot, model, plant));
        }
        // From here on nobody interrupts: all robots begin anew, or none.
        let mut engine = self.engine.lock(py)?;
        for (robot, model, plant) in plants {
            engine.place(robot, model, &plant).map_err(refused)?;
        }
        self.show(py, &engine)
    }

    #[pyo3(signature = (f_hz, theta_rad, robots = None))]
    fn set_drive(
        &self,
        py: Python<'_>,
        f_hz: PyReadonlyArray1<'_, f64>,
        theta_rad: PyReadonlyArray1<'_, f64>,
        robots: Option<Vec<i64>>,
    ) -> PyResult<()> {
        let mut engine = self.engine.lock(py)?;
        let robots = chosen(&engine, robots)?;
        let f_hz = each(&f_hz, robots.len(), "f_hz")?;
        let theta_rad = each(&theta_rad, robots.len(), "theta_rad")?;
        if let Some(fast) = f_hz.iter().find(|f| f.abs() > FASTEST_HZ) {
            return Err(PyValueError::new_err(format!(
                "f_hz holds {fast}: the simulation shakes at -{FASTEST_HZ} to {FASTEST_HZ} Hz"
            )));
        }
        for ((robot, f), theta) in robots.into_iter().zip(f_hz).zip(theta_rad) {
            engine.set_drive(robot, f, theta);
        }
        Ok(())
    }

    #[pyo3(signature = (seconds, step = 1e-4))]
    fn run(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = number)] seconds: f64,
        #[pyo3(from_py_with = number)] step: f64,
    ) -> PyResult<()> {
        if !(1e-6..=1e-3).contains(&step) {
            return Err(PyValueError::new_err(format!(
                "step is {step} s: choose 0.000001 to 0.001 s"
            )));
        }
        if !(0.0..=1e5).contains(&seconds) {
            return Err(PyValueError::new_err(format!(
                "seconds is {seconds}: choose 0 to 100000 s"
            )));
        }
        let steps = whole_steps(seconds, step)?;
        let longest = self.engine.lock(py)?.longest_step();
        if step > longest {
            return Err(PyValueError::new_err(format!(
                "step is {step} s: the contact of a robot's feet is stable up to {longest:.2e} s: choose that or less, or a lower contact.stiffness_n_per_m"
            )));
        }
        if step > LONGEST_SURE_STEP {
            let warning = c"with steps beyond 0.00025 s walks are off by more than 1 %, by 10 % at 0.001 s: choose 0.0001 s";
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), warning, 1)?;
        }
        self.show(py, &*self.engine.lock(py)?)?;
        let mut slice = (SLICE / self.engine.lock(py)?.len()).clamp(1, LONGEST_SLICE);
        let (mut left, mut interrupted) = (steps, Ok(()));
        while left > 0 && interrupted.is_ok() {
            let (now, began) = (left.min(slice), Instant::now());
            {
                let (engine, pool) = (&mut *self.engine.lock(py)?, &mut *self.pool.lock(py)?);
                py.detach(|| pool.install(|| engine.run(now, step)))?;
            }
            // Who interrupts may look at the robots.
            interrupted = py.check_signals();
            left -= now;
            slice = match began.elapsed() {
                short if short < PATIENCE / 2 => 2 * slice,
                long if long > PATIENCE => (slice / 2).max(1),
                _ => slice,
            };
        }
        // The arrays show how far it came.
        self.show(py, &*self.engine.lock(py)?)?;
        interrupted
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let engine = self.engine.lock(py)?;
        Ok(format!("Batch of {} robots at {:.4} s", engine.len(), engine.time()))
    }
}

/// Time between two looks at who wants to interrupt.
const PATIENCE: Duration = Duration::from_millis(200);
/// Steps of all robots together before the first look, and of each at most.
const SLICE: usize = 50_000;
const LONGEST_SLICE: usize = 1000;
/// Farthest place on the floor, m.
const FARTHEST: f64 = 1e6;
/// Largest heading, rad: what is left of it by whole turns is known to a billionth.
pub const LARGEST_HEADING: f64 = 1e6;
/// Robots that begin anew between two such looks.
const LOOK: usize = 256;

/// Longest step with which walks are within 1 % (`sim-hil/docs/convergence.md`), s.
const LONGEST_SURE_STEP: f64 = 2.5e-4;
/// What rounding takes from a whole number of steps, as a part of it.
const ROUNDING: f64 = 1e-9;

/// Returns how many steps a time is; an error when it is no whole number of them.
pub fn whole_steps(seconds: f64, step: f64) -> PyResult<usize> {
    let steps = seconds / step;
    if (steps - steps.round()).abs() > ROUNDING * steps.max(1.0) {
        return Err(PyValueError::new_err(format!(
            "seconds is {seconds} s, {steps} steps of {step} s: choose a whole number of steps"
        )));
    }
    Ok(steps.round() as usize)
}

/// Fastest shaking, Hz.
const FASTEST_HZ: f64 = flix_sim::experiment::walk::Shaking::FASTEST_HZ;

impl Batch {
    /// Returns a robot as a plant.
    pub fn plant(&self, py: Python<'_>, robot: i64) -> PyResult<Plant> {
        let engine = self.engine.lock(py)?;
        let robot = chosen(&engine, Some(vec![robot]))?[0];
        engine.plant(robot).map_err(refused)
    }
}
