//! The world: the robot, two clients, and the datagrams between them; halts, and orders that arrive.

use std::fmt;

use crate::client::Client;
use crate::goal::Goal;
use crate::invariant::Invariant;
use crate::model::{Change, Model};
use crate::network::{Datagram, Telemetry, UnderWay};
use crate::order::{Age, Order, Word};
use crate::robot::{Halt, Mode, Robot, Session};

/// Names of the operators.
pub(crate) const OPERATORS: [&str; 2] = ["anna", "bob"];

/// A moment, or a counter, after all others of a [canonical](crate::canonical) world.
pub(crate) const NOW: u8 = 40;

/// A state of everything.
#[derive(Clone, Copy, Debug, Default, Hash, PartialEq, Eq)]
pub struct World {
    /// The robot.
    pub robot: Robot,
    /// The clients of both operators.
    pub clients: [Client; 2],
    /// Datagrams to the robot.
    pub up: UnderWay<Datagram>,
    /// Telemetry to the clients.
    pub down: UnderWay<Telemetry>,
    /// In a run without further halts: what the press of `actor` has to reach.
    pub goal: Option<Goal>,
    /// Operator whose press is to take effect: 0 or 1.
    pub actor: u8,
    /// The invariant that the last step broke.
    pub broken: Option<Invariant>,
}

impl World {
    /// Counts a halt: every order and every screen is of before. `counts`: every permit is an old permit, too.
    pub(crate) fn halt(&mut self, model: &Model, halt: Halt, counts: bool) {
        self.robot.halt = halt;
        let older = |age: Age| match age {
            _ if !counts => age,
            Age::Previous if model.has(Change::OneBit) => Age::Present,
            _ if model.has_programs => age.next(),
            _ => Age::Previous,
        };
        let orders = self.up.all_mut().iter_mut().map(|it| &mut it.order);
        let orders = orders.chain(self.clients.iter_mut().map(|it| &mut it.order));
        for order in orders.chain([&mut self.robot.order]) {
            (order.is_unseen, order.age) = (true, older(order.age));
        }
        for client in &mut self.clients {
            (client.is_unseen, client.age) = (true, older(client.age));
        }
        for telemetry in self.down.all_mut() {
            (telemetry.is_unseen, telemetry.age) = (true, older(telemetry.age));
        }
        self.robot.is_unreported |= counts;
    }

    /// Gives a datagram to the robot. `is_late`: its order is too old, so that it acts only where its word calms.
    ///
    /// A late `Off` or `Stop` leaves no state whose end a sign of life could put off, so it makes no difference whether the robot
    /// takes it for one.
    ///
    /// # Errors
    ///
    /// The invariant that breaks.
    pub(crate) fn take(
        &mut self,
        model: &Model,
        datagram: &Datagram,
        is_late: bool,
    ) -> Result<(), Invariant> {
        let mut order = datagram.order;
        if order.word == Word::StopFromOutside {
            self.robot.calmed = self.robot.calmed.max(order.pressed);
            self.robot.is_stopped = true;
            self.halt(model, Halt::Other, true);
            self.robot.rest();
            return Ok(());
        }
        if datagram.session != Session::Present && !model.has(Change::NoSession) {
            return Ok(());
        }
        let is_overtaken = datagram.counter < self.robot.newest && !model.has(Change::NoCounter);
        if is_overtaken && !counts_in_any_order(model, order.word) {
            return Ok(());
        }
        order.is_expired = is_late;
        if order.word.calms() {
            self.robot.calmed = self.robot.calmed.max(order.pressed);
        }
        let is_withheld = if order.word.calms() {
            is_late && model.has(Change::LateStopWithheld)
        } else {
            is_late && !model.has(Change::ExpiredBegins)
        };
        if !is_withheld {
            self.act(model, datagram, order, is_overtaken)?;
        }
        if order.word.calms() && self.robot.mode.is_driven() { Err(Invariant::I2) } else { Ok(()) }
    }

    /// Puts an order in force.
    fn act(
        &mut self,
        model: &Model,
        datagram: &Datagram,
        order: Order,
        is_overtaken: bool,
    ) -> Result<(), Invariant> {
        if order.word == Word::Stop {
            let client = &mut self.clients[usize::from(datagram.sender)];
            let is_this_stop = client.order.word == Word::Stop
                && client.stop_since != 0
                && datagram.counter >= client.stop_since
                && datagram.session == client.session;
            client.is_stop_received |= is_this_stop;
            if !self.robot.is_stopped && model.has(Change::StopInAnyOrder) {
                self.halt(model, Halt::Other, true);
            }
            self.robot.is_stopped = true;
        }
        let ends_trial = self.robot.mode == Mode::Trying && order.word != Word::Try;
        let is_own_off = order.word == Word::Off && self.robot.mode.is_driven();
        let reported = if self.robot.is_unreported { Age::Previous } else { Age::Present };
        if !is_overtaken {
            let robot = &mut self.robot;
            robot.newest = robot.newest.max(datagram.counter);
            (robot.order, robot.is_late) = (order, false);
            (robot.giver, robot.giver_session) = (datagram.sender, datagram.session);
            robot.is_approved = model.has(Change::SlowHalfChecks) && order.age == reported;
        }
        if ends_trial && model.has(Change::OwnEndOfTrialCounts)
            || is_own_off && model.has(Change::OwnOffCounts)
        {
            self.halt(model, Halt::Tried, true);
        }
        let robot = &mut self.robot;
        if is_overtaken {
            robot.order = Order::default();
            robot.rest();
            return Ok(());
        }
        robot.obey(model)
    }

    /// Ends the session of both ends. Its telemetry is dropped, because no client can read it any more.
    pub(crate) fn end_sessions(&mut self) {
        for session in self.clients.iter_mut().map(|it| &mut it.session) {
            *session = session.ended();
        }
        for session in self.up.all_mut().iter_mut().map(|it| &mut it.session) {
            *session = session.ended();
        }
        self.down = UnderWay::default();
    }
}

impl Session {
    fn ended(self) -> Self {
        if self == Self::Present { Self::Ended } else { self }
    }
}

/// Returns whether an order counts although a newer order was received.
pub(crate) fn counts_in_any_order(model: &Model, word: Word) -> bool {
    word == Word::Stop && model.has(Change::StopInAnyOrder)
        || word == Word::Off && model.has(Change::OffInAnyOrder)
}

impl fmt::Display for World {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let robot = &self.robot;
        write!(f, "{:?}", robot.mode)?;
        if robot.faults > 1 {
            write!(f, " by {}", robot.faults)?;
        }
        f.write_str(if robot.is_stopped { " stopped" } else { "" })?;
        f.write_str(if robot.is_late { " late" } else { "" })?;
        write!(f, ", order {}", robot.order)?;
        for (name, client) in OPERATORS.iter().zip(&self.clients) {
            match client.session {
                Session::None => {}
                _ if client.has_telemetry => {
                    write!(f, "; {name} {}, shown {:?}", client.order, client.age)?
                }
                _ => write!(f, "; {name} {}, shown nothing", client.order)?,
            }
        }
        Ok(())
    }
}

impl fmt::Display for Order {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.word.needs_permit() || self.word == Word::Next {
            write!(f, "{:?}({:?})", self.word, self.age)
        } else {
            write!(f, "{:?}", self.word)
        }
    }
}
