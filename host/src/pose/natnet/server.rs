//! The sending end, as of Motive, for a simulated robot.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::Duration;

use flix_protocol::units::Instant;
use natnet::{
    ConnectionInfo, DataSet, MessageHeader, ModelDef, NAT_CONNECT, NAT_DISCONNECT, NAT_KEEPALIVE,
    NAT_REQUEST_MODELDEF, PlannedBody, RigidBodyDef, ServerInfo, SyntheticServer, Version,
};

use super::{DATA_PORT, MULTICAST_GROUP, UpAxis};
use crate::link::transient;
use crate::pose::Pose;

/// Ticks of the stream's clock in a second, as Motive's.
const CLOCK: u64 = 10_000_000;
/// A unicast client that is silent for longer is gone.
const FORGET_AFTER: Duration = Duration::from_secs(5);
/// Most unicast clients at a time: a stranger cannot fill the memory.
const MOST_CLIENTS: usize = 16;
/// Numbers that follow a body's name in its description, besides the markers: their count, 0.
const NO_MARKERS: [u8; 4] = [0; 4];

/// How the stream looks.
#[derive(Debug, Clone)]
pub struct ServerSettings {
    /// Layout, 3.0 to 4.1.
    pub version: Version,
    /// Name of the rigid body.
    pub body_name: String,
    /// Its streaming number.
    pub body: i32,
    /// Up axis of the stream.
    pub up: UpAxis,
    /// Group and port of a multicast stream; `None` streams to every client that connects.
    pub multicast: Option<(Ipv4Addr, u16)>,
}

/// A NatNet server on a command socket.
#[derive(Debug)]
pub struct NatNetServer {
    settings: ServerSettings,
    socket: UdpSocket,
    clients: Vec<(SocketAddr, Instant)>,
    frame: i32,
}

impl Default for ServerSettings {
    fn default() -> Self {
        Self {
            version: Version::V4_1,
            body_name: "flix-walker".to_owned(),
            body: 1,
            up: UpAxis::Y,
            multicast: Some((MULTICAST_GROUP, DATA_PORT)),
        }
    }
}

impl NatNetServer {
    /// Opens the command socket. On loopback the stream stays on this computer.
    ///
    /// # Errors
    /// When the layout is not known or the address cannot be had.
    pub fn bind(address: SocketAddr, settings: ServerSettings) -> io::Result<Self> {
        settings.version.validate().map_err(io::Error::other)?;
        let socket = UdpSocket::bind(address)?;
        socket.set_nonblocking(true)?;
        socket.set_multicast_loop_v4(true)?;
        Ok(Self { settings, socket, clients: Vec::new(), frame: 0 })
    }

    /// Returns the command socket's address.
    ///
    /// # Errors
    /// As the system says.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        self.socket.local_addr()
    }

    /// Returns the unicast clients at present.
    #[must_use]
    pub fn clients(&self) -> usize {
        self.clients.len()
    }

    /// Answers the requests that have come in. Never waits.
    ///
    /// # Errors
    /// When the socket fails for good.
    pub fn serve(&mut self, now: Instant) -> io::Result<()> {
        let mut buffer = [0u8; 2048];
        while let Some((length, from)) = transient(self.socket.recv_from(&mut buffer))? {
            if let Some(answer) = self.answer(&buffer[..length], from, now) {
                // A client that is gone is its own affair.
                let _ = self.socket.send_to(&answer, from);
            }
        }
        self.clients.retain(|(_, heard)| now.since(*heard) <= FORGET_AFTER);
        Ok(())
    }

    /// Streams the pose at `seconds` of the robot's time; `None`: the cameras do not see it.
    ///
    /// # Errors
    /// When the datagram cannot be sent.
    pub fn stream(&mut self, seconds: f64, pose: Option<&Pose>) -> io::Result<()> {
        self.frame = self.frame.wrapping_add(1);
        let datagram = self.frame_datagram(self.frame, seconds, pose)?;
        match self.settings.multicast {
            Some(group) => {
                transient(self.socket.send_to(&datagram, group))?;
            }
            None => {
                for (client, _) in &self.clients {
                    let _ = self.socket.send_to(&datagram, client);
                }
            }
        }
        Ok(())
    }

    /// One frame of data, as it goes over the wire.
    ///
    /// # Errors
    /// Never with a layout that [`NatNetServer::bind`] accepted.
    fn frame_datagram(&self, frame: i32, seconds: f64, pose: Option<&Pose>) -> io::Result<Vec<u8>> {
        let body = match pose {
            Some(pose) => {
                let (position, orientation) = self.settings.up.from_pose(pose);
                PlannedBody::tracked(self.settings.body, position, orientation)
            }
            None => PlannedBody::dropout(self.settings.body),
        };
        SyntheticServer::new(self.settings.version, CLOCK)
            .datagram(frame, seconds, &[body])
            .map_err(io::Error::other)
    }

    /// The answer to a client's datagram, if it asks for one.
    fn answer(&mut self, datagram: &[u8], from: SocketAddr, now: Instant) -> Option<Vec<u8>> {
        let asked = MessageHeader::parse(datagram).ok()?.message_id;
        match asked {
            NAT_CONNECT => {
                self.hear(from, now, true);
                self.server_info().to_datagram().ok()
            }
            NAT_KEEPALIVE => {
                self.hear(from, now, false);
                None
            }
            NAT_DISCONNECT => {
                self.clients.retain(|(client, _)| *client != from);
                None
            }
            NAT_REQUEST_MODELDEF => self.model().to_datagram(self.settings.version).ok(),
            _ => None,
        }
    }

    fn hear(&mut self, from: SocketAddr, now: Instant, greets: bool) {
        if let Some(client) = self.clients.iter_mut().find(|(client, _)| *client == from) {
            client.1 = now;
        } else if greets && self.clients.len() < MOST_CLIENTS {
            self.clients.push((from, now));
        }
    }

    fn server_info(&self) -> ServerInfo {
        let (group, data_port) = self.settings.multicast.unwrap_or((MULTICAST_GROUP, DATA_PORT));
        ServerInfo {
            application_name: "flix-sim".to_owned(),
            server_version: Version::new(1, 0, 0, 0),
            protocol_version: self.settings.version,
            high_res_clock_frequency: CLOCK,
            connection: ConnectionInfo {
                data_port,
                multicast: self.settings.multicast.is_some(),
                multicast_group: group.octets(),
            },
        }
    }

    fn model(&self) -> ModelDef {
        let body = RigidBodyDef {
            name: self.settings.body_name.clone(),
            id: self.settings.body,
            parent_id: -1,
            offset: [0.0; 3],
            tail: NO_MARKERS.to_vec(),
        };
        ModelDef { datasets: vec![DataSet::RigidBody(body)] }
    }
}
