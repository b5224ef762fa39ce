//! Ctrl-C, SIGTERM and a closed terminal as a flag that every loop checks.
//!
//! The signal handler only sets the flag: a program that drives a robot first stops it, then ends.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::system::{ERRORS, listen};

/// A request to end this program.
#[derive(Debug, Clone)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Handles from now on what asks a program to end: Ctrl-C (SIGINT), SIGTERM, SIGHUP and SIGQUIT; on Windows Ctrl-C, Ctrl-Break, a
    /// console that is closed, and the end of its user's session.
    ///
    /// # Errors
    /// When the operating system refuses the handlers.
    pub fn listen() -> io::Result<Self> {
        let raised = Arc::new(AtomicBool::new(false));
        listen(&raised)?;
        Ok(Self(raised))
    }

    /// Lets a write fail from now on that a limit on the length of files forbids, where it would end the program.
    ///
    /// # Errors
    /// When the operating system refuses the handlers.
    pub fn let_writes_fail() -> io::Result<()> {
        for signal in ERRORS {
            signal_hook::flag::register(*signal, Arc::default())?;
        }
        Ok(())
    }

    /// Creates a flag that no signal raises, for tests and for loops within loops.
    #[must_use]
    pub fn never() -> Self {
        Self(Arc::default())
    }

    /// Requests the end from inside the program.
    pub fn raise(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Returns whether the end was requested.
    #[must_use]
    pub fn is_raised(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}
