//! Where the fast loop and the tasks leave whole values for each other. The newest stays.

use core::cell::Cell;

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;

/// One value, on any core, at any priority. Held for the time of a copy.
pub(crate) struct Mailbox<T: Copy>(Mutex<CriticalSectionRawMutex, Cell<Option<T>>>);

impl<T: Copy> Mailbox<T> {
    /// Empty.
    pub(crate) const fn new() -> Self {
        Self(Mutex::new(Cell::new(None)))
    }

    /// Leaves a value; what was there is gone.
    pub(crate) fn put(&self, value: T) {
        self.0.lock(|cell| cell.set(Some(value)));
    }

    /// What was left last.
    pub(crate) fn newest(&self) -> Option<T> {
        self.0.lock(Cell::get)
    }

    /// What was left last, once.
    pub(crate) fn take(&self) -> Option<T> {
        self.0.lock(Cell::take)
    }
}
