//! The receiving end.
//!
//! NatNet is not authenticated. The source takes datagrams of the server's address alone, on the network
//! card that reaches it, and trusts no stream that jumps ([`crate::pose::continuity`]). An attacker on the
//! same network who forges the server's address can still keep the poses from being trusted.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::str::FromStr;
use std::time::Duration;

use flix_protocol::units::Instant;
use natnet::command::{
    CommandError, ConnectOptions, Request, connect_request, connect_request_with,
    disconnect_datagram, keepalive_datagram, request_modeldef,
};
use natnet::net::{DataClient, MIN_DATA_BUFFER, RawCommandClient};
use natnet::{
    Decoder, Message, MessageHeader, ModelDef, NAT_MODELDEF, NAT_SERVERINFO, ParsePolicy,
    ServerInfo, Version,
};
use socket2::{Domain, Protocol, Socket, Type};

use super::UpAxis;
use super::frames::{Frames, Judged, NatNetReading, NatNetStatistics};
use crate::link::transient;
use crate::pose::{PoseError, PoseSample, PoseSource};
use crate::system::text::printable;

/// A unicast server forgets a client that is silent for longer; NatNet's own samples send this
/// often.
const KEEPALIVE: Duration = Duration::from_millis(250);
/// A question without an answer is asked again after so long: either datagram may be lost.
const ASK_AGAIN: Duration = Duration::from_millis(300);
/// A stream without a frame for longer is over, as after a restart of Motive, which knows no client then: it is greeted again.
const SILENCE: Duration = Duration::from_secs(1);
/// Bit of a frame that says that the list of bodies has changed (NatNet SDK 4.1, `NatNetTypes.h`).
const LIST_CHANGED: u16 = 0x02;
/// Shortest wait that is requested from the operating system.
const SHORTEST_WAIT: Duration = Duration::from_millis(1);
/// Frames in a row that prove the layout that was asked for. A frame of the layout before may still be on its way.
const FRAMES_OF_PROOF: u32 = 3;
/// The newest layout that is understood: it is asked for where the server's own is newer.
const NEWEST: Version = Version::V4_1;
/// Most datagrams that one call of `poll` reads: a flood of them cannot keep the caller from its other work.
/// 128,000 a second at 500 calls a second.
const DATAGRAMS_AT_ONCE: u32 = 256;

/// The rigid body that is the robot.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Body {
    /// The only one that is streamed.
    #[default]
    Only,
    /// By streaming number.
    Number(i32),
    /// By Motive's name for it.
    Name(String),
}

impl FromStr for Body {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        // "007" is a name.
        let number = text.parse().ok().filter(|number: &i32| number.to_string() == text);
        Ok(number.map_or_else(|| Self::Name(text.to_owned()), Self::Number))
    }
}

/// Origin of the stream, and the body wanted of it.
#[derive(Debug, Clone)]
pub struct NatNetSettings {
    /// Motive's computer and command port.
    pub server: SocketAddrV4,
    /// The address of the network card that reaches it; unspecified leaves the choice to the
    /// system.
    pub interface: Ipv4Addr,
    /// The rigid body that is the robot.
    pub body: Body,
    /// Motive's up axis.
    pub up: UpAxis,
    /// How long to wait for Motive's answers.
    pub timeout: Duration,
}

