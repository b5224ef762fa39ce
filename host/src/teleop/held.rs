//! Keys that are held: what they repeat changes a walk, and is no new wish of the operator.

use flix_protocol::message::Setpoint;
use flix_protocol::units::Instant;

use super::action::Action;
use super::cockpit::Cockpit;
use crate::link::Client;

impl Cockpit {
    /// Changes a walk by a [step](Action::step). Rotors that came to rest because commands stayed away stay at rest, and at rest
    /// no step does anything.
    pub fn step(&mut self, step: Action, client: &mut Client, now: Instant) {
        let is_walking = self.wanted.frequency() != Setpoint::REST.frequency();
        if let Some(setpoint) = step.step(self.wanted)
            && is_walking
            && client.held().is_some()
        {
            self.wanted = setpoint;
            client.hold(now, setpoint);
        }
    }
}
