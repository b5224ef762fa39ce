//! A robot over its link: asking, arming, disarming, in whatever time passes.

use std::time::Duration;

use flix_protocol::message::{
    Command, Mark, Name, Outcome, Parameter, ParameterCommand, Refusal, Setpoint, State, Telemetry,
};
use flix_protocol::session::ConnectError;
use flix_protocol::units::Instant;

use super::{
    ARM_PATIENCE, Client, KEEP_ALIVE, LinkError, NotTaken, PASSING_PATIENCE, REQUEST_PATIENCE,
    REVOKED_PATIENCE, TELEMETRY_LAG, TRY_AGAIN, Update, Wish, passes_by_itself,
};

/// Twice the longest time in which a robot ramps down and brakes its rotors.
pub(super) const DISARM_PATIENCE: Duration = Duration::from_secs(2);
/// Longest time between two looks at received datagrams.
pub(super) const LONGEST_WAIT: Duration = Duration::from_millis(20);

/// A robot over its link: on a socket in real time ([`super::udp::Connection`]), or simulated. Implement
/// [`operate`](RobotLink::operate) and [`wait`](RobotLink::wait); every other method is provided.
///
/// | request | asked again | a refusal is |
/// |---|---|---|
/// | [`request`](RobotLink::request) | no | an answer |
/// | [`insist`](RobotLink::insist) | while the robot's state passes by itself | an answer |
/// | [`ask`](RobotLink::ask) | while the robot's state passes by itself | an error |
///
/// A method that waits in a session ends with the session, with [`LinkError::Connect`], [`LinkError::Revoked`],
/// [`LinkError::Silent`], [`LinkError::Back`] or [`LinkError::Left`], and with the error of [`RobotLink::wait`] where time does not
/// pass any more.
pub trait RobotLink {
    /// Why the robot did not do as asked.
    type Error: From<LinkError>;

    /// Returns the client, to command it, and its present time.
    fn operate(&mut self) -> (&mut Client, Instant);

    /// Lets time pass, for at most `longest` where that can be chosen, and datagrams travel.
    ///
    /// # Errors
    /// When the network fails permanently, a simulation cannot go on, or the program is interrupted.
    fn wait(&mut self, longest: Duration) -> Result<(), Self::Error>;

    /// Returns why there is no session, by why the client failed to connect.
    fn no_session(&self, error: ConnectError) -> LinkError {
        LinkError::Connect(error)
    }

    /// Runs until `look` returns a value: it is shown each update, and `None` whenever all have been shown. Goes on where a session
    /// is lost. `deadline` bounds the wait between two looks, and ends nothing by itself.
    ///
    /// # Errors
    /// When time does not pass any more.
    fn look_until<T>(
        &mut self,
        deadline: Instant,
        mut look: impl FnMut(&mut Client, Instant, Option<&Update>) -> Option<T>,
    ) -> Result<T, Self::Error> {
        loop {
            let (client, now) = self.operate();
            while let Some(update) = client.update() {
                if let Some(found) = look(client, now, Some(&update)) {
                    return Ok(found);
                }
            }
            if let Some(found) = look(client, now, None) {
                return Ok(found);
            }
            self.wait(deadline.since(now).min(LONGEST_WAIT))?;
        }
    }

    /// Runs as [`RobotLink::look_until`] does, in this session alone.
    ///
    /// # Errors
    /// When the session ends.
    fn look_in_session<T>(
        &mut self,
        deadline: Instant,
        mut look: impl FnMut(&mut Client, Instant, Option<&Update>) -> Option<T>,
    ) -> Result<T, Self::Error> {
        let found = self.look_until(deadline, |client, now, update| {
            let found = look(client, now, update).map(Ok);
            let ends = |it: &&Update| matches!(it, Update::Failed(_) | Update::Lost | Update::Left);
            found.or_else(|| update.filter(ends).cloned().map(Err))
        })?;
        found.map_err(|ended| {
            let why = match ended {
                Update::Failed(error) => self.no_session(error),
                Update::Lost => self.why_lost(),
                _ => LinkError::Left,
            };
            why.into()
        })
    }

