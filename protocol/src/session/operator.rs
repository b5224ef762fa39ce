//! The operator's end of a session.

use core::time::Duration;

use heapless::{Deque, Vec};

use super::channel::{Channel, Plain, SendError};
use super::connect::{ConnectError, Greeting};
use super::key::{Entropy, EphemeralKey, Key, SessionKeys, Signer};
use super::stop::StopSession;
use super::{
    CONFIRM_PATIENCE, HANDSHAKE_RETRY, HOLDER_SILENCE, SESSION_LIFE, SESSION_RENEWAL, VERSION,
};
use crate::frame::{self, Datagram, Frame, HandshakeFrame, KeyId, Nonce, PublicKey, Purpose, Tag};
use crate::message::{DropReason, Dropped, ToOperator, ToRobot};
use crate::units::Instant;

/// State of the connection, as the operator sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// A handshake is under way.
    Connecting,
    /// The session stands, and the robot was heard within [`HOLDER_SILENCE`].
    Connected,
    /// The session stands, and the robot has been silent for this long. It may come back;
    /// [`OperatorSession::connect`] starts over.
    Silent(Duration),
    /// The robot closed the session.
    Left,
    /// The handshake failed; [`OperatorSession::connect`] tries again.
    Failed(ConnectError),
}

/// Meaning of a datagram for the operator.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "handled and dropped, never stored")]
pub enum OperatorReceived {
    /// The handshake continues: send the datagram that [`OperatorSession::poll`] returns.
    Progress,
    /// The session is open.
    Connected,
    /// A message of the robot.
    Message(ToOperator),
    /// The robot closed the session.
    Left,
    /// Dropped, and counted in [`OperatorSession::health`].
    Dropped(DropReason),
}

/// Quality of the link, as the operator sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LinkHealth {
    /// Time between the newest answered command and its reply.
    pub round_trip: Option<Duration>,
    /// Sealed datagrams accepted in the present session.
    pub accepted: u64,
    /// Datagrams of the present session that the robot sent and that have not arrived.
    pub lost: u64,
    /// Datagrams dropped since this end was created, by reason.
    pub dropped: Dropped,
}

impl LinkHealth {
    /// Returns the share of the robot's datagrams that did not arrive, from 0 to 1.
    #[must_use]
    pub fn loss(&self) -> f32 {
        let sent = self.accepted + self.lost;
        if sent == 0 { 0.0 } else { self.lost as f32 / sent as f32 }
    }
}

/// Most unanswered commands that are timed at once.
const TIMED_COMMANDS: usize = 32;

/// The operator's end of the link.
///
/// Call [`OperatorSession::poll`] at the time of [`OperatorSession::poll_at`], and send each datagram that it returns. Never
/// panics on any datagram.
pub struct OperatorSession {
    key: Key,
    key_id: KeyId,
    signer: Signer,
    entropy: Entropy,
    phase: Phase,
    dropped: Dropped,
    round_trip: Option<Duration>,
    /// Request numbers and when they were sent, oldest first.
    timed: Deque<(u32, Instant), TIMED_COMMANDS>,
}

enum Phase {
    Greeting(Greeting),
    Confirming { greeting: Greeting, since: Instant, opening: Opening },
    Established(Session),
    Left,
    Failed(ConnectError),
}

/// A session that the robot is asked to open.
struct Opening {
    robot_nonce: Nonce,
    ephemeral: EphemeralKey,
    client_public: PublicKey,
    /// The datagram that asks for it, and its tag.
    confirm: HandshakeFrame,
    tag: Tag,
}

struct Session {
    channel: Channel,
    heard: Instant,
    newest_telemetry: Option<u64>,
    /// The renewal that is under way: this end's nonce, and when it is sent next.
    renewal: Option<(Nonce, Instant)>,
}

impl OperatorSession {
    /// Creates an end that begins to connect at once.
    ///
    /// `entropy` comes from the operating system's random source, fresh for every session object.
    #[must_use]
    pub fn new(key: Key, entropy: [u8; 32], now: Instant) -> Self {
        let signer = Signer::new(&key);
        let mut entropy = Entropy::new(entropy);
        let phase = Phase::Greeting(Greeting::new(&mut entropy, now));
        Self {
            key_id: key.id(),
            key,
            signer,
            entropy,
            phase,
            dropped: Dropped::default(),
            round_trip: None,
            timed: Deque::new(),
        }
    }

    /// Returns a stop of this robot that needs no session, and leaves this one alone.
    #[must_use]
    pub fn stop(&mut self, now: Instant) -> StopSession {
        StopSession::new(&self.key, *self.entropy.secret(), now)
    }

