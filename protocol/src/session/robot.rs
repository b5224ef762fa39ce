//! The robot's end of a session.

use core::net::SocketAddr;
use core::time::Duration;

use heapless::Vec;

use super::channel::{Channel, Plain, SendError, split_echo};
use super::cookie::Cookies;
use super::key::{Entropy, EphemeralKey, Key, SessionKeys, Signer, same};
use super::operators::{MAXIMUM_OPERATORS, Operator, Operators};
use super::send_times::{LONGEST_COMMAND_AGE, SendTimes};
use super::{
    COOKIE_EPOCHS, HOLDER_SILENCE, SESSION_EXPIRY, SESSION_LIFE, STOP_COOKIE_EPOCHS,
    STOP_COOKIE_LIFE, VERSION,
};
use crate::failsafe::COMMAND_AGE;
use crate::frame::{
    self, Confirm, Datagram, Frame, HandshakeFrame, Hello, KeyId, Nonce, Purpose, RefusalReason,
    Sealed, Stop, Tag,
};
use crate::message::{
    DropReason, Dropped, LinkQuality, OperatorName, ToOperator, ToRobot, unreadable,
};
use crate::units::Instant;

/// Meaning of a datagram for the robot.
#[derive(Debug, Clone, PartialEq)]
pub enum RobotReceived {
    /// The handshake continues: send this back to the sender of the datagram.
    Answer(HandshakeFrame),
    /// An operator opened a session: send this back to the sender of the datagram.
    Connected(HandshakeFrame),
    /// A message: authentic, not replayed, fresh, and newer than every message before.
    Message(ToRobot),
    /// As [`RobotReceived::Message`], but older than the command age. Only orders that are safe at any time may be obeyed: the
    /// operator may be gone.
    Late {
        /// The message.
        message: ToRobot,
        /// Its age, at most; `None`: older than the robot remembers.
        age: Option<Duration>,
    },
    /// An authentic request with this number that cannot be read: refuse it.
    Unreadable(u32),
    /// The operator closed the session.
    Left,
    /// This operator demands a stop outside a session, also while another holds it: latch the stop, and send this back to the
    /// sender of the datagram.
    Stop(HandshakeFrame, OperatorName),
    /// Dropped, and counted in [`RobotSession::quality`]. When there is a frame, send it back to
    /// the sender of the datagram.
    Dropped(DropReason, Option<HandshakeFrame>),
}

/// The robot's end of the link: authenticates operators, and holds at most one session.
///
/// Its size is constant. A datagram that is not authentic changes only the counters of dropped
/// datagrams. Never panics on any datagram.
pub struct RobotSession {
    credentials: Vec<Credential, MAXIMUM_OPERATORS>,
    entropy: Entropy,
    cookies: Cookies,
    /// Of stops: a session that begins meanwhile does not make them invalid.
    stop_cookies: Cookies,
    /// Cookies of the newest stops, and when each came: each stops the robot once.
    stops: Vec<(Nonce, Instant), STOPS>,
    is_at_rest: bool,
    holder: Option<Holder>,
    accepted: u32,
    dropped: Dropped,
    last_message: Option<Instant>,
    command_age: Duration,
    /// Age of the newest message at its arrival; `None`: older than is remembered, or no message.
    age: Option<Duration>,
    late: u32,
}

/// Stops that are remembered: more than operators demand within the life of a cookie. One more makes all cookies of stops
/// invalid: the next operator who demands a stop gets a new one.
const STOPS: usize = 8;

/// An operator with the signers that are derived from its key.
struct Credential {
    name: OperatorName,
    key_id: KeyId,
    key: Key,
    handshake: Signer,
    stop: Signer,
}

impl Credential {
    fn new(operator: &Operator) -> Self {
        let key = operator.key();
        Self {
            name: operator.name(),
            key_id: key.id(),
            handshake: Signer::new(&key),
            stop: Signer::for_stop(&key),
            key,
        }
    }