    /// Runs the link until `look` returns a value for an update, for at most `patience`. `None` when
    /// the time is over.
    ///
    /// # Errors
    /// When the session ends.
    fn wait_for<T>(
        &mut self,
        patience: Duration,
        mut look: impl FnMut(&Client, &Update) -> Option<T>,
    ) -> Result<Option<T>, Self::Error> {
        let deadline = self.operate().1 + patience;
        self.look_in_session(deadline, |client, now, update| match update {
            Some(update) => look(client, update).map(Some),
            None => (now >= deadline).then_some(None),
        })
    }

    /// Waits until telemetry fulfils a condition, for at most `patience`. `None` when it did not.
    ///
    /// # Errors
    /// When the session ends.
    fn wait_for_telemetry(
        &mut self,
        patience: Duration,
        mut is_wanted: impl FnMut(&Telemetry) -> bool,
    ) -> Result<Option<Telemetry>, Self::Error> {
        self.wait_for(patience, |_, update| match update {
            Update::Telemetry(telemetry) if is_wanted(telemetry) => Some(*telemetry),
            _ => None,
        })
    }

    /// Lets this time pass.
    ///
    /// # Errors
    /// When the session ends.
    fn pause(&mut self, duration: Duration) -> Result<(), Self::Error> {
        self.wait_for(duration, |_, _| None::<()>).map(|_| ())
    }

    /// Returns why the session is lost: a robot that is there refuses a key that was revoked, or answers again. Where it answers,
    /// waits for its telemetry, too, which tells whether it is still driven.
    fn why_lost(&mut self) -> LinkError {
        let deadline = self.operate().1 + REVOKED_PATIENCE;
        let mut why = LinkError::Silent;
        let found = self.look_until(deadline, |_, now, update| match update {
            Some(Update::Failed(ConnectError::WrongKey)) => Some(LinkError::Revoked),
            Some(Update::Connected) => {
                why = LinkError::Back;
                None
            }
            Some(Update::Telemetry(_)) => Some(LinkError::Back),
            Some(_) => None,
            None => (now >= deadline).then(|| why.clone()),
        });
        found.unwrap_or(why)
    }

    /// Waits until the session is open, as long as the session tries
    /// ([`flix_protocol::session::CONNECT_PATIENCE`]).
    ///
    /// # Errors
    /// When there is none.
    fn wait_until_connected(&mut self) -> Result<(), Self::Error> {
        let deadline = self.operate().1 + 2 * flix_protocol::session::CONNECT_PATIENCE;
        let connected = self.look_until(deadline, |_, now, update| match update {
            Some(Update::Connected) => Some(Ok(())),
            Some(Update::Failed(error)) => Some(Err(*error)),
            Some(_) => None,
            None => (now >= deadline).then_some(Err(ConnectError::NoAnswer)),
        })?;
        Ok(connected.map_err(|error| self.no_session(error))?)
    }

    /// Sends a request to the robot and waits for the answer; a refusal, too, is one.
    ///
    /// # Errors
    /// When the robot does not answer.
    fn request(&mut self, command: Command) -> Result<Outcome, Self::Error> {
        let (client, now) = self.operate();
        let request = client.request(now, command);
        // The client itself reports a request that is not answered, once its turn has come.
        let outcome = self.wait_for(2 * REQUEST_PATIENCE, |_, update| match update {
            Update::Answer { request: answered, outcome } if *answered == request => {
                Some(Some(outcome.clone()))
            }
            Update::Unanswered { request: given_up } if *given_up == request => Some(None),
            _ => None,
        })?;
        Ok(outcome.flatten().ok_or(LinkError::Unanswered)?)
    }

