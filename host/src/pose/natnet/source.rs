//! The receiving end.
//!
//! NatNet is not authenticated. The source takes datagrams of the server's address alone, on the network
//! card that reaches it, and trusts no stream that jumps ([`crate::pose::continuity`]). Somebody on the
//! same network who forges the server's address can still keep the poses from being trusted.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::str::FromStr;
use std::time::Duration;

use flix_protocol::units::Instant;
use natnet::command::{disconnect_datagram, keepalive_datagram, request_modeldef};
use natnet::net::{CommandClient, DataClient, HandshakeError, MIN_DATA_BUFFER, RawCommandClient};
use natnet::{Decoder, Message, ModelDef, ParsePolicy, ServerInfo, Version};
use socket2::{Domain, Protocol, Socket, Type};

use super::UpAxis;
use crate::pose::continuity::Continuity;
use crate::pose::{Picture, Pose, PoseError, PoseSample, PoseSource};
use crate::text::printable;

/// A unicast server forgets a client that is silent for longer; NatNet's own samples send this
/// often.
const KEEPALIVE: Duration = Duration::from_millis(250);
/// Most datagrams that one call of `poll` reads: a flood of them cannot keep the caller from its other work.
/// 128,000 a second at 500 calls a second.
const DATAGRAMS_AT_ONCE: u32 = 256;

/// Which rigid body is the robot.
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
        Ok(text.parse().map_or_else(|_| Self::Name(text.to_owned()), Self::Number))
    }
}

/// Where the stream comes from and what is wanted of it.
#[derive(Debug, Clone)]
pub struct NatNetSettings {
    /// Motive's computer and command port.
    pub server: SocketAddrV4,
    /// The address of the network card that reaches it; unspecified leaves the choice to the
    /// system.
    pub interface: Ipv4Addr,
    /// Which rigid body is the robot.
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
        /// Which card was asked for.
        interface: Ipv4Addr,
        /// What the system said.
        source: io::Error,
    },
    /// Nobody answered.
    #[error(
        "no answer from {0}: start Motive there (or `flix-sim serve --natnet`), switch on its data streaming, let UDP ports 1510 and 1511 \
         through its firewall, and set its streaming interface to the network card that reaches this \
         computer, not to loopback"
    )]
    NoAnswer(SocketAddrV4),
    /// Somebody answered, but not in NatNet.
    #[error("{server} answered with something that is not NatNet: {reason}")]
    NotNatNet {
        /// Who.
        server: SocketAddrV4,
        /// What did not fit.
        reason: String,
    },
    /// A layout that is not known.
    #[error(
        "{server} streams NatNet {version}; versions 3.0 to 4.1 are understood: set another in Motive"
    )]
    Version {
        /// Who.
        server: SocketAddrV4,
        /// Which.
        version: String,
    },
    /// The asked body is not streamed.
    #[error("Motive streams no rigid body \"{wanted}\"; it has: {present}")]
    NoSuchBody {
        /// Asked for.
        wanted: String,
        /// What there is.
        present: String,
    },
    /// Several bodies and none was named.
    #[error("Motive streams several rigid bodies ({0}): say which is the robot with --body")]
    WhichBody(String),
}

/// What was received so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct NatNetStatistics {
    /// Datagrams of any kind from the server.
    pub datagrams: u64,
    /// Frames among them.
    pub frames: u64,
    /// Datagrams that could not be read.
    pub unreadable: u64,
    /// Frames without the robot's body.
    pub without_body: u64,
    /// Frames whose body was not tracked.
    pub untracked: u64,
    /// Frames that never came, by the gaps in their numbers.
    pub lost: u64,
    /// Poses out of reach of the pose before them.
    pub jumps: u64,
    /// Datagrams from other addresses than the server's; they were dropped.
    pub strangers: u64,
    /// Address of the last of these.
    pub stranger: Option<IpAddr>,
}

/// What one datagram reported.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NatNetReading {
    /// Number of the frame.
    pub frame: i32,
    /// The robot's pose and whether it is tracked; `None`: the frame has no such body.
    pub body: Option<(Pose, bool)>,
    /// When the cameras were exposed, and when the frame was sent, in ticks of the server's clock; 0: not stated.
    pub ticks: [u64; 2],
}

/// What was read from the socket.
enum Received {
    /// A datagram of the server, of this length.
    Datagram(usize),
    /// A datagram of somebody else.
    Foreign,
}

