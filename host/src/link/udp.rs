//! The client on a UDP socket, in real time.

use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::time::Duration;

use flix_protocol::frame::MAXIMUM_DATAGRAM;
use flix_protocol::message::{Command, Outcome, Refusal};
use flix_protocol::session::{ConnectError, Key};
use flix_protocol::units::Instant;

use super::{Client, StopState, Update};
use crate::interrupt::Interrupt;

/// How long a program that ends by accident repeats stop before it gives up on an acknowledgement.
/// The robot's own command deadline is 250 ms.
pub const FAREWELL_PATIENCE: Duration = Duration::from_millis(500);
/// How long a program that was asked to end repeats stop.
pub const STOP_PATIENCE: Duration = Duration::from_secs(2);
/// Longest wait for a datagram before interruptions are looked at again.
const LONGEST_WAIT: Duration = Duration::from_millis(20);
/// The shortest timeout worth asking of the operating system.
const SHORTEST_WAIT: Duration = Duration::from_millis(1);

/// What was asked of the robot did not come about.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The network did not do it.
    #[error("the network failed: {0}")]
    Network(#[from] io::Error),
    /// The operating system gave no randomness for the handshake.
    #[error("the operating system gave no random numbers for the handshake: {0}")]
    Random(#[from] getrandom::Error),
    /// No session.
    #[error("{0}")]
    Connect(ConnectError),
    /// The robot was there and is not heard any more.
    #[error("the robot fell silent: it stops by itself; check its battery and the network")]
    Silent,
    /// The robot said goodbye.
    #[error("the robot ended the session: it restarts, or got another key")]
    Left,
    /// No reply to this request, though the robot is there.
    #[error("the robot did not answer within {} s: the link loses too much; see `flix link-test`", super::REQUEST_PATIENCE.as_secs())]
    Unanswered,
    /// The robot will not.
    #[error("the robot refused: {0}")]
    Refused(Refusal),
    /// A signal.
    #[error("interrupted")]
    Interrupted,
}

/// A robot on the network.
///
/// Dropped while it drives the robot, by an error or a panic too, it stops the robot first, for at
/// most [`FAREWELL_PATIENCE`].
pub struct Connection {
    socket: UdpSocket,
    client: Client,
    start: std::time::Instant,
    interrupt: Interrupt,
}

impl Connection {
    /// Begins to connect to the robot at this address. Waits that are interrupted end with
    /// [`LinkError::Interrupted`].
    ///
    /// # Errors
    /// When there is no socket or no randomness to be had.
    pub fn open(address: SocketAddr, key: Key, interrupt: Interrupt) -> Result<Self, LinkError> {
        let any: SocketAddr = match address {
            SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
            SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
        };
        let socket = UdpSocket::bind(any)?;
        socket.connect(address)?;
        let mut entropy = [0; 32];
        getrandom::fill(&mut entropy)?;
        let client = Client::new(key, entropy, Instant::START);
        Ok(Self { socket, client, start: std::time::Instant::now(), interrupt })
    }

    /// The client's present time.
    #[must_use]
    pub fn now(&self) -> Instant {
        Instant::START + self.start.elapsed()
    }

    /// What the client knows.
    #[must_use]
    pub const fn client(&self) -> &Client {
        &self.client
    }

    /// The client and its present time, to ask something of it.
    pub fn operate(&mut self) -> (&mut Client, Instant) {
        let now = self.now();
        (&mut self.client, now)
    }

    /// Sends what is due, and takes what has come, waiting for at most `longest` for the first
    /// datagram.
    ///
    /// # Errors
    /// When the network fails in a way that trying again does not mend.
    pub fn step(&mut self, longest: Duration) -> Result<(), LinkError> {
        self.send_due()?;
        let now = self.now();
        let wait = self.client.transmit_at().map_or(longest, |at| at.since(now).min(longest));
        self.socket.set_read_timeout(Some(wait.max(SHORTEST_WAIT)))?;
        let mut datagram = [0; MAXIMUM_DATAGRAM + 1];
        let mut waits = true;
        loop {
            match self.socket.recv(&mut datagram) {
                Ok(length) => {
                    let now = self.now();
                    self.client.receive(now, &datagram[..length]);
                    if waits {
                        self.socket.set_nonblocking(true)?;
                        waits = false;
                    }
                }
                Err(error) if is_transient(&error) => break,
                Err(error) => return Err(error.into()),
            }
        }
        if !waits {
            self.socket.set_nonblocking(false)?;
        }
        self.send_due()
    }

    fn send_due(&mut self) -> Result<(), LinkError> {
        loop {
            let now = self.now();
            let Some(frame) = self.client.transmit(now) else { return Ok(()) };
            match self.socket.send(&frame) {
                Ok(_) => {}
                Err(error) if is_transient(&error) => return Ok(()),
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Runs the link until `look` finds what it wants in an update, for at most `patience`.
    /// `None` when the time is over.
    ///
    /// # Errors
    /// When there is no session any more, the network fails, or somebody interrupts.
    pub fn wait_for<T>(
        &mut self,
        patience: Duration,
        mut look: impl FnMut(&Client, &Update) -> Option<T>,
    ) -> Result<Option<T>, LinkError> {
        let deadline = self.now() + patience;
        loop {
            while let Some(update) = self.client.update() {
                if let Some(found) = look(&self.client, &update) {
                    return Ok(Some(found));
                }
                match update {
                    Update::Failed(error) => return Err(LinkError::Connect(error)),
                    Update::Lost => return Err(LinkError::Silent),
                    Update::Left => return Err(LinkError::Left),
                    _ => {}
                }
            }
            if self.interrupt.is_raised() {
                return Err(LinkError::Interrupted);
            }
            let now = self.now();
            if now >= deadline {
                return Ok(None);
            }
            self.step(deadline.since(now).min(LONGEST_WAIT))?;
        }
    }

    /// Waits until the robot is ours. How long is the session's to say
    /// ([`flix_protocol::session::CONNECT_PATIENCE`]).
    ///
    /// # Errors
    /// As for [`Connection::wait_for`].
    pub fn wait_until_connected(&mut self) -> Result<(), LinkError> {
        let is_connected =
            |_: &Client, update: &Update| (*update == Update::Connected).then_some(());
        let patience = 2 * flix_protocol::session::CONNECT_PATIENCE;
        self.wait_for(patience, is_connected)?.ok_or(LinkError::Connect(ConnectError::NoAnswer))
    }

    /// Asks something of the robot and waits for the answer. A refusal is an error.
    ///
    /// # Errors
    /// As for [`Connection::wait_for`]; when the robot refuses or does not answer.
    pub fn ask(&mut self, command: Command) -> Result<Outcome, LinkError> {
        let (client, now) = self.operate();
        let request = client.request(now, command);
        let outcome = self.wait_for(2 * super::REQUEST_PATIENCE, |_, update| match update {
            Update::Answer { request: answered, outcome } if *answered == request => {
                Some(Some(outcome.clone()))
            }
            Update::Unanswered { request: given_up } if *given_up == request => Some(None),
            _ => None,
        })?;
        match outcome.flatten() {
            Some(Outcome::Refused(refusal)) => Err(LinkError::Refused(refusal)),
            Some(outcome) => Ok(outcome),
            None => Err(LinkError::Unanswered),
        }
    }

    /// Stops the robot: repeats stop until it is acknowledged, for at most `patience`, through
    /// interruptions and lost sessions. Returns whether it was acknowledged.
    pub fn stop(&mut self, patience: Duration) -> bool {
        let (client, now) = self.operate();
        client.stop(now);
        let deadline = now + patience;
        while self.client.stop_state() != StopState::Acknowledged {
            let now = self.now();
            if now >= deadline {
                return false;
            }
            if self.step(deadline.since(now).min(LONGEST_WAIT)).is_err() {
                std::thread::sleep(SHORTEST_WAIT);
            }
            while let Some(update) = self.client.update() {
                if matches!(update, Update::Failed(_) | Update::Left) {
                    let (client, now) = self.operate();
                    client.connect(now);
                }
            }
        }
        true
    }

    /// Says goodbye, so that the next operator need not wait.
    pub fn leave(&mut self) {
        self.client.leave();
        // Nothing depends on it: without it the next operator waits for a second.
        let _ = self.send_due();
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        if self.client.is_driving() {
            self.stop(FAREWELL_PATIENCE);
        }
        self.leave();
    }
}

/// Nothing came in time, or nobody listens there yet: trying again is right.
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
    )
}
