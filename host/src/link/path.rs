//! A UDP socket to one address, whose own address follows the computer's.

use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use super::LinkError;
use crate::system::PASSING_SOCKET_ERRORS;

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
    /// Why the system refused the last datagram; `None` where the system took it.
    refused: Option<io::ErrorKind>,
}

impl Path {
    /// Opens a way to this address.
    ///
    /// # Errors
    /// When the system has no socket, or no way there.
    pub(super) fn to(to: SocketAddr) -> Result<Self, LinkError> {
        let socket = connect(to).map_err(|error| match why_unsent(error.kind()) {
            Some(why) => LinkError::Unsent { to, why },
            None => error.into(),
        })?;
        Ok(Self { to, socket, look_at: Instant::now() + LOOK, refused: None })
    }

    /// Returns why nothing reaches the address, where the system refused the last datagram.
    pub(super) fn unsent(&self) -> Option<LinkError> {
        Some(LinkError::Unsent { to: self.to, why: why_unsent(self.refused?)? })
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
    pub(super) fn send(&mut self, datagram: &[u8]) -> io::Result<bool> {
        let sent = self.socket.send(datagram);
        self.refused = sent.as_ref().err().map(io::Error::kind);
        Ok(transient(sent)?.is_some())
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

/// Returns cause and remedy of a system that sends nothing, for errors that name a cause.
const fn why_unsent(kind: io::ErrorKind) -> Option<&'static str> {
    match kind {
        io::ErrorKind::PermissionDenied => Some(
            "its firewall refuses; allow this program there (macOS: System Settings, Privacy & Security, Local Network; \
             Windows: Windows Security, Allow an app through firewall)",
        ),
        io::ErrorKind::HostUnreachable
        | io::ErrorKind::NetworkUnreachable
        | io::ErrorKind::NetworkDown
        | io::ErrorKind::AddrNotAvailable => Some(
            "it has no way there; is this computer in the robot's network, and the robot on? (macOS: allow your terminal in System \
             Settings, Privacy & Security, Local Network)",
        ),
        _ => None,
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

/// Returns the result of a socket; `None` for a passing error: no datagram in time, a closed port, or a network that is
/// away for a while.
///
/// # Errors
/// When it does not pass.
pub fn transient<T>(result: io::Result<T>) -> io::Result<Option<T>> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error) if is_transient(&error) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Returns whether the error passes: nothing arrived in time, no program listens there yet, or the network is away.
fn is_transient(error: &io::Error) -> bool {
    use io::ErrorKind as Kind;
    matches!(
        error.kind(),
        Kind::WouldBlock
            | Kind::TimedOut
            | Kind::Interrupted
            | Kind::ConnectionRefused
            | Kind::ConnectionReset
            | Kind::HostUnreachable
            | Kind::NetworkUnreachable
            | Kind::NetworkDown
            | Kind::AddrNotAvailable
    ) || error.raw_os_error().is_some_and(|code| PASSING_SOCKET_ERRORS.contains(&code))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As the systems number them: `EPERM`, `ENOMEM`, `EACCES`, `ENODEV`, `EINVAL`, `ENETDOWN`, `ENETUNREACH`, `ECONNRESET`, `ENOBUFS`,
    /// `ECONNREFUSED`, `EHOSTDOWN`, `EHOSTUNREACH` of Linux; the same of Windows.
    #[cfg(target_os = "linux")]
    const PASSING: &[i32] = &[1, 12, 13, 19, 22, 100, 101, 104, 105, 111, 112, 113];
    #[cfg(windows)]
    const PASSING: &[i32] =
        &[10_013, 10_022, 10_040, 10_050, 10_051, 10_052, 10_054, 10_055, 10_064, 10_065];
    #[cfg(not(any(target_os = "linux", windows)))]
    const PASSING: &[i32] = &[];

    #[test]
    fn a_datagram_that_the_system_refuses_is_an_error_with_a_remedy() {
        // No socket sends to all hosts unless asked to: EACCES.
        let to = (Ipv4Addr::BROADCAST, 9).into();
        let refused = Path::to(to).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(refused.contains("255.255.255.255") && refused.contains("firewall"), "{refused}");
        let mut path = Path::to((Ipv4Addr::LOCALHOST, 9).into()).unwrap();
        for (kind, word) in [
            (io::ErrorKind::PermissionDenied, "firewall"),
            (io::ErrorKind::NetworkUnreachable, "no way"),
            (io::ErrorKind::HostUnreachable, "Local Network"),
        ] {
            path.refused = Some(kind);
            assert!(path.unsent().unwrap().to_string().contains(word), "{kind}");
        }
        path.refused = Some(io::ErrorKind::ConnectionRefused);
        assert_eq!(path.unsent(), None);
    }

    #[test]
    fn a_network_that_is_away_or_busy_passes_and_a_broken_socket_does_not() {
        for code in PASSING {
            let away = transient(Err::<(), _>(io::Error::from_raw_os_error(*code)));
            assert!(matches!(away, Ok(None)), "{code}: {away:?}");
        }
        // EBADF everywhere that is not Windows; there, no error of a socket.
        assert!(transient(Err::<(), _>(io::Error::from_raw_os_error(9))).is_err());
    }
}