    /// Drops the present session, if any, and begins to connect.
    pub fn connect(&mut self, now: Instant) {
        self.timed.clear();
        self.phase = Phase::Greeting(Greeting::new(&mut self.entropy, now));
    }

    /// Returns the state of the connection.
    #[must_use]
    pub fn status(&self, now: Instant) -> Status {
        match &self.phase {
            Phase::Greeting(_) | Phase::Confirming { .. } => Status::Connecting,
            Phase::Established(session) => {
                let silence = now.since(session.heard);
                if silence < HOLDER_SILENCE { Status::Connected } else { Status::Silent(silence) }
            }
            Phase::Left => Status::Left,
            Phase::Failed(error) => Status::Failed(*error),
        }
    }

    /// Returns the quality of the link.
    #[must_use]
    pub fn health(&self) -> LinkHealth {
        let (accepted, lost) = match &self.phase {
            Phase::Established(session) => {
                (session.channel.window().accepted(), session.channel.window().missing())
            }
            _ => (0, 0),
        };
        LinkHealth { round_trip: self.round_trip, accepted, lost, dropped: self.dropped }
    }

    /// Returns when [`OperatorSession::poll`] is due next; `None` once the handshake is over.
    #[must_use]
    pub fn poll_at(&self) -> Option<Instant> {
        match &self.phase {
            Phase::Greeting(greeting) | Phase::Confirming { greeting, .. } => {
                Some(greeting.send_at.min(greeting.gives_up_at()))
            }
            _ => None,
        }
    }

    /// Returns the datagram that opens the session or renews its keys, if one is due. Call again until it
    /// returns `None`, and while the session stands whenever a command is sent.
    pub fn poll(&mut self, now: Instant) -> Option<HandshakeFrame> {
        self.expire(now);
        if let Phase::Established(session) = &mut self.phase {
            return session.renew(&mut self.entropy, now);
        }
        if let Phase::Confirming { mut greeting, since, .. } = self.phase
            && now.since(since) >= CONFIRM_PATIENCE
        {
            greeting.renew(&mut self.entropy);
            self.phase = Phase::Greeting(greeting);
        }
        let (Phase::Greeting(greeting) | Phase::Confirming { greeting, .. }) = &mut self.phase
        else {
            return None;
        };
        if let Some(error) = greeting.failure(now) {
            self.phase = Phase::Failed(error);
            return None;
        }
        if now < greeting.send_at {
            return None;
        }
        let repetition = greeting.repetition(now, HANDSHAKE_RETRY);
        let client_nonce = greeting.client_nonce;
        let tag = |signed: &[u8]| self.signer.tag(signed, &[]);
        Some(match &self.phase {
            Phase::Confirming { opening, .. } => opening.confirm.clone(),
            _ => {
                let (purpose, key_id) = (Purpose::Drive, &self.key_id);
                frame::hello(VERSION, &client_nonce, purpose, key_id, repetition, tag)
            }
        })
    }

    /// Receives a datagram from the robot's address.
    pub fn receive(&mut self, now: Instant, datagram: &[u8]) -> OperatorReceived {
        self.expire(now);
        let received = match Datagram::parse(datagram) {
            Some(datagram) => self.parsed(now, datagram),
            None => Err(DropReason::Malformed),
        };
        received.unwrap_or_else(|reason| {
            self.dropped.count(reason);
            OperatorReceived::Dropped(reason)
        })
    }

    /// Seals a message.
    ///
    /// # Errors
    /// When there is no session, or the message does not fit.
    pub fn send(&mut self, now: Instant, message: &ToRobot) -> Result<Frame, SendError> {
        self.expire(now);
        let Phase::Established(session) = &mut self.phase else {
            return Err(SendError::NoSession);
        };
        let frame = session.channel.seal(message)?;
        // Telemetry answers an order, with the time for which the robot had held it.
        if let ToRobot::Request(request) = message {
            if self.timed.is_full() {
                self.timed.pop_front();
            }
            let remembered = self.timed.push_back((request.number, now));
            debug_assert!(remembered.is_ok(), "one was taken out of a full queue");
        }
        Ok(frame)
    }

    /// Returns how many datagrams were sealed in the session: the number of the newest.
    #[must_use]
    pub fn sealed(&self) -> u64 {
        match &self.phase {
            Phase::Established(session) => session.channel.sealed(),
            _ => 0,
        }
    }

    /// Seals any bytes, for tests of a robot's answer to messages that it cannot read.
    ///
    /// # Errors
    /// As for [`OperatorSession::send`].
    pub fn send_bytes(&mut self, plain: &[u8]) -> Result<Frame, SendError> {
        let Phase::Established(session) = &mut self.phase else {
            return Err(SendError::NoSession);
        };
        session.channel.seal_copy(plain)
    }

