//! The network task, for any driver of embassy-net.
//!
//! It carries datagrams between UDP sockets and the slow half, and wakes it in time. It never
//! waits for the network: with no link, no address or no room in a socket, datagrams are dropped as
//! the network itself would drop them, and the exchange with the fast half goes on.
//!
//! - Each answer of a handshake leaves through a socket of its own, because it goes to an address that
//!   anybody can invent: one that does not exist would hold up everything behind it, for a second.
//! - What a datagram asks for reaches the fast half before the next datagram is taken, so that a stop
//!   waits for nothing.
//! - A socket that has been full for [`STALL`] waits for an address that does not answer, and is
//!   emptied.
//! - mDNS is answered on the robot's own network alone, at most every [`DISCOVERY_INTERVAL`] and with at
//!   most [`AMPLIFICATION`](crate::mdns::AMPLIFICATION) times the bytes of the question; the robot probes for its names and announces
//!   itself whenever it gets an address. Another robot of the same name is reported.

use core::net::{Ipv4Addr, SocketAddr};
use core::task::Poll;

use embassy_futures::select::select3;
use embassy_futures::{poll_once, yield_now};
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{DhcpConfig, IpEndpoint, Ipv4Cidr, Stack};
use embassy_time::{Duration, Instant as Moment, Timer};
use flix_protocol::DEFAULT_PORT;
use flix_protocol::frame::{Datagram, Frame, MAXIMUM_DATAGRAM, MAXIMUM_HANDSHAKE};
use flix_protocol::units::Instant;

use crate::mdns::{self, ANSWER_LENGTH, Responder};
use crate::neighbours::Guard;

/// How often what is asked and reports are exchanged with the fast half, whatever the network does.
pub const EXCHANGE_INTERVAL: Duration = Duration::from_millis(5);
/// How long a socket may be full before it is emptied.
pub const STALL: Duration = Duration::from_millis(200);
/// Shortest time between two answers to mDNS.
pub const DISCOVERY_INTERVAL: Duration = Duration::from_millis(100);
/// Sockets that the task needs in the stack's resources.
pub const SOCKETS: usize = 3;

/// Datagrams taken before the others get a turn: a flood must not starve the rest of the chip.
const BURST: usize = 16;
/// Longer than any datagram that Ethernet carries, so that too long ones arrive and are counted.
const RECEIVE_LENGTH: usize = 1536;
/// Probes before the first announcement, and the time after each (RFC 6762, section 8.1).
const PROBES: u8 = 3;
const PROBE_INTERVAL: Duration = Duration::from_millis(250);
/// Announcements, and the time after each (RFC 6762, section 8.3).
const ANNOUNCEMENTS: u8 = 2;
const ANNOUNCEMENT_INTERVAL: Duration = Duration::from_secs(1);
/// Shortest time between two reports of another robot of the same name.
const TWIN_INTERVAL: Duration = Duration::from_secs(60);
/// Hop limit of mDNS (RFC 6762, section 11).
const DISCOVERY_HOP_LIMIT: u8 = 255;

/// The first message of DHCP is repeated after so long, and each request, too (RFC 2131, section 4.1: 4 s; the client's
/// own 10 s are long for somebody who waits).
const DHCP_REPEAT: core::time::Duration = core::time::Duration::from_secs(3);

/// Returns how the robot asks for an address, by DHCP; it names itself as in mDNS.
#[must_use]
pub fn dhcp(name: &str) -> DhcpConfig {
    let mut config = DhcpConfig::default();
    config.retry_config.discover_timeout = DHCP_REPEAT.into();
    config.retry_config.initial_request_timeout = DHCP_REPEAT.into();
    let mut host = heapless::String::new();
    let _ = mdns::host_name(name).chars().try_for_each(|character| host.push(character));
    config.hostname = Some(host);
    config
}

/// The robot, as the network task sees it: its slow half, and the clock and mailboxes of the chip.
pub trait Station {
    /// Returns the name of the board, which is announced with the robot.
    fn board(&self) -> &'static str;
    /// Returns the time since power-up, of the clock that the fast half runs on.
    fn now(&self) -> Instant;
    /// Hands over what is asked and configurations to the fast half, and takes its report.
    fn exchange(&mut self);
    /// Takes a datagram that came from `from`, and returns whether its operator sent it just now.
    fn receive(&mut self, from: SocketAddr, datagram: &[u8]) -> bool;
    /// Returns the next datagram to send, and to whom.
    fn transmit(&mut self, frame: &mut Frame) -> Option<SocketAddr>;
    /// Returns when there will be something to transmit.
    fn poll_at(&self) -> Option<Instant>;
    /// Takes the address of another robot that has the same name.
    fn meet_twin(&mut self, _address: Ipv4Addr) {}
}

