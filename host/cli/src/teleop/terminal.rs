//! The terminal in full screen, and what of its input a person pressed.
//!
//! A terminal sends bytes for more than keys: for the wheel of a mouse (as arrow keys, unless the program asks for the mouse
//! itself; xterm's control sequences, mode 1007), for pasted text (mode 2004 marks it), for a window that gains or loses the
//! focus (mode 1004), and as answers to questions of other programs. All of that is asked for here and dropped, but for the
//! lost focus. What still comes in one go is no typing, see [`keyboard::Typing`](super::keyboard::Typing), and a sequence whose
//! end is lost swallows no key, see [`Sequences`]. Ctrl-C is left to the terminal's driver, which makes a signal of it before
//! any of that is read.

use std::io::{self, BufWriter, IsTerminal};
use std::sync::Once;
use std::sync::mpsc;
use std::time::{Duration, Instant};

use flix_protocol::units::Instant as Moment;
use ratatui::buffer::Buffer;
use ratatui::crossterm::cursor::Show;
use ratatui::crossterm::event::{
    DisableBracketedPaste, DisableFocusChange, DisableMouseCapture, EnableBracketedPaste,
    EnableFocusChange, EnableMouseCapture, KeyboardEnhancementFlags, PopKeyboardEnhancementFlags,
    PushKeyboardEnhancementFlags,
};
use ratatui::crossterm::style::Colored;
use ratatui::crossterm::terminal::LeaveAlternateScreen;
use ratatui::crossterm::{execute, terminal};
use ratatui::prelude::CrosstermBackend;
use ratatui::style::{Color, Modifier};
use ratatui::{Frame, Terminal};

use super::keyboard::{Report, Typed, Typing};
use super::multiplexer::Multiplexer;
use super::sequences::{Heard, Sequences};
use flix_shell::outlet::{Outlet, PATIENCE, stdout};

/// Bytes of a large picture: one that fits leaves at once.
const PICTURE: usize = 1 << 16;
/// Interval of looking whether anybody is attached to a multiplexer.
const LOOK: Duration = Duration::from_secs(1);
/// How long a robot moves on without a key where it cannot be known whether anybody looks.
pub(crate) const UNSEEN: Duration = Duration::from_secs(5);

/// A terminal in full screen. Dropped, also by a panic, it is as it was.
pub(crate) struct Screen {
    /// None once it is closed.
    terminal: Option<Terminal<CrosstermBackend<BufWriter<&'static Outlet>>>>,
    heard: mpsc::Receiver<(Instant, Heard)>,
    sequences: Sequences,
    typing: Typing,
    start: Instant,
}

impl Screen {
    /// Takes the terminal. `holds`: it has to report keys that are released.
    ///
    /// # Errors
    /// When the terminal fails; [`io::ErrorKind::Unsupported`] when it does not report that.
    pub(crate) fn open(holds: bool) -> io::Result<Self> {
        // Asked before anything else reads what it answers.
        if holds && !reports_releases()? {
            return Err(io::ErrorKind::Unsupported.into());
        }
        // Restores the terminal before the message of a panic is printed; unwinding then drops the connection, which stops the
        // robot.
        drop(ratatui::try_init()?);
        let terminal =
            Terminal::new(CrosstermBackend::new(BufWriter::with_capacity(PICTURE, stdout())))?;
        static ONCE: Once = Once::new();
        ONCE.call_once(|| {
            let restore = std::panic::take_hook();
            std::panic::set_hook(Box::new(move |panic| {
                let _ = be_quiet();
                restore(panic);
            }));
        });
        let screen = Self {
            terminal: Some(terminal),
            heard: heard(),
            sequences: Sequences::default(),
            typing: Typing::new(holds),
            start: Instant::now(),
        };
        #[cfg(unix)]
        interrupt_by_signal()?;
        execute!(stdout(), EnableMouseCapture, EnableBracketedPaste, EnableFocusChange)?;
        if holds && cfg!(unix) {
            let flags = KeyboardEnhancementFlags::DISAMBIGUATE_ESCAPE_CODES
                | KeyboardEnhancementFlags::REPORT_EVENT_TYPES
                | KeyboardEnhancementFlags::REPORT_ALTERNATE_KEYS
                | KeyboardEnhancementFlags::REPORT_ALL_KEYS_AS_ESCAPE_CODES;
            execute!(stdout(), PushKeyboardEnhancementFlags(flags))?;
        }
        Ok(screen)
    }

    /// Returns whether the terminal has taken the picture before: until then none is drawn.
    pub(crate) fn is_ready(&self) -> bool {
        stdout().is_idle()
    }

    /// Draws; an error when the terminal is closed.
    pub(crate) fn draw(&mut self, draw: impl FnOnce(&mut Frame<'_>)) -> io::Result<()> {
        self.terminal.as_mut().map_or_else(
            || Err(io::ErrorKind::BrokenPipe.into()),
            |terminal| {
                let draw = |frame: &mut Frame<'_>| {
                    draw(frame);
                    if Colored::ansi_color_disabled_memoized() {
                        without_colours(frame.buffer_mut());
                    }
                };
                terminal.draw(draw).map(drop)
            },
        )
    }

