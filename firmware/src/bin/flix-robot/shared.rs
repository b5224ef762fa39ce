//! The exchange, shared between interrupts and tasks, on any core, at any priority. Interrupts are held off for the
//! time of a copy.

use core::cell::RefCell;

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use flix_firmware::fast::exchange::{Access, Exchange};
use flix_firmware::scope::Memory;
use flix_protocol::message::State;

/// The exchange between fast loop and tasks.
pub(crate) struct Shared(Mutex<CriticalSectionRawMutex, RefCell<Exchange<&'static mut Memory>>>);

impl Shared {
    /// Shares an exchange.
    pub(crate) const fn new(exchange: Exchange<&'static mut Memory>) -> Self {
        Self(Mutex::new(RefCell::new(exchange)))
    }

    /// Returns the state of the fast loop as last reported.
    pub(crate) fn state(&self) -> State {
        self.0.lock(|exchange| exchange.borrow().newest_report().state)
    }
}

impl Access for &Shared {
    type Memory = &'static mut Memory;

    fn with<R>(&mut self, access: impl FnOnce(&mut Exchange<Self::Memory>) -> R) -> R {
        self.0.lock(|exchange| access(&mut exchange.borrow_mut()))
    }
}