/// Why there is no stream.
#[derive(Debug, thiserror::Error)]
pub enum NatNetError {
    /// A socket could not be had.
    #[error(
        "cannot open a socket on {interface}: {source}; is this the address of a network card here?"
    )]
    Socket {
        /// The card that was asked for.
        interface: Ipv4Addr,
        /// Error of the operating system.
        source: io::Error,
    },
    /// No server answered.
    #[error(
        "no answer from {0}: start Motive there (or `flix-sim serve --natnet`), switch on its data streaming, let UDP ports 1510 and 1511 \
         through its firewall, and set its streaming interface to the network card that reaches this \
         computer, not to loopback"
    )]
    NoAnswer(SocketAddrV4),
    /// A server answered, but not in NatNet.
    #[error("{server} answered with something that is not NatNet: {reason}")]
    NotNatNet {
        /// Address of the server.
        server: SocketAddrV4,
        /// The contradiction.
        reason: String,
    },
    /// A layout that is not known.
    #[error(
        "{server} streams NatNet {version}; 3.0, 3.1 and all from 4.0 on are understood: update Motive"
    )]
    Version {
        /// Address of the server.
        server: SocketAddrV4,
        /// Names the version.
        version: String,
    },
    /// A layout newer than those known, on a stream whose server cannot be asked for another.
    #[error(
        "{server} streams NatNet {version} by multicast; there 3.0 to 4.1 are understood: switch Motive's data streaming to \
         unicast, where 4.1 can be asked for"
    )]
    Multicast {
        /// Address of the server.
        server: SocketAddrV4,
        /// Names the version.
        version: String,
    },
    /// A stream by multicast to an address that is no group.
    #[error(
        "{server} streams to {group}, which is no multicast group: set the multicast interface to 239.255.42.99 in Motive's data \
         streaming, or switch it to unicast"
    )]
    NoGroup {
        /// Address of the server.
        server: SocketAddrV4,
        /// Where to.
        group: Ipv4Addr,
    },
    /// The server was asked for a layout that is known, and streams another.
    #[error(
        "{server} speaks NatNet {version}, was asked for 4.1, and does not send it ({reason}): close other programs that \
         receive from Motive by unicast, then restart its data streaming; if that does not help, use a Motive \
         that speaks 4.1 or earlier, or send the poses as text (--pose udp:PORT)"
    )]
    NotGranted {
        /// Address of the server.
        server: SocketAddrV4,
        /// The version that it speaks.
        version: String,
        /// The contradiction.
        reason: String,
    },
    /// The asked body is not streamed.
    #[error("Motive streams no rigid body \"{wanted}\"; it has: {present}")]
    NoSuchBody {
        /// Asked for.
        wanted: String,
        /// Bodies that there are.
        present: String,
    },
    /// Several bodies and none was named.
    #[error("Motive streams several rigid bodies ({0}): say which is the robot with --body")]
    WhichBody(String),
    /// Several bodies are meant.
    #[error(
        "it is ambiguous which rigid body is the robot: {0} share a name or a number; give each its own name and streaming \
         number in Motive"
    )]
    Ambiguous(String),
}

/// Result of a read from the socket.
enum Received {
    /// A datagram of the server's stream, of this length.
    Datagram(usize),
    /// One beside the stream.
    Answer(usize),
    /// A datagram of another sender.
    Foreign,
}

/// A stream to a group.
struct Multicast {
    stream: DataClient,
    /// Its socket, by which the group is joined again.
    card: Socket,
    group: Ipv4Addr,
    port: u16,
}

impl Multicast {
    /// Opens the stream that the server announces; `None` for one to this computer alone.
    fn open(info: &ServerInfo, settings: &NatNetSettings) -> Result<Option<Self>, NatNetError> {
        if !info.connection.multicast {
            return Ok(None);
        }
        let (group, port) = (info.multicast_group(), info.connection.data_port);
        if !group.is_multicast() {
            return Err(NatNetError::NoGroup { server: settings.server, group });
        }
        let failed = |source| NatNetError::Socket { interface: settings.interface, source };
        let socket = multicast_socket(group, port, settings.interface).map_err(failed)?;
        let card = Socket::from(socket.try_clone().map_err(failed)?);
        Ok(Some(Self { stream: DataClient::from_socket(socket), card, group, port }))
    }
}

