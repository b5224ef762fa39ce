//! Linux and macOS.

use std::fs::{DirBuilder, File};
use std::io;
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, Command};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::process::{Pid, Resource, Rlimit, Signal, getpgrp, kill_process_group, setrlimit};
use rustix::time::{ClockId, clock_gettime};
use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGXFSZ};

/// Raises a flag by each signal that asks a program to end.
///
/// # Errors
/// When the operating system refuses the handlers.
pub fn listen(raised: &Arc<AtomicBool>) -> io::Result<()> {
    for signal in [SIGINT, SIGTERM, SIGHUP, SIGQUIT] {
        signal_hook::flag::register(signal, Arc::clone(raised))?;
    }
    Ok(())
}

/// Signals that end a program where an error says the same: of a file that is to be longer than it may (`ulimit -f`).
pub const ERRORS: &[i32] = &[SIGXFSZ];

/// The clock that goes on while the computer is suspended: on macOS the monotonic one does.
#[cfg(any(target_os = "linux", target_os = "android"))]
const SLEEPLESS: ClockId = ClockId::Boottime;
/// See above.
#[cfg(not(any(target_os = "linux", target_os = "android")))]
const SLEEPLESS: ClockId = ClockId::Monotonic;

/// Returns the time since the computer started, suspended or not.
#[must_use]
pub fn uptime() -> Duration {
    let time = clock_gettime(SLEEPLESS);
    let nanos = u32::try_from(time.tv_nsec).unwrap_or_default();
    Duration::new(u64::try_from(time.tv_sec).unwrap_or_default(), nanos)
}

/// What a socket that is in order reports while a network is away or busy, and `std` has no name of its own for: the card is
/// taken out (`ENODEV`), its address is (`EINVAL` for a socket that is bound to it), its queue is full (`ENOBUFS`, `ENOMEM`),
/// the neighbour is off (`EHOSTDOWN`), or a firewall drops what is sent (`EPERM`).
pub const PASSING_SOCKET_ERRORS: &[i32] = &[
    Errno::NODEV.raw_os_error(),
    Errno::INVAL.raw_os_error(),
    Errno::NOBUFS.raw_os_error(),
    Errno::NOMEM.raw_os_error(),
    Errno::HOSTDOWN.raw_os_error(),
    Errno::PERM.raw_os_error(),
    Errno::ACCESS.raw_os_error(),
];

/// Keeps what is in memory out of core dumps and away from debuggers of other programs, as far as the system allows: it may be a
/// key.
pub fn keep_memory_private() {
    // Both are refused by no system that has them; without them, a crash leaves what it leaves.
    let none = Rlimit { current: Some(0), maximum: Some(0) };
    let _ = setrlimit(Resource::Core, none);
    #[cfg(any(target_os = "linux", target_os = "android"))]
    let _ = rustix::process::set_dumpable_behavior(rustix::process::DumpableBehavior::NotDumpable);
}

/// Creates a new file that only its owner can read, for writing.
///
/// # Errors
/// When it exists already or cannot be created.
pub fn create_private(path: &Path) -> io::Result<File> {
    File::options().write(true).create_new(true).mode(0o600).open(path)
}

/// Creates a folder that only its owner can list, and those that it lies in.
///
/// # Errors
/// When one cannot be created.
pub fn create_private_folder(path: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(path)
}

/// Returns the permission bits of a file that others than its owner can use.
///
/// # Errors
/// When they cannot be read.
pub fn exposed_mode(file: &File) -> io::Result<Option<u32>> {
    let mode = file.metadata()?.mode() & 0o777;
    Ok(Some(mode).filter(|mode| mode & 0o077 != 0))
}

/// Returns the command that runs this line of the shell; end it by [`end_together`].
#[must_use]
pub fn shell(line: &str) -> Command {
    let mut command = Command::new("/bin/sh");
    command.arg("-c").arg(line).process_group(0);
    command
}

/// Ends a [`shell`] and all that it started.
pub fn end_together(child: &mut Child) {
    // One that has ended already cannot be killed, and needs not be.
    let _ = kill_process_group(Pid::from_child(child), Signal::KILL);
    let _ = child.wait();
}

/// Waits for a typed line, so long at most, and returns whether there is one for this program. A job in the background
/// that reads is stopped by the system.
#[must_use]
pub fn has_keys(longest: Duration) -> bool {
    let stdin = io::stdin();
    if !rustix::termios::tcgetpgrp(&stdin).is_ok_and(|group| group == getpgrp()) {
        std::thread::sleep(longest);
        return false;
    }
    let mut waiting = [PollFd::new(&stdin, PollFlags::IN)];
    let longest = Timespec::try_from(longest).ok();
    poll(&mut waiting, longest.as_ref()).is_ok_and(|ready| ready > 0)
}

/// Returns the next place from `at` on where a file holds anything: a hole takes no room and reads as zeros. Nothing where only a hole
/// follows; `at` where the file system knows of none. Moves the file's position.
pub fn data_from(file: &File, at: u64) -> Option<u64> {
    match rustix::fs::seek(file, rustix::fs::SeekFrom::Data(at)) {
        Ok(place) => Some(place),
        Err(Errno::NXIO) => None,
        Err(_) => Some(at),
    }
}
