//! A drive by hand in real time: moves what link and poses report into the [`Cockpit`], and all of it into the record.

use std::time::Duration;

use flix_protocol::message::Setpoint;
use flix_protocol::units::Instant;

use flix_host::link::udp::Connection;
use flix_host::link::{Client, LinkError, RobotLink};
use flix_host::pose::any::Poses;
use flix_host::pose::{PoseError, PoseSource};
use flix_host::record::{RecordError, Recorder};
use flix_host::teleop::Cockpit;
use flix_host::teleop::cockpit::Weight;

/// How the operator left.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// By its key.
    Quit,
    /// By Ctrl-C, a signal or a closed terminal.
    Interrupted,
}

/// The pages are served no more.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "the page cannot be served any more: its part of this program has failed; start `flix cockpit` again"
)]
pub struct Gone;

/// Why driving by hand failed.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The link failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The poses failed.
    #[error(transparent)]
    Pose(#[from] PoseError),
    /// The pages that drive are gone.
    #[error(transparent)]
    Pages(#[from] Gone),
}

/// Poses and a record, where the operator wants them.
#[derive(Default)]
pub struct Extras {
    /// Source of poses.
    pub poses: Option<Poses>,
    /// Record of the drive. Once it cannot be written any more, driving goes on without it.
    pub recorder: Option<Recorder>,
    /// Why it cannot.
    pub unrecorded: Option<RecordError>,
}

/// A drive by hand over an open connection.
pub struct Drive<'a> {
    connection: &'a mut Connection,
    extras: &'a mut Extras,
    cockpit: Cockpit,
    commanded: Setpoint,
}

impl<'a> Drive<'a> {
    /// Begins at rest. `robot`: the robot, as the operator named it.
    #[must_use]
    pub fn new(connection: &'a mut Connection, robot: &str, extras: &'a mut Extras) -> Self {
        let (client, now) = connection.operate();
        let mut cockpit = Cockpit::new(robot, now);
        cockpit.connected(client, now);
        Self { connection, extras, cockpit, commanded: Setpoint::REST }
    }

    /// Records what was commanded, sends what is due, and takes what arrives within `longest`.
    ///
    /// # Errors
    /// When the network or the source of poses fails.
    pub fn step(&mut self, longest: Duration) -> Result<(), DriveError> {
        if self.commanded != self.cockpit.setpoint {
            self.commanded = self.cockpit.setpoint;
            let (now, setpoint) = (self.connection.now(), self.commanded);
            self.record(now, |recorder| recorder.command(now, &setpoint, "operator"));
        }
        self.connection.step(longest)?;
        let now = self.connection.now();
        while let Some(update) = self.connection.operate().0.update() {
            self.record(now, |recorder| recorder.update(now, &update));
            self.cockpit.observe(&update, self.connection.operate().0, now);
        }
        while let Some(poses) = &mut self.extras.poses
            && let Some(sample) = poses.poll(now)?
        {
            self.record(now, |recorder| recorder.pose(&sample));
            self.cockpit.see(&sample, self.connection.operate().0, now);
        }
        self.cockpit.watch(self.connection.operate().0, now);
        Ok(())
    }

    /// Returns what an operator acts on, and the present time.
    pub fn operate(&mut self) -> (&mut Cockpit, &mut Client, Instant) {
        let (client, now) = self.connection.operate();
        (&mut self.cockpit, client, now)
    }

    fn record(
        &mut self,
        now: Instant,
        write: impl FnOnce(&mut Recorder) -> Result<(), RecordError>,
    ) {
        if let Some(Err(error)) = self.extras.recorder.as_mut().map(write) {
            self.extras.recorder = None;
            let text = format!("{error}; driving goes on unrecorded");
            self.cockpit.note(now, Weight::Alarm, &text);
            self.cockpit.is_unrecorded = true;
            self.extras.unrecorded = Some(error);
        }
    }
}