/// A stream of poses from Motive.
pub struct NatNetSource {
    settings: NatNetSettings,
    /// Whether the system's choice of network card is followed, because none was named.
    follows: bool,
    info: ServerInfo,
    layout: Layout,
    bodies: Vec<(String, i32)>,
    body: Option<i32>,
    command: RawCommandClient,
    /// Where frames come; without it by `command`.
    multicast: Option<Multicast>,
    next_keepalive: Instant,
    /// Request that begins the stream, repeated at intervals.
    greeting: Vec<u8>,
    greet_at: Instant,
    buffer: Vec<u8>,
    frames: Frames,
    heard: Option<Instant>,
    /// When to ask which bodies there are now; nothing while that is known. Numbers may be of other bodies until then, and
    /// no pose is trusted.
    ask_bodies_at: Option<Instant>,
}

impl NatNetSource {
    /// Greets the server, finds the robot's rigid body, and opens the stream that the server
    /// announces.
    ///
    /// # Errors
    /// Each with a remedy.
    pub fn connect(mut settings: NatNetSettings) -> Result<Self, NatNetError> {
        let follows = settings.interface.is_unspecified();
        if follows {
            settings.interface = interface_towards(settings.server)
                .map_err(|source| NatNetError::Socket { interface: settings.interface, source })?;
        }
        let socket = |source| NatNetError::Socket { interface: settings.interface, source };
        let client = RawCommandClient::bind(settings.interface, settings.server).map_err(socket)?;
        let conversation = Conversation { client, settings };
        let info = conversation.greet()?;
        let layout = Layout::of(&info, conversation.settings.server)?;
        let bodies = conversation.bodies(&info, layout)?;
        let body = choose(&bodies, &conversation.settings.body)?;
        let Conversation { client, settings } = conversation;
        let socket = |source| NatNetError::Socket { interface: settings.interface, source };
        client.set_nonblocking(true).map_err(socket)?;
        let greeting = layout.begin(settings.server)?;
        let multicast = Multicast::open(&info, &settings)?;
        Ok(Self {
            settings,
            follows,
            info,
            layout,
            bodies,
            body,
            command: client,
            multicast,
            next_keepalive: Instant::START,
            greeting,
            greet_at: Instant::START,
            buffer: vec![0; MIN_DATA_BUFFER],
            frames: Frames::default(),
            heard: None,
            ask_bodies_at: None,
        })
    }

    /// Returns the server that streams.
    #[must_use]
    pub fn server(&self) -> &ServerInfo {
        &self.info
    }

    /// Describes the version that the server speaks, and the one that it was asked for.
    #[must_use]
    pub fn version(&self) -> String {
        let spoken = self.info.protocol_version;
        if self.layout.is_asked_for {
            format!("{spoken}, asked for {}", self.layout.version)
        } else {
            format!("{spoken}, asked for no other")
        }
    }

    /// Names and numbers of all streamed rigid bodies.
    #[must_use]
    pub fn bodies(&self) -> &[(String, i32)] {
        &self.bodies
    }

    /// Returns counts of the frames received so far.
    #[must_use]
    pub fn statistics(&self) -> NatNetStatistics {
        self.frames.statistics
    }

    fn say(&self, what: &[u8]) -> io::Result<()> {
        transient(self.command.send(what)).map(drop)
    }

    /// Takes another socket where the system reaches the server from another address now: a computer that has changed its network
    /// hears nothing by the former one.
    fn follow(&mut self) {
        let server = self.settings.server;
        // Without any way there, or a socket, the present one is as good as another.
        let Ok(interface) = interface_towards(server) else { return };
        if self.follows
            && interface != self.settings.interface
            && let Ok(client) = RawCommandClient::bind(interface, server)
            && client.set_nonblocking(true).is_ok()
        {
            (self.command, self.settings.interface) = (client, interface);
        }
    }

    /// Joins the group of a stream by multicast anew: a network card that was away has forgotten it.
    fn join_again(&self) {
        if let Some(Multicast { card, group, .. }) = &self.multicast {
            // While the card is away both fail, and are tried again.
            let _ = card.leave_multicast_v4(group, &self.settings.interface);
            let _ = card.join_multicast_v4(group, &self.settings.interface);
        }
    }

