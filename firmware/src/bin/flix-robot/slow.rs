//! The slow half as the network task sees it: what crosses to and from the fast loop.

use core::cell::Cell;
use core::net::{Ipv4Addr, SocketAddr};

use embassy_time::Timer;
use flix_firmware::blackbox::Kept;
use flix_firmware::hardware::SettingsStore;
use flix_firmware::joining;
use flix_firmware::net::{EXCHANGE_INTERVAL, Station};
use flix_firmware::robot::SlowHalf;
use flix_protocol::frame::Frame;
use flix_protocol::message::{ResetReason, State};
use flix_protocol::units::Instant;

use crate::choice::BOARD;
use crate::clock::now;
use crate::log::log;
use crate::network::SIGNAL;
use crate::rtc_memory;
use crate::shared::Shared;
use crate::watchdog;

/// The slow half, with the way to the fast loop.
pub(crate) struct SlowTask<S> {
    slow: SlowHalf<S>,
    exchange: &'static Shared,
    printed: Option<State>,
    /// Ticks of the fast loop at the last feeding.
    ticks: u64,
}

impl<S: SettingsStore> SlowTask<S> {
    /// Starts before the first exchange; `reset` is why the chip last started, and `kept` what the run before left, for
    /// operators who ask.
    pub(crate) fn new(
        mut slow: SlowHalf<S>,
        reset: ResetReason,
        kept: Kept,
        exchange: &'static Shared,
    ) -> Self {
        slow.link.set_crash(kept.report(reset.clone()));
        slow.link.set_build(rtc_memory::build());
        slow.link.set_reset(reset);
        Self { slow, exchange, printed: None, ticks: 0 }
    }

    /// Returns the way to the fast loop.
    pub(crate) const fn shared(&self) -> &'static Shared {
        self.exchange
    }

    /// Runs for ever without a network: settings and faults still cross.
    pub(crate) async fn run_alone(mut self) -> ! {
        loop {
            self.exchange();
            Timer::after(EXCHANGE_INTERVAL).await;
        }
    }

    /// Feeds the watchdog while the fast loop goes on.
    fn feed(&mut self) {
        let report = self.slow.report();
        if !joining::may_try(report.state) {
            watchdog::close_window();
        }
        let ticks = report.timing.ticks;
        if self.ticks != ticks {
            self.ticks = ticks;
            watchdog::feed();
        }
    }

    /// Prints where the supervisor went.
    fn print_state(&mut self) {
        let report = self.slow.report();
        if self.printed != Some(report.state) {
            self.printed = Some(report.state);
            match report.first_fault {
                Some(fault) => log!("robot: {}, {fault}", report.state),
                None => log!("robot: {}", report.state),
            }
        }
    }
}

impl<S: SettingsStore> Station for SlowTask<S> {
    fn board(&self) -> &'static str {
        BOARD.hardware.name
    }

    fn now(&self) -> Instant {
        now()
    }

    fn exchange(&mut self) {
        self.slow.link.set_signal(SIGNAL.lock(Cell::get));
        self.slow.exchange(&mut self.exchange);
        if let Some(bytes) = self.slow.link.keep() {
            rtc_memory::keep_run(&bytes);
        }
        self.feed();
        self.print_state();
    }

    fn receive(&mut self, from: SocketAddr, datagram: &[u8]) -> bool {
        self.slow.receive(now(), from, datagram)
    }

    fn transmit(&mut self, frame: &mut Frame) -> Option<SocketAddr> {
        self.slow.transmit(now(), frame)
    }

    fn poll_at(&self) -> Option<Instant> {
        self.slow.poll_at(now())
    }

    fn meet_twin(&mut self, address: Ipv4Addr) {
        log!("mdns: another robot has this name, at {address}: provision one of them with --name");
    }
}
