//! The robot's end of a session.

use core::net::{IpAddr, SocketAddr};
use core::time::Duration;

use super::channel::{Channel, SendError};
use super::key::{Entropy, HmacSha256, Key, SessionKeys, Signer, keyed, same, tag};
use super::{COOKIE_EPOCH, HOLDER_SILENCE, SESSION_EXPIRY, VERSION};
use crate::frame::{self, Datagram, Frame, HandshakeFrame, Nonce, RefusalReason, Tag, Version};
use crate::message::{
    Command, DropReason, Dropped, LinkQuality, Refusal, ToOperator, ToRobot, unreadable,
};
use crate::units::Instant;

/// Meaning of a datagram for the robot.
#[derive(Debug, Clone, PartialEq)]
pub enum RobotReceived {
    /// The handshake continues: send this back to the sender of the datagram.
    Answer(HandshakeFrame),
    /// An operator opened a session: send this back to the sender of the datagram.
    Connected(HandshakeFrame),
    /// A command: authentic, not replayed, and newer than every command before (a `Stop` may be
    /// older).
    Command(ToRobot),
    /// An authentic command that cannot be done: answer the request with this refusal.
    Refused {
        /// [`ToRobot::request`].
        request: u32,
        /// The reason.
        refusal: Refusal,
    },
    /// The operator closed the session.
    Left,
    /// Dropped, and counted in [`RobotSession::quality`]. When there is a frame, send it back to
    /// the sender of the datagram.
    Dropped(DropReason, Option<HandshakeFrame>),
}

/// The robot's end of the link: authenticates operators, and holds at most one session.
///
/// Its size is constant. A datagram that is not authentic changes only the counters of dropped
/// datagrams. Never panics on any datagram.
pub struct RobotSession {
    identity: Option<(Key, Signer)>,
    entropy: Entropy,
    cookies: Cookies,
    holder: Option<Holder>,
    accepted: u32,
    dropped: Dropped,
    last_command: Option<Instant>,
}

/// The operator that holds the session.
struct Holder {
    peer: SocketAddr,
    client_nonce: Nonce,
    robot_nonce: Nonce,
    channel: Channel,
    heard: Instant,
    newest_command: Option<u64>,
}

impl RobotSession {
    /// Creates the end of a robot without a session. Without a key it refuses all operators.
    ///
    /// `entropy` comes from a hardware random source, fresh at every start.
    #[must_use]
    pub fn new(key: Option<Key>, entropy: [u8; 32]) -> Self {
        let mut entropy = Entropy::new(entropy);
        Self {
            cookies: Cookies::new(&mut entropy),
            entropy,
            identity: key.map(with_signer),
            holder: None,
            accepted: 0,
            dropped: Dropped::default(),
            last_command: None,
        }
    }

    /// Sets another key, or none. The present session ends without an answer.
    pub fn set_key(&mut self, key: Option<Key>) {
        self.identity = key.map(with_signer);
        self.end();
        self.cookies = Cookies::new(&mut self.entropy);
    }

    /// Ends the present session, if any, and wipes its keys. Send [`RobotSession::goodbye`] first
    /// to inform its holder.
    pub fn end(&mut self) {
        self.holder = None;
    }

    /// Returns whether the robot has a key.
    #[must_use]
    pub const fn is_provisioned(&self) -> bool {
        self.identity.is_some()
    }

    /// Returns the address of the operator that holds the session: messages go there.
    #[must_use]
    pub fn peer(&self, now: Instant) -> Option<SocketAddr> {
        let holder = self.holder.as_ref()?;
        (now.since(holder.heard) < SESSION_EXPIRY).then_some(holder.peer)
    }

    /// Returns the time since the last valid command of any session; `None` when there was none.
    #[must_use]
    pub fn silence(&self, now: Instant) -> Option<Duration> {
        self.last_command.map(|at| now.since(at))
    }

    /// Returns how well the robot receives. The board adds the radio power.
    #[must_use]
    pub fn quality(&self, now: Instant) -> LinkQuality {
        let clamp = |number: u64| u32::try_from(number).unwrap_or(u32::MAX);
        let missing = self.holder.as_ref().map_or(0, |holder| holder.channel.window().missing());
        let silence = self.silence(now).map(|silence| silence.as_micros());
        LinkQuality {
            accepted: self.accepted,
            lost: clamp(missing),
            dropped: self.dropped,
            silence_us: silence.and_then(|us| u32::try_from(us).ok()).unwrap_or(u32::MAX),
            signal_dbm: None,
        }
    }

