//! The loop of driving at a terminal.

use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use super::gamepad::Gamepads;
use super::terminal::{Screen, UNSEEN, is_closed};
use super::view;
use crate::by_hand::drive::{Drive, DriveError, Ending};
use flix_host::system::interrupt::Interrupt;
use flix_host::teleop::action::Action;
use flix_host::teleop::cockpit::Weight;
use flix_protocol::units::Instant as Moment;

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
    /// The terminal does not report that a key is released.
    #[error(
        "--hold-to-run: this terminal does not report that a key is released, as those with kitty's keyboard protocol do \
         (kitty, Ghostty, WezTerm, foot): take one of them, or `flix cockpit --hold-to-run`"
    )]
    NoReleases,
    /// The terminal failed.
    #[error("the terminal failed: {0}")]
    Terminal(io::Error),
    /// Link or poses failed.
    #[error(transparent)]
    Drive(#[from] DriveError),
}

/// Drives by hand until the operator leaves. Restores the terminal at the end, also after errors and
/// panics. If the robot `holds`, it rests when the key of its walk is released.
///
/// # Errors
/// When there is no terminal, or the network fails.
pub fn run(drive: &mut Drive, interrupt: &Interrupt, holds: bool) -> Result<Ending, ScreenError> {
    if !(io::stdin().is_terminal() && io::stdout().is_terminal()) {
        return Err(ScreenError::NoTerminal);
    }
    let mut screen = Screen::open(holds).map_err(|error| match error.kind() {
        io::ErrorKind::Unsupported => ScreenError::NoReleases,
        _ => ScreenError::Terminal(error),
    })?;
    let mut ending = operate(drive, &mut screen, interrupt)?;
    calm(drive, ending);
    // The robot comes to rest while the last answers of the terminal arrive: read later, they would be input of the shell. A link that
    // fails here fails again in the caller, which disarms or stops the robot and reports the failure.
    while screen.is_answer_due() && !is_closed() && drive.step(KEY_LATENCY).is_ok() {
        let stops = |it: &Action| matches!(it, Action::Stop | Action::Interrupt);
        let typed = screen.typed();
        if ending == Ending::Quit && typed.actions.iter().any(stops) {
            ending = Ending::Interrupted;
            calm(drive, ending);
        }
    }
    Ok(ending)
}

fn calm(drive: &mut Drive<'_>, ending: Ending) {
    let (_, client, now) = drive.operate();
    match ending {
        Ending::Quit => client.disarm(now),
        Ending::Interrupted => client.stop(now),
    }
}

fn operate(
    drive: &mut Drive<'_>,
    screen: &mut Screen,
    interrupt: &Interrupt,
) -> Result<Ending, ScreenError> {
    let mut drawn = None::<Instant>;
    let mut gamepads = Gamepads::open();
    // Time of the picture that was drawn last: none yet.
    let mut drawn_at = Moment::START;
    loop {
        drive.step(KEY_LATENCY)?;
        if interrupt.is_raised() || is_closed() {
            return Ok(Ending::Interrupted);
        }
        let (cockpit, client, now) = drive.operate();
        let typed = screen.typed();
        let pressed = now.since(Moment::START).saturating_sub(typed.pressed);
        let seen = typed.seen.unwrap_or(drawn_at).min(Moment::START + pressed);
        if typed.is_touched || gamepads.is_touched() {
            cockpit.attend(now);
        }
        if typed.dropped > 0 {
            let text = format!("{} keys at once or too late are no typing: ignored", typed.dropped);
            cockpit.note(now, Weight::Warning, &text);
        }
        for action in typed.actions {
            match action {
                Action::Quit => return Ok(Ending::Quit),
                Action::Interrupt => return Ok(Ending::Interrupted),
                action => cockpit.act(action, seen, client, now),
            }
        }
        for step in typed.steps {
            cockpit.step(step, client, now);
        }
        cockpit.be_unsure(typed.is_unsure.then_some(UNSEEN), now);
        if let Some(doubt) = typed.doubt {
            cockpit.abandon(doubt, client, now);
        }
        for action in gamepads.read(!typed.is_unwatched, cockpit, now) {
            cockpit.act(action, seen, client, now);
        }
        if screen.is_ready() && drawn.is_none_or(|at| at.elapsed() >= FRAME) {
            drawn = Some(Instant::now());
            cockpit.tick(client, now);
            let shown = screen.draw(|frame| view::draw(frame, cockpit));
            if shown.and_then(|()| screen.ask(now)).is_err() {
                return Ok(Ending::Interrupted);
            }
            drawn_at = now;
        }
    }
}
