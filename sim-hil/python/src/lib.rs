//! The module `flixwalker._flixwalker`: thin classes over the simulator. Their words for people are in
//! `flixwalker/_flixwalker.pyi`.

mod batch;
mod film;
mod model;
mod robot;
mod walk;

use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::thread;
use std::time::Duration;

use pyo3::exceptions::{PyOverflowError, PyRuntimeError, PyTypeError};
use pyo3::prelude::*;
use pyo3::sync::MutexExt as _;
use pyo3::types::PyBool;

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

    /// Version, with the commit that the package is built from.
    #[pymodule_export]
    #[allow(non_upper_case_globals, reason = "Python's name of it")]
    const __version__: &str = env!("FLIX_VERSION");
}

/// Takes a number. Python has true for 1, and nobody means it.
fn number<'py, T: for<'a> FromPyObject<'a, 'py>>(value: &Bound<'py, PyAny>) -> PyResult<T> {
    // A scalar or an array of numpy has a kind.
    let kind = value.getattr("dtype").and_then(|dtype| dtype.getattr("kind"));
    if value.is_instance_of::<PyBool>() || kind.is_ok_and(|kind| kind.eq("b").unwrap_or(false)) {
        return Err(PyTypeError::new_err(format!("{value} is no number")));
    }
    value.extract().map_err(Into::into)
}

/// Takes a number, or none.
fn optional_number<'py, T: for<'a> FromPyObject<'a, 'py>>(
    value: &Bound<'py, PyAny>,
) -> PyResult<Option<T>> {
    if value.is_none() { Ok(None) } else { number(value).map(Some) }
}

/// Takes a seed.
fn seed_of(value: &Bound<'_, PyAny>) -> PyResult<u64> {
    number(value).map_err(|error| {
        if error.is_instance_of::<PyOverflowError>(value.py()) {
            refused(format!("a seed is {value}: choose whole numbers from 0 to 2**64 - 1"))
        } else {
            error
        }
    })
}

/// Threads of one's own.
struct Pool {
    threads: Option<usize>,
    pool: Option<rayon::ThreadPool>,
    /// Whose threads these are: those of a process do not survive its fork.
    process: u32,
}

impl Pool {
    /// Starts so many threads, one for each core if no number is given.
    fn new(threads: Option<usize>) -> PyResult<Self> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).build();
        Ok(Self { threads, pool: Some(pool.map_err(refused)?), process: std::process::id() })
    }

    /// Runs something on these threads, or on new ones in a process that was forked.
    fn install<T: Send>(&mut self, work: impl FnOnce() -> T + Send) -> PyResult<T> {
        if self.process != std::process::id() {
            // What it replaces waits for threads that are not there.
            *self = Self::new(self.threads)?;
        }
        Ok(match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        })
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        if self.process != std::process::id() {
            std::mem::forget(self.pool.take());
        }
    }
}

/// Works without the interpreter on a thread of its own, while this one looks at who wants to interrupt. `work` may ask what
/// it is given whether anybody still waits: what it makes after that is dropped.
fn interruptible<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&(dyn Fn() -> bool + Sync)) -> T + Send + 'static,
) -> PyResult<T> {
    /// Between two looks.
    const LOOK: Duration = Duration::from_millis(50);
    let (goes_on, (sender, receiver)) = (Arc::new(AtomicBool::new(true)), mpsc::channel());
    let receiver = Mutex::new(receiver);
    let asked = Arc::clone(&goes_on);
    let worker = thread::spawn(move || {
        // Nobody takes what nobody waits for.
        let _ = sender.send(work(&|| asked.load(Ordering::Relaxed)));
    });
    let next = || receiver.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(LOOK);
    loop {
        match py.detach(next) {
            Ok(worked) => return Ok(worked),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                let Err(panic) = worker.join() else { unreachable!("it sends what it made") };
                resume_unwind(panic)
            }
        }
        if let Err(interrupted) = py.check_signals() {
            goes_on.store(false, Ordering::Relaxed);
            return Err(interrupted);
        }
    }
}

/// What threads share.
struct Shared<T> {
    value: Mutex<T>,
    /// Which process has looked at it last: of a thread that has it in another one nothing is left here.
    process: AtomicU32,
}

impl<T> Shared<T> {
    fn new(value: T) -> Self {
        Self { value: Mutex::new(value), process: AtomicU32::new(std::process::id()) }
    }

    /// Waits, without the interpreter, until no other thread has it. One that panicked has left what can still be looked at.
    ///
    /// # Errors
    /// In a process that was forked while another thread had it.
    fn lock(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, T>> {
        let here = std::process::id();
        if self.process.load(Ordering::Relaxed) != here
            && matches!(self.value.try_lock(), Err(TryLockError::WouldBlock))
        {
            return Err(PyRuntimeError::new_err(
                "this process was forked while another thread ran these robots: fork before, or make them here",
            ));
        }
        self.process.store(here, Ordering::Relaxed);
        Ok(self.value.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner))
    }
}

/// Tells Python what the simulator refuses, in its own words.
fn refused(error: impl std::fmt::Display) -> PyErr {
    pyo3::exceptions::PyValueError::new_err(error.to_string())
}
