//! The terminal and the loop.

use std::io::{self, IsTerminal};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event};

use super::drive::{Drive, DriveError, Ending};
use super::gamepad::Gamepads;
use super::keyboard::action;
use super::view;
use flix_host::interrupt::Interrupt;
use flix_host::teleop::action::Action;

/// Longest wait for a datagram between two checks of the keys.
const KEY_LATENCY: Duration = Duration::from_millis(10);
/// Interval of the pictures: 30 per second are smooth, and few enough for SSH.
const FRAME: Duration = Duration::from_millis(33);

/// Why driving by hand failed.
#[derive(Debug, thiserror::Error)]
pub enum ScreenError {
    /// There is no terminal.
    #[error("teleop needs a terminal: run it in one, or over `ssh -t`; `flix drive` works without")]
    NoTerminal,
    /// The terminal failed.
    #[error("the terminal failed: {0}")]
    Terminal(io::Error),
    /// Link or poses failed.
    #[error(transparent)]
    Drive(#[from] DriveError),
}

/// Drives by hand until the operator leaves. Restores the terminal at the end, also after errors and
/// panics.
///
/// # Errors
/// When there is no terminal, or the network fails.
pub fn run(drive: &mut Drive, interrupt: &Interrupt) -> Result<Ending, ScreenError> {
    if !(io::stdin().is_terminal() && io::stdout().is_terminal()) {
        return Err(ScreenError::NoTerminal);
    }
    // Its panic hook restores the terminal before the message is printed; unwinding then drops the
    // connection, which stops the robot.
    let mut terminal = ratatui::try_init().map_err(ScreenError::Terminal)?;
    let ending = show(&mut terminal, drive, interrupt);
    if is_closed() {
        // Dropped, it would report its cursor to a standard error that may be closed as well, and panic.
        std::mem::forget(terminal);
        return ending;
    }
    // A terminal that is closed cannot be restored, and needs not be.
    let _ = ratatui::try_restore();
    ending
}

fn show(
    terminal: &mut DefaultTerminal,
    drive: &mut Drive,
    interrupt: &Interrupt,
) -> Result<Ending, ScreenError> {
    let mut drawn = None::<Instant>;
    let keys = keyboard();
    let mut gamepads = Gamepads::open();
    loop {
        drive.step(KEY_LATENCY)?;
        if interrupt.is_raised() || is_closed() {
            return Ok(Ending::Interrupted);
        }
        let (cockpit, client, now) = drive.operate();
        for action in keys.try_iter() {
            match action {
                Action::Quit => return Ok(Ending::Quit),
                Action::Interrupt => return Ok(Ending::Interrupted),
                action => cockpit.act(action, client, now),
            }
        }
        for action in gamepads.read(cockpit, now) {
            cockpit.act(action, client, now);
        }
        if drawn.is_none_or(|at| at.elapsed() >= FRAME) {
            drawn = Some(Instant::now());
            cockpit.tick(client, now);
            if terminal.draw(|frame| view::draw(frame, cockpit)).is_err() {
                return Ok(Ending::Interrupted);
            }
        }
    }
}

/// Returns the actions of the keys as they are pressed. A thread of its own reads them: a read of a
/// terminal that closes at that moment never returns.
pub(crate) fn keyboard() -> mpsc::Receiver<Action> {
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
pub(crate) fn is_closed() -> bool {
    !io::stdin().is_terminal()
}