    /// Returns the credential with the key that a datagram claims. Identifiers are public.
    fn find<'a>(credentials: &'a [Self], key_id: &KeyId) -> Option<&'a Self> {
        credentials.iter().find(|credential| credential.key_id == *key_id)
    }

    /// Returns the credential with the key that a datagram claims, if the datagram's tag proves it.
    fn proven<'a>(
        credentials: &'a [Self],
        key_id: &KeyId,
        signer: fn(&Self) -> &Signer,
        signed: &[u8],
        tag: &Tag,
    ) -> Option<&'a Self> {
        Self::find(credentials, key_id).filter(|it| signer(it).verify(signed, &[], tag))
    }
}

/// The operator that holds the session.
struct Holder {
    peer: SocketAddr,
    name: OperatorName,
    key_id: KeyId,
    /// Tag of the Confirm that opened the session, and its answer.
    confirm: Tag,
    accept: HandshakeFrame,
    channel: Channel,
    sent: SendTimes,
    /// Arrival of the newest fresh datagram; before the first, the moment of the Challenge.
    heard: Instant,
    /// Moment of the newest fresh datagram.
    moment: Instant,
    newest_message: Option<u64>,
    /// The renewal that is under way, or was the last: the operator's nonce and the robot's.
    renewal: Option<(Nonce, Nonce)>,
}

impl RobotSession {
    /// Creates the end of a robot without a session. Without operators it refuses everybody.
    ///
    /// `entropy` comes from a hardware random source, fresh at every start.
    #[must_use]
    pub fn new(operators: impl Into<Operators>, entropy: [u8; 32]) -> Self {
        let mut entropy = Entropy::new(entropy);
        Self {
            cookies: Cookies::new(&mut entropy),
            stop_cookies: Cookies::new(&mut entropy),
            stops: Vec::new(),
            is_at_rest: false,
            entropy,
            credentials: operators.into().iter().map(Credential::new).collect(),
            holder: None,
            accepted: 0,
            dropped: Dropped::default(),
            last_message: None,
            command_age: COMMAND_AGE,
            age: None,
            late: 0,
        }
    }

    /// Sets other operators, or none. The present session goes on if its holder's key is among theirs;
    /// otherwise it ends without an answer. Returns whether a session goes on.
    pub fn set_operators(&mut self, operators: impl Into<Operators>) -> bool {
        let operators = operators.into();
        self.credentials = operators.iter().map(Credential::new).collect();
        self.cookies = Cookies::new(&mut self.entropy);
        self.stop_cookies = Cookies::new(&mut self.entropy);
        self.holder = self.holder.take().and_then(|holder| {
            let name = Credential::find(&self.credentials, &holder.key_id)?.name;
            Some(Holder { name, ..holder })
        });
        self.holder.is_some()
    }

    /// Ends the present session, if any, and wipes its keys. Send [`RobotSession::goodbye`] first
    /// to inform its holder.
    pub fn end(&mut self) {
        self.holder = None;
    }

    /// Returns the address of the operator that holds the session: messages go there.
    #[must_use]
    pub fn peer(&self, now: Instant) -> Option<SocketAddr> {
        let holder = self.holder.as_ref()?;
        let is_alive =
            now.since(holder.heard) < SESSION_EXPIRY && holder.channel.age(now) < SESSION_LIFE;
        is_alive.then_some(holder.peer)
    }

    /// Returns the name of the operator that holds the session.
    #[must_use]
    pub fn operator(&self, now: Instant) -> Option<OperatorName> {
        self.peer(now)?;
        self.holder.as_ref().map(|holder| holder.name)
    }

    /// Returns the time since the last valid message of any session; `None` when there was none.
    #[must_use]
    pub fn silence(&self, now: Instant) -> Option<Duration> {
        self.last_message.map(|at| now.since(at))
    }

