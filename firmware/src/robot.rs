//! The whole robot's software, the one entry for chips and simulator.
//!
//! [`Robot`] is everything in one place, for a program of one thread. Where the fast loop has a
//! priority or a core of its own, [`halves`] gives the two halves, and an [`Exchange`] is what crosses
//! between them; [`Robot::tick`] does with them exactly what a chip does:
//!
//! ```text
//!            every tick, 10 kHz                     when there is something to do
//! Sensors -> FastHalf::tick -> Actuation    datagrams -> SlowHalf::receive
//!                  |                        datagrams <- SlowHalf::transmit, poll_at
//!                  +------- Exchange ------------------- SlowHalf::exchange
//! ```
//!
//! Cryptography and flash belong to the slow half and never delay a tick.

use core::net::SocketAddr;

use flix_protocol::frame::Frame;
use flix_protocol::message::{Event, Fault, SCOPE_VALUES};
use flix_protocol::session::Operators;
use flix_protocol::units::Instant;

use crate::fast::configuration::Configuration;
use crate::fast::control::Control;
use crate::fast::exchange::{Access, Exchange, Report};
use crate::hardware::{Actuation, Hardware, Sensors, SettingsStore};
use crate::link::{Link, identity};
use crate::scope::Sample;
use crate::settings::{Settings, Tuning};
use crate::stored::LoadError;

/// What a robot without a key says at boot; the operator's program says the same.
pub const UNPROVISIONED: &str = "this robot has no key yet and refuses the network; connect it by USB and run: flix provision --port PORT --ssid NETWORK";

/// Ticks between two reports to the slow half: 1 ms, far below every deadline.
const REPORT_INTERVAL: u8 = 10;

/// The whole robot's software.
pub struct Robot<S> {
    fast: FastHalf,
    /// Link, settings and telemetry.
    pub slow: SlowHalf<S>,
    exchange: Exchange,
}

impl<S: SettingsStore> Robot<S> {
    /// Starts at power-up; as [`halves`] says.
    pub fn new(
        hardware: Hardware,
        name: &str,
        operators: impl Into<Operators>,
        entropy: [u8; 32],
        store: S,
    ) -> Self {
        let (fast, slow, report) = halves(hardware, name, operators, entropy, store);
        Self { fast, slow, exchange: Exchange::new(report, [0; SCOPE_VALUES]) }
    }

    /// Does one tick of the fast loop, [`TICK_RATE_HZ`](crate::hardware::TICK_RATE_HZ) times a second.
    pub fn tick(&mut self, now: Instant, sensors: &Sensors) -> Actuation {
        self.slow.exchange(&mut self.exchange);
        let actuation = self.fast.tick(now, sensors, &mut self.exchange);
        self.slow.exchange(&mut self.exchange);
        actuation
    }

    /// Returns how the fast half is, as of the last tick.
    #[must_use]
    pub fn report(&self) -> Report {
        self.fast.control.report()
    }
}

/// Starts at power-up: disarmed, with the settings that `store` holds. Returns the two halves for a fast loop with a
/// priority or a core of its own, and the fast half's first report, for the [`Exchange`] between them.
///
/// Operators see `name` (at most 32 bytes of it). Without operators the robot refuses everybody. `entropy` must come from a
/// hardware random source, fresh at every start. Stored values that are out of range have their defaults and are assumed: the
/// robot does not arm on them. Where nothing can be read all have, and [`Fault::Settings`] stands until it is cleared.
pub fn halves<S: SettingsStore>(
    hardware: Hardware,
    name: &str,
    operators: impl Into<Operators>,
    entropy: [u8; 32],
    store: S,
) -> (FastHalf, SlowHalf<S>, Report) {
    let tuning = Tuning::new(store);
    let mut control = Control::new(Configuration::new(tuning.settings(), &hardware));
    let identity = identity(name, &hardware);
    let (settings, report) = (tuning.settings(), control.report());
    let mut link = Link::new(identity, &hardware, operators, entropy, settings, report);
    if let Err(error) = tuning.loaded() {
        link.add_event(control.report().time, Event::SettingsDefaulted);
        // Of values that are out of range the others are in force, and these are assumed.
        if error != LoadError::OutOfRange {
            control.raise(Fault::Settings);
        }
    }
    let report = control.report();
    let slow = SlowHalf {
        alignments: report.alignments,
        offered: tuning.revision(),
        hardware,
        tuning,
        link,
    };
    let fast = FastHalf { control, ticks_to_report: 0, sample: None };
    (fast, slow, report)
}