/// Serves operators on [`DEFAULT_PORT`] for ever. `name` is what the robot is found under.
///
/// The stack needs room for [`SOCKETS`] sockets; `guard` stands before its driver. The link may go and come back at any time.
pub async fn serve(stack: Stack<'_>, guard: &Guard, name: &str, station: &mut impl Station) -> ! {
    let (mut received, mut receive_meta) = ([0; 8 * MAXIMUM_DATAGRAM], [PacketMetadata::EMPTY; 16]);
    let (mut sent, mut send_meta) = ([0; 8 * MAXIMUM_DATAGRAM], [PacketMetadata::EMPTY; 8]);
    let session =
        UdpSocket::new(stack, &mut receive_meta, &mut received, &mut send_meta, &mut sent);
    let (mut received, mut receive_meta) = ([0; RECEIVE_LENGTH], [PacketMetadata::EMPTY; 4]);
    let (mut sent, mut send_meta) = ([0; 2 * ANSWER_LENGTH], [PacketMetadata::EMPTY; 2]);
    let discovery =
        UdpSocket::new(stack, &mut receive_meta, &mut received, &mut send_meta, &mut sent);

    // The session's socket comes first: what arrives goes to the first that listens on a port.
    let mut session = Outlet::open(session, DEFAULT_PORT);
    let mut discovery =
        Discovery::open(stack, Responder::new(name, station.board(), DEFAULT_PORT), discovery);
    let mut buffer = [0; RECEIVE_LENGTH];
    let mut frame = Frame::new();
    loop {
        let due = Timer::after(until_due(station).min(EXCHANGE_INTERVAL));
        select3(session.socket.wait_recv_ready(), discovery.outlet.socket.wait_recv_ready(), due)
            .await;
        station.exchange();
        for _ in 0..BURST {
            let Some((from, length)) = session.take(&mut buffer) else { break };
            let datagram = &buffer[..length];
            if station.receive(from, datagram) {
                guard.confirm(from, datagram);
            }
            station.exchange();
            guard.hold(from, datagram);
            flush(station, stack, &mut session, &mut frame).await;
            guard.release();
        }
        flush(station, stack, &mut session, &mut frame).await;
        if let Some(twin) = discovery.serve(&mut buffer) {
            station.meet_twin(twin);
        }
        guard.has(discovery.address, discovery.gateway);
        yield_now().await;
    }
}

fn until_due(station: &impl Station) -> Duration {
    let wait = station.poll_at().map(|due| due.since(station.now()).as_micros());
    wait.and_then(|wait| u64::try_from(wait).ok()).map_or(Duration::MAX, Duration::from_micros)
}

async fn flush(
    station: &mut impl Station,
    stack: Stack<'_>,
    session: &mut Outlet<'_>,
    frame: &mut Frame,
) {
    while let Some(to) = station.transmit(frame) {
        if matches!(Datagram::parse(frame), Some(Datagram::Sealed(_))) {
            session.send(frame, to);
        } else {
            answer(stack, frame, to).await;
        }
    }
}

/// Sends an answer of a handshake through a socket that lasts no longer: the stack holds back whatever
/// waits in the same socket behind an address that nobody has.
async fn answer(stack: Stack<'_>, datagram: &[u8], to: SocketAddr) {
    let (mut none, mut no_meta) = ([0; 0], [PacketMetadata::EMPTY; 0]);
    let (mut sent, mut send_meta) = ([0; MAXIMUM_HANDSHAKE], [PacketMetadata::EMPTY; 1]);
    let socket = UdpSocket::new(stack, &mut no_meta, &mut none, &mut send_meta, &mut sent);
    let mut outlet = Outlet::open(socket, DEFAULT_PORT);
    outlet.send(datagram, to);
    // The stack's task gets its turn within two of ours, whichever of us is first.
    for _ in 0..2 {
        yield_now().await;
    }
}

/// A socket that is never waited for.
struct Outlet<'a> {
    socket: UdpSocket<'a>,
    port: u16,
    full_since: Option<Moment>,
}

impl<'a> Outlet<'a> {
    fn open(socket: UdpSocket<'a>, port: u16) -> Self {
        let mut outlet = Self { socket, port, full_since: None };
        outlet.bind();
        outlet
    }

    fn bind(&mut self) {
        // Fails only for port 0 and open sockets.
        let _ = self.socket.bind(self.port);
    }

    /// Returns what has arrived, if anything has.
    fn take(&mut self, datagram: &mut [u8]) -> Option<(SocketAddr, usize)> {
        match poll_once(self.socket.recv_from(datagram)) {
            Poll::Ready(Ok((length, metadata))) => {
                let from = metadata.endpoint;
                Some((SocketAddr::new(from.addr.into(), from.port), length))
            }
            Poll::Ready(Err(_)) | Poll::Pending => None,
        }
    }

    /// Sends a datagram, or drops it where there is no room. Nothing came by IPv6, so nothing goes there.
    fn send(&mut self, datagram: &[u8], to: SocketAddr) {
        let SocketAddr::V4(to) = to else { return };
        if poll_once(self.socket.send_to(datagram, IpEndpoint::from(to))).is_ready() {
            self.full_since = None;
            return;
        }
        let since = *self.full_since.get_or_insert_with(Moment::now);
        if since.elapsed() >= STALL {
            self.socket.close();
            self.bind();
            self.full_since = None;
        }
    }
}