    /// Receives a datagram from this address.
    pub fn receive(&mut self, now: Instant, from: SocketAddr, datagram: &[u8]) -> RobotReceived {
        if self.peer(now).is_none() {
            self.end();
        }
        let received = match Datagram::parse(datagram) {
            Some(Datagram::Hello { version, client_nonce, signed, tag }) => {
                self.hello(now, from, version, &client_nonce, signed, &tag)
            }
            Some(Datagram::Confirm { client_nonce, robot_nonce, signed, tag }) => {
                self.confirm(now, from, &client_nonce, &robot_nonce, signed, &tag)
            }
            Some(Datagram::Sealed { session, counter, header, ciphertext, tag }) => {
                self.sealed(now, from, session, counter, header, ciphertext, &tag)
            }
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
        Ok((peer, holder.channel.seal(message)?))
    }

    /// Ends the session and returns the datagram that informs its holder.
    ///
    /// # Errors
    /// When there is no session.
    pub fn goodbye(&mut self, now: Instant) -> Result<(SocketAddr, Frame), SendError> {
        let peer = self.peer(now).ok_or(SendError::NoSession)?;
        let mut holder = self.holder.take().ok_or(SendError::NoSession)?;
        Ok((peer, holder.channel.seal_goodbye()?))
    }

    fn hello(
        &self,
        now: Instant,
        from: SocketAddr,
        version: Version,
        client_nonce: &Nonce,
        signed: &[u8],
        claimed: &Tag,
    ) -> RobotReceived {
        let Some((_, signer)) = &self.identity else {
            return self.refuse(RefusalReason::Unprovisioned, client_nonce);
        };
        if version != VERSION {
            return self.refuse(RefusalReason::Version, client_nonce);
        }
        if !signer.verify(signed, &[], claimed) {
            return self.refuse(RefusalReason::Key, client_nonce);
        }
        if self.is_held_against(now, from) {
            return self.refuse(RefusalReason::Busy, client_nonce);
        }
        let robot_nonce = self.cookies.nonce(now, from, client_nonce);
        let tag = |signed: &[u8]| signer.tag(signed, &[client_nonce]);
        RobotReceived::Answer(frame::challenge(&robot_nonce, tag))
    }

    fn confirm(
        &mut self,
        now: Instant,
        from: SocketAddr,
        client_nonce: &Nonce,
        robot_nonce: &Nonce,
        signed: &[u8],
        claimed: &Tag,
    ) -> RobotReceived {
        let Some((key, signer)) = &self.identity else {
            return self.refuse(RefusalReason::Unprovisioned, client_nonce);
        };
        if !signer.verify(signed, &[], claimed) {
            return RobotReceived::Dropped(DropReason::Forged, None);
        }
        if let Some(holder) = &self.holder
            && holder.peer == from
            && same(&holder.client_nonce, client_nonce)
            && same(&holder.robot_nonce, robot_nonce)
        {
            // The Accept was lost: send it again. Nothing starts over.
            return RobotReceived::Answer(accept(signer, holder));
        }
        if !self.cookies.is_fresh(now, from, client_nonce, robot_nonce) {
            return RobotReceived::Dropped(DropReason::Replayed, None);
        }
        if self.is_held_against(now, from) {
            return self.refuse(RefusalReason::Busy, client_nonce);
        }
        let holder = Holder {
            peer: from,
            client_nonce: *client_nonce,
            robot_nonce: *robot_nonce,
            channel: Channel::robot(&SessionKeys::derive(key, client_nonce, robot_nonce)),
            heard: now,
            newest_command: None,
        };
        let answer = accept(signer, &holder);
        self.holder = Some(holder);
        self.cookies = Cookies::new(&mut self.entropy);
        RobotReceived::Connected(answer)
    }

    #[allow(clippy::too_many_arguments, reason = "the fields of one datagram")]
    fn sealed(
        &mut self,
        now: Instant,
        from: SocketAddr,
        session: u32,
        counter: u64,
        header: &[u8],
        ciphertext: &[u8],
        tag: &Tag,
    ) -> RobotReceived {
        let Some(holder) = self
            .holder
            .as_mut()
            .filter(|holder| holder.peer == from && holder.channel.session() == session)
        else {
            return RobotReceived::Dropped(DropReason::Session, None);
        };
        let plain = match holder.channel.open(counter, header, ciphertext, tag) {
            Ok(plain) => plain,
            Err(reason) => return RobotReceived::Dropped(reason, None),
        };
        holder.heard = now;
        if plain.is_empty() {
            self.end();
            return RobotReceived::Left;
        }
        let command = postcard::from_bytes::<ToRobot>(&plain);
        let is_stop = matches!(&command, Ok(ToRobot { command: Command::Stop, .. }));
        if !is_stop && holder.newest_command.is_some_and(|newest| counter < newest) {
            return RobotReceived::Dropped(DropReason::Stale, None);
        }
        match command {
            Ok(command) => {
                holder.newest_command = holder.newest_command.max(Some(counter));
                self.last_command = Some(now);
                RobotReceived::Command(command)
            }
            Err(_) => match unreadable(&plain) {
                Some((request, refusal)) => RobotReceived::Refused { request, refusal },
                None => RobotReceived::Dropped(DropReason::Malformed, None),
            },
        }
    }

    /// Returns whether another operator holds the session and was received recently.
    fn is_held_against(&self, now: Instant, from: SocketAddr) -> bool {
        self.holder
            .as_ref()
            .is_some_and(|holder| holder.peer != from && now.since(holder.heard) < HOLDER_SILENCE)
    }

    fn refuse(&self, reason: RefusalReason, client_nonce: &Nonce) -> RobotReceived {
        // An operator with another key cannot verify a tag, and a flood should cost nothing.
        let tag = |signed: &[u8]| match &self.identity {
            Some((_, signer)) if reason != RefusalReason::Key => signer.tag_any_version(signed),
            _ => Tag::default(),
        };
        let answer = frame::refusal(reason, VERSION, client_nonce, tag);
        let reason = match reason {
            RefusalReason::Version => DropReason::Version,
            RefusalReason::Key => DropReason::Forged,
            RefusalReason::Busy => DropReason::Busy,
            RefusalReason::Unprovisioned => DropReason::Unprovisioned,
        };
        RobotReceived::Dropped(reason, Some(answer))
    }
}

/// Makes nonces that need not be stored.
struct Cookies(HmacSha256);

impl Cookies {
    /// Creates cookies with a new secret: all earlier nonces become invalid.
    fn new(entropy: &mut Entropy) -> Self {
        Self(keyed(&entropy.secret()))
    }

