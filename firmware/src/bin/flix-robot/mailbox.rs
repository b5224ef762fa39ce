//! What is shared between interrupts and tasks, on any core, at any priority: whole values, of which the
//! newest stays. Interrupts are held off for the time of a copy.

use core::cell::{Cell, RefCell};

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use flix_firmware::exchange::{Access, Exchange};
use flix_protocol::message::State;

/// One value.
pub(crate) struct Mailbox<T: Copy>(Mutex<CriticalSectionRawMutex, Cell<Option<T>>>);

impl<T: Copy> Mailbox<T> {
    /// Starts empty.
    pub(crate) const fn new() -> Self {
        Self(Mutex::new(Cell::new(None)))
    }

    /// Leaves a value; what was there is gone.
    pub(crate) fn put(&self, value: T) {
        self.0.lock(|cell| cell.set(Some(value)));
    }

    /// Returns what was left last.
    pub(crate) fn newest(&self) -> Option<T> {
        self.0.lock(Cell::get)
    }

    /// Returns what was left last, once.
    pub(crate) fn take(&self) -> Option<T> {
        self.0.lock(Cell::take)
    }
}

/// The exchange between fast loop and tasks.
pub(crate) struct Shared(Mutex<CriticalSectionRawMutex, RefCell<Exchange>>);

impl Shared {
    /// Shares an exchange.
    pub(crate) const fn new(exchange: Exchange) -> Self {
        Self(Mutex::new(RefCell::new(exchange)))
    }

    /// Returns the state of the fast loop as last reported.
    pub(crate) fn state(&self) -> State {
        self.0.lock(|exchange| exchange.borrow().newest_report().state)
    }
}

impl Access for &Shared {
    fn with<R>(&mut self, access: impl FnOnce(&mut Exchange) -> R) -> R {
        self.0.lock(|exchange| access(&mut exchange.borrow_mut()))
    }
}