enum Channel {
    Multicast(DataClient),
    Unicast { socket: RawCommandClient, next_keepalive: Instant },
}

/// A stream of poses from Motive.
pub struct NatNetSource {
    settings: NatNetSettings,
    info: ServerInfo,
    bodies: Vec<(String, i32)>,
    body: Option<i32>,
    channel: Channel,
    buffer: Vec<u8>,
    last_frame: Option<i32>,
    continuity: Continuity,
    statistics: NatNetStatistics,
}

impl NatNetSource {
    /// Greets the server, finds the robot's rigid body, and opens the stream that the server
    /// announces.
    ///
    /// # Errors
    /// In sentences that say what to change.
    pub fn connect(mut settings: NatNetSettings) -> Result<Self, NatNetError> {
        if settings.interface.is_unspecified() {
            settings.interface = interface_towards(settings.server)
                .map_err(|source| NatNetError::Socket { interface: settings.interface, source })?;
        }
        let socket = |source| NatNetError::Socket { interface: settings.interface, source };
        let mut client =
            CommandClient::bind(settings.interface, settings.server).map_err(socket)?;
        let info = client
            .connect_handshake(settings.timeout)
            .map_err(|error| refused(settings.server, &error))?;
        let (bodies, body) = find_body(&mut client, &settings, info.protocol_version)?;
        let channel = if info.connection.multicast {
            let group = info.multicast_group();
            let socket = multicast_socket(group, info.connection.data_port, settings.interface)
                .map_err(socket)?;
            Channel::Multicast(DataClient::from_socket(socket))
        } else {
            let raw = client.into_raw();
            raw.set_nonblocking(true).map_err(socket)?;
            Channel::Unicast { socket: raw, next_keepalive: Instant::START }
        };
        Ok(Self {
            settings,
            info,
            bodies,
            body,
            channel,
            buffer: vec![0; MIN_DATA_BUFFER],
            last_frame: None,
            continuity: Continuity::default(),
            statistics: NatNetStatistics::default(),
        })
    }

    /// Returns who streams.
    #[must_use]
    pub fn server(&self) -> &ServerInfo {
        &self.info
    }

    /// Names and numbers of all streamed rigid bodies.
    #[must_use]
    pub fn bodies(&self) -> &[(String, i32)] {
        &self.bodies
    }

    /// Returns what was received so far.
    #[must_use]
    pub fn statistics(&self) -> NatNetStatistics {
        self.statistics
    }