    /// Returns how well the robot receives. The board adds the radio power.
    #[must_use]
    pub fn quality(&self, now: Instant) -> LinkQuality {
        let clamp = |number: u64| u32::try_from(number).unwrap_or(u32::MAX);
        let missing = self.holder.as_ref().map_or(0, |holder| holder.channel.window().missing());
        LinkQuality {
            accepted: self.accepted,
            lost: clamp(missing),
            dropped: self.dropped,
            silence_us: microseconds(self.silence(now)),
            age_us: microseconds(self.age),
            late: self.late,
            signal_dbm: None,
        }
    }

    /// Sets the age up to which a command counts, at most [`LONGEST_COMMAND_AGE`].
    pub fn set_command_age(&mut self, age: Duration) {
        self.command_age = age.min(LONGEST_COMMAND_AGE);
    }

    /// Sets whether a stop is latched and the motors are not driven, which Stopped states to [`StopSession`].
    ///
    /// [`StopSession`]: super::StopSession
    pub const fn set_at_rest(&mut self, is_at_rest: bool) {
        self.is_at_rest = is_at_rest;
    }

    /// Returns the age up to which a command counts.
    #[must_use]
    pub const fn command_age(&self) -> Duration {
        self.command_age
    }

    /// Returns the moment of the holder's newest fresh datagram: the time at which the robot sent the newest datagram that the
    /// holder had seen. `None` without a session.
    #[must_use]
    pub fn moment(&self) -> Option<Instant> {
        self.holder.as_ref().map(|holder| holder.moment)
    }

    /// Returns the number of the newest message, among the operator's datagrams of the session, counted from 1; 0 before the first.
    #[must_use]
    pub fn newest_message(&self) -> u64 {
        let newest = self.holder.as_ref().and_then(|holder| holder.newest_message);
        newest.map_or(0, |counter| counter.saturating_add(1))
    }

    /// Receives a datagram from this address.
    pub fn receive(&mut self, now: Instant, from: SocketAddr, datagram: &[u8]) -> RobotReceived {
        if self.peer(now).is_none() {
            self.end();
        }
        if let Some(holder) = &mut self.holder {
            holder.channel.expire(now);
        }
        let received = match Datagram::parse(datagram) {
            Some(
                Datagram::Hello(Hello { client_nonce, .. })
                | Datagram::Confirm(Confirm { client_nonce, .. })
                | Datagram::Stop(Stop { client_nonce, .. }),
            ) if self.credentials.is_empty() => {
                refuse(RefusalReason::Unprovisioned, &client_nonce, None)
            }
            Some(Datagram::Hello(hello)) => self.hello(now, from, &hello),
            Some(Datagram::Confirm(confirm)) => self.confirm(now, from, &confirm),
            Some(Datagram::Sealed(sealed)) => match self.opened(now, from, &sealed) {
                Ok(plain) if sealed.is_renewal => self.renew(now, sealed.session, &plain),
                Ok(plain) => self.sealed(now, sealed.counter, &plain),
                Err(reason) => RobotReceived::Dropped(reason, None),
            },
            Some(Datagram::Stop(stop)) => self.stop(now, from, &stop),
            _ => RobotReceived::Dropped(DropReason::Malformed, None),
        };
        match &received {
            RobotReceived::Dropped(reason, _) => self.dropped.count(*reason),
            _ => self.accepted = self.accepted.saturating_add(1),
        }
        received
    }

    /// Seals a message to the operator. Returns the address to send it to.
    ///
    /// # Errors
    /// When there is no session, or the message does not fit.
    pub fn send(
        &mut self,
        now: Instant,
        message: &ToOperator,
    ) -> Result<(SocketAddr, Frame), SendError> {
        let peer = self.peer(now).ok_or(SendError::NoSession)?;
        let holder = self.holder.as_mut().ok_or(SendError::NoSession)?;
        let frame = holder.channel.seal(message)?;
        holder.sent.sent(holder.channel.sealed(), now);
        Ok((peer, frame))
    }

