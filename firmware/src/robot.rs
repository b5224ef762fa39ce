//! The whole robot's software, the one entry for chips and simulator.
//!
//! [`Robot`] is everything in one place, for whoever runs on one thread. Where the fast loop has a
//! priority or a core of its own, [`Robot::into_halves`] gives the two halves:
//!
//! ```text
//!            every tick, 10 kHz                        when there is something to do
//! Sensors -> Control::tick -> Actuation       datagrams -> SlowHalf::receive
//!               ^      |                      datagrams <- SlowHalf::transmit, poll_at
//!               |      +---- Report, Copy ------------> SlowHalf::observe
//!               +----------- Order, Copy -------------- SlowHalf::order
//!               +----------- Configuration, Copy ------ SlowHalf::configuration
//! ```
//!
//! Whole values cross, each overwriting the one before, so a lock is held for one copy and neither
//! half ever waits for the other: cryptography and flash never delay a tick. A configuration must be
//! handed over ([`Control::configure`]) before the order that came with it.

use core::net::SocketAddr;

use flix_protocol::frame::Frame;
use flix_protocol::message::{Event, Fault, LinkQuality};
use flix_protocol::session::Key;
use flix_protocol::units::Instant;

use crate::exchange::{Order, Report};
use crate::fast::configuration::Configuration;
use crate::fast::control::Control;
use crate::hardware::{Actuation, Hardware, Sensors, SettingsStore};
use crate::link::{Link, identity, is_idle};
use crate::settings::{Settings, Tuning};

/// What a robot without a key says at boot; the operator's program says the same.
pub const UNPROVISIONED: &str = "this robot has no key yet and refuses the network; connect it by USB and run: flix provision --port PORT --ssid NETWORK";

/// What a robot is called that nobody has named yet.
pub const UNNAMED: &str = "flix-walker";

/// Ticks between two reports to the slow half: 1 ms, far below every deadline.
const REPORT_INTERVAL: u8 = 10;

/// The whole robot's software.
pub struct Robot<S> {
    control: Control,
    slow: SlowHalf<S>,
    ticks_to_report: u8,
}

impl<S: SettingsStore> Robot<S> {
    /// At power-up: disarmed, with the settings that `store` holds.
    ///
    /// `name` is told to operators (at most 32 bytes of it). Without a key the robot refuses every
    /// operator. `entropy` must come from a hardware random source, fresh at every start.
    /// When the stored settings cannot be trusted the defaults are in force and
    /// [`Fault::Settings`] stands until it is cleared.
    pub fn new(
        hardware: Hardware,
        name: &str,
        key: Option<Key>,
        entropy: [u8; 32],
        store: S,
    ) -> Self {
        let tuning = Tuning::new(store);
        let parameters = tuning.settings().parameters();
        let mut control = Control::new(Configuration::new(&parameters, &hardware));
        let mut link = Link::new(identity(name, &hardware), key, entropy, control.report());
        if tuning.loaded().is_err() {
            link.tell(control.report().time, Event::SettingsDefaulted);
            control.raise(Fault::Settings);
        }
        let slow = SlowHalf {
            alignments: control.report().alignments,
            applied: tuning.revision(),
            hardware,
            tuning,
            link,
        };
        Self { control, slow, ticks_to_report: 0 }
    }

    /// One tick of the fast loop, [`TICK_RATE_HZ`](crate::hardware::TICK_RATE_HZ) times a second.
    pub fn tick(&mut self, now: Instant, sensors: &Sensors) -> Actuation {
        if let Some(offer) = self.slow.configuration()
            && self.control.configure(&offer.configuration)
        {
            self.slow.configured(offer.revision);
        }
        let actuation = self.control.tick(now, sensors, &self.slow.order());
        if self.ticks_to_report == 0 {
            self.ticks_to_report = REPORT_INTERVAL;
            self.slow.observe(&self.control.report());
        }
        self.ticks_to_report -= 1;
        actuation
    }

    /// Takes a datagram that came from `from`. Never panics.
    pub fn receive(&mut self, now: Instant, from: SocketAddr, datagram: &[u8]) {
        self.slow.receive(now, from, datagram);
    }

    /// The next datagram to send, and to whom. Call until `None`, after each datagram received and
    /// whenever [`Robot::poll_at`] says.
    pub fn transmit(&mut self, now: Instant, frame: &mut Frame) -> Option<SocketAddr> {
        self.slow.transmit(now, frame)
    }

