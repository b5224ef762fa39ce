//! A UDP socket to one address, whose own address follows the computer's.

use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use super::udp::transient;

/// Silence after which the system is asked by which address it would send now, and the time between two such questions: a
/// computer that has changed its network is back within a second.
const LOOK: Duration = Duration::from_millis(250);

/// A way to one address.
///
/// The system chooses the address that a socket sends from when the socket is connected, and keeps it. A computer that moves to
/// another network, or gets another address, sends from one that is gone: with an error, or in silence. So while nothing
/// arrives, a second socket asks the system anew, and takes the place of the first where the answer is another.
pub(super) struct Path {
    to: SocketAddr,
    socket: UdpSocket,
    look_at: Instant,
}

impl Path {
    /// Opens a way to this address.
    ///
    /// # Errors
    /// When the system has no socket, or no way there.
    pub(super) fn to(to: SocketAddr) -> io::Result<Self> {
        Ok(Self { to, socket: connect(to)?, look_at: Instant::now() + LOOK })
    }

    /// Returns the socket.
    pub(super) const fn socket(&self) -> &UdpSocket {
        &self.socket
    }

    /// Returns where the way leads.
    pub(super) const fn peer(&self) -> SocketAddr {
        self.to
    }

    /// Takes another socket where the computer would send from another address now; returns whether it did.
    ///
    /// # Errors
    /// When the system does not know its sockets.
    pub(super) fn follow(&mut self) -> io::Result<bool> {
        let now = Instant::now();
        if now < self.look_at {
            return Ok(false);
        }
        self.look_at = now + LOOK;
        // Without any way there the present socket is as good as another.
        let Ok(other) = connect(self.to) else { return Ok(false) };
        let has_moved = other.local_addr()?.ip() != self.socket.local_addr()?.ip();
        if has_moved {
            self.socket = other;
        }
        Ok(has_moved)
    }

    /// Sends a datagram; returns whether the system took it.
    ///
    /// # Errors
    /// When the network fails permanently.
    pub(super) fn send(&self, datagram: &[u8]) -> io::Result<bool> {
        Ok(transient(self.socket.send(datagram))?.is_some())
    }

    /// Receives a datagram, and returns its length; `None` where none has arrived in time.
    ///
    /// # Errors
    /// When the network fails permanently.
    pub(super) fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        let received = transient(self.socket.recv(buffer))?;
        if received.is_some() {
            self.look_at = Instant::now() + LOOK;
        }
        Ok(received)
    }
}

/// Returns a socket that sends to this address and receives from it alone.
pub(super) fn connect(address: SocketAddr) -> io::Result<UdpSocket> {
    let any: SocketAddr = match address {
        SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
        SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
    };
    let socket = UdpSocket::bind(any)?;
    socket.connect(address)?;
    Ok(socket)
}