    /// Sends a request as [`RobotLink::request`] does, and again while the robot refuses for a reason that
    /// [passes](passes_by_itself), for at most [`PASSING_PATIENCE`].
    ///
    /// # Errors
    /// When the robot does not answer.
    fn insist(&mut self, command: Command) -> Result<Outcome, Self::Error> {
        let end = self.operate().1 + PASSING_PATIENCE;
        loop {
            match self.request(command.clone())? {
                Outcome::Refused(refusal)
                    if passes_by_itself(&refusal) && self.operate().1 < end =>
                {
                    self.pause(TRY_AGAIN)?;
                }
                outcome => return Ok(outcome),
            }
        }
    }

    /// Sends a request as [`RobotLink::insist`] does. A refusal is an error.
    ///
    /// # Errors
    /// When the robot refuses or does not answer.
    fn ask(&mut self, command: Command) -> Result<Outcome, Self::Error> {
        match self.insist(command)? {
            Outcome::Refused(refusal) => self.refused(refusal),
            outcome => Ok(outcome),
        }
    }

    /// Ends with a refusal; that of a stopped robot names the operator that stopped it, as soon as telemetry does.
    ///
    /// # Errors
    /// Always.
    fn refused<T>(&mut self, refusal: Refusal) -> Result<T, Self::Error> {
        let stopper = match self.operate().0.stopped_by() {
            _ if refusal != Refusal::Stopped => None,
            None => self.wait_for(TELEMETRY_LAG, |client, _| client.stopped_by())?,
            known => known,
        };
        Err(stopper.map_or(LinkError::Refused(refusal), LinkError::StoppedBy).into())
    }

    /// Returns a setting as the robot states it: its value, unit and range, and how it is known.
    ///
    /// # Errors
    /// As for [`RobotLink::ask`]; when the robot has none of this name.
    fn parameter(&mut self, name: impl TryInto<Name>) -> Result<Parameter, Self::Error> {
        self.ask_setting(ParameterCommand::Get(setting_name(name)?))
    }

    /// Asks a question that is answered by a setting.
    ///
    /// # Errors
    /// As for [`RobotLink::ask`].
    fn ask_setting(&mut self, command: ParameterCommand) -> Result<Parameter, Self::Error> {
        match self.ask(Command::Parameter(command))? {
            Outcome::Parameter(parameter) => Ok(parameter),
            _ => Err(LinkError::OtherAnswer.into()),
        }
    }

    /// Sets a setting until power-off, and returns it as the robot took it.
    ///
    /// # Errors
    /// As for [`RobotLink::parameter`]; when the robot refuses the value.
    fn set(&mut self, name: impl TryInto<Name>, value: f32) -> Result<Parameter, Self::Error> {
        self.ask_setting(ParameterCommand::Set(setting_name(name)?, value))
    }

    /// Sets a setting as [`RobotLink::set`] does, and states how its value is known.
    ///
    /// # Errors
    /// As for [`RobotLink::set`].
    fn set_marked(
        &mut self,
        name: impl TryInto<Name>,
        value: f32,
        mark: Mark,
    ) -> Result<Parameter, Self::Error> {
        self.ask_setting(ParameterCommand::Put(setting_name(name)?, value, mark))
    }

    /// Returns the value of a setting.
    ///
    /// # Errors
    /// As for [`RobotLink::parameter`].
    fn setting(&mut self, name: impl TryInto<Name>) -> Result<f64, Self::Error> {
        Ok(self.parameter(name)?.value.into())
    }

