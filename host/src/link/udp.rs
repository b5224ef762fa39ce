//! The client on a UDP socket, in real time.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use flix_protocol::frame::MAXIMUM_DATAGRAM;
use flix_protocol::message::{Refusal, State, Telemetry};
use flix_protocol::session::{ConnectError, Key, StopSession, StopStatus};
use flix_protocol::units::Instant;

use super::path::Path;
pub use super::path::transient;
use super::robot_link::{DISARM_PATIENCE, LONGEST_WAIT};
use super::{Client, LinkError, RobotLink, StopState, TELEMETRY_LAG, Update, Wish};
use crate::system::Clock;
use crate::system::interrupt::Interrupt;

/// Time for which a program that ends by accident repeats stop without an acknowledgement. The
/// robot's own deadline is [`flix_protocol::failsafe::COMMAND_DEADLINE`].
pub const FAREWELL_PATIENCE: Duration = Duration::from_millis(500);
/// Time for which a program that is interrupted repeats stop.
pub const STOP_PATIENCE: Duration = Duration::from_secs(2);
/// Time for which clearing is repeated: faults brake for half a second before they can be cleared.
pub(crate) const CLEAR_PATIENCE: Duration = Duration::from_secs(3);
/// Datagrams of one socket that are read at once while others have to be read, too.
pub(super) const ANSWERS_AT_ONCE: u32 = 64;
/// Shortest timeout that is requested from the operating system.
const SHORTEST_WAIT: Duration = Duration::from_millis(1);

impl From<io::Error> for LinkError {
    fn from(error: io::Error) -> Self {
        Self::Network(error.to_string())
    }
}

impl From<getrandom::Error> for LinkError {
    fn from(error: getrandom::Error) -> Self {
        Self::Random(error.to_string())
    }
}

/// A robot on the network.
///
/// When it is dropped while it drives the robot, also by an error or a panic, it first stops the
/// robot, for at most [`FAREWELL_PATIENCE`].
pub struct Connection {
    path: Path,
    client: Client,
    start: Clock,
    interrupt: Interrupt,
    was_connected: bool,
}

impl Connection {
    /// Begins to connect to the robot at this address. An interruption ends every wait with
    /// [`LinkError::Interrupted`].
    ///
    /// # Errors
    /// When the operating system provides no socket or no random numbers.
    pub fn open(address: SocketAddr, key: Key, interrupt: Interrupt) -> Result<Self, LinkError> {
        let path = Path::to(address)?;
        let entropy = entropy()?;
        let client = Client::new(key, entropy, Instant::START);
        let start = Clock::start();
        Ok(Self { path, client, start, interrupt, was_connected: false })
    }

    /// Returns the present time of the client.
    #[must_use]
    pub fn now(&self) -> Instant {
        Instant::START + self.start.elapsed()
    }

    /// Returns the client.
    #[must_use]
    pub const fn client(&self) -> &Client {
        &self.client
    }

    /// Receives all datagrams that have arrived, sends those that are due, and waits for at most `longest` for the next
    /// one.
    ///
    /// # Errors
    /// When the network fails permanently.
    pub fn step(&mut self, longest: Duration) -> Result<(), LinkError> {
        // First the datagrams that came meanwhile, because a sealed datagram echoes the newest of them.
        self.receive_arrived()?;
        if self.path.follow()? {
            self.client.move_address();
        }
        self.send_due()?;
        let now = self.now();
        let wait = self.client.transmit_at().map_or(longest, |at| at.since(now).min(longest));
        self.path.socket().set_read_timeout(Some(wait.max(SHORTEST_WAIT)))?;
        if self.receive_one()? {
            self.receive_arrived()?;
        }
        self.was_connected |= self.client.is_connected(self.now());
        self.send_due()
    }

    /// Receives everything that has arrived, without waiting.
    fn receive_arrived(&mut self) -> Result<(), LinkError> {
        self.path.socket().set_nonblocking(true)?;
        while self.receive_one()? {}
        Ok(self.path.socket().set_nonblocking(false)?)
    }

