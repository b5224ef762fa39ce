//! The terminal and the loop.

use std::io::{self, IsTerminal};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use flix_protocol::message::Setpoint;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event};

use super::cockpit::Weight;
use super::keyboard::{Action, action};
use super::{Cockpit, view};
use crate::interrupt::Interrupt;
use crate::link::udp::{Connection, LinkError};
use crate::pose::any::Poses;
use crate::pose::{PoseError, PoseSource};
use crate::record::{RecordError, Recorder};

/// Longest wait for a datagram between two checks of the keys.
const KEY_LATENCY: Duration = Duration::from_millis(10);
/// Interval of the pictures: 30 per second are smooth, and few enough for SSH.
const FRAME: Duration = Duration::from_millis(33);

/// How the operator left.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// By its key.
    Quit,
    /// By Ctrl-C, a signal or a closed terminal.
    Interrupted,
}

/// Why driving by hand failed.
#[derive(Debug, thiserror::Error)]
pub enum ScreenError {
    /// There is no terminal.
    #[error("teleop needs a terminal: run it in one, or over `ssh -t`; `flix drive` works without")]
    NoTerminal,
    /// The terminal failed.
    #[error("the terminal failed: {0}")]
    Terminal(io::Error),
    /// The link failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The poses failed.
    #[error(transparent)]
    Pose(#[from] PoseError),
}

/// Poses and a record, where the operator wants them.
#[derive(Default)]
pub struct Extras {
    /// Source of poses.
    pub poses: Option<Poses>,
    /// Record of the drive. Once it cannot be written any more, driving goes on without it.
    pub recorder: Option<Recorder>,
}

/// Drives by hand until the operator leaves. Restores the terminal at the end, also after errors and
/// panics.
///
/// # Errors
/// When there is no terminal, or the network fails.
pub fn run(
    connection: &mut Connection,
    robot: &str,
    extras: &mut Extras,
    interrupt: &Interrupt,
) -> Result<Ending, ScreenError> {
    if !(io::stdin().is_terminal() && io::stdout().is_terminal()) {
        return Err(ScreenError::NoTerminal);
    }
    // Its panic hook restores the terminal before the message is printed; unwinding then drops the
    // connection, which stops the robot.
    let mut terminal = ratatui::try_init().map_err(ScreenError::Terminal)?;
    let ending = drive(&mut terminal, connection, robot, extras, interrupt);
    if is_closed() {
        // Dropped, it would report its cursor to a standard error that may be closed as well, and panic.
        std::mem::forget(terminal);
        return ending;
    }
    // A terminal that is closed cannot be restored, and needs not be.
    let _ = ratatui::try_restore();
    ending
}

fn drive(
    terminal: &mut DefaultTerminal,
    connection: &mut Connection,
    robot: &str,
    extras: &mut Extras,
    interrupt: &Interrupt,
) -> Result<Ending, ScreenError> {
    let (client, now) = connection.operate();
    let mut cockpit = Cockpit::new(robot, now);
    cockpit.connected(client, now);
    let mut drawn = None::<Instant>;
    let mut commanded = Setpoint::REST;
    let keys = keyboard();
    loop {
        connection.step(KEY_LATENCY)?;
        let (client, now) = connection.operate();
        while let Some(update) = client.update() {
            extras.record(|recorder| recorder.update(now, &update), &mut cockpit, now);
            cockpit.observe(&update, client, now);
        }
        while let Some(sample) = extras.poses.as_mut().map_or(Ok(None), |poses| poses.poll(now))? {
            extras.record(|recorder| recorder.pose(&sample), &mut cockpit, now);
            cockpit.see(&sample, client, now);
        }
        if interrupt.is_raised() || is_closed() {
            return Ok(Ending::Interrupted);
        }
        for action in keys.try_iter() {
            match action {
                Action::Quit => return Ok(Ending::Quit),
                Action::Interrupt => return Ok(Ending::Interrupted),
                action => cockpit.act(action, client, now),
            }
        }
        if commanded != cockpit.wanted {
            commanded = cockpit.wanted;
            extras.record(
                |recorder| recorder.command(now, &commanded, "operator"),
                &mut cockpit,
                now,
            );
        }
        if drawn.is_none_or(|at| at.elapsed() >= FRAME) {
            drawn = Some(Instant::now());
            cockpit.tick(client, now);
            if terminal.draw(|frame| view::draw(frame, &cockpit)).is_err() {
                return Ok(Ending::Interrupted);
            }
        }
    }
}

impl Extras {
    fn record(
        &mut self,
        write: impl FnOnce(&mut Recorder) -> Result<(), RecordError>,
        cockpit: &mut Cockpit,
        now: flix_protocol::units::Instant,
    ) {
        if let Some(Err(error)) = self.recorder.as_mut().map(write) {
            self.recorder = None;
            cockpit.note(now, Weight::Alarm, &format!("{error}; driving goes on unrecorded"));
        }
    }
}

/// Returns the actions of the keys as they are pressed. A thread of its own reads them: a read of a
/// terminal that closes at that moment never returns.
fn keyboard() -> mpsc::Receiver<Action> {
    let (sender, actions) = mpsc::channel();
    std::thread::spawn(move || {
        loop {
            let pressed = match event::read() {
                Ok(Event::Key(key)) => action(key),
                Ok(_) => None,
                // A terminal that cannot be read is closed.
                Err(_) => Some(Action::Interrupt),
            };
            if pressed.is_some_and(|action| sender.send(action).is_err()) {
                return;
            }
        }
    });
    actions
}

/// Returns whether the terminal is closed: it is no terminal any more.
fn is_closed() -> bool {
    !io::stdin().is_terminal()
}
