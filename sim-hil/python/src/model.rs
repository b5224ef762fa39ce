//! A robot as data.

use std::ffi::CString;

use flix_sim::model::mjcf::{mjcf, too_long};
use flix_sim::model::{Legs, NAMES, RobotModel, random, scattered, stranger};
use flix_sim::plant::mechanics::reference_contact;
use pyo3::exceptions::{PyKeyError, PyUserWarning, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};
use serde_json::Value;

use crate::{number, refused, seed_of};

/// Creates a model of that name, or reads a TOML file.
#[pyclass(frozen, eq, module = "flixwalker", from_py_object)]
#[derive(Clone, PartialEq)]
pub struct Model(pub RobotModel);

/// Returns the dimensions of the legs' beams.
fn beam(legs: &Legs) -> [f64; 3] {
    [legs.length_mm, legs.width_mm, legs.thickness_mm]
}

/// Returns how stiff the legs are.
fn stiffness(legs: &Legs) -> [f64; 2] {
    [legs.bend_stiffness_n_m_rad, legs.twist_stiffness_n_m_rad]
}

/// Returns a model's fields as nested values.
fn tree(model: &RobotModel) -> PyResult<Value> {
    serde_json::to_value(model).map_err(refused)
}

/// Finds a field by its path, names joined by dots.
fn find<'a>(tree: &'a mut Value, path: &str) -> PyResult<&'a mut Value> {
    let missing = || PyKeyError::new_err(format!("a model has no field {path}"));
    path.split('.').try_fold(tree, |at, name| {
        match at {
            Value::Array(list) => name.parse().ok().and_then(|i: usize| list.get_mut(i)),
            other => other.get_mut(name),
        }
        .ok_or_else(missing)
    })
}

/// Converts by way of JSON.
fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (value.to_string(),))
}

fn from_python(value: &Bound<'_, PyAny>) -> PyResult<Value> {
    let py = value.py();
    // Numbers and arrays of numpy become plain ones.
    let plain = py.import("operator")?.call_method1("methodcaller", ("tolist",))?;
    let options = PyDict::new(py);
    options.set_item("default", plain)?;
    options.set_item("allow_nan", false)?;
    let text: String =
        py.import("json")?.call_method("dumps", (value,), Some(&options))?.extract()?;
    serde_json::from_str(&text).map_err(refused)
}

#[pymethods]
impl Model {
    #[new]
    fn new(name: std::path::PathBuf) -> PyResult<Self> {
        let name = name.to_str().ok_or_else(|| refused("a model's name is text"))?;
        RobotModel::named(name).map(Self).map_err(refused)
    }

    #[staticmethod]
    fn from_toml(text: &str) -> PyResult<Self> {
        RobotModel::from_toml(text).map(Self).map_err(refused)
    }

    #[staticmethod]
    fn random(#[pyo3(from_py_with = seed_of)] seed: u64) -> Self {
        Self(random(seed))
    }

    fn scattered(
        &self,
        #[pyo3(from_py_with = number)] share: f64,
        #[pyo3(from_py_with = seed_of)] seed: u64,
    ) -> PyResult<Self> {
        if !(0.0..=0.2).contains(&share) {
            return Err(PyValueError::new_err(format!("share is {share}: choose 0 to 0.2")));
        }
        Ok(Self(scattered(&self.0, share, seed)))
    }

    fn stranger(&self, #[pyo3(from_py_with = seed_of)] seed: u64) -> Self {
        Self(stranger(&self.0, seed))
    }

    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    fn to_toml(&self) -> PyResult<String> {
        toml::to_string(&self.0).map_err(refused)
    }

    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &tree(&self.0)?)
    }

    fn mjcf(&self, py: Python<'_>, #[pyo3(from_py_with = number)] step: f64) -> PyResult<String> {
        if !(1e-6..=1e-1).contains(&step) {
            return Err(PyValueError::new_err(format!(
                "step is {step} s: choose 0.000001 to 0.1 s"
            )));
        }
        let contact = reference_contact(&self.0);
        if let Some(sentence) = too_long(step, contact) {
            let sentence = CString::new(sentence)?;
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), &sentence, 1)?;
        }
        Ok(mjcf(&self.0, step, contact))
    }

    fn __getitem__<'py>(&self, py: Python<'py>, path: &str) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, find(&mut tree(&self.0)?, path)?)
    }

    fn __contains__(&self, path: &str) -> PyResult<bool> {
        Ok(find(&mut tree(&self.0)?, path).is_ok())
    }

    fn replace(&self, py: Python<'_>, fields: &Bound<'_, PyDict>) -> PyResult<Self> {
        let before = tree(&self.0)?;
        let (mut tree, mut replaced) = (before.clone(), Vec::new());
        for (path, value) in fields {
            let path: String = path.extract()?;
            let plain = from_python(&value).map_err(|_| {
                refused(format!(
                    "{path} is {value:?}: give finite numbers, text, or lists and tables of them"
                ))
            })?;
            *find(&mut tree, &path)? = plain.clone();
            replaced.push((path, plain));
        }
        let model: RobotModel = serde_json::from_value(tree).map_err(|error| {
            // Alone each says whether it is the one.
            let wrong = replaced.into_iter().find_map(|(path, plain)| {
                let mut alone = before.clone();
                *find(&mut alone, &path).ok()? = plain.clone();
                let error = serde_json::from_value::<RobotModel>(alone).err()?;
                Some(format!("{path} is {plain}: {error}"))
            });
            refused(wrong.unwrap_or_else(|| error.to_string()))
        })?;
        model.check().map_err(refused)?;
        if let (Some(before), Some(after)) = (&self.0.legs, &model.legs)
            && beam(before) != beam(after)
            && stiffness(before) == stiffness(after)
        {
            let sentence = c"length_mm, width_mm and thickness_mm of legs set the segments, the height and the inertia, not the stiffness: \
                             bend_stiffness_n_m_rad and twist_stiffness_n_m_rad stay as they were";
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), sentence, 1)?;
        }
        Ok(Self(model))
    }

    fn __hash__(&self, py: Python<'_>) -> PyResult<isize> {
        // Models that are equal may differ in the sign of a zero.
        let text = self.to_toml()?.replace("-0.0", "0.0");
        PyString::new(py, &text).hash()
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        Ok((py.get_type::<Self>().getattr("from_toml")?, (self.to_toml()?,)))
    }

    fn __repr__(&self) -> String {
        format!("Model({:?})", self.0.name)
    }
}

/// Names of the models that come with the simulator.
#[pyfunction]
pub fn models() -> Vec<&'static str> {
    NAMES.to_vec()
}
