//! What was seen of a robot, as a page for the browser.

use std::path::PathBuf;

use flix_sim::view::Film as Frames;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::batch::Batch;
use crate::model::Model;
use crate::{Shared, number, refused};

/// Creates a film of robots of this model.
#[pyclass(frozen, module = "flixwalker")]
pub struct Film {
    // Any thread may look.
    frames: Shared<Frames>,
    reference: Vec<[f64; 2]>,
}

impl Film {
    fn recording(&self, py: Python<'_>, title: &str) -> PyResult<flix_sim::view::Recording> {
        let mut recording = self.frames.lock(py)?.clone().into_recording(title.to_owned());
        recording.reference.clone_from(&self.reference);
        Ok(recording)
    }
}

#[pymethods]
impl Film {
    #[new]
    #[pyo3(signature = (model, interval = 0.005, reference = Vec::new()))]
    fn new(
        model: &Model,
        #[pyo3(from_py_with = number)] interval: f64,
        reference: Vec<[f64; 2]>,
    ) -> PyResult<Self> {
        if !(1e-4..=1e3).contains(&interval) {
            return Err(PyValueError::new_err(format!(
                "interval is {interval} s: choose 0.0001 to 1000 s"
            )));
        }
        if reference.iter().flatten().any(|it| !it.is_finite()) {
            return Err(PyValueError::new_err("reference holds what is no number"));
        }
        Ok(Self { frames: Shared::new(Frames::new(&model.0, interval)), reference })
    }

    fn shoot(
        &self,
        py: Python<'_>,
        batch: &Batch,
        #[pyo3(from_py_with = number)] robot: i64,
    ) -> PyResult<()> {
        let plant = batch.plant(py, robot)?;
        self.frames.lock(py)?.shoot(&plant);
        Ok(())
    }

    fn to_html(&self, py: Python<'_>, title: &str) -> PyResult<String> {
        self.recording(py, title)?.to_html().map_err(refused)
    }

    fn write(&self, py: Python<'_>, path: PathBuf, title: &str) -> PyResult<PathBuf> {
        self.recording(py, title)?.write(&path).map_err(refused)
    }
}
