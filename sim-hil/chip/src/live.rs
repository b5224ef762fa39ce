//! The rig for programs of this computer: its serial port is a pseudo-terminal, its network a UDP socket at the robot's
//! address, so that the real `flix` finds a robot, provisions and drives it.
//!
//! The chip's time never runs faster than the clock of the wall. Where the emulation is slower it falls behind, and hurries
//! after by no more than the jitter of a good network: commands reach the robot at least as often as on time, and every
//! deadline of the robot is a deadline of its own time. What `flix` waits for comes later by the same share; [`Live::pace`]
//! reports it.

use std::collections::HashMap;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use flix_protocol::DEFAULT_PORT;
use flix_sim::experiment::metrics::HoldMeter;
use flix_sim::rig::bench::setpoint;
use rustix::fs::{Mode, OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use serde::Serialize;
use socket2::{Domain, Protocol, Socket, Type};

use crate::rig::{Rig, RigError};
use crate::session::{Hold, Times};
use flix_esp32c6::network::{Datagram, GROUP, MDNS_PORT};

/// Steps of the plant between two looks at the clock and the sockets.
const STEPS_AT_ONCE: usize = 5;
/// The chip may be ahead of the clock by so much.
const LEAD: Duration = Duration::from_millis(1);
/// What the chip is late by beyond this is lost. Commands come every 20 ms.
const JITTER: Duration = Duration::from_millis(20);
/// Bytes that wait for the chip's serial port, at most.
const BACKLOG: usize = 64;
/// Addresses that are tried for the robot: those after its usual one, where that is taken.
const ADDRESSES: u8 = 100;
/// f this near to the setpoint, Hz, has reached it.
pub(crate) const REACHED_HZ: f64 = 1.0;

/// How fast the emulation is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Pace {
    /// Time of the chip, s.
    pub chip_s: f64,
    /// Time of the wall, s.
    pub wall_s: f64,
    /// Seconds of the chip that a second of computing makes: below one the chip falls behind.
    pub seconds_a_second: f64,
}

/// A setpoint that somebody commands over the network, measured from its settling on.
pub struct Watch {
    asked: (f64, f64),
    times: Times,
    current_limit_a: f64,
    meter: HoldMeter,
    peak_current_a: f64,
    reached: Option<Duration>,
    /// What was measured, once all is.
    pub hold: Option<Hold>,
}

impl Watch {
    /// Waits for f (Hz) and theta (degrees).
    pub fn new(asked: (f64, f64), times: Times, current_limit_a: f64) -> Result<Self, RigError> {
        let setpoint =
            setpoint(asked.0, asked.1).map_err(|error| RigError::Fault(error.to_string()))?;
        let meter = HoldMeter::new(setpoint);
        let (peak_current_a, reached, hold) = (0.0, None, None);
        Ok(Self { asked, times, current_limit_a, meter, peak_current_a, reached, hold })
    }

    fn look(&mut self, rig: &mut Rig) {
        let (truth, now) = (rig.truth(), rig.chip.now());
        if (truth.frequency() - self.asked.0).abs() > REACHED_HZ {
            self.reached = None;
            return;
        }
        let held = now - *self.reached.get_or_insert(now);
        if held < self.times.settle || self.hold.is_some() {
            return;
        }
        self.meter.watch(&truth);
        self.peak_current_a = self.peak_current_a.max(truth.largest_current());
        if held >= self.times.settle + self.times.measure {
            let (peak, limit) = (self.peak_current_a, self.current_limit_a);
            self.hold = Some(Hold::of(self.asked, &self.meter, peak, limit));
        }
    }
}

/// The rig and its ways out.
pub struct Live {
    /// The rig.
    pub rig: Rig,
    /// The serial port.
    pub port: PathBuf,
    /// Whether the robot is found by its name: this computer carries multicast.
    pub is_announced: bool,
    /// What is measured.
    pub watch: Option<Watch>,
    terminal: OwnedFd,
    /// Kept open, so that the terminal lives while nobody has it open.
    _other_end: OwnedFd,
    socket: UdpSocket,
    everybody: Option<UdpSocket>,
    peers: HashMap<u16, SocketAddrV4>,
    began: (Instant, Duration),
    /// When the clock reaches the chip's time.
    due: Instant,
    slept: Duration,
}

impl Live {
    /// Gives a rig its ways out.
    pub fn new(mut rig: Rig) -> std::io::Result<Self> {
        let Terminal { near: terminal, far: other_end, port } = Terminal::open()?;
        let mut modes = tcgetattr(&other_end)?;
        modes.make_raw();
        tcsetattr(&other_end, OptionalActions::Now, &modes)?;
        fcntl_setfl(&terminal, fcntl_getfl(&terminal)? | OFlags::NONBLOCK)?;
        let socket = socket_of(&mut rig)?;
        let everybody = everybody().ok();
        let (now, virtual_now) = (Instant::now(), rig.chip.now());
        Ok(Self {
            rig,
            port,
            is_announced: everybody.is_some(),
            watch: None,
            terminal,
            _other_end: other_end,
            socket,
            everybody,
            peers: HashMap::new(),
            began: (now, virtual_now),
            due: now,
            slept: Duration::ZERO,
        })
    }

    /// Returns the robot's address.
    pub fn address(&self) -> Ipv4Addr {
        self.rig.chip.network.lease.into()
    }

