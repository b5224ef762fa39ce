//! The open pages: one drives, all watch, and all may stop.
//!
//! The page that drives is an operator. Without a sign of life for [`SIGN_OF_LIFE`] the robot rests, without one for
//! [`LINK_LOST`] it is disarmed, as the robot itself does with a silent link. The walk does not go on by itself
//! afterwards: the operator commands anew.

use std::collections::{BTreeSet, VecDeque};
use std::time::Duration;

use flix_protocol::failsafe::{COMMAND_DEADLINE, LINK_LOST};
use flix_protocol::message::Setpoint;
use flix_protocol::units::Instant;

use super::message::{Message, Request};
use crate::link::Client;
use crate::teleop::Cockpit;
use crate::teleop::action::Action;
use crate::teleop::cockpit::Weight;
use crate::teleop::scope::Wish;

/// Age from which a message is no sign of life: the robot's own deadline for commands.
pub const SIGN_OF_LIFE: Duration = COMMAND_DEADLINE;

/// Presses of STOP that are remembered.
const PRESSES: usize = 16;

/// Number of a page, never used again.
pub type PageId = u32;

/// The open pages.
#[derive(Debug, Clone, Default)]
pub struct Pages {
    open: BTreeSet<PageId>,
    /// The newest presses by which pages have asked for a stop.
    presses: VecDeque<u32>,
    driver: Option<Driver>,
}

/// The page that drives.
#[derive(Debug, Clone, Copy)]
struct Driver {
    page: PageId,
    /// Time of the newest snapshot that it has shown.
    seen: Instant,
    is_silent: bool,
    /// Silent for so long that the robot was disarmed.
    is_lost: bool,
}

impl Driver {
    const fn new(page: PageId, seen: Instant) -> Self {
        Self { page, seen, is_silent: false, is_lost: false }
    }
}

/// A page sent a message that no page sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Misuse;

impl Pages {
    /// Returns the stamp of a snapshot that is taken now, ms.
    #[must_use]
    pub const fn stamp(now: Instant) -> u64 {
        now.as_micros() / 1000
    }

    /// Returns the page that drives.
    #[must_use]
    pub fn driver(&self) -> Option<PageId> {
        self.driver.map(|driver| driver.page)
    }

    /// Returns the number of open pages.
    #[must_use]
    pub fn count(&self) -> usize {
        self.open.len()
    }

    /// Returns the newest presses by which pages have asked for a stop: these were heard.
    #[must_use]
    pub const fn presses(&self) -> &VecDeque<u32> {
        &self.presses
    }

    /// Takes a page that was opened; it drives if no other does.
    pub fn open(&mut self, page: PageId, now: Instant) {
        self.open.insert(page);
        if self.driver.is_none() {
            self.driver = Some(Driver::new(page, now));
        }
    }

    /// Takes that a page is closed: without its operator the robot is disarmed.
    pub fn close(
        &mut self,
        page: PageId,
        cockpit: &mut Cockpit,
        client: &mut Client,
        now: Instant,
    ) {
        self.open.remove(&page);
        if self.driver.take_if(|driver| driver.page == page).is_some() {
            disarm(cockpit, client, now, "the page that drove is closed: the robot is disarmed");
        }
    }

    /// Ends a page that sent a message that no page sends, and stops the robot. A number that is not open is passed over.
    pub fn expel(
        &mut self,
        page: PageId,
        cockpit: &mut Cockpit,
        client: &mut Client,
        now: Instant,
    ) {
        if !self.open.contains(&page) {
            return;
        }
        cockpit.act(Action::Stop, now, client, now);
        cockpit.note(now, Weight::Alarm, "a page sent what no page sends: it is closed");
        self.close(page, cockpit, client, now);
    }

