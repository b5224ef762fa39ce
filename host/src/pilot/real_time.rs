//! A [`Pilot`] on a socket, in real time.

use crate::link::RobotLink;
use std::time::Duration;

use super::{Ending, Helm, Pilot};
use crate::link::LinkError;
use crate::link::udp::Connection;
use crate::pose::{PoseError, PoseSample, PoseSource};
use crate::system::interrupt::Interrupt;

/// Longest wait for datagrams of the robot between two checks for poses.
const SLICE: Duration = Duration::from_millis(2);

/// Drives to the end of the run. Returns the ending and how long it drove, s. `watch` is shown the pilot after every step, with
/// the poses that it took; why something cannot go on ends the run as [`Ending::NotRecorded`].
///
/// # Errors
/// When the network or the source of poses fails; the robot is stopped when the connection is dropped.
pub fn drive<H: Helm, E: From<LinkError> + From<PoseError>>(
    connection: &mut Connection,
    source: &mut impl PoseSource,
    interrupt: &Interrupt,
    pilot: &mut Pilot<H>,
    mut watch: impl FnMut(&Pilot<H>, &[PoseSample]) -> Result<(), String>,
) -> Result<(Ending, f64), E> {
    let mut poses = Vec::new();
    loop {
        connection.step(SLICE)?;
        let (client, now) = connection.operate();
        poses.clear();
        while let Some(sample) = source.poll(now)? {
            poses.push(sample);
        }
        if interrupt.is_raised() {
            pilot.end(now, client, Ending::Interrupted);
        }
        let ending = pilot.step(now, client, &poses);
        if let Err(trouble) = watch(pilot, &poses) {
            pilot.end(now, client, Ending::NotRecorded(trouble));
        }
        if let Some(ending) = ending {
            let seconds = now.since(pilot.driving_since().unwrap_or(now)).as_secs_f64();
            return Ok((ending, seconds));
        }
    }
}
