//! A robot over the network, to be commissioned.

use std::time::Duration;

use flix_protocol::message::{Command, Outcome, Refusal, Setpoint, Telemetry};

use super::Subject;
use crate::link::LinkError;
use crate::link::udp::Connection;

impl Subject for Connection {
    type Error = LinkError;

    fn ask(&mut self, command: Command) -> Result<Outcome, LinkError> {
        Self::ask(self, command)
    }

    fn pause(&mut self, duration: Duration) -> Result<(), LinkError> {
        self.wait_for(duration, |_, _| None::<()>).map(|_| ())
    }

    fn telemetry(&mut self) -> Option<Telemetry> {
        self.client().telemetry().copied()
    }

    fn arm(&mut self) -> Result<(), LinkError> {
        Self::arm(self)
    }

    fn disarm(&mut self) -> Result<(), LinkError> {
        Self::disarm(self)
    }

    fn hold(&mut self, setpoint: Setpoint) {
        let (client, now) = self.operate();
        client.hold(now, setpoint);
    }

    fn refusal(error: &LinkError) -> Option<&Refusal> {
        match error {
            LinkError::Refused(refusal) => Some(refusal),
            _ => None,
        }
    }
}
