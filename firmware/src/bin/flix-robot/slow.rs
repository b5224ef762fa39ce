//! The slow half as the network task sees it: what crosses to and from the fast loop.

use core::net::SocketAddr;

use embassy_time::Timer;
use esp_println::println;
use flix_firmware::hardware::SettingsStore;
use flix_firmware::net::{EXCHANGE_INTERVAL, Station};
use flix_firmware::robot::SlowHalf;
use flix_protocol::frame::Frame;
use flix_protocol::message::State;
use flix_protocol::units::Instant;

use crate::clock::now;
use crate::fast;
use crate::network::SIGNAL;

/// The slow half, with what it needs to hand configurations over.
pub(crate) struct Robot<S> {
    slow: SlowHalf<S>,
    offered: Option<u16>,
    state: Option<State>,
}

impl<S: SettingsStore> Robot<S> {
    /// Before the fast loop's first report.
    pub(crate) const fn new(slow: SlowHalf<S>) -> Self {
        Self { slow, offered: None, state: None }
    }

    /// For ever, without a network: settings and faults still cross.
    pub(crate) async fn run_alone(mut self) -> ! {
        loop {
            self.exchange();
            Timer::after(EXCHANGE_INTERVAL).await;
        }
    }

    /// Takes the newest report, and says so when the supervisor went elsewhere.
    fn observe(&mut self) {
        let Some(report) = fast::REPORT.newest() else { return };
        self.slow.observe(&report);
        if self.state != Some(report.state) {
            self.state = Some(report.state);
            match report.first_fault {
                Some(fault) => println!("robot: {}, {fault}", report.state),
                None => println!("robot: {}", report.state),
            }
        }
    }
}

impl<S: SettingsStore> Station for Robot<S> {
    fn now(&self) -> Instant {
        now()
    }

    fn exchange(&mut self) {
        self.observe();
        if let Some(revision) = fast::CONFIGURED.take() {
            self.slow.configured(revision);
        }
        // Before the order that came with it.
        if let Some(offer) = self.slow.configuration()
            && self.offered != Some(offer.revision)
        {
            self.offered = Some(offer.revision);
            fast::CONFIGURATION.put(offer);
        }
        self.slow.set_signal(SIGNAL.newest());
        fast::ORDER.put(self.slow.order());
    }

    fn receive(&mut self, from: SocketAddr, datagram: &[u8]) {
        self.slow.receive(now(), from, datagram);
    }

    fn transmit(&mut self, frame: &mut Frame) -> Option<SocketAddr> {
        self.slow.transmit(now(), frame)
    }

    fn poll_at(&self) -> Option<Instant> {
        self.slow.poll_at(now())
    }
}