    /// Returns how fast the emulation was so far.
    pub fn pace(&self) -> Pace {
        let wall = self.began.0.elapsed();
        let chip_s = (self.rig.chip.now() - self.began.1).as_secs_f64();
        let computed_s = wall.saturating_sub(self.slept).as_secs_f64();
        Pace { chip_s, wall_s: wall.as_secs_f64(), seconds_a_second: chip_s / computed_s }
    }

    /// Goes on for some steps of the plant, and waits where the chip is ahead of the clock.
    pub fn advance(&mut self) -> Result<(), RigError> {
        let before = self.rig.chip.now();
        self.receive()?;
        for _ in 0..STEPS_AT_ONCE {
            self.rig.step()?;
            if let Some(watch) = &mut self.watch {
                watch.look(&mut self.rig);
            }
        }
        self.send();
        self.due += self.rig.chip.now() - before;
        let now = Instant::now();
        self.due = self.due.max(now - JITTER);
        let ahead = self.due.saturating_duration_since(now);
        if ahead > LEAD {
            std::thread::sleep(ahead);
            self.slept += now.elapsed();
        }
        Ok(())
    }

    /// Takes what came from this computer.
    fn receive(&mut self) -> Result<(), RigError> {
        let mut bytes = [0; 1_500];
        let now = self.rig.chip.cycles();
        let network = &mut self.rig.chip.network;
        for (socket, robot_port) in
            [(Some(&self.socket), DEFAULT_PORT), (self.everybody.as_ref(), MDNS_PORT)]
        {
            let Some(socket) = socket else { continue };
            while let Ok((length, std::net::SocketAddr::V4(from))) = socket.recv_from(&mut bytes) {
                let payload = bytes[..length].to_vec();
                if robot_port == MDNS_PORT && !is_question(&payload) {
                    continue;
                }
                self.peers.insert(from.port(), from);
                network.send_datagram(&Datagram { port: from.port(), payload }, robot_port, now);
            }
        }
        if self.rig.chip.serial_backlog() < BACKLOG {
            let mut bytes = [0; BACKLOG];
            match rustix::io::read(&self.terminal, &mut bytes) {
                Ok(length) => self.rig.chip.send_serial(&bytes[..length]),
                // Nothing there, or nobody has the other end open.
                Err(Errno::AGAIN | Errno::IO) => {}
                Err(error) => return Err(RigError::Fault(format!("terminal: {error}"))),
            }
        }
        Ok(())
    }

    /// Gives this computer what came from the robot. A datagram may be lost.
    fn send(&mut self) {
        let now = self.rig.chip.cycles();
        while let Some(Datagram { port, payload }) = self.rig.chip.network.receive_datagram(now) {
            if port == MDNS_PORT {
                let group = SocketAddrV4::new(GROUP.into(), MDNS_PORT);
                let _ = self.everybody.as_ref().map(|socket| socket.send_to(&payload, group));
            } else if let Some(peer) = self.peers.get(&port) {
                let _ = self.socket.send_to(&payload, peer);
            }
        }
        let fresh = std::mem::take(&mut self.rig.fresh_serial);
        // What does not fit is lost, as on a wire without flow control.
        let _ = rustix::io::write(&self.terminal, &fresh);
    }
}

/// A pseudo-terminal.
pub(crate) struct Terminal {
    /// The side of whoever types and reads here.
    pub(crate) near: OwnedFd,
    /// The side of a program.
    pub(crate) far: OwnedFd,
    /// Its name.
    pub(crate) port: PathBuf,
}

impl Terminal {
    pub(crate) fn open() -> std::io::Result<Self> {
        let near = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&near)?;
        unlockpt(&near)?;
        let name = ptsname(&near, Vec::new())?;
        let port = Path::new(&*name.to_string_lossy()).to_path_buf();
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let far = rustix::fs::open(&port, flags, Mode::empty())?;
        Ok(Self { near, far, port })
    }
}

/// Opens a socket at the robot's address, or at the next that is free, which the robot is then given.
fn socket_of(rig: &mut Rig) -> std::io::Result<UdpSocket> {
    let network = &mut rig.chip.network;
    let mut tried = 0;
    loop {
        match UdpSocket::bind((Ipv4Addr::from(network.lease), DEFAULT_PORT)) {
            Ok(socket) => {
                socket.set_nonblocking(true)?;
                return Ok(socket);
            }
            Err(error) if tried == ADDRESSES => return Err(error),
            Err(_) => {
                tried += 1;
                network.lease[3] += 1;
            }
        }
    }
}

/// Opens a socket for what is said to everybody on this computer. What the robot says goes no farther: its address is good
/// for nothing elsewhere.
fn everybody() -> std::io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_reuse_address(true)?;
    socket.set_reuse_port(true)?;
    socket.bind(&SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, MDNS_PORT).into())?;
    socket.join_multicast_v4(&GROUP.into(), &Ipv4Addr::UNSPECIFIED)?;
    socket.set_multicast_ttl_v4(0)?;
    socket.set_nonblocking(true)?;
    Ok(socket.into())
}

/// Distinguishes questions from answers (RFC 1035, section 4.1.1).
fn is_question(message: &[u8]) -> bool {
    message.get(2).is_some_and(|flags| flags & 0x80 == 0)
}