/// Returns whether an address is in the robot's own network. mDNS goes no farther (RFC 6762, section
/// 11); an answer to a forged address elsewhere would flood whoever has it.
fn is_on_link(network: Option<Ipv4Cidr>, from: SocketAddr) -> bool {
    match (network, from) {
        (Some(network), SocketAddr::V4(from)) => network.contains_addr(from.ip()),
        _ => false,
    }
}

/// Answers and announces over mDNS.
struct Discovery<'a> {
    stack: Stack<'a>,
    responder: Responder,
    outlet: Outlet<'a>,
    address: Option<Ipv4Addr>,
    gateway: Option<Ipv4Addr>,
    /// Probes and announcements of this address, and when the next is due.
    introduced: u8,
    introduce_at: Moment,
    quiet_until: Moment,
    twin_at: Option<Moment>,
}

impl<'a> Discovery<'a> {
    fn open(stack: Stack<'a>, responder: Responder, mut socket: UdpSocket<'a>) -> Self {
        socket.set_hop_limit(Some(DISCOVERY_HOP_LIMIT));
        Self {
            stack,
            responder,
            outlet: Outlet::open(socket, mdns::PORT),
            address: None,
            gateway: None,
            introduced: 0,
            introduce_at: Moment::from_ticks(0),
            quiet_until: Moment::from_ticks(0),
            twin_at: None,
        }
    }

    /// Returns the address of another robot of the same name, when that is to be reported.
    fn serve(&mut self, query: &mut [u8; RECEIVE_LENGTH]) -> Option<Ipv4Addr> {
        // A fixed address stays while the link is gone.
        let network = self.stack.config_v4().filter(|_| self.stack.is_link_up());
        self.gateway = network.as_ref().and_then(|config| config.gateway);
        let network = network.map(|config| config.address);
        let address = network.map(|network| network.address());
        let is_new = address != self.address;
        self.address = address;
        let received = self.outlet.take(query);
        // Joining is reported (IGMP) once, with the next message that leaves, and only from an address: so the group is left
        // with each change, and joined in the next turn. Without a report, a switch that looks for them passes no question on.
        // Both fail only when the stack has no room for a group: then the robot is not found, but works.
        let _ = match address {
            Some(_) if !is_new => self.stack.join_multicast_group(mdns::GROUP),
            _ => self.stack.leave_multicast_group(mdns::GROUP),
        };
        let address = address?;
        if is_new {
            (self.introduced, self.introduce_at) = (0, Moment::now());
        }
        if self.introduced < PROBES + ANNOUNCEMENTS && Moment::now() >= self.introduce_at {
            self.introduce(address);
        }
        let (from, length) = received.filter(|(from, _)| is_on_link(network, *from))?;
        let datagram = &query[..length];
        if Moment::now() >= self.quiet_until {
            self.answer(address, from, datagram);
        }
        let is_recent = |at: Moment| at.elapsed() < TWIN_INTERVAL;
        let twin =
            self.responder.twin(address, datagram).filter(|_| !self.twin_at.is_some_and(is_recent));
        self.twin_at = twin.map(|_| Moment::now()).or(self.twin_at);
        twin
    }

    /// Sends the next probe, or the next announcement.
    fn introduce(&mut self, address: Ipv4Addr) {
        let mut datagram = [0; ANSWER_LENGTH];
        let (length, wait) = if self.introduced < PROBES {
            (self.responder.probe(address, &mut datagram), PROBE_INTERVAL)
        } else {
            (self.responder.announcement(address, &mut datagram), ANNOUNCEMENT_INTERVAL)
        };
        self.introduced += 1;
        self.introduce_at = Moment::now() + wait;
        if let Some(length) = length {
            let everybody = SocketAddr::from((mdns::GROUP, mdns::PORT));
            self.outlet.send(&datagram[..length], everybody);
        }
    }

    fn answer(&mut self, address: Ipv4Addr, from: SocketAddr, query: &[u8]) {
        let mut answer = [0; ANSWER_LENGTH];
        if let Some((to, length)) = self.responder.answer(address, from, query, &mut answer) {
            self.outlet.send(&answer[..length], to);
            self.quiet_until = Moment::now() + DISCOVERY_INTERVAL;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mdns_goes_no_farther_than_the_robots_network() {
        let network = Some(Ipv4Cidr::new(Ipv4Addr::new(192, 168, 4, 20), 24));
        let from = |address: [u8; 4]| SocketAddr::from((address, 40_000));
        assert!(is_on_link(network, from([192, 168, 4, 2])));
        assert!(!is_on_link(network, from([192, 168, 5, 2])));
        assert!(!is_on_link(None, from([192, 168, 4, 2])));
    }
}
