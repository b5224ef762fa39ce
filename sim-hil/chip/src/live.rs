//! The rig in real time: its serial port is a pseudo-terminal, its network a UDP socket of this computer, so that the
//! real `flix` finds a robot.

use std::collections::HashMap;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use flix_protocol::DEFAULT_PORT;
use flix_sim::rig::robot::Truth;
use rustix::fs::{Mode, OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use crate::network::Datagram;
use crate::rig::{Rig, RigError};

/// Steps of the plant between two looks at the clock and the sockets.
const STEPS_AT_ONCE: usize = 5;
/// The emulation may be ahead of the clock by so much.
const LEAD: Duration = Duration::from_millis(1);
/// Bytes that wait for the chip's serial port, at most.
const BACKLOG: usize = 64;

/// The robot's truth at a time since power-on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Time since power-on, s.
    pub seconds: f64,
    /// What holds then.
    pub truth: Truth,
}

/// The rig and what it is seen to do.
pub struct Live {
    /// The rig.
    pub rig: Rig,
    /// The truth, every `STEPS_AT_ONCE` steps.
    pub samples: Vec<Sample>,
    /// Why the emulation ended, if it did.
    pub ended: Option<RigError>,
    /// By how much the emulation was late, at most.
    pub latest: Duration,
    terminal: OwnedFd,
    socket: UdpSocket,
    peers: HashMap<u16, SocketAddrV4>,
}

/// A rig that runs in a thread of its own.
pub struct Running {
    /// The rig, to be looked at and changed between its steps.
    pub live: Arc<Mutex<Live>>,
    /// The serial port.
    pub port: PathBuf,
    /// The robot's address on this computer.
    pub address: SocketAddr,
    stops: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    /// Kept open, so that the terminal lives while nobody has it open.
    _other_end: OwnedFd,
}

impl Running {
    /// Runs a rig from now on.
    ///
    /// # Errors
    /// When there is no pseudo-terminal or no socket to be had.
    pub fn start(rig: Rig) -> std::io::Result<Self> {
        let terminal = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        grantpt(&terminal)?;
        unlockpt(&terminal)?;
        let name = ptsname(&terminal, Vec::new())?;
        let port = Path::new(&*name.to_string_lossy()).to_path_buf();
        let other_end = rustix::fs::open(&port, OFlags::RDWR | OFlags::NOCTTY, Mode::empty())?;
        let mut modes = tcgetattr(&other_end)?;
        modes.make_raw();
        tcsetattr(&other_end, OptionalActions::Now, &modes)?;
        fcntl_setfl(&terminal, fcntl_getfl(&terminal)? | OFlags::NONBLOCK)?;
        let socket = UdpSocket::bind(SocketAddrV4::new(Ipv4Addr::LOCALHOST, 0))?;
        socket.set_nonblocking(true)?;
        let address = socket.local_addr()?;
        let live = Arc::new(Mutex::new(Live {
            rig,
            samples: Vec::new(),
            ended: None,
            latest: Duration::ZERO,
            terminal,
            socket,
            peers: HashMap::new(),
        }));
        let stops = Arc::new(AtomicBool::new(false));
        let thread = std::thread::spawn({
            let (live, stops) = (Arc::clone(&live), Arc::clone(&stops));
            move || pace(&live, &stops)
        });
        Ok(Self { live, port, address, stops, thread: Some(thread), _other_end: other_end })
    }

    /// Does something with the rig between two of its steps.
    pub fn with<T>(&self, work: impl FnOnce(&mut Live) -> T) -> T {
        work(&mut self.live.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stops.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic in there has been printed.
            let _ = thread.join();
        }
    }
}

/// No faster than the clock.
fn pace(live: &Mutex<Live>, stops: &AtomicBool) {
    let started = Instant::now();
    let offset = live.lock().unwrap_or_else(PoisonError::into_inner).rig.chip.now();
    while !stops.load(Ordering::Relaxed) {
        let virtual_time = {
            let mut live = live.lock().unwrap_or_else(PoisonError::into_inner);
            if live.ended.is_some() {
                return;
            }
            live.advance();
            let virtual_time = live.rig.chip.now() - offset;
            live.latest = live.latest.max(started.elapsed().saturating_sub(virtual_time));
            virtual_time
        };
        let ahead = virtual_time.saturating_sub(started.elapsed());
        if ahead > LEAD {
            std::thread::sleep(ahead);
        }
    }
}

impl Live {
    fn advance(&mut self) {
        self.receive();
        for _ in 0..STEPS_AT_ONCE {
            if let Err(error) = self.rig.step() {
                self.ended = Some(error);
                return;
            }
        }
        let truth = self.rig.truth();
        self.samples.push(Sample { seconds: self.rig.chip.now().as_secs_f64(), truth });
        self.send();
    }

    /// Takes what came from this computer.
    fn receive(&mut self) {
        let mut bytes = [0; 1_500];
        let now = self.rig.chip.cycles();
        while let Ok((length, SocketAddr::V4(from))) = self.socket.recv_from(&mut bytes) {
            self.peers.insert(from.port(), from);
            let datagram = Datagram { port: from.port(), payload: bytes[..length].to_vec() };
            self.rig.chip.network.send_datagram(&datagram, DEFAULT_PORT, now);
        }
        if self.rig.chip.serial_backlog() < BACKLOG {
            let mut bytes = [0; BACKLOG];
            match rustix::io::read(&self.terminal, &mut bytes) {
                Ok(length) => self.rig.chip.send_serial(&bytes[..length]),
                // Nothing there, or nobody has the other end open.
                Err(Errno::AGAIN | Errno::IO) => {}
                Err(error) => self.ended = Some(RigError::Fault(format!("terminal: {error}"))),
            }
        }
    }

    /// Gives this computer what came from the robot.
    fn send(&mut self) {
        let now = self.rig.chip.cycles();
        while let Some(datagram) = self.rig.chip.network.receive_datagram(now) {
            if let Some(peer) = self.peers.get(&datagram.port) {
                // A datagram may be lost.
                let _ = self.socket.send_to(&datagram.payload, peer);
            }
        }
        let fresh = std::mem::take(&mut self.rig.fresh_serial);
        // What does not fit is lost, as on a wire without flow control.
        let _ = rustix::io::write(&self.terminal, &fresh);
    }
}