    fn receive(&mut self, now: Instant) -> io::Result<Option<Received>> {
        if self.ask_bodies_at.is_some_and(|at| now >= at) {
            self.ask_bodies_at = Some(now + ASK_AGAIN);
            let question = request_modeldef().map_err(io::Error::other)?;
            self.say(question.as_bytes())?;
        }
        let heard = *self.heard.get_or_insert(now);
        if now.since(heard) > SILENCE && now >= self.greet_at {
            self.greet_at = now + ASK_AGAIN;
            self.follow();
            self.join_again();
            self.say(&self.greeting)?;
        }
        let mut kind: fn(usize) -> Received = Received::Datagram;
        let received = match &mut self.multicast {
            Some(Multicast { stream, .. }) => match transient(self.command.recv(&mut self.buffer))?
            {
                Some(received) => {
                    kind = Received::Answer;
                    Ok(received)
                }
                None => stream.recv(&mut self.buffer),
            },
            None => {
                if now >= self.next_keepalive {
                    self.next_keepalive = now + KEEPALIVE;
                    transient(self.command.send(&keepalive_datagram()))?;
                }
                self.command.recv(&mut self.buffer)
            }
        };
        let Some((length, from)) = transient(received)? else { return Ok(None) };
        if from.ip() == *self.settings.server.ip() {
            return Ok(Some(kind(length)));
        }
        self.frames.statistics.strangers += 1;
        self.frames.statistics.stranger = Some(from.ip());
        Ok(Some(Received::Foreign))
    }

    /// Doubts the numbers of the bodies after a frame that gives reason to, and after silence.
    fn doubt(&mut self, now: Instant, is_doubtful: bool) {
        let is_after_silence = self.heard.is_some_and(|heard| now.since(heard) > SILENCE);
        if is_after_silence || is_doubtful {
            self.ask_bodies_at = Some(now);
        }
        self.heard = Some(now);
    }

    /// Takes the server's answer to another greeting: a Motive that started anew may speak another version, or
    /// stream another way.
    fn renew(&mut self, now: Instant, info: ServerInfo) -> Result<(), NatNetError> {
        let [spoken, before] = [&info, &self.info].map(|info| info.protocol_version);
        let is_granted = self.layout.is_asked_for && spoken == self.layout.version;
        if spoken != before && !is_granted {
            self.layout = Layout::of(&info, self.settings.server)?;
            self.greeting = self.layout.begin(self.settings.server)?;
            (self.greet_at, self.ask_bodies_at) = (now, Some(now));
            self.heard = Some(Instant::START);
        }
        let group =
            info.connection.multicast.then(|| (info.multicast_group(), info.connection.data_port));
        if group != self.multicast.as_ref().map(|it| (it.group, it.port)) {
            self.multicast = Multicast::open(&info, &self.settings)?;
        }
        self.info = if is_granted { ServerInfo { protocol_version: before, ..info } } else { info };
        Ok(())
    }

    /// Takes the list of bodies as it is now, which Motive also sends unasked. While it leaves open which is the robot, it is
    /// asked for again.
    fn look_up(&mut self, now: Instant, model: &ModelDef) {
        self.bodies = named(model);
        match choose(&self.bodies, &self.settings.body) {
            Ok(body) => (self.body, self.ask_bodies_at) = (body, None),
            Err(_) => self.ask_bodies_at = self.ask_bodies_at.or(Some(now)),
        }
    }
}