    /// Ends the session and returns the datagram that informs its holder.
    ///
    /// # Errors
    /// When there is no session.
    pub fn goodbye(&mut self, now: Instant) -> Result<(SocketAddr, Frame), SendError> {
        let peer = self.peer(now).ok_or(SendError::NoSession)?;
        let mut holder = self.holder.take().ok_or(SendError::NoSession)?;
        Ok((peer, holder.channel.seal_copy(&[])?))
    }

    fn hello(&self, now: Instant, from: SocketAddr, hello: &Hello<'_>) -> RobotReceived {
        let Hello { version, client_nonce, purpose, key_id, signed, tag } = hello;
        let credential = Credential::find(&self.credentials, key_id);
        if *version != VERSION {
            return refuse(RefusalReason::Version, client_nonce, credential);
        }
        let Some(credential) = credential.filter(|it| it.handshake.verify(signed, &[], tag)) else {
            // An operator with another key cannot verify a tag, and a flood should cost nothing.
            return refuse(RefusalReason::Key, client_nonce, None);
        };
        let signer = &credential.handshake;
        let cookies = match purpose {
            Some(Purpose::Drive) => match self.held_against(now, from, key_id) {
                Some(holder) => return held(client_nonce, key_id, holder, signer),
                None => &self.cookies,
            },
            Some(Purpose::Stop) => &self.stop_cookies,
            None => return RobotReceived::Dropped(DropReason::Malformed, None),
        };
        let robot_nonce = cookies.nonce(now, from, client_nonce);
        let tag = |signed: &[u8]| signer.tag(signed, &[client_nonce]);
        RobotReceived::Answer(frame::challenge(&robot_nonce, tag))
    }

    fn confirm(&mut self, now: Instant, from: SocketAddr, confirm: &Confirm<'_>) -> RobotReceived {
        let Confirm { client_nonce, robot_nonce, key_id, client_public, signed, tag: claimed } =
            confirm;
        let credentials = &self.credentials;
        let Some(Credential { name, key, handshake: signer, .. }) =
            Credential::proven(credentials, key_id, |it| &it.handshake, signed, claimed)
        else {
            return RobotReceived::Dropped(DropReason::Forged, None);
        };
        if let Some(holder) = &self.holder
            && holder.peer == from
            && same(&holder.confirm, claimed)
        {
            // The Accept was lost: send it again. Nothing starts over.
            return RobotReceived::Answer(holder.accept.clone());
        }
        let Some(moment) = self.cookies.moment(now, COOKIE_EPOCHS, from, client_nonce, robot_nonce)
        else {
            return RobotReceived::Dropped(DropReason::Replayed, None);
        };
        if let Some(holder) = self.held_against(now, from, key_id) {
            return held(client_nonce, key_id, holder, signer);
        }
        // From here on it costs two multiplications on the curve: one try for each cookie.
        self.cookies = Cookies::new(&mut self.entropy);
        let ephemeral = EphemeralKey::new(&mut self.entropy);
        let Some(shared) = ephemeral.agree(client_public) else {
            return RobotReceived::Dropped(DropReason::Malformed, None);
        };
        let publics = [client_public, &ephemeral.public()];
        let keys = SessionKeys::first(key, [client_nonce, robot_nonce], publics, &shared);
        let answer = frame::accept(keys.session, publics[1], |it| signer.tag(it, &[claimed]));
        // A holder that connects anew was heard in its session before, too. One that others replace was silent for so long that
        // it makes no difference to them.
        let heard = self.holder.as_ref().map_or(moment, |it| it.heard.max(moment));
        self.holder = Some(Holder {
            peer: from,
            name: *name,
            key_id: *key_id,
            confirm: *claimed,
            accept: answer.clone(),
            channel: Channel::robot(&keys, now),
            sent: SendTimes::new(now),
            heard,
            moment,
            newest_message: None,
            renewal: None,
        });
        RobotReceived::Connected(answer)
    }

