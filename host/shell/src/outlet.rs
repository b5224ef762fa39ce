//! Standard output and standard error, each written by a thread of its own: a terminal that does not read holds up no loop that
//! drives a robot.
//!
//! A terminal stops to read after Ctrl-S, while text is marked in a Windows console, and while it is suspended; a pipe does so for as
//! long as its reader is busy.

use std::collections::VecDeque;
use std::io::{self, IsTerminal, Write};
use std::sync::{Condvar, Mutex, MutexGuard, Once, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, TermLike};
use terminal_size::{Width, terminal_size_of};

/// Bytes that wait at most, but for one text: what comes beyond is dropped where nobody waits for it.
const MOST: usize = 1 << 16;
/// Bytes that a terminal is given at once: half of a second on a serial line of 9600 baud.
const PIECE: usize = 480;
/// Pictures of a bar in a second.
const BAR_HZ: u8 = 15;
/// Pause between two looks at how far a stream has come.
const LOOK: Duration = Duration::from_millis(20);
/// Time that a terminal is given to take anything, before this program goes on without it.
pub const PATIENCE: Duration = Duration::from_secs(1);

/// What waits, and how far the thread has come.
#[derive(Default)]
struct State {
    waiting: VecDeque<u8>,
    /// Bytes that the thread has taken and not written yet.
    taken: usize,
    /// Whether it took nothing for too long, and nothing since.
    is_stuck: bool,
    /// Why the stream cannot be written.
    error: Option<io::Error>,
}

/// A stream of this program.
pub struct Outlet {
    state: Mutex<State>,
    changed: Condvar,
    started: Once,
    is_terminal: fn() -> bool,
    write: fn(&[u8]) -> io::Result<()>,
}

static STDOUT: Outlet = Outlet::new(
    || io::stdout().is_terminal(),
    |bytes| {
        let mut stream = io::stdout().lock();
        stream.write_all(bytes).and_then(|()| stream.flush())
    },
);
static STDERR: Outlet =
    Outlet::new(|| io::stderr().is_terminal(), |bytes| io::stderr().write_all(bytes));

/// Returns standard output.
#[must_use]
pub fn stdout() -> &'static Outlet {
    &STDOUT
}

/// Returns standard error.
#[must_use]
pub fn stderr() -> &'static Outlet {
    &STDERR
}

/// Gives both streams the time to take what waits; call it before the program ends.
pub fn finish() {
    // Of what can be shown no more nothing can be said.
    let _ = STDERR.wait(Some(PATIENCE));
    let _ = STDOUT.wait(Some(PATIENCE));
}

/// Lets a bar be drawn on standard error by its thread.
#[must_use]
pub fn drawn(bar: ProgressBar) -> ProgressBar {
    if io::stderr().is_terminal() && !bar.is_hidden() {
        bar.set_draw_target(ProgressDrawTarget::term_like_with_hz(Box::new(&STDERR), BAR_HZ));
    }
    bar
}

impl Outlet {
    const fn new(is_terminal: fn() -> bool, write: fn(&[u8]) -> io::Result<()>) -> Self {
        let state = State { waiting: VecDeque::new(), taken: 0, is_stuck: false, error: None };
        let state = Mutex::new(state);
        Self { state, changed: Condvar::new(), started: Once::new(), is_terminal, write }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns whether all was written.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        let state = self.state();
        state.waiting.is_empty() && state.taken == 0
    }

    /// Writes later. Drops the bytes where too many wait already.
    pub fn put(&'static self, bytes: &[u8]) {
        self.started.call_once(|| drop(std::thread::spawn(|| self.serve())));
        let mut state = self.state();
        if state.waiting.len() < MOST {
            state.waiting.extend(bytes);
        }
        self.changed.notify_all();
    }

    /// Waits until all is written, or the stream has taken nothing for as long as `patience`. `None`: without limit for a reader, and
    /// [`PATIENCE`] for a terminal.
    ///
    /// # Errors
    /// When the stream cannot be written, or has taken nothing for that long.
    pub fn wait(&self, patience: Option<Duration>) -> io::Result<()> {
        let patience = patience.or_else(|| (self.is_terminal)().then_some(PATIENCE));
        let mut state = self.state();
        let (mut left, mut since) = (usize::MAX, Instant::now());
        while !state.waiting.is_empty() || state.taken > 0 {
            let now_left = state.waiting.len() + state.taken;
            if now_left != left {
                (left, since) = (now_left, Instant::now());
            }
            if patience.is_some_and(|most| state.is_stuck || since.elapsed() >= most) {
                state.is_stuck |= since.elapsed() >= PATIENCE;
                let why = "the terminal takes nothing: Ctrl-S holds it (Ctrl-Q ends that), or marked text";
                return Err(io::Error::new(io::ErrorKind::TimedOut, why));
            }
            let waited = self.changed.wait_timeout(state, LOOK);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        state.error.take().map_or(Ok(()), Err)
    }

    /// Moves the cursor (ECMA-48, 8.3.18 to 8.3.22).
    fn control(&'static self, count: usize, letter: char) -> io::Result<()> {
        if count > 0 { self.write_str(&format!("\x1b[{count}{letter}")) } else { Ok(()) }
    }

    fn serve(&self) {
        let mut state = self.state();
        loop {
            while state.waiting.is_empty() {
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
            let most = if (self.is_terminal)() { PIECE } else { MOST };
            let length = state.waiting.len().min(most);
            let piece: Vec<u8> = state.waiting.drain(..length).collect();
            state.taken = length;
            drop(state);
            let written = (self.write)(&piece);
            state = self.state();
            (state.taken, state.is_stuck) = (0, false);
            if let Err(error) = written {
                state.waiting.clear();
                state.error = Some(error);
            }
            self.changed.notify_all();
        }
    }
}

impl Write for &'static Outlet {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.put(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.state().error.take().map_or(Ok(()), Err)
    }
}

impl TermLike for &'static Outlet {
    fn width(&self) -> u16 {
        terminal_size_of(io::stderr()).map_or(80, |(Width(columns), _)| columns)
    }

    fn move_cursor_up(&self, lines: usize) -> io::Result<()> {
        self.control(lines, 'A')
    }

    fn move_cursor_down(&self, lines: usize) -> io::Result<()> {
        self.control(lines, 'B')
    }

    fn move_cursor_right(&self, columns: usize) -> io::Result<()> {
        self.control(columns, 'C')
    }

    fn move_cursor_left(&self, columns: usize) -> io::Result<()> {
        self.control(columns, 'D')
    }

    fn write_line(&self, text: &str) -> io::Result<()> {
        self.write_str(&format!("{text}\n"))
    }

    fn write_str(&self, text: &str) -> io::Result<()> {
        self.put(text.as_bytes());
        Ok(())
    }

    fn clear_line(&self) -> io::Result<()> {
        self.write_str("\r\x1b[2K")
    }

    fn flush(&self) -> io::Result<()> {
        Ok(())
    }
}

impl std::fmt::Debug for Outlet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Outlet")
    }
}