    /// Receives one datagram; returns whether there was one.
    fn receive_one(&mut self) -> Result<bool, LinkError> {
        let mut datagram = [0; MAXIMUM_DATAGRAM + 1];
        let Some(length) = self.path.receive(&mut datagram)? else { return Ok(false) };
        let now = self.now();
        self.client.receive(now, &datagram[..length]);
        Ok(true)
    }

    fn send_due(&mut self) -> Result<(), LinkError> {
        loop {
            let now = self.now();
            let Some(frame) = self.client.transmit(now) else { return Ok(()) };
            if !self.path.send(&frame)? {
                return Ok(());
            }
        }
    }

    /// Clears the latched stop and the faults, and returns the telemetry that stated them. A stop or fault later than `asked` stays
    /// latched, as does each that the robot had not stated when the session began.
    ///
    /// # Errors
    /// As for [`RobotLink::ask`]; when another operator stopped the robot, or the cause of a fault is still there.
    pub fn clear(&mut self, asked: std::time::Instant) -> Result<Telemetry, LinkError> {
        // A delay of telemetry makes a stop or fault look younger than it is: the oldest age among several reports decides.
        let is_known = |it: &Telemetry| it.latched_for().is_none_or(|ago| ago >= asked.elapsed());
        let first = self.wait_for_telemetry(super::REQUEST_PATIENCE, |_| true)?;
        let first = first.ok_or(LinkError::Unanswered)?;
        let judged = match is_known(&first) {
            true => Some(first),
            false => self.wait_for_telemetry(TELEMETRY_LAG, is_known)?,
        };
        let Some(judged) = judged else {
            let newest = self.telemetry().unwrap_or(first);
            return self.not_cleared(&newest);
        };
        // A robot that has halted since needs an order to clear of its own.
        let mut newer = None;
        self.press_by(|client, now| {
            newer = client.telemetry().copied().filter(|it| it.permit != judged.permit);
            if newer.is_some() { Ok(()) } else { client.press(now, Wish::Clear) }
        })?;
        if let Some(newer) = newer {
            return self.not_cleared(&newer);
        }
        let mut last = None;
        let cleared = self.wait_for(CLEAR_PATIENCE + TELEMETRY_LAG, |_, update| match update {
            Update::Telemetry(telemetry) => {
                last = Some(*telemetry);
                (!telemetry.stopped && telemetry.faults.is_empty()).then_some(None)
            }
            // A later stop of a second operator, or a later fault, needs an order to clear of its own.
            Update::Ended { why, .. } => Some(Some(why.clone())),
            _ => None,
        })?;
        match (cleared, last) {
            (Some(None), _) => Ok(judged),
            (_, Some(telemetry)) if !telemetry.faults.is_empty() => {
                Err(LinkError::faulted(&telemetry))
            }
            (Some(Some(Some(refusal))), _) => self.refused(refusal),
            _ => Err(LinkError::StillStopped),
        }
    }

    /// Ends with the faults or the stop that telemetry states, which came too late to be cleared.
    fn not_cleared<T>(&mut self, newest: &Telemetry) -> Result<T, LinkError> {
        match LinkError::of_idle(newest) {
            Some(error) => Err(error),
            None => self.refused(Refusal::Stopped),
        }
    }

    /// Stops the robot: repeats stop until it is acknowledged, for at most `patience`, also through
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

    /// Closes the session, so that the next operator need not wait.
    pub fn leave(&mut self) {
        self.client.leave();
        // Nothing depends on it: without it the next operator waits for a second.
        let _ = self.send_due();
    }
}

impl RobotLink for Connection {
    type Error = LinkError;

    fn operate(&mut self) -> (&mut Client, Instant) {
        let now = self.now();
        (&mut self.client, now)
    }

    fn wait(&mut self, longest: Duration) -> Result<(), LinkError> {
        if self.interrupt.is_raised() {
            return Err(LinkError::Interrupted);
        }
        self.step(longest)
    }