    /// Ends the session and returns the datagram that informs the robot.
    ///
    /// # Errors
    /// When there is no session.
    pub fn goodbye(&mut self) -> Result<Frame, SendError> {
        let Phase::Established(session) = &mut self.phase else {
            return Err(SendError::NoSession);
        };
        let frame = session.channel.seal_copy(&[]);
        self.phase = Phase::Left;
        frame
    }

    fn parsed(
        &mut self,
        now: Instant,
        datagram: Datagram<'_>,
    ) -> Result<OperatorReceived, DropReason> {
        match datagram {
            Datagram::Challenge { robot_nonce, signed, tag } => {
                let (Phase::Greeting(greeting) | Phase::Confirming { greeting, .. }) = &self.phase
                else {
                    return Err(DropReason::Session);
                };
                if !self.signer.verify(signed, &[&greeting.client_nonce], &tag) {
                    return Err(DropReason::Forged);
                }
                if matches!(self.phase, Phase::Confirming { .. }) {
                    // The robot may have accepted the first already, and takes no second.
                    return Err(DropReason::Replayed);
                }
                let mut greeting = *greeting;
                (greeting.send_at, greeting.hint) = (now, None);
                let opening = self.opening(&greeting.client_nonce, robot_nonce);
                self.phase = Phase::Confirming { greeting, since: now, opening };
                Ok(OperatorReceived::Progress)
            }
            Datagram::Accept { session, robot_public, signed, tag } => {
                let Phase::Confirming { greeting, opening, .. } = &self.phase else {
                    return Err(DropReason::Session);
                };
                if !self.signer.verify(signed, &[&opening.tag], &tag) {
                    return Err(DropReason::Forged);
                }
                let nonces = [&greeting.client_nonce, &opening.robot_nonce];
                let keys = opening.keys(&self.key, nonces, &robot_public);
                let keys = keys.filter(|keys| keys.session == session);
                let channel = Channel::operator(&keys.ok_or(DropReason::Malformed)?, now);
                self.phase = Phase::Established(Session {
                    channel,
                    heard: now,
                    newest_telemetry: None,
                    renewal: None,
                });
                Ok(OperatorReceived::Connected)
            }
            Datagram::Refusal { reason, version, client_nonce, .. } => {
                self.refused(now, ConnectError::refused(reason, version), &client_nonce)
            }
            Datagram::Held { client_nonce, holder, signed, tag } => {
                // A robot that is held has our key, so it says so with a good tag.
                if !self.signer.verify(signed, &[], &tag) {
                    return Err(DropReason::Forged);
                }
                self.refused(now, ConnectError::Busy(holder), &client_nonce)
            }
            Datagram::Sealed(sealed) => {
                let Phase::Established(open) = &mut self.phase else {
                    return Err(DropReason::Session);
                };
                let plain = open.channel.open(now, &sealed)?;
                open.heard = now;
                if sealed.is_renewal {
                    return self.renewed(now, &plain);
                }
                self.opened(now, sealed.counter, &plain)
            }
            Datagram::Hello(_)
            | Datagram::Confirm(_)
            | Datagram::Stop(_)
            | Datagram::Stopped { .. } => Err(DropReason::Malformed),
        }
    }

    fn refused(
        &mut self,
        now: Instant,
        error: ConnectError,
        client_nonce: &Nonce,
    ) -> Result<OperatorReceived, DropReason> {
        let (Phase::Greeting(greeting) | Phase::Confirming { greeting, .. }) = &mut self.phase
        else {
            return Err(DropReason::Session);
        };
        greeting.refused(now, error, client_nonce)?;
        Ok(OperatorReceived::Progress)
    }

    /// Prepares the datagram that asks a robot which has proved to be fresh for a session.
    fn opening(&mut self, client_nonce: &Nonce, robot_nonce: Nonce) -> Opening {
        let ephemeral = EphemeralKey::new(&mut self.entropy);
        let client_public = ephemeral.public();
        let mut tag = Tag::default();
        let sign = |signed: &[u8]| {
            tag = self.signer.tag(signed, &[]);
            tag
        };
        let confirm =
            frame::confirm(client_nonce, &robot_nonce, &self.key_id, &client_public, sign);
        Opening { robot_nonce, ephemeral, client_public, confirm, tag }
    }

    /// Ends a session whose keys were not renewed in time.
    fn expire(&mut self, now: Instant) {
        if let Phase::Established(session) = &mut self.phase {
            session.channel.expire(now);
            if session.channel.age(now) >= SESSION_LIFE {
                self.phase = Phase::Left;
            }
        }
    }

