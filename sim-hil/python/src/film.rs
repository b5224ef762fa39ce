//! What was seen of a robot, as a page for the browser.

use std::path::PathBuf;

use flix_sim::view::Film as Frames;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::batch::Batch;
use crate::model::Model;
use crate::refused;

/// Creates a film of robots of this model.
#[pyclass(module = "flixwalker")]
pub struct Film {
    frames: Frames,
    reference: Vec<[f64; 2]>,
}

impl Film {
    fn recording(&self, title: &str) -> flix_sim::view::Recording {
        let mut recording = self.frames.clone().into_recording(title.to_owned());
        recording.reference.clone_from(&self.reference);
        recording
    }
}

#[pymethods]
impl Film {
    #[new]
    #[pyo3(signature = (model, interval = 0.005, reference = Vec::new()))]
    fn new(model: &Model, interval: f64, reference: Vec<[f64; 2]>) -> PyResult<Self> {
        if !(1e-4..=1e3).contains(&interval) {
            return Err(PyValueError::new_err(format!(
                "interval is {interval} s: choose 0.0001 to 1000 s"
            )));
        }
        Ok(Self { frames: Frames::new(&model.0, interval), reference })
    }

    fn shoot(&mut self, py: Python<'_>, batch: &Batch, robot: i64) -> PyResult<()> {
        self.frames.shoot(&batch.plant(py, robot)?);
        Ok(())
    }

    fn to_html(&self, title: &str) -> PyResult<String> {
        self.recording(title).to_html().map_err(refused)
    }

    fn write(&self, path: PathBuf, title: &str) -> PyResult<PathBuf> {
        self.recording(title).write(&path).map_err(refused)
    }
}