    /// Asks the terminal to answer once it has shown the picture of this moment. A system that makes events of the bytes has no
    /// answer among them.
    pub(crate) fn ask(&mut self, picture: Moment) -> io::Result<()> {
        let (columns, rows) = terminal::size()?;
        let now = self.start.elapsed();
        if cfg!(unix)
            && let Some([column, row]) = self.typing.ask(now, picture, [columns, rows])
        {
            // CUP, then DSR (ECMA-48, 8.3.21 and 8.3.35).
            stdout().put(format!("\x1b[{row};{column}H\x1b[6n").as_bytes());
        }
        Ok(())
    }

    /// Returns whether an answer of the terminal may still arrive: after the end of this program the shell would read the answer.
    pub(crate) fn is_answer_due(&self) -> bool {
        self.typing.is_answer_due(self.start.elapsed())
    }

    /// Returns what was typed since the last call. Never waits.
    pub(crate) fn typed(&mut self) -> Typed {
        self.typing.look(self.start.elapsed());
        for (at, heard) in self.heard.try_iter() {
            let at = at.saturating_duration_since(self.start);
            let reports = match heard {
                Heard::Bytes(bytes) => self.sequences.take(at, &bytes),
                Heard::Report(report) => vec![report],
            };
            for report in reports {
                self.typing.report(at, report);
            }
        }
        let now = self.start.elapsed();
        for report in self.sequences.settle(now) {
            self.typing.report(now, report);
        }
        self.typing.take(now)
    }
}

/// Takes the colours off a picture, and reverses text that has a ground of its own (<https://no-color.org>). Left to crossterm, each
/// colour would become a control sequence that ends bold and reversed text as well.
fn without_colours(picture: &mut Buffer) {
    for cell in &mut picture.content {
        if cell.bg != Color::Reset {
            cell.modifier.toggle(Modifier::REVERSED);
        }
        (cell.fg, cell.bg) = (Color::Reset, Color::Reset);
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        if is_closed() {
            // Dropped, it would report its cursor to a standard error that may be closed as well, and panic.
            std::mem::forget(self.terminal.take());
            return;
        }
        // A terminal that is closed at this moment cannot be restored, and needs not be.
        let _ = be_quiet();
        let _ = execute!(stdout(), LeaveAlternateScreen, Show);
        let _ = stdout().wait(Some(PATIENCE));
        let _ = terminal::disable_raw_mode();
        // What was typed or pasted meanwhile is for nobody, least of all for the shell.
        #[cfg(unix)]
        let _ = rustix::termios::tcflush(io::stdin(), rustix::termios::QueueSelector::IFlush);
    }
}

/// Lets the driver of a terminal in raw mode make signals of Ctrl-C and Ctrl-\, and of no other key. What restores the
/// terminal ends that, too.
#[cfg(unix)]
fn interrupt_by_signal() -> io::Result<()> {
    use rustix::termios::{
        LocalModes, OptionalActions, SpecialCodeIndex, tcgetattr, tcgetpgrp, tcsetattr,
    };
    const CTRL_C: u8 = 0x03;
    const CTRL_BACKSLASH: u8 = 0x1c;
    if tcgetpgrp(io::stdin()).ok() != Some(rustix::process::getpgrp()) {
        // It would send signals to somebody else, or to nobody.
        return Ok(());
    }
    let mut driver = tcgetattr(io::stdin())?;
    driver.local_modes |= LocalModes::ISIG;
    driver.special_codes[SpecialCodeIndex::VINTR] = CTRL_C;
    driver.special_codes[SpecialCodeIndex::VQUIT] = CTRL_BACKSLASH;
    // The first of two that are alike is the one that counts: no key suspends a program that drives a robot.
    driver.special_codes[SpecialCodeIndex::VSUSP] = CTRL_C;
    Ok(tcsetattr(io::stdin(), OptionalActions::Now, &driver)?)
}

/// Lets the terminal report no more than keys. To pop what was not pushed does nothing.
fn be_quiet() -> io::Result<()> {
    let mut stdout = stdout();
    // Each by itself: where a system refuses one, the others are asked for all the same.
    let popped = execute!(stdout, PopKeyboardEnhancementFlags);
    let unfocused = execute!(stdout, DisableFocusChange);
    let typed = execute!(stdout, DisableBracketedPaste);
    popped.and(unfocused).and(typed).and(execute!(stdout, DisableMouseCapture))
}