    /// Takes the robot's nonce: uses the new keys from now on.
    fn renewed(&mut self, now: Instant, plain: &Plain) -> Result<OperatorReceived, DropReason> {
        let Phase::Established(session) = &mut self.phase else {
            return Err(DropReason::Session);
        };
        let robot_nonce = plain.as_slice().try_into().map_err(|_| DropReason::Malformed)?;
        let Some((client_nonce, _)) = session.renewal.take() else {
            return Err(DropReason::Stale);
        };
        session.channel.prepare([&client_nonce, &robot_nonce]);
        session.channel.switch(now);
        Ok(OperatorReceived::Progress)
    }

    fn opened(
        &mut self,
        now: Instant,
        counter: u64,
        plain: &Plain,
    ) -> Result<OperatorReceived, DropReason> {
        if plain.is_empty() {
            self.phase = Phase::Left;
            return Ok(OperatorReceived::Left);
        }
        let message = postcard::from_bytes(plain).map_err(|_| DropReason::Malformed)?;
        match &message {
            ToOperator::Telemetry(_) => {
                if let Phase::Established(session) = &mut self.phase {
                    session.newest_telemetry = session.newest_telemetry.max(Some(counter));
                    if session.newest_telemetry != Some(counter) {
                        return Err(DropReason::Stale);
                    }
                }
            }
            ToOperator::Reply(reply) => self.time_reply(now, reply.request),
            ToOperator::Event(_) => {}
        }
        Ok(OperatorReceived::Message(message))
    }

    /// Measures the round trip of a reply, unless the command was sent more than once: then it is
    /// unknown which one was answered (Karn's rule).
    fn time_reply(&mut self, now: Instant, request: u32) {
        let sent: Vec<Instant, 2> = self
            .timed
            .iter()
            .filter(|(number, _)| *number == request)
            .map(|(_, at)| *at)
            .take(2)
            .collect();
        if let [at] = sent[..] {
            self.round_trip = Some(now.since(at));
        }
        self.timed.retain(|(number, _)| *number != request);
    }
}

impl Opening {
    /// Returns the keys of the session; `None` when this key of the robot makes no secret.
    fn keys(
        &self,
        key: &Key,
        nonces: [&Nonce; 2],
        robot_public: &PublicKey,
    ) -> Option<SessionKeys> {
        let shared = self.ephemeral.agree(robot_public)?;
        Some(SessionKeys::first(key, nonces, [&self.client_public, robot_public], &shared))
    }
}

impl Session {
    /// Returns the request for new keys, when it is due.
    fn renew(&mut self, entropy: &mut Entropy, now: Instant) -> Option<HandshakeFrame> {
        if self.channel.age(now) < SESSION_RENEWAL {
            return None;
        }
        let (nonce, send_at) = self.renewal.get_or_insert_with(|| (entropy.nonce(), now));
        if now < *send_at {
            return None;
        }
        *send_at = now + HANDSHAKE_RETRY;
        self.channel.seal_renewal(nonce)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Confirm;
    use crate::session::key::tests::SMALL_ORDER;

    #[test]
    fn a_robot_whose_ephemeral_key_makes_no_secret_is_not_believed() {
        let now = Instant::from_micros(1_000);
        let key = Key::new([1; 32]);
        let signer = Signer::new(&key);
        let mut operator = OperatorSession::new(key.clone(), [22; 32], now);
        let hello = operator.poll(now).unwrap();
        let Some(Datagram::Hello(hello)) = Datagram::parse(&hello) else { panic!("a hello") };
        let (client_nonce, robot_nonce) = (hello.client_nonce, [6; 16]);
        let challenge = frame::challenge(&robot_nonce, |it| signer.tag(it, &[&client_nonce]));
        assert_eq!(operator.receive(now, &challenge), OperatorReceived::Progress);
        let confirm = operator.poll(now).unwrap();
        let Some(Datagram::Confirm(Confirm { client_public, tag, .. })) = Datagram::parse(&confirm)
        else {
            panic!("a confirm")
        };
        for public in SMALL_ORDER {
            // All else is right, the number of the session, too.
            let (nonces, publics) = ([&client_nonce, &robot_nonce], [&client_public, &public]);
            let keys = SessionKeys::first(&key, nonces, publics, &[0; 32]);
            let accept = frame::accept(keys.session, &public, |it| signer.tag(it, &[&tag]));
            let received = operator.receive(now, &accept);
            assert_eq!(received, OperatorReceived::Dropped(DropReason::Malformed));
        }
        assert_eq!(operator.status(now), Status::Connecting);
    }
}