impl PoseSource for NatNetSource {
    fn poll(&mut self, now: Instant) -> Result<Option<PoseSample>, PoseError> {
        for _ in 0..DATAGRAMS_AT_ONCE {
            let length = match self.receive(now)? {
                None => return Ok(None),
                Some(Received::Foreign) => continue,
                Some(Received::Answer(length)) => length,
                Some(Received::Datagram(length)) => {
                    self.frames.statistics.datagrams += 1;
                    length
                }
            };
            let datagram = &self.buffer[..length];
            let is_list =
                || MessageHeader::parse(datagram).is_ok_and(|it| it.message_id == NAT_MODELDEF);
            if is_list() {
                let Layout { version, .. } = self.layout;
                match ModelDef::parse_with_policy(datagram, version, self.layout.policy()) {
                    Ok(model) => self.look_up(now, &model),
                    Err(_) => self.frames.statistics.unreadable += 1,
                }
                continue;
            }
            if let Ok(info) = ServerInfo::parse(datagram) {
                self.renew(now, info).map_err(io::Error::other)?;
                continue;
            }
            match NatNetReading::in_layout(datagram, self.layout, self.body, self.settings.up) {
                Ok(Some(reading)) => {
                    let frequency = self.info.high_res_clock_frequency;
                    let Judged { sample, is_doubtful } = self.frames.take(now, &reading, frequency);
                    self.doubt(now, is_doubtful);
                    if let Some(sample) = sample {
                        let valid = sample.valid && self.ask_bodies_at.is_none();
                        return Ok(Some(PoseSample { valid, ..sample }));
                    }
                }
                Ok(None) => {}
                Err(_) => self.frames.statistics.unreadable += 1,
            }
        }
        Ok(None)
    }
}

impl Drop for NatNetSource {
    fn drop(&mut self) {
        if self.multicast.is_none() {
            // A courtesy: a server that does not hear it forgets us anyway.
            let _ = self.command.send(&disconnect_datagram());
        }
    }
}

impl NatNetReading {
    /// Reads one datagram of a stream; `None` for datagrams that are no frames. `body`: the robot's
    /// number, or `None` for the only body. A body whose numbers are not finite counts as not
    /// tracked.
    ///
    /// # Errors
    /// When the datagram does not fit the version's layout.
    pub fn from_datagram(
        datagram: &[u8],
        version: Version,
        body: Option<i32>,
        up: UpAxis,
    ) -> Result<Option<Self>, natnet::Error> {
        Self::in_layout(datagram, Layout { version, is_asked_for: false }, body, up)
    }

    fn in_layout(
        datagram: &[u8],
        layout: Layout,
        body: Option<i32>,
        up: UpAxis,
    ) -> Result<Option<Self>, natnet::Error> {
        let decoder = Decoder::new(layout.version)?.with_policy(layout.policy());
        let Message::FrameOfData(frame) = decoder.parse(datagram)?.into_message() else {
            return Ok(None);
        };
        let mut meant =
            frame.rigid_bodies.iter().filter(|b| body.is_none_or(|number| b.id == number));
        // Of several bodies none can be told to be the robot.
        let found = meant.next().filter(|_| meant.next().is_none());
        let body = found.map(|b| {
            let pose = up.to_pose(b.position, b.orientation);
            (pose, b.tracking_valid() && pose.is_sound())
        });
        let ticks = [frame.timing.camera_mid_exposure, frame.timing.transmit];
        let is_list_changed = frame.params & LIST_CHANGED != 0;
        Ok(Some(Self { frame: frame.frame_number, body, ticks, is_list_changed }))
    }
}

/// Layout of a stream's datagrams.
#[derive(Debug, Clone, Copy)]
struct Layout {
    version: Version,
    /// Whether it is not the server's own: then it is not taken on trust.
    is_asked_for: bool,
}

impl Layout {
    fn of(info: &ServerInfo, server: SocketAddrV4) -> Result<Self, NatNetError> {
        let spoken = info.protocol_version;
        if spoken.validate().is_ok() {
            return Ok(Self { version: spoken, is_asked_for: false });
        }
        let version = spoken.to_string();
        if !spoken.at_least(NEWEST.major, NEWEST.minor) {
            return Err(NatNetError::Version { server, version });
        }
        if info.connection.multicast {
            return Err(NatNetError::Multicast { server, version });
        }
        Ok(Self { version: NEWEST, is_asked_for: true })
    }

