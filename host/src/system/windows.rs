//! Windows. A user's files are in a folder of the user's own, which others cannot read.

use std::fs::{DirBuilder, File};
use std::io;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use tokio::runtime::Builder;
use tokio::signal::windows;

/// Raises a flag by Ctrl-C, by Ctrl-Break, when the console is closed, and when the user logs off or the computer shuts down. Windows
/// ends a program as soon as its handler of the last three returns: tokio's never does, and leaves some 5 s to stop a robot and conclude
/// a record.
///
/// # Errors
/// When the operating system refuses the handlers.
pub fn listen(raised: &Arc<AtomicBool>) -> io::Result<()> {
    let (mut key, mut pause) = (windows::ctrl_c()?, windows::ctrl_break()?);
    let (mut closed, mut left) = (windows::ctrl_close()?, windows::ctrl_logoff()?);
    let mut down = windows::ctrl_shutdown()?;
    let raised = Arc::clone(raised);
    let runtime = Builder::new_current_thread().build()?;
    std::thread::spawn(move || {
        runtime.block_on(async {
            loop {
                tokio::select! {
                    _ = key.recv() => {}
                    _ = pause.recv() => {}
                    _ = closed.recv() => {}
                    _ = left.recv() => {}
                    _ = down.recv() => {}
                }
                raised.store(true, Ordering::SeqCst);
            }
        });
    });
    Ok(())
}

/// Signals that end a program where an error says the same.
pub const ERRORS: &[i32] = &[];

/// What a socket that is in order reports while a network is away or busy, or of a datagram that is longer than any of ours, and
/// `std` has no name of its own for: `WSAEINVAL`, `WSAEMSGSIZE`, `WSAENETRESET`, `WSAENOBUFS`, `WSAEHOSTDOWN`.
pub const PASSING_SOCKET_ERRORS: &[i32] = &[10_013, 10_022, 10_040, 10_052, 10_055, 10_064];

/// Returns the time since the first call: the counter behind goes on while the computer is suspended.
#[must_use]
pub fn uptime() -> Duration {
    static FIRST: OnceLock<Instant> = OnceLock::new();
    FIRST.get_or_init(Instant::now).elapsed()
}

/// Does nothing: Windows writes the memory of a program to a file only where a person has set it up.
pub const fn keep_memory_private() {}

/// Creates a new file, for writing.
///
/// # Errors
/// When it exists already or cannot be created.
pub fn create_private(path: &Path) -> io::Result<File> {
    File::options().write(true).create_new(true).open(path)
}

/// Creates a folder, and those that it lies in.
///
/// # Errors
/// When one cannot be created.
pub fn create_private_folder(path: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).create(path)
}

/// Returns nothing: files have no permission bits.
///
/// # Errors
/// Never.
pub fn exposed_mode(_file: &File) -> io::Result<Option<u32>> {
    Ok(None)
}

/// Returns the command that runs this line of the shell; end it by [`end_together`].
#[must_use]
pub fn shell(line: &str) -> Command {
    let mut command = Command::new("cmd");
    command.arg("/C").arg(line);
    command
}

/// Ends a [`shell`] and all that it started.
pub fn end_together(child: &mut Child) {
    let process = child.id().to_string();
    let mut tree = Command::new("taskkill");
    tree.args(["/T", "/F", "/PID", &process]).stdout(Stdio::null()).stderr(Stdio::null());
    // One that has ended already cannot be killed, and needs not be.
    let _ = tree.status();
    let _ = child.kill();
    let _ = child.wait();
}

/// Returns that a line may be read: a console has no jobs in the background.
#[must_use]
pub fn has_keys(_longest: Duration) -> bool {
    true
}

/// Returns `at`: holes are read as the zeros that they stand for.
pub fn data_from(_file: &File, at: u64) -> Option<u64> {
    Some(at)
}