    /// Receives a stop outside a session. A repeated one is answered and changes nothing.
    fn stop(&mut self, now: Instant, from: SocketAddr, stop: &Stop<'_>) -> RobotReceived {
        let Stop { client_nonce, robot_nonce, key_id, signed, tag: claimed } = stop;
        let credentials = &self.credentials;
        let Some(Credential { name, stop: signer, .. }) =
            Credential::proven(credentials, key_id, |it| &it.stop, signed, claimed)
        else {
            return RobotReceived::Dropped(DropReason::Forged, None);
        };
        if self
            .stop_cookies
            .moment(now, STOP_COOKIE_EPOCHS, from, client_nonce, robot_nonce)
            .is_none()
        {
            return RobotReceived::Dropped(DropReason::Replayed, None);
        }
        let tag = |signed: &[u8]| signer.tag(signed, &[client_nonce, robot_nonce]);
        let answer = frame::stopped(self.is_at_rest, tag);
        if self.stops.iter().any(|(known, _)| same(known, robot_nonce)) {
            return RobotReceived::Answer(answer);
        }
        let name = *name;
        // A cookie that is good no longer needs not be known.
        self.stops.retain(|(_, came)| now.since(*came) <= STOP_COOKIE_LIFE);
        if self.stops.push((*robot_nonce, now)).is_err() {
            // One that is forgotten must not count again: no cookie made until now does.
            self.stops.clear();
            self.stop_cookies = Cookies::new(&mut self.entropy);
        }
        RobotReceived::Stop(answer, name)
    }

    /// Opens a sealed datagram of the holder.
    fn opened(
        &mut self,
        now: Instant,
        from: SocketAddr,
        sealed: &Sealed<'_>,
    ) -> Result<Plain, DropReason> {
        self.holder
            .as_mut()
            .filter(|holder| holder.peer == from && holder.channel.knows(sealed.session))
            .ok_or(DropReason::Session)?
            .channel
            .open(now, sealed)
    }

    /// Makes the next keys of the session ready. A repeated request gets the same answer.
    fn renew(&mut self, now: Instant, session: u32, plain: &Plain) -> RobotReceived {
        let Some(holder) = &mut self.holder else {
            return RobotReceived::Dropped(DropReason::Session, None);
        };
        let Some(Ok(client_nonce)) = split_echo(plain).map(|(_, nonce)| Nonce::try_from(nonce))
        else {
            return RobotReceived::Dropped(DropReason::Malformed, None);
        };
        if session != holder.channel.session() {
            // Sent before the operator knew that its keys are renewed already.
            return RobotReceived::Dropped(DropReason::Stale, None);
        }
        let robot_nonce = match &holder.renewal {
            Some((known, robot_nonce)) if same(known, &client_nonce) => *robot_nonce,
            _ => {
                let robot_nonce = self.entropy.nonce();
                holder.channel.prepare([&client_nonce, &robot_nonce]);
                holder.renewal = Some((client_nonce, robot_nonce));
                robot_nonce
            }
        };
        match holder.channel.seal_renewal(&robot_nonce) {
            Some(answer) => {
                holder.sent.sent(holder.channel.sealed(), now);
                RobotReceived::Answer(answer)
            }
            None => RobotReceived::Dropped(DropReason::Session, None),
        }
    }

    fn sealed(&mut self, now: Instant, counter: u64, plain: &Plain) -> RobotReceived {
        let Some(holder) = &mut self.holder else {
            return RobotReceived::Dropped(DropReason::Session, None);
        };
        let Some((echo, plain)) = split_echo(plain) else {
            return RobotReceived::Dropped(DropReason::Malformed, None);
        };
        if plain.is_empty() {
            self.end();
            return RobotReceived::Left;
        }
        let was_sent = echo <= holder.channel.sealed();
        let moment = holder.sent.moment(echo).filter(|_| was_sent);
        let age = moment.map(|moment| now.since(moment));
        let is_fresh = age.is_some_and(|age| age <= self.command_age);
        if is_fresh {
            holder.heard = now;
            holder.moment = holder.moment.max(moment.unwrap_or_default());
        }
        if holder.newest_message.is_some_and(|newest| counter < newest) {
            return RobotReceived::Dropped(DropReason::Stale, None);
        }
        let Ok(message) = postcard::from_bytes(plain) else {
            return match unreadable(plain) {
                Some(number) => RobotReceived::Unreadable(number),
                None => RobotReceived::Dropped(DropReason::Malformed, None),
            };
        };
        holder.newest_message = Some(counter);
        self.age = age;
        if is_fresh {
            self.last_message = Some(now);
            RobotReceived::Message(message)
        } else {
            self.late = self.late.saturating_add(1);
            RobotReceived::Late { message, age }
        }
    }

