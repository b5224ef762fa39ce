//! The terminal and the loop.

use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event};

use super::keyboard::{Action, action};
use super::{Cockpit, view};
use crate::interrupt::Interrupt;
use crate::link::udp::{Connection, LinkError};

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
}

/// Drives by hand until the operator leaves. Restores the terminal at the end, also after errors and
/// panics.
///
/// # Errors
/// When there is no terminal, or the network fails.
pub fn run(
    connection: &mut Connection,
    robot: &str,
    interrupt: &Interrupt,
) -> Result<Ending, ScreenError> {
    if !(io::stdin().is_terminal() && io::stdout().is_terminal()) {
        return Err(ScreenError::NoTerminal);
    }
    // Its panic hook restores the terminal before the message is printed; unwinding then drops the
    // connection, which stops the robot.
    let mut terminal = ratatui::try_init().map_err(ScreenError::Terminal)?;
    let ending = drive(&mut terminal, connection, robot, interrupt);
    ratatui::restore();
    ending
}

fn drive(
    terminal: &mut DefaultTerminal,
    connection: &mut Connection,
    robot: &str,
    interrupt: &Interrupt,
) -> Result<Ending, ScreenError> {
    let (client, now) = connection.operate();
    let mut cockpit = Cockpit::new(robot, now);
    cockpit.connected(client, now);
    let mut drawn = None::<Instant>;
    loop {
        connection.step(KEY_LATENCY)?;
        let (client, now) = connection.operate();
        while let Some(update) = client.update() {
            cockpit.observe(&update, client, now);
        }
        match pressed() {
            // A terminal that cannot be read is closed.
            Err(_) => return Ok(Ending::Interrupted),
            Ok(actions) => {
                for action in actions {
                    match action {
                        Action::Quit => return Ok(Ending::Quit),
                        Action::Interrupt => return Ok(Ending::Interrupted),
                        action => cockpit.act(action, client, now),
                    }
                }
            }
        }
        if interrupt.is_raised() {
            return Ok(Ending::Interrupted);
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

/// Returns the actions of the keys that were pressed since the last call.
fn pressed() -> io::Result<Vec<Action>> {
    let mut actions = Vec::new();
    while event::poll(Duration::ZERO)? {
        if let Event::Key(key) = event::read()? {
            actions.extend(action(key));
        }
    }
    Ok(actions)
}
