//! The exchange, shared between interrupts and tasks, on any core, at any priority. Interrupts are held off for the
//! time of a copy.

use core::cell::{Cell, RefCell};

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use flix_firmware::fast::exchange::{Access, Exchange};
use flix_firmware::provision::Radio;
use flix_firmware::scan::Scans;
use flix_firmware::scope::Memory;
use flix_protocol::message::State;
use flix_protocol::provision::{Answer, HeardNetwork, NetworkState};

/// The exchange between fast loop and tasks, how far the robot is on its way onto its network, and what its radio hears.
pub(crate) struct Shared {
    exchange: Mutex<CriticalSectionRawMutex, RefCell<Exchange<&'static mut Memory>>>,
    network: Mutex<CriticalSectionRawMutex, Cell<NetworkState>>,
    scans: Mutex<CriticalSectionRawMutex, RefCell<Scans>>,
}

impl Shared {
    /// Shares an exchange.
    pub(crate) const fn new(exchange: Exchange<&'static mut Memory>) -> Self {
        let network = Mutex::new(Cell::new(NetworkState::Joining));
        let scans = Mutex::new(RefCell::new(Scans::new()));
        Self { exchange: Mutex::new(RefCell::new(exchange)), network, scans }
    }

    /// Returns the state of the fast loop as last reported.
    pub(crate) fn state(&self) -> State {
        self.exchange.lock(|exchange| exchange.borrow().newest_report().state)
    }

    /// Returns the same for those who write flash or restart the chip (`Report::settled`).
    pub(crate) fn settled(&self) -> State {
        self.exchange.lock(|exchange| exchange.borrow().newest_report().settled())
    }

    /// Notes how far the robot is on its way onto its network.
    pub(crate) fn set_network(&self, state: NetworkState) {
        self.network.lock(|network| network.set(state));
    }

    /// Returns whether the radio has to listen for access points.
    pub(crate) fn scan_is_due(&self) -> bool {
        self.scans.lock(|scans| scans.borrow().is_due())
    }

    /// Notes the access points of a scan; `None` where the radio could not scan.
    pub(crate) fn end_scan(&self, heard: Option<impl IntoIterator<Item = HeardNetwork>>) {
        self.scans.lock(|scans| scans.borrow_mut().end(heard));
    }
}

impl Radio for Shared {
    fn network(&self) -> NetworkState {
        self.network.lock(Cell::get)
    }

    fn scan(&self, number: u8, from: u8) -> Answer {
        self.scans.lock(|scans| scans.borrow_mut().ask(number, from))
    }
}

impl Access for &Shared {
    type Memory = &'static mut Memory;

    fn with<R>(&mut self, access: impl FnOnce(&mut Exchange<Self::Memory>) -> R) -> R {
        self.exchange.lock(|exchange| access(&mut exchange.borrow_mut()))
    }
}