    /// Returns the request that begins a stream of this layout.
    fn greeting(self) -> Result<Request, CommandError> {
        if self.is_asked_for {
            connect_request_with(ConnectOptions::requesting(self.version))
        } else {
            connect_request()
        }
    }

    fn begin(self, server: SocketAddrV4) -> Result<Vec<u8>, NatNetError> {
        let greeting = self.greeting().map_err(|error| not_natnet(server, error))?;
        Ok(greeting.as_bytes().to_vec())
    }

    const fn policy(self) -> ParsePolicy {
        if self.is_asked_for { ParsePolicy::Strict } else { ParsePolicy::Compatible }
    }
}

fn not_natnet(server: SocketAddrV4, reason: impl ToString) -> NatNetError {
    NatNetError::NotNatNet { server, reason: reason.to_string() }
}

type Bodies = Vec<(String, i32)>;

fn named(model: &ModelDef) -> Bodies {
    model.rigid_bodies().map(|(name, id)| (name.to_owned(), id)).collect()
}

/// Questions to a server, and its answers.
struct Conversation {
    client: RawCommandClient,
    settings: NatNetSettings,
}

impl Conversation {
    /// Asks, again and again, until `read` makes something of a datagram; `None`: not within the time-out.
    fn ask<T>(
        &self,
        questions: &[&[u8]],
        mut read: impl FnMut(u16, &[u8]) -> Option<T>,
    ) -> Result<Option<T>, NatNetError> {
        let interface = self.settings.interface;
        let socket = |source| NatNetError::Socket { interface, source };
        let begin = std::time::Instant::now();
        let mut ask_at = Duration::ZERO;
        let mut buffer = vec![0; MIN_DATA_BUFFER];
        loop {
            let now = begin.elapsed();
            if now >= self.settings.timeout {
                return Ok(None);
            }
            if now >= ask_at {
                ask_at = now + ASK_AGAIN;
                for question in questions {
                    transient(self.client.send(question)).map_err(socket)?;
                }
            }
            let wait = ask_at.min(self.settings.timeout).saturating_sub(now);
            self.client.set_read_timeout(Some(wait.max(SHORTEST_WAIT))).map_err(socket)?;
            let received = transient(self.client.recv(&mut buffer)).map_err(socket)?;
            let Some((length, from)) = received else { continue };
            if from.ip() != *self.settings.server.ip() {
                continue;
            }
            let datagram = &buffer[..length];
            let Ok(header) = MessageHeader::parse(datagram) else { continue };
            if let Some(found) = read(header.message_id, datagram) {
                return Ok(Some(found));
            }
        }
    }

    fn strange(&self, reason: impl ToString) -> NatNetError {
        not_natnet(self.settings.server, reason)
    }

    /// Returns the server that answers, with its default version.
    fn greet(&self) -> Result<ServerInfo, NatNetError> {
        let question = connect_request().map_err(|e| self.strange(e))?;
        self.ask(&[question.as_bytes()], |id, datagram| {
            (id == NAT_SERVERINFO).then(|| ServerInfo::parse(datagram))
        })?
        .ok_or(NatNetError::NoAnswer(self.settings.server))?
        .map_err(|e| self.strange(e))
    }