/// Returns whether the terminal reports keys that are released: kitty's keyboard protocol and the console of Windows do.
fn reports_releases() -> io::Result<bool> {
    if cfg!(not(unix)) {
        return Ok(true);
    }
    terminal::enable_raw_mode()?;
    let supports = terminal::supports_keyboard_enhancement();
    terminal::disable_raw_mode()?;
    // Whoever does not answer does not.
    Ok(supports.unwrap_or(false))
}

/// Returns what the terminal lets us know, as it does. Threads of their own read it: a read of a terminal that closes at that
/// moment never returns.
fn heard() -> mpsc::Receiver<(Instant, Heard)> {
    let (sender, heard) = mpsc::channel();
    let looking = sender.clone();
    std::thread::spawn(move || {
        loop {
            // A terminal that cannot be read is closed.
            let is_open = match read() {
                Ok(None) => continue,
                Ok(Some(heard)) => sender.send((Instant::now(), heard)).is_ok(),
                Err(_) => {
                    let _ = sender.send((Instant::now(), Heard::Report(Report::Closed)));
                    false
                }
            };
            if !is_open {
                return;
            }
        }
    });
    if let Some(multiplexer) = Multiplexer::around() {
        std::thread::spawn(move || {
            let send = |report| looking.send((Instant::now(), Heard::Report(report))).is_ok();
            loop {
                let attached = multiplexer.is_attached();
                let is_sent = send(Report::Unsure(attached.is_none()));
                if !is_sent || attached == Some(false) && !send(Report::Unwatched) {
                    return;
                }
                std::thread::sleep(LOOK);
            }
        });
    }
    heard
}

/// Waits for bytes of the terminal.
#[cfg(unix)]
fn read() -> io::Result<Option<Heard>> {
    use rustix::io::Errno;
    let mut bytes = [0; 4096];
    match rustix::io::read(io::stdin(), &mut bytes) {
        Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
        Ok(length) => Ok(bytes.get(..length).map(|bytes| Heard::Bytes(bytes.to_vec()))),
        Err(Errno::INTR) => Ok(None),
        // Who shares it with us does not wait.
        Err(Errno::AGAIN) => {
            use rustix::event::{PollFd, PollFlags, poll};
            poll(&mut [PollFd::new(&io::stdin(), PollFlags::IN)], None)?;
            Ok(None)
        }
        Err(error) => Err(error.into()),
    }
}

/// Waits for an event of the terminal: here the system makes them.
#[cfg(not(unix))]
fn read() -> io::Result<Option<Heard>> {
    Ok(reported(&ratatui::crossterm::event::read()?).map(Heard::Report))
}

/// Returns what an event of the console of Windows reports.
#[cfg(any(not(unix), test))]
const fn reported(event: &ratatui::crossterm::event::Event) -> Option<Report> {
    use ratatui::crossterm::event::Event;
    match event {
        Event::Key(key) => Some(Report::Held(*key)),
        Event::FocusLost => Some(Report::Unwatched),
        Event::FocusGained => Some(Report::Watched),
        _ => None,
    }
}

/// Returns whether the terminal is closed: it is no terminal any more.
pub(crate) fn is_closed() -> bool {
    !io::stdin().is_terminal()
}

#[cfg(test)]
mod tests {
    use ratatui::crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

    use super::*;
    use flix_host::teleop::action::Action;

    #[test]
    fn a_walk_that_is_held_at_a_console_of_windows_ends_when_its_key_is_released() {
        let mut typing = Typing::new(true);
        let mut at = Duration::ZERO;
        let mut typed = |kind| {
            let key = KeyEvent::new(KeyCode::Char('w'), KeyModifiers::NONE);
            let report = reported(&Event::Key(KeyEvent { kind, ..key })).unwrap();
            typing.report(at, report);
            at += Duration::from_millis(40);
            let typed = typing.take(at);
            assert_eq!(typed.doubt, None);
            typed.actions
        };
        assert!(matches!(typed(KeyEventKind::Press)[..], [Action::Walk(_)]));
        // It repeats as presses.
        assert_eq!(typed(KeyEventKind::Press), []);
        assert_eq!(typed(KeyEventKind::Release), [Action::Rest]);
    }

    #[test]
    fn without_colours_a_ground_is_reversed_and_the_rest_keeps_its_form() {
        use ratatui::layout::Rect;
        use ratatui::style::Style;
        let mut picture = Buffer::empty(Rect::new(0, 0, 3, 1));
        picture.set_string(0, 0, "a", Style::new().fg(Color::Red).add_modifier(Modifier::BOLD));
        picture.set_string(1, 0, "b", Style::new().bg(Color::Red));
        picture.set_string(2, 0, "c", Style::new().add_modifier(Modifier::REVERSED));
        without_colours(&mut picture);
        let forms: Vec<_> =
            picture.content.iter().map(|cell| (cell.fg, cell.bg, cell.modifier)).collect();
        let of = |modifier| (Color::Reset, Color::Reset, modifier);
        assert_eq!(forms, [Modifier::BOLD, Modifier::REVERSED, Modifier::REVERSED].map(of));
    }
}