/// The fast loop: everything that must not wait.
pub struct FastHalf {
    control: Control,
    ticks_to_report: u8,
    /// What the last tick left for the scope.
    sample: Option<Sample>,
}

impl FastHalf {
    /// Takes what the slow half asks for, does one tick, and reports in every tenth. Never panics,
    /// unless `exchange` does.
    #[inline]
    pub fn tick(
        &mut self,
        now: Instant,
        sensors: &Sensors,
        exchange: &mut impl Access,
    ) -> Actuation {
        let control = &mut self.control;
        let sample = self.sample.take();
        let (asked, channels, revision) = exchange.with(|exchange| {
            if let Some(sample) = &sample {
                exchange.scope.record(sample);
            }
            let channels = exchange.scope.plan().channels.clone();
            let revision = exchange.scope.revision();
            (exchange.take(|new| control.configure(new)), channels, revision)
        });
        let actuation = control.tick(now, sensors, &asked);
        self.sample = Some(control.sample(&channels, revision));
        if self.ticks_to_report == 0 {
            self.ticks_to_report = REPORT_INTERVAL;
            let report = control.report();
            exchange.with(|exchange| exchange.report(report));
        }
        self.ticks_to_report -= 1;
        actuation
    }
}

/// Link, settings and telemetry: everything that may take its time.
pub struct SlowHalf<S> {
    hardware: Hardware,
    /// Robot's end of the link.
    pub link: Link,
    tuning: Tuning<S>,
    /// Revision of the settings that were handed over last.
    offered: u16,
    alignments: u8,
}

impl<S: SettingsStore> SlowHalf<S> {
    /// Takes the newest report, and hands over what is asked, with a configuration where the settings
    /// changed. Call at least every 10 ms, and soon after each [`SlowHalf::receive`].
    pub fn exchange(&mut self, exchange: &mut impl Access) {
        let observed = self.report().timing.ticks;
        let (report, waiting) = exchange.with(|exchange| {
            let report = exchange.newest_report();
            let is_new = report.timing.ticks != observed;
            (is_new.then_some(*report), exchange.is_configuration_waiting())
        });
        while self.link.asks_scope() {
            exchange.with(|exchange| self.link.consult(&mut exchange.scope));
        }
        let learnt = report.is_some_and(|report| self.observe(&report));
        let revision = self.tuning.revision();
        // The fast half knows what it found; a configuration that waits for it does not.
        let is_outdated = self.offered != revision || (waiting && learnt);
        self.offered = revision;
        let configuration =
            is_outdated.then(|| Configuration::new(self.tuning.settings(), &self.hardware));
        exchange.with(|exchange| exchange.ask(*self.link.asked(), configuration.as_ref()));
    }

    /// Takes over how the fast half is; returns whether it has aligned since the last report.
    fn observe(&mut self, report: &Report) -> bool {
        self.link.observe(report);
        let learnt = report.alignments != self.alignments;
        if learnt {
            self.alignments = report.alignments;
            self.tuning.learn(report.alignment);
        }
        if self.link.may_write() && self.tuning.save_learnt() == Ok(true) {
            self.link.add_event(report.time, Event::SettingsSaved);
        }
        learnt
    }

    /// Returns how the fast half was at the last exchange.
    #[must_use]
    pub const fn report(&self) -> &Report {
        self.link.report()
    }

    /// Takes a datagram that came from `from`, and returns whether its operator sent it just now. Never panics.
    pub fn receive(&mut self, now: Instant, from: SocketAddr, datagram: &[u8]) -> bool {
        self.link.receive(now, from, datagram, &mut self.tuning)
    }

    /// Returns the next datagram to send, and to whom. Call until `None`, after each datagram received and
    /// whenever [`SlowHalf::poll_at`] says.
    pub fn transmit(&mut self, now: Instant, frame: &mut Frame) -> Option<SocketAddr> {
        self.link.transmit(now, self.tuning.settings(), frame)
    }

    /// Returns when there will be something to transmit, unless ticks or datagrams change that.
    #[must_use]
    pub fn poll_at(&self, now: Instant) -> Option<Instant> {
        self.link.poll_at(now)
    }

    /// Returns the settings in force.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        self.tuning.settings()
    }

    /// Takes another name and other operators: ends the session and disarms, unless its holder is among
    /// them.
    pub fn provision(&mut self, name: &str, operators: impl Into<Operators>) {
        self.link.set_name(name);
        self.link.set_operators(operators);
    }
}