    /// Returns a session that is not that of this address and key, if it was heard recently. Only the holder's own key
    /// at the holder's own address is the holder.
    fn held_against(&self, now: Instant, from: SocketAddr, key_id: &KeyId) -> Option<&Holder> {
        let holder = self.holder.as_ref()?;
        let is_other = holder.peer != from || holder.key_id != *key_id;
        (is_other && now.since(holder.heard) < HOLDER_SILENCE).then_some(holder)
    }
}

/// Refuses, with a tag where both ends hold one key.
fn refuse(
    reason: RefusalReason,
    client_nonce: &Nonce,
    credential: Option<&Credential>,
) -> RobotReceived {
    let tag = |signed: &[u8]| {
        credential.map(|known| known.handshake.tag_any_version(signed)).unwrap_or_default()
    };
    let answer = frame::refusal(reason, VERSION, client_nonce, tag);
    let reason = match reason {
        RefusalReason::Version => DropReason::Version,
        RefusalReason::Key => DropReason::Forged,
        RefusalReason::Unprovisioned => DropReason::Unprovisioned,
    };
    RobotReceived::Dropped(reason, Some(answer))
}

/// Refuses an operator, by its key, because another holds the session.
fn held(client_nonce: &Nonce, key_id: &KeyId, holder: &Holder, signer: &Signer) -> RobotReceived {
    let other = (holder.key_id != *key_id).then_some(holder.name);
    let answer = frame::held(client_nonce, other, |signed| signer.tag(signed, &[]));
    RobotReceived::Dropped(DropReason::Busy, Some(answer))
}

/// Returns this time in microseconds; the longest there is when it is unknown or does not fit.
fn microseconds(time: Option<Duration>) -> u32 {
    time.and_then(|time| u32::try_from(time.as_micros()).ok()).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::key::tests::SMALL_ORDER;

    /// Only a holder of the key can send such a Confirm, and the multiplications are worth a cookie even to him.
    #[test]
    fn an_ephemeral_key_that_makes_no_secret_opens_no_session_and_uses_up_its_cookie() {
        let now = Instant::from_micros(1_000);
        let from = ([192, 168, 4, 2], 4000).into();
        let key = Key::new([1; 32]);
        let signer = Signer::new(&key);
        let sign = |signed: &[u8]| signer.tag(signed, &[]);
        let mut robot = RobotSession::new(Some(key.clone()), [11; 32]);
        for public in SMALL_ORDER {
            let hello = frame::hello(VERSION, &[5; 16], Purpose::Drive, &key.id(), 0, sign);
            let RobotReceived::Answer(challenge) = robot.receive(now, from, &hello) else {
                panic!("a challenge")
            };
            let Some(Datagram::Challenge { robot_nonce, .. }) = Datagram::parse(&challenge) else {
                panic!("a challenge")
            };
            let good = EphemeralKey::new(&mut Entropy::new([7; 32])).public();
            let received = [public, good].map(|public| {
                let confirm = frame::confirm(&[5; 16], &robot_nonce, &key.id(), &public, sign);
                robot.receive(now, from, &confirm)
            });
            let dropped = [DropReason::Malformed, DropReason::Replayed];
            assert_eq!(received, dropped.map(|reason| RobotReceived::Dropped(reason, None)));
        }
    }
}