    /// When there will be something to transmit, unless ticks or datagrams change that.
    #[must_use]
    pub fn poll_at(&self, now: Instant) -> Option<Instant> {
        self.slow.poll_at(now)
    }

    /// How the fast half is, as of the last tick.
    #[must_use]
    pub fn report(&self) -> Report {
        self.control.report()
    }

    /// In force.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        self.slow.settings()
    }

    /// As [`SlowHalf::order`].
    #[must_use]
    pub const fn order(&self) -> Order {
        self.slow.order()
    }

    /// As [`SlowHalf::operator`].
    #[must_use]
    pub fn operator(&self, now: Instant) -> Option<SocketAddr> {
        self.slow.operator(now)
    }

    /// As [`SlowHalf::quality`].
    #[must_use]
    pub fn quality(&self, now: Instant) -> LinkQuality {
        self.slow.quality(now)
    }

    /// As [`SlowHalf::provision`].
    pub fn provision(&mut self, name: &str, key: Option<Key>) {
        self.slow.provision(name, key);
    }

    /// The two halves, for a fast loop with a priority or a core of its own.
    #[must_use]
    pub fn into_halves(self) -> (Control, SlowHalf<S>) {
        (self.control, self.slow)
    }
}

/// A configuration for the fast half.
#[derive(Debug, Clone, Copy)]
pub struct Offer {
    /// Names it in [`SlowHalf::configured`].
    pub revision: u16,
    /// For [`Control::configure`].
    pub configuration: Configuration,
}

/// Link, settings and telemetry: everything that may take its time.
pub struct SlowHalf<S> {
    hardware: Hardware,
    link: Link,
    tuning: Tuning<S>,
    /// Revision of the settings that the fast half runs with.
    applied: u16,
    alignments: u8,
}

impl<S: SettingsStore> SlowHalf<S> {
    /// What the fast half is asked for. Copy it over at least every 10 ms.
    #[must_use]
    pub const fn order(&self) -> Order {
        *self.link.order()
    }

    /// What the fast half should be configured with, while it is not yet. Offer it to
    /// [`Control::configure`] until that takes it, then say [`SlowHalf::configured`].
    #[must_use]
    pub fn configuration(&self) -> Option<Offer> {
        let revision = self.tuning.revision();
        (self.applied != revision).then(|| {
            let parameters = self.tuning.settings().parameters();
            Offer { revision, configuration: Configuration::new(&parameters, &self.hardware) }
        })
    }

    /// The fast half has taken over the offer with this revision.
    pub const fn configured(&mut self, revision: u16) {
        self.applied = revision;
    }

    /// Takes over how the fast half is. Call at least every 10 ms.
    pub fn observe(&mut self, report: &Report) {
        self.link.observe(report);
        if report.alignments != self.alignments {
            self.alignments = report.alignments;
            self.tuning.learn(report.alignment);
        }
        if is_idle(report.state) && self.tuning.save_learnt() == Ok(true) {
            self.link.tell(report.time, Event::SettingsSaved);
        }
    }

    /// As [`Robot::receive`].
    pub fn receive(&mut self, now: Instant, from: SocketAddr, datagram: &[u8]) {
        self.link.receive(now, from, datagram, &mut self.tuning);
    }

    /// As [`Robot::transmit`].
    pub fn transmit(&mut self, now: Instant, frame: &mut Frame) -> Option<SocketAddr> {
        self.link.transmit(now, self.tuning.settings(), frame)
    }

    /// As [`Robot::poll_at`].
    #[must_use]
    pub fn poll_at(&self, now: Instant) -> Option<Instant> {
        self.link.poll_at(now)
    }

    /// In force.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        self.tuning.settings()
    }

    /// Who holds the session.
    #[must_use]
    pub fn operator(&self, now: Instant) -> Option<SocketAddr> {
        self.link.operator(now)
    }

    /// How well the robot hears, and what it dropped.
    #[must_use]
    pub fn quality(&self, now: Instant) -> LinkQuality {
        self.link.quality(now)
    }

    /// Whether the robot has a key; without one it refuses the network, see [`UNPROVISIONED`].
    #[must_use]
    pub const fn is_provisioned(&self) -> bool {
        self.link.is_provisioned()
    }

    /// Takes another name and key: ends the session, if any, and disarms.
    pub fn provision(&mut self, name: &str, key: Option<Key>) {
        self.link.set_identity(identity(name, &self.hardware));
        self.link.set_key(key);
    }

    /// Radio power as last received, for telemetry.
    pub fn set_signal(&mut self, dbm: Option<i8>) {
        self.link.set_signal(dbm);
    }
}