    fn receive(&mut self, now: Instant) -> io::Result<Option<Received>> {
        let received = match &mut self.channel {
            Channel::Multicast(client) => client.recv(&mut self.buffer),
            Channel::Unicast { socket, next_keepalive } => {
                if now >= *next_keepalive {
                    *next_keepalive = now + KEEPALIVE;
                    socket.send(&keepalive_datagram())?;
                }
                socket.recv(&mut self.buffer)
            }
        };
        match received {
            Ok((length, from)) if from.ip() == *self.settings.server.ip() => {
                Ok(Some(Received::Datagram(length)))
            }
            Ok((_, from)) => {
                self.statistics.strangers += 1;
                self.statistics.stranger = Some(from.ip());
                Ok(Some(Received::Foreign))
            }
            Err(error) if is_only_empty(&error) => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn count(&mut self, reading: &NatNetReading) {
        self.statistics.frames += 1;
        if let Some(last) = self.last_frame.replace(reading.frame) {
            let gap = i64::from(reading.frame) - i64::from(last) - 1;
            self.statistics.lost += u64::try_from(gap).unwrap_or(0);
        }
        match reading.body {
            None => self.statistics.without_body += 1,
            Some((_, false)) => self.statistics.untracked += 1,
            Some((_, true)) => {}
        }
    }
}

impl PoseSource for NatNetSource {
    fn poll(&mut self, now: Instant) -> Result<Option<PoseSample>, PoseError> {
        for _ in 0..DATAGRAMS_AT_ONCE {
            let length = match self.receive(now)? {
                None => return Ok(None),
                Some(Received::Foreign) => continue,
                Some(Received::Datagram(length)) => length,
            };
            self.statistics.datagrams += 1;
            let datagram = &self.buffer[..length];
            let version = self.info.protocol_version;
            match NatNetReading::from_datagram(datagram, version, self.body, self.settings.up) {
                Ok(Some(reading)) => {
                    self.count(&reading);
                    if let Some((pose, tracked)) = reading.body {
                        let valid = tracked && self.continuity.take(now, &pose);
                        self.statistics.jumps = self.continuity.jumps();
                        let picture = picture(reading.ticks, self.info.high_res_clock_frequency);
                        return Ok(Some(PoseSample { time: now, pose, valid, picture }));
                    }
                }
                Ok(None) => {}
                Err(_) => self.statistics.unreadable += 1,
            }
        }
        Ok(None)
    }
}

impl Drop for NatNetSource {
    fn drop(&mut self) {
        if let Channel::Unicast { socket, .. } = &self.channel {
            // A courtesy: a server that does not hear it forgets us anyway.
            let _ = socket.send(&disconnect_datagram());
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
        let decoder = Decoder::new(version)?.with_policy(ParsePolicy::Compatible);
        let Message::FrameOfData(frame) = decoder.parse(datagram)?.into_message() else {
            return Ok(None);
        };
        let found = match body {
            Some(number) => frame.rigid_bodies.iter().find(|b| b.id == number),
            None => frame.rigid_bodies.first(),
        };
        let body = found.map(|b| {
            let pose = up.to_pose(b.position, b.orientation);
            (pose, b.tracking_valid() && pose.is_sound())
        });
        let ticks = [frame.timing.camera_mid_exposure, frame.timing.transmit];
        Ok(Some(Self { frame: frame.frame_number, body, ticks }))
    }
}

/// Returns when a picture was taken and sent, of ticks of a clock that makes so many a second; `None` where they are
/// not stated.
fn picture(ticks: [u64; 2], frequency: u64) -> Option<Picture> {
    let [exposed, sent] = ticks.map(|ticks| {
        let micros = u128::from(ticks) * 1_000_000 / u128::from(frequency.max(1));
        Instant::from_micros(u64::try_from(micros).unwrap_or(u64::MAX))
    });
    let is_stated = frequency > 0 && ticks[0] > 0;
    is_stated.then(|| Picture { exposed, sent: sent.max(exposed) })
}

fn refused(server: SocketAddrV4, error: &HandshakeError) -> NatNetError {
    match error {
        HandshakeError::Io(_) => NatNetError::NoAnswer(server),
        HandshakeError::UnsupportedVersion { info, .. } => {
            NatNetError::Version { server, version: info.protocol_version.to_string() }
        }
        HandshakeError::Command(_) | HandshakeError::Decode(_) => {
            NatNetError::NotNatNet { server, reason: error.to_string() }
        }
    }
}

type Bodies = Vec<(String, i32)>;

/// All bodies, and the number of the robot's.
fn find_body(
    client: &mut CommandClient,
    settings: &NatNetSettings,
    version: Version,
) -> Result<(Bodies, Option<i32>), NatNetError> {
    let server = settings.server;
    let strange = |reason: String| NatNetError::NotNatNet { server, reason };
    let request = request_modeldef().map_err(|e| strange(e.to_string()))?;
    let answer =
        client.exchange(&request, settings.timeout).map_err(|_| NatNetError::NoAnswer(server))?;
    let model = ModelDef::parse_with_policy(&answer, version, ParsePolicy::Compatible)
        .map_err(|e| strange(e.to_string()))?;
    let bodies: Bodies = model.rigid_bodies().map(|(name, id)| (name.to_owned(), id)).collect();
    let present = list(&bodies);
    let missing = |wanted: String| NatNetError::NoSuchBody { wanted, present: present.clone() };
    let number = match &settings.body {
        Body::Only if bodies.len() > 1 => return Err(NatNetError::WhichBody(present)),
        Body::Only => bodies.first().map(|b| b.1),
        Body::Number(number) => Some(
            bodies
                .iter()
                .find(|b| b.1 == *number)
                .map(|b| b.1)
                .ok_or_else(|| missing(number.to_string()))?,
        ),
        Body::Name(name) => {
            Some(model.resolve_rigid_body(name).ok_or_else(|| missing(name.clone()))?)
        }
    };
    Ok((bodies, number))
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

fn is_only_empty(error: &io::Error) -> bool {
    // A unicast server that is gone makes itself known as a refused connection: it may come back.
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::ConnectionRefused
    )
}
