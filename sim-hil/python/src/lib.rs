//! The module `flixwalker._flixwalker`: thin classes over the simulator. Their words for people are in
//! `flixwalker/_flixwalker.pyi`.

mod batch;
mod film;
mod model;
mod robot;
mod walk;

use pyo3::prelude::*;

#[pymodule]
mod _flixwalker {
    #[pymodule_export]
    use super::batch::Batch;
    #[pymodule_export]
    use super::film::Film;
    #[pymodule_export]
    use super::model::{Model, models};
    #[pymodule_export]
    use super::robot::Robot;
    #[pymodule_export]
    use super::walk::{paper_pairs, walk};
}

/// Creates threads of one's own, all cores if no number is given: those of a process do not survive its fork.
fn pool(threads: Option<usize>) -> PyResult<rayon::ThreadPool> {
    rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).build().map_err(refused)
}

/// Tells Python what the simulator refuses, in its own words.
fn refused(error: impl std::fmt::Display) -> PyErr {
    pyo3::exceptions::PyValueError::new_err(error.to_string())
}
