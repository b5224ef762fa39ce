//! `flix stop`: stops the robot until it is cleared.

use std::process::ExitCode;

use flix_protocol::message::State;

use super::output::print;
use super::robot::RobotArgs;
use super::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::link::udp::{DISARM_PATIENCE, LinkError, STOP_PATIENCE};
use crate::link::{StopState, Update};

/// Stop the robot, in every state.
///
/// Stop is repeated until the robot acknowledges it. Both rotors ramp down together, and the robot
/// stays stopped until `flix clear`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    robot: RobotArgs,
}

/// Stops, and waits until the rotors are at rest.
///
/// # Errors
/// When the robot cannot be reached, refuses this operator, or does not come to rest.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let interrupt = Interrupt::listen().map_err(Error::usage)?;
    let mut connection = args.robot.begin(&interrupt)?;
    // Requested before there is a session, so that it is the first message of the session.
    let (client, now) = connection.operate();
    client.stop(now);
    connection.wait_until_connected()?;
    connection.wait_for(STOP_PATIENCE, |client, update| {
        let is_acknowledged = client.stop_state() == StopState::Acknowledged;
        (is_acknowledged || *update == Update::StopAcknowledged).then_some(())
    })?;
    if connection.client().stop_state() != StopState::Acknowledged {
        return Err(LinkError::Unanswered.into());
    }
    let mut actual = State::Stopping;
    let at_rest = connection.wait_for_telemetry(DISARM_PATIENCE, |telemetry| {
        actual = telemetry.state;
        telemetry.stopped && matches!(actual, State::Disarmed | State::Faulted)
    })?;
    if at_rest.is_none() {
        return Err(LinkError::State { wanted: State::Disarmed, actual }.into());
    }
    print("stopped; `flix clear` makes it ready again\n")?;
    Ok(Exit::Done.into())
}
