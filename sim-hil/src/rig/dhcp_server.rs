//! A DHCP server on the simulated network ([`network_task`](super::network_task)), as wrong as any.

use core::net::{Ipv4Addr, SocketAddrV4};

use super::network_task::{Arp, ROUTER, arp, datagram, ports_and_payload};

/// Messages of DHCP, by their number (RFC 2132, 9.6).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Kind {
    /// Asks for servers.
    Discover = 1,
    /// Offers an address.
    Offer = 2,
    /// Asks for an address.
    Request = 3,
    /// Grants an address.
    Acknowledgement = 5,
    /// Refuses an address.
    Refusal = 6,
}

/// Ports of servers and clients.
const PORTS: [u16; 2] = [67, 68];
/// Card of the server, and of its router.
const CARD: u8 = 9;

/// A server with all that it says. Options that are `None` or empty are left out.
#[derive(Debug, Clone)]
pub struct DhcpServer {
    /// Address for every client.
    pub given: Ipv4Addr,
    /// Source of its datagrams: its own address, or that of a relay.
    pub source: Ipv4Addr,
    /// Its own address as option 54 says it.
    pub identifier: Option<Ipv4Addr>,
    /// Mask of the network.
    pub mask: Option<Ipv4Addr>,
    /// Ways to other networks.
    pub routers: Vec<Ipv4Addr>,
    /// Length of the lease, s.
    pub lease: Option<u32>,
    /// Time to the first renewal (T1), s.
    pub renewal: Option<u32>,
}

impl DhcpServer {
    /// Returns a server in order, which gives 10.0.0.77 for an hour.
    #[must_use]
    pub fn new() -> Self {
        let own = Ipv4Addr::new(10, 0, 0, 253);
        Self {
            given: Ipv4Addr::new(10, 0, 0, 77),
            source: own,
            identifier: Some(own),
            mask: Some(Ipv4Addr::new(255, 255, 255, 0)),
            routers: vec![ROUTER],
            lease: Some(3_600),
            renewal: None,
        }
    }

    /// Returns the frame that answers a frame of the client: an offer, an acknowledgement, or where the server and its
    /// router are.
    #[must_use]
    pub fn answer(&self, frame: &[u8]) -> Option<Vec<u8>> {
        if frame.get(12..14)? == [0x08, 0x06] {
            let asked = <[u8; 4]>::try_from(frame.get(38..42)?).ok().map(Ipv4Addr::from)?;
            // Nobody but the client has the address that is given.
            let is_here = self.source == asked || self.routers.contains(&asked);
            return (is_here && asked != self.given)
                .then(|| arp(Arp::Reply, CARD, asked, self.given));
        }
        let message = message(frame)?;
        let kind = match message.get(242)? {
            1 => Kind::Offer,
            3 => Kind::Acknowledgement,
            _ => return None,
        };
        Some(self.say(kind, message))
    }

    /// Returns the frame of a message to the client that sent this one.
    #[must_use]
    pub fn say(&self, kind: Kind, to: &[u8]) -> Vec<u8> {
        let mut message = vec![0; 236];
        message[..4].copy_from_slice(&[2, 1, 6, 0]);
        message[4..8].copy_from_slice(&to[4..8]);
        message[16..20].copy_from_slice(&self.given.octets());
        message[28..44].copy_from_slice(&to[28..44]);
        message.extend([99, 130, 83, 99, 53, 1, kind as u8]);
        let addresses = |of: &[Ipv4Addr]| of.iter().flat_map(Ipv4Addr::octets).collect();
        let seconds = |of: Option<u32>| of.map_or(Vec::new(), |it| it.to_be_bytes().to_vec());
        let options: [(u8, Vec<u8>); 5] = [
            (54, addresses(self.identifier.as_slice())),
            (1, addresses(self.mask.as_slice())),
            (3, addresses(&self.routers)),
            (51, seconds(self.lease)),
            (58, seconds(self.renewal)),
        ];
        for (code, value) in options.iter().filter(|(_, value)| !value.is_empty()) {
            message.extend([*code, value.len() as u8]);
            message.extend(value);
        }
        message.push(255);
        let [from, to] = [(self.source, PORTS[0]), (self.given, PORTS[1])];
        let [from, to] = [from, to].map(|(address, port)| SocketAddrV4::new(address, port));
        datagram(CARD, from, to, &message)
    }
}

impl Default for DhcpServer {
    fn default() -> Self {
        Self::new()
    }
}

/// Returns the DHCP message of a client in a frame.
#[must_use]
pub fn message(frame: &[u8]) -> Option<&[u8]> {
    let (from, to, message) = ports_and_payload(frame)?;
    ([to, from] == PORTS && message.get(240..242)? == [53, 1]).then_some(message)
}