    /// Arms the robot: waits until it is connected, its link is proven and its motors are aligned. From then on the
    /// robot holds its rotors at rest until [`Client::hold`] commands something else.
    ///
    /// # Errors
    /// As for [`RobotLink::ask`]; when a fault is latched.
    fn arm(&mut self) -> Result<(), Self::Error> {
        let (client, now) = self.operate();
        if !client.is_connected(now) {
            self.wait_until_connected()?;
        }
        self.press_by(|client, now| client.insist_on(now, Wish::Arm, ARM_PATIENCE))?;
        // The client itself ends a wish without an effect, and says why.
        let deadline = self.operate().1 + ARM_PATIENCE + KEEP_ALIVE;
        // Events meanwhile are for the caller, who drives the robot afterwards.
        let mut happened = Vec::new();
        let ended = self.look_in_session(deadline, |client, now, update| match update {
            Some(event @ Update::Event(_)) => {
                happened.push(event.clone());
                None
            }
            Some(Update::Telemetry(telemetry)) => {
                let is_armed = matches!(telemetry.state, State::Armed | State::Running);
                (is_armed && client.order().permit().is_some()).then_some(Ok(()))
            }
            Some(update) => LinkError::while_arming(update).map(Err),
            None if now >= deadline => {
                let actual = client.telemetry().map_or(State::Disarmed, |it| it.state);
                client.disarm(now);
                Some(Err(LinkError::State { wanted: State::Armed, actual }))
            }
            None => None,
        })?;
        self.operate().0.put_back(happened);
        let known = self.telemetry().and_then(|it| LinkError::of_idle(&it));
        Ok(ended.map_err(|error| known.unwrap_or(error))?)
    }

    /// Takes a wish by [`Client::press`], as soon as the robot has stated its permit.
    ///
    /// # Errors
    /// When the session ends, or the robot states nothing.
    fn press(&mut self, wish: Wish) -> Result<(), Self::Error> {
        self.press_by(|client, now| client.press(now, wish))
    }

    /// Takes a wish by `press`, as [`RobotLink::press`] does.
    ///
    /// # Errors
    /// As for [`RobotLink::press`].
    fn press_by(
        &mut self,
        mut press: impl FnMut(&mut Client, Instant) -> Result<(), NotTaken>,
    ) -> Result<(), Self::Error> {
        let deadline = self.operate().1 + REQUEST_PATIENCE;
        let pressed = self.look_in_session(deadline, |client, now, update| {
            // Updates from before the wish are no answer to it.
            if update.is_some() {
                return None;
            }
            match press(client, now) {
                Ok(()) => Some(true),
                Err(_) => (now >= deadline).then_some(false),
            }
        })?;
        if pressed { Ok(()) } else { Err(LinkError::Unanswered.into()) }
    }

    /// Brings the rotors to rest and lets the motors coast.
    ///
    /// # Errors
    /// When the session ends, the robot does not come to rest in time, or a fault or a stop brought it to rest.
    fn disarm(&mut self) -> Result<(), Self::Error> {
        let (client, now) = self.operate();
        client.disarm(now);
        let mut actual = State::Stopping;
        let disarmed = self.wait_for(DISARM_PATIENCE, |client, update| {
            let Update::Telemetry(telemetry) = update else { return None };
            actual = telemetry.state;
            (client.is_heard(telemetry) && telemetry.state.is_idle())
                .then(|| LinkError::of_idle(telemetry).map_or(Ok(()), Err))
        })?;
        let wanted = State::Disarmed;
        Ok(disarmed.unwrap_or(Err(LinkError::State { wanted, actual }))?)
    }

    /// Returns the newest telemetry.
    fn telemetry(&mut self) -> Option<Telemetry> {
        self.operate().0.telemetry().copied()
    }

    /// Commands the robot to shake so until something else is commanded, as a person does: see [`Client::want`].
    fn want(&mut self, setpoint: Setpoint) {
        let (client, now) = self.operate();
        client.want(now, setpoint);
    }

    /// Commands it so, as a program does that steers by itself: see [`Client::hold`].
    fn hold(&mut self, setpoint: Setpoint) {
        let (client, now) = self.operate();
        client.hold(now, setpoint);
    }
}

/// Returns the name of a setting. No robot has one whose name is longer than names can be.
fn setting_name(name: impl TryInto<Name>) -> Result<Name, LinkError> {
    name.try_into().map_err(|_| LinkError::Refused(Refusal::UnknownParameter))
}