    /// Takes a message of a page; one of a page that is not open, as it was expelled, is passed over.
    ///
    /// # Errors
    /// When it claims to have seen a picture that is not shown yet.
    pub fn receive(
        &mut self,
        page: PageId,
        message: Message,
        cockpit: &mut Cockpit,
        client: &mut Client,
        now: Instant,
    ) -> Result<(), Misuse> {
        if !self.open.contains(&page) {
            return Ok(());
        }
        if message.seen > Self::stamp(now) {
            return Err(Misuse);
        }
        let seen = Instant::from_micros(message.seen * 1000);
        let is_fresh = now.since(seen) <= SIGN_OF_LIFE;
        let driver = self.driver.as_mut().filter(|driver| driver.page == page);
        let drives = driver.is_some();
        if let Some(driver) = driver.filter(|_| is_fresh) {
            driver.seen = driver.seen.max(seen);
            (driver.is_silent, driver.is_lost) = (false, false);
        }
        let was_heard = message.press.is_some_and(|press| self.presses.contains(&press));
        match message.request {
            Some(Request::Attend) if drives && is_fresh => cockpit.attend(now),
            None | Some(Request::Attend) => {}
            // A stop that is repeated for want of an answer does not stop a robot that was cleared meanwhile.
            Some(Request::Act(Action::Stop)) if was_heard => {}
            Some(Request::Act(Action::Stop)) => {
                cockpit.act(Action::Stop, seen, client, now);
                self.presses.extend(message.press);
                self.presses.drain(..self.presses.len().saturating_sub(PRESSES));
            }
            Some(Request::Act(action @ (Action::Rest | Action::Disarm))) if drives => {
                cockpit.act(action, seen, client, now);
            }
            Some(_) if !is_fresh => {
                let text = "not done: the page or its connection was too slow; try again";
                cockpit.note(now, Weight::Warning, text);
            }
            Some(Request::Drive) if !drives => {
                rest(cockpit, client, now);
                client.give_up(now);
                self.driver = Some(Driver::new(page, seen));
                cockpit.note(now, Weight::Note, "another page drives now");
            }
            Some(Request::Drive) => {}
            Some(Request::Settings) => cockpit.settings.read(client, now),
            Some(Request::Act(action)) if drives => cockpit.act(action, seen, client, now),
            Some(Request::Set(name, value)) if drives => {
                if let Err(why) = cockpit.settings.set(name, &value, client, now) {
                    cockpit.note(now, Weight::Warning, &format!("not done: {why}"));
                }
            }
            Some(Request::Save) if drives => cockpit.settings.save(client, now),
            Some(Request::Scope(channels, when)) if drives => match Wish::parse(&channels, &when) {
                Ok(wish) => cockpit.scope.begin(wish, client, now),
                Err(error) => cockpit.note(now, Weight::Warning, &error.to_string()),
            },
            Some(Request::Act(_) | Request::Set(..) | Request::Save | Request::Scope(..)) => {
                let text = match self.driver {
                    Some(_) => "not done: another page drives",
                    None => "not done: no page drives: take over first",
                };
                cockpit.note(now, Weight::Warning, text);
            }
        }
        Ok(())
    }

    /// Lets the robot rest, then disarms it, when the page that drives is silent. Call it some hundred times a second.
    pub fn watch(&mut self, cockpit: &mut Cockpit, client: &mut Client, now: Instant) {
        let Some(driver) = &mut self.driver else { return };
        let silence = now.since(driver.seen);
        if silence > SIGN_OF_LIFE && !driver.is_silent {
            driver.is_silent = true;
            if cockpit.setpoint != Setpoint::REST {
                rest(cockpit, client, now);
                let text = "the page that drives is hidden, or too slow: the robot rests";
                cockpit.note(now, Weight::Warning, text);
            }
        }
        if silence > LINK_LOST && !driver.is_lost {
            driver.is_lost = true;
            disarm(cockpit, client, now, "the page that drives is silent: the robot is disarmed");
        }
    }
}

fn rest(cockpit: &mut Cockpit, client: &mut Client, now: Instant) {
    if cockpit.setpoint != Setpoint::REST {
        cockpit.act(Action::Rest, now, client, now);
    }
}

/// Disarms the robot unless its newest telemetry states that it is disarmed, because an armed robot may stay armed with nothing
/// held. Ends requests that are not done yet.
fn disarm(cockpit: &mut Cockpit, client: &mut Client, now: Instant, why: &str) {
    client.give_up(now);
    if client.is_driving() || !cockpit.telemetry.as_ref().is_none_or(|it| it.state.is_idle()) {
        cockpit.act(Action::Disarm, now, client, now);
        cockpit.note(now, Weight::Alarm, why);
    }
}
