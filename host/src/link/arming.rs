//! Arms a robot: asks until it obeys, then waits until its motors are aligned.

use flix_protocol::message::{Command, Outcome, Refusal, State, Telemetry};
use flix_protocol::units::Instant;

use super::{Client, LinkError, TELEMETRY_LAG, TRY_AGAIN, Update, passes_by_itself};

/// How often a robot is armed again whose motors coast because commands stayed away while it aligned them.
const MOST_ARMINGS: u32 = 3;

/// A robot that is being armed, without a clock and a socket. The first request also [holds](Client::hold) rest, whose
/// repetition keeps an armed robot armed.
#[derive(Debug, Clone, PartialEq)]
pub struct Arming {
    phase: Phase,
    deadline: Instant,
    /// How many halts the robot had stated when it was asked last.
    halts: u8,
    /// How often it was armed again.
    again: u32,
    /// Why it has not obeyed yet.
    refusal: Option<Refusal>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// Waits for the answer to this request.
    Asking(u32),
    /// Asks again then.
    Waiting(Instant),
    /// Its motors are aligned; it was armed then.
    Aligning(Instant),
}

impl Arming {
    /// Asks a robot that is connected to arm; gives it up at `deadline`.
    #[must_use]
    pub fn begin(now: Instant, client: &mut Client, deadline: Instant) -> Self {
        let mut arming =
            Self { phase: Phase::Waiting(now), deadline, halts: 0, again: 0, refusal: None };
        arming.ask(now, client);
        arming
    }

    fn ask(&mut self, now: Instant, client: &mut Client) {
        self.halts = client.halts();
        self.phase = Phase::Asking(client.request(now, Command::Arm));
    }

    /// Returns whether the robot has obeyed, and is aligning its motors.
    #[must_use]
    pub const fn is_obeyed(&self) -> bool {
        matches!(self.phase, Phase::Aligning(_))
    }

    /// Takes an update of the client; returns how arming has ended, once it has.
    pub fn observe(
        &mut self,
        now: Instant,
        client: &Client,
        update: &Update,
    ) -> Option<Result<(), LinkError>> {
        match (update, self.phase) {
            (Update::Answer { request, outcome }, Phase::Asking(asked)) if *request == asked => {
                if let Outcome::Refused(refusal) = outcome {
                    return self.refused(now, client, refusal).map(Err);
                }
                self.phase = Phase::Aligning(now);
            }
            (Update::Unanswered { request }, Phase::Asking(asked)) if *request == asked => {
                (self.phase, self.refusal) = (Phase::Waiting(now), None);
            }
            (Update::Telemetry(telemetry), Phase::Aligning(since)) => {
                return self.hear(now, telemetry, since);
            }
            // The robot answers sooner than it states its halt.
            (Update::Telemetry(telemetry), Phase::Waiting(_))
                if self.refusal == Some(Refusal::Rested) && telemetry.halts != self.halts =>
            {
                self.phase = Phase::Waiting(now);
            }
            _ => {}
        }
        None
    }

    /// Asks again where that is due. Returns why the robot is given up, once it is.
    pub fn poll(&mut self, now: Instant, client: &mut Client) -> Option<LinkError> {
        if now > self.deadline {
            let actual = client.telemetry().map_or(State::Disarmed, |it| it.state);
            return Some(match (&self.refusal, self.phase) {
                (Some(refusal), _) => LinkError::Refused(refusal.clone()),
                (None, Phase::Aligning(_)) => LinkError::State { wanted: State::Armed, actual },
                (None, Phase::Asking(_) | Phase::Waiting(_)) => LinkError::Unanswered,
            });
        }
        if let Phase::Waiting(until) = self.phase
            && now >= until
        {
            self.ask(now, client);
        }
        None
    }

    /// Takes a refusal; returns why arming ends by it, if it does.
    fn refused(&mut self, now: Instant, client: &Client, refusal: &Refusal) -> Option<LinkError> {
        let until = match refusal {
            // By whom it is stopped comes with telemetry.
            Refusal::Stopped if client.telemetry().is_none() => now + TRY_AGAIN,
            refusal if passes_by_itself(refusal) => now + TRY_AGAIN,
            Refusal::Rested if self.again < MOST_ARMINGS => {
                self.again += 1;
                if client.halts() == self.halts { now + TELEMETRY_LAG } else { now }
            }
            Refusal::Stopped if let Some(by) = client.stopped_by() => {
                return Some(LinkError::StoppedBy(by));
            }
            refusal => return Some(LinkError::Refused(refusal.clone())),
        };
        (self.phase, self.refusal) = (Phase::Waiting(until), Some(refusal.clone()));
        None
    }

    /// Takes telemetry of a robot that has obeyed; returns how arming has ended, once it has.
    fn hear(
        &mut self,
        now: Instant,
        telemetry: &Telemetry,
        since: Instant,
    ) -> Option<Result<(), LinkError>> {
        match telemetry.state {
            State::Faulted => Some(Err(LinkError::faulted(telemetry))),
            _ if let Some(by) = telemetry.stopped_by => Some(Err(LinkError::StoppedBy(by))),
            State::Armed | State::Running => Some(Ok(())),
            // Commands stayed away while the motors were aligned, which is over.
            State::Disarmed if telemetry.halts != self.halts => {
                if self.again == MOST_ARMINGS {
                    return Some(Err(LinkError::Lapsed));
                }
                self.again += 1;
                self.phase = Phase::Waiting(now);
                None
            }
            // Telemetry from before the answer, at first.
            State::Disarmed if now.since(since) > TELEMETRY_LAG => {
                Some(Err(LinkError::State { wanted: State::Armed, actual: State::Disarmed }))
            }
            State::Disarmed | State::Aligning | State::Stopping => None,
        }
    }
}