    /// Returns all rigid bodies. Verifies by the answer that a requested layout was granted.
    fn bodies(&self, info: &ServerInfo, layout: Layout) -> Result<Bodies, NatNetError> {
        let server = self.settings.server;
        let strange = |error: CommandError| self.strange(error);
        let wish = layout.greeting().map_err(strange)?;
        let question = request_modeldef().map_err(strange)?;
        // The wish each time: the answer to a greeting that was repeated is no sign that it has arrived.
        let wishes: &[&[u8]] = if layout.is_asked_for { &[wish.as_bytes()] } else { &[] };
        let mut misfit = None;
        let model = self.ask(&[wishes, &[question.as_bytes()]].concat(), |id, datagram| {
            let read = (id == NAT_MODELDEF)
                .then(|| ModelDef::parse_with_policy(datagram, layout.version, layout.policy()))?;
            read.map_err(|error| misfit = Some(error)).ok()
        })?;
        let mut frames = 0;
        if model.is_some() && layout.is_asked_for {
            let decoder = Decoder::new(layout.version).map_err(|e| self.strange(e))?;
            misfit = None;
            // Without any frame the stream is paused, which is no misfit.
            let _ = self.ask(wishes, |_, datagram| {
                match decoder.parse(datagram).map(natnet::DecodedMessage::into_message) {
                    Ok(Message::FrameOfData(_)) => frames += 1,
                    Ok(_) => {}
                    Err(error) => {
                        frames = 0;
                        misfit = Some(error);
                    }
                }
                (frames >= FRAMES_OF_PROOF).then_some(())
            })?;
        }
        let is_proven = !layout.is_asked_for || frames >= FRAMES_OF_PROOF;
        match (model, misfit) {
            (Some(model), misfit) if misfit.is_none() || is_proven => Ok(named(&model)),
            (_, Some(error)) if layout.is_asked_for => Err(NatNetError::NotGranted {
                server,
                version: info.protocol_version.to_string(),
                reason: error.to_string(),
            }),
            (None, Some(error)) => Err(self.strange(error)),
            _ => Err(NatNetError::NoAnswer(server)),
        }
    }
}

/// Returns the number of the robot's body; `None` when none is streamed yet and none was named.
fn choose(bodies: &[(String, i32)], wanted: &Body) -> Result<Option<i32>, NatNetError> {
    let word = match wanted {
        Body::Only if bodies.len() > 1 => return Err(NatNetError::WhichBody(list(bodies))),
        Body::Only => return Ok(bodies.first().map(|b| b.1)),
        Body::Number(number) => number.to_string(),
        Body::Name(name) => name.clone(),
    };
    let is_meant = |(name, number): &(String, i32)| *name == word || number.to_string() == word;
    let Some(&(_, number)) = bodies.iter().find(|body| is_meant(body)) else {
        return Err(NatNetError::NoSuchBody { wanted: word, present: list(bodies) });
    };
    // Frames know bodies by their number alone.
    let alike: Bodies =
        bodies.iter().filter(|body| is_meant(body) || body.1 == number).cloned().collect();
    if alike.len() > 1 { Err(NatNetError::Ambiguous(list(&alike))) } else { Ok(Some(number)) }
}

fn list(bodies: &[(String, i32)]) -> String {
    if bodies.is_empty() {
        return "none; make one from the robot's markers in Motive and switch on its streaming"
            .into();
    }
    let named: Vec<_> =
        bodies.iter().map(|(name, id)| format!("\"{}\" (number {id})", printable(name))).collect();
    named.join(", ")
}

/// Returns the address of the network card that reaches the server. Sends nothing.
fn interface_towards(server: SocketAddrV4) -> io::Result<Ipv4Addr> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    socket.connect(server)?;
    match socket.local_addr()?.ip() {
        IpAddr::V4(address) => Ok(address),
        IpAddr::V6(_) => Ok(Ipv4Addr::UNSPECIFIED),
    }
}

/// A socket that shares its port with other listeners of the same stream.
fn multicast_socket(group: Ipv4Addr, port: u16, interface: Ipv4Addr) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_reuse_address(true)?;
    let bind = |address| socket.bind(&SocketAddr::from((address, port)).into());
    // Bound to the group, a socket receives nothing but the group; not every system can do that.
    bind(group).or_else(|_| bind(Ipv4Addr::UNSPECIFIED))?;
    socket.join_multicast_v4(&group, &interface)?;
    socket.set_nonblocking(true)?;
    Ok(socket.into())
}
