//! Walks as the studies take them.

use flix_host::nav::PAPER_PAIRS;
use flix_sim::experiment::walk::{Shaking, Start};
use flix_sim::experiment::walks::{OneOfMany, TOGETHER, walks_while};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::iter::ParallelIterator as _;
use rayon::slice::ParallelSlice as _;

use crate::batch::whole_steps;
use crate::model::Model;
use crate::{Pool, interruptible, number, refused};

/// Walks each robot for a while and returns a column for each quantity.
#[pyfunction]
#[pyo3(signature = (models, f_hz, theta_deg, seeds, seconds = 8.0, step = 1e-4, threads = None))]
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn walk<'py>(
    py: Python<'py>,
    models: Vec<Model>,
    f_hz: PyReadonlyArray1<'py, f64>,
    theta_deg: PyReadonlyArray1<'py, f64>,
    seeds: Vec<u64>,
    #[pyo3(from_py_with = number)] seconds: f64,
    #[pyo3(from_py_with = number)] step: f64,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    let (f, theta) = (f_hz.as_array(), theta_deg.as_array());
    let n = models.len();
    if [f.len(), theta.len(), seeds.len()] != [n; 3] {
        return Err(PyValueError::new_err(format!(
            "{n} models, {} f_hz, {} theta_deg, {} seeds: give as many of each, one a walk",
            f.len(),
            theta.len(),
            seeds.len()
        )));
    }
    if !(1e-6..=1e-3).contains(&step) || !(step..=1e4).contains(&seconds) {
        return Err(PyValueError::new_err(format!(
            "{seconds} s in steps of {step} s: choose steps of 0.000001 to 0.001 s and 10000 s at most"
        )));
    }
    whole_steps(seconds, step)?;
    let many = models
        .into_iter()
        .zip(f.iter().zip(theta))
        .zip(&seeds)
        .map(|((model, (f, theta)), seed)| {
            let shaking = Shaking::new(*f, *theta).map_err(refused)?;
            let start = Start { seed: *seed, heading: None };
            Ok(OneOfMany { model: model.0, shaking, start })
        })
        .collect::<PyResult<Vec<_>>>()?;
    let mut pool = Pool::new(threads)?;
    let mut columns: [Vec<f64>; 6] = Default::default();
    let (mut upright, mut failures) = (Vec::new(), Vec::new());
    let walked: Vec<_> = interruptible(py, move |goes_on| {
        let walk = |many: &[_]| walks_while(many, seconds, step, goes_on).unwrap_or_default();
        pool.install(|| many.par_chunks(TOGETHER).flat_map(walk).collect())
    })??;
    for walked in walked {
        let row = walked.as_ref().map_or([f64::NAN; 6], |w| {
            [w.forward_m_s, w.lateral_m_s, w.yaw_rad_s, w.energy_j, w.path_m, w.cost_of_transport]
        });
        for (column, value) in columns.iter_mut().zip(row) {
            column.push(value);
        }
        upright.push(walked.as_ref().is_ok_and(|w| w.upright));
        failures.push(walked.err().map_or_else(String::new, |why| why.to_string()));
    }
    let table = PyDict::new(py);
    let names =
        ["forward_m_s", "lateral_m_s", "yaw_rad_s", "energy_j", "path_m", "cost_of_transport"];
    for (name, column) in names.into_iter().zip(columns) {
        table.set_item(name, PyArray1::from_vec(py, column))?;
    }
    table.set_item("upright", PyArray1::from_vec(py, upright))?;
    table.set_item("failure", failures)?;
    Ok(table)
}

/// The nine pairs of the paper's Tables III and IV: name, f in Hz, theta in degrees.
#[pyfunction]
pub fn paper_pairs() -> Vec<(&'static str, f32, f32)> {
    PAPER_PAIRS.to_vec()
}