    fn no_session(&self, error: ConnectError) -> LinkError {
        match error {
            ConnectError::WrongKey if self.was_connected => LinkError::Revoked,
            ConnectError::NoAnswer if let Some(unsent) = self.path.unsent() => unsent,
            error => no_session(self.path.peer(), error),
        }
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

/// Stops the robot at this address without a session, also while another operator holds the robot, and waits until it is at rest.
/// Asks by all of these keys at once, and also at all addresses that `more` returns meanwhile, because an address may be that of
/// a relay that passes on the proof of the key and not the stop. Returns the place of the key that the robot has answered by.
///
/// # Errors
/// When no robot answers, it refuses every key, or does not come to rest; when the network fails, or
/// the program is interrupted.
pub fn stop(
    address: SocketAddr,
    keys: &[&Key],
    interrupt: &Interrupt,
    mut more: impl FnMut() -> Option<SocketAddr>,
) -> Result<usize, LinkError> {
    let start = Clock::start();
    let now = || Instant::START + start.elapsed();
    let ask = |address: SocketAddr| {
        keys.iter().map(move |key| {
            let path = Path::to(address)?;
            path.socket().set_nonblocking(true)?;
            Ok((path, StopSession::new(key, entropy()?, now())))
        })
    };
    let mut stops = ask(address).collect::<Result<Vec<_>, LinkError>>()?;
    let mut latched = None;
    let mut datagram = [0; MAXIMUM_DATAGRAM + 1];
    loop {
        while let Some(other) = more() {
            // An address that cannot be asked keeps no other from being asked.
            stops.extend(ask(other).collect::<Result<Vec<_>, LinkError>>().unwrap_or_default());
        }
        // Where others are asked, too, an error of one way ends nothing.
        let is_alone = stops.len() == keys.len();
        let (mut failed, mut failures) = (ConnectError::NoAnswer, 0);
        for (place, (path, stop)) in stops.iter_mut().enumerate() {
            let by = place % keys.len();
            if path.follow().unwrap_or_default() {
                // The robot's answers so far hold for the former address.
                path.socket().set_nonblocking(true)?;
                *stop = StopSession::new(keys[by], entropy()?, now());
            }
            while let Some(frame) = stop.poll(now()) {
                let sent = path.send(&frame);
                if is_alone {
                    sent?;
                }
            }
            match stop.status() {
                StopStatus::AtRest => return Ok(by),
                StopStatus::Failed(error) => (failed, failures) = (error, failures + 1),
                StopStatus::Latched if *latched.get_or_insert(now()) + DISARM_PATIENCE <= now() => {
                    let (wanted, actual) = (State::Disarmed, State::Stopping);
                    return Err(LinkError::State { wanted, actual });
                }
                StopStatus::Latched | StopStatus::Asking => {}
            }
        }
        if failures == stops.len() {
            if stops.iter().any(|(_, stop)| stop.is_challenged()) {
                return Err(LinkError::StopUnacknowledged);
            }
            let unsent = stops.iter().find_map(|(path, _)| path.unsent());
            return Err(unsent.unwrap_or_else(|| no_session(address, failed)));
        }
        if interrupt.is_raised() {
            return Err(LinkError::Interrupted);
        }
        for (path, stop) in &mut stops {
            for _ in 0..ANSWERS_AT_ONCE {
                // An error of a socket ends sending by it.
                let received = path.receive(&mut datagram).ok().flatten();
                let Some(length) = received else { break };
                // One that is dropped is one that a stranger sent, or came twice.
                let _ = stop.receive(now(), &datagram[..length]);
            }
        }
        std::thread::sleep(SHORTEST_WAIT);
    }
}

fn no_session(address: SocketAddr, error: ConnectError) -> LinkError {
    if address.ip().is_loopback() && error == ConnectError::NoAnswer {
        LinkError::NoneHere(address)
    } else {
        LinkError::Connect(error)
    }
}

fn entropy() -> Result<[u8; 32], getrandom::Error> {
    let mut entropy = [0; 32];
    getrandom::fill(&mut entropy)?;
    Ok(entropy)
}