    /// Returns the nonce for this peer and this client nonce now.
    fn nonce(&self, now: Instant, peer: SocketAddr, client_nonce: &Nonce) -> Nonce {
        self.nonce_of(epoch(now), peer, client_nonce)
    }

    /// Returns whether this nonce was made for this peer and this client nonce in this epoch or the
    /// one before, in constant time.
    fn is_fresh(
        &self,
        now: Instant,
        peer: SocketAddr,
        client_nonce: &Nonce,
        robot_nonce: &Nonce,
    ) -> bool {
        let present = epoch(now);
        [present, present.saturating_sub(1)]
            .iter()
            .any(|&epoch| same(&self.nonce_of(epoch, peer, client_nonce), robot_nonce))
    }

    fn nonce_of(&self, epoch: u64, peer: SocketAddr, client_nonce: &Nonce) -> Nonce {
        let address = match peer.ip() {
            IpAddr::V4(address) => address.to_ipv6_mapped(),
            IpAddr::V6(address) => address,
        };
        let (epoch, port) = (epoch.to_le_bytes(), peer.port().to_le_bytes());
        tag(&self.0, &[&epoch, &address.octets(), &port, client_nonce])
    }
}

fn with_signer(key: Key) -> (Key, Signer) {
    let signer = Signer::new(&key);
    (key, signer)
}

fn accept(signer: &Signer, holder: &Holder) -> HandshakeFrame {
    frame::accept(holder.channel.session(), |signed| {
        signer.tag(signed, &[&holder.client_nonce, &holder.robot_nonce])
    })
}

/// Returns the number of the cookie's epoch.
const fn epoch(now: Instant) -> u64 {
    now.as_micros() / COOKIE_EPOCH.as_micros() as u64
}
