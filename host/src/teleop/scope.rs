//! The scope on a screen: captures and fetches over the running link, while the robot may be driven.

use flix_protocol::message::{
    Command, Outcome, ScopeCommand, ScopePlan, ScopeState, ScopeStatus, Trigger,
};
use flix_protocol::units::Instant;

use crate::link::Client;
use crate::scope::{Capture, WishError, channels, trigger};

/// Capture that an operator wants to see.
#[derive(Debug, Clone, PartialEq)]
pub enum Wish {
    /// A new capture.
    Plan(ScopePlan),
    /// The robot's capture of the last fault.
    Last,
}

impl Wish {
    /// Parses channels and a trigger as `flix scope` does, with half of the rows before a trigger that is waited
    /// for; `last` instead of the trigger is [`Wish::Last`].
    ///
    /// # Errors
    /// When they are none.
    pub fn parse(names: &str, when: &str) -> Result<Self, WishError> {
        if when.trim() == "last" {
            return Ok(Self::Last);
        }
        let mut chosen = channels(names)?;
        let trigger = trigger(when, &mut chosen)?;
        let plan = ScopePlan { channels: chosen.into_iter().collect(), trigger, before: 0 };
        let before = if trigger == Trigger::Now { 0 } else { plan.rows() / 2 };
        Ok(Self::Plan(ScopePlan { before, ..plan }))
    }
}

/// A capture that is under way, and the newest that is complete.
#[derive(Debug, Clone, Default)]
pub struct Viewer {
    newest: Option<Capture>,
    revision: u32,
    step: Option<Step>,
}

#[derive(Debug, Clone)]
enum Step {
    /// Asked how far it is; `is_new` after a plan of ours.
    Asked {
        request: u32,
        is_new: bool,
    },
    /// It is not complete; the next telemetry is the time to ask again.
    Waits,
    Reading {
        request: u32,
        capture: Capture,
        is_new: bool,
    },
}

/// Subject of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answered {
    /// One of many steps.
    Step,
    /// A capture is complete and here.
    Capture,
    /// There is nothing to fetch.
    Nothing,
    /// The robot refused it.
    Refused,
}

impl Viewer {
    /// Returns the newest capture.
    #[must_use]
    pub const fn newest(&self) -> Option<&Capture> {
        self.newest.as_ref()
    }

    /// Returns a number that grows with each capture.
    #[must_use]
    pub const fn revision(&self) -> u32 {
        self.revision
    }

    /// Begins this capture, and gives up the one under way.
    pub fn begin(&mut self, wish: Wish, client: &mut Client, now: Instant) {
        let (command, is_new) = match wish {
            Wish::Plan(plan) => (ScopeCommand::Begin(plan), true),
            Wish::Last => (ScopeCommand::Status, false),
        };
        let request = client.request(now, Command::Scope(command));
        self.step = Some(Step::Asked { request, is_new });
    }

    /// Gives up the capture under way, as after a lost connection.
    pub fn give_up(&mut self) {
        self.step = None;
    }

    /// Takes that a request was not answered.
    pub fn unanswered(&mut self, request: u32) {
        self.step.take_if(|step| step.request() == Some(request));
    }

    /// Asks again how far a capture is. Call it with each telemetry.
    pub fn look(&mut self, client: &mut Client, now: Instant) {
        if matches!(self.step, Some(Step::Waits)) {
            let request = client.request(now, Command::Scope(ScopeCommand::Status));
            self.step = Some(Step::Asked { request, is_new: true });
        }
    }

    /// Takes the answer to a request; `None` when it was not of the scope.
    pub fn answered(
        &mut self,
        request: u32,
        outcome: &Outcome,
        client: &mut Client,
        now: Instant,
    ) -> Option<Answered> {
        let step = self.step.take_if(|step| step.request() == Some(request))?;
        Some(match (step, outcome) {
            (Step::Asked { is_new, .. }, Outcome::Scope(status)) => {
                self.take_status(status, is_new, client, now)
            }
            (Step::Reading { mut capture, is_new, .. }, Outcome::ScopeRows(rows)) => {
                if capture.take(rows) {
                    self.read_on(capture, is_new, client, now)
                } else {
                    Answered::Refused
                }
            }
            _ => Answered::Refused,
        })
    }

    fn take_status(
        &mut self,
        status: &ScopeStatus,
        is_new: bool,
        client: &mut Client,
        now: Instant,
    ) -> Answered {
        if status.state == ScopeState::Complete {
            return self.read_on(Capture::new(status.clone()), is_new, client, now);
        }
        if !is_new {
            return Answered::Nothing;
        }
        self.step = Some(Step::Waits);
        Answered::Step
    }

    fn read_on(
        &mut self,
        capture: Capture,
        is_new: bool,
        client: &mut Client,
        now: Instant,
    ) -> Answered {
        if let Some(first) = capture.wanted() {
            let request = client.request(now, Command::Scope(ScopeCommand::Read(first)));
            self.step = Some(Step::Reading { request, capture, is_new });
            return Answered::Step;
        }
        if is_new {
            // It watches for faults again.
            client.request(now, Command::Scope(ScopeCommand::Begin(ScopePlan::watch())));
        }
        self.newest = Some(capture);
        self.revision += 1;
        Answered::Capture
    }
}

impl Step {
    const fn request(&self) -> Option<u32> {
        match self {
            Self::Asked { request, .. } | Self::Reading { request, .. } => Some(*request),
            Self::Waits => None,
        }
    }
}
