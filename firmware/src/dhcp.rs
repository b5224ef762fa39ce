//! What stands between the stack's DHCP client and a network that is not in order.
//!
//! The client (smoltcp 0.13.1, `dhcpv4`) believes each server, also one that lies or leaves options out, and the stack panics
//! on routers and servers that no host can be. It begins anew and renews as fast as the network answers. [`Lease`] reads its
//! messages, both ways:
//!
//! - Each message to the client is written here, with the addresses that [`believed`] takes from the server's message.
//! - An acknowledgement counts as the answer to a request alone, for the address that was asked for; at a renewal only from the
//!   server that was asked (RFC 2131, 4.3.2). A refusal counts from the server of the lease alone.
//! - From one beginning to the next pass at least [`PAUSES`], longer each time until an address is given: what it sends
//!   before is dropped, and it repeats that by itself.
//! - Nor does a renewal leave sooner than [`RENEWAL`] after the request before.

use core::net::Ipv4Addr;

use embassy_time::{Duration, Instant as Moment};
use flix_protocol::provision::FixedAddress;
use smoltcp::phy::ChecksumCapabilities;
use smoltcp::wire::{
    DHCP_CLIENT_PORT, DHCP_SERVER_PORT, DhcpMessageType as Kind, DhcpOption, DhcpPacket, DhcpRepr,
    EthernetAddress, EthernetFrame, EthernetProtocol, EthernetRepr, IpProtocol, Ipv4Cidr,
    Ipv4Packet, Ipv4Repr, UdpPacket, UdpRepr,
};

/// Least time from one beginning to the next, s; the last one from then on. The client repeats itself every 3 s, so that it begins
/// after 3, 6, 12 and 24 s (RFC 2131, section 4.1, doubles likewise).
const PAUSES: [u64; 4] = [2, 5, 11, 23];
/// Least time from a request to a renewal. The client asks again after a minute, or when it may ask any server.
const RENEWAL: Duration = Duration::from_millis(500);
/// Length of a lease that says none, s. BusyBox's client assumes it, too.
const LEASE: u32 = 3_600;
/// Shortest lease that is believed, s: the client renews it every 4 s.
const SHORTEST_LEASE: u32 = 8;

/// Options (RFC 2132): routers, times to the first renewal and to asking any server.
const ROUTERS: u8 = 3;
const TIMES: [u8; 2] = [58, 59];
/// Length of an Ethernet header.
const ETHERNET_HEADER: usize = 14;
/// Longest frame with a message of the client, or with one that is written here.
pub(crate) const LONGEST_MESSAGE: usize = ETHERNET_HEADER + 20 + 8 + 240 + 160;

/// What the messages so far have shown.
#[derive(Debug, Default)]
pub(crate) struct Lease {
    /// The server that the client chose.
    server: Option<Ipv4Addr>,
    /// The address for which the client has asked without an answer yet, and where it asked: of one server, or of all.
    asked: Option<[Ipv4Addr; 2]>,
    /// Mask and router of the lease, or of the offer: some servers leave them out when they acknowledge.
    network: Option<Ipv4Addr>,
    router: Option<Ipv4Addr>,
    /// When the client last began.
    began: Option<Moment>,
    /// How often it began anew since the link is up, or an address was given.
    restarts: usize,
    /// When it last requested.
    requested: Option<Moment>,
    /// The client's hardware address.
    client: Option<EthernetAddress>,
    /// Number of the exchange in which the client is, on the wire and as the client counts it.
    transaction: u32,
    own: u32,
}

/// Returns what the client may believe of an offer or an acknowledgement that came from `sender`: addresses that a host can have, as
/// in [`FixedAddress`], and the usual where the server says nothing that holds. `None` where no address is left.
fn believed<'a>(
    mut message: DhcpRepr<'a>,
    routers: &[u8],
    sender: Ipv4Addr,
) -> Option<DhcpRepr<'a>> {
    let own = message.your_ip;
    let mask = message.subnet_mask.and_then(|mask| Ipv4Cidr::from_netmask(own, mask).ok());
    // A network of one address has no neighbours.
    let mask = mask.filter(|network| network.prefix_len() < 32);
    let class = match own.octets()[0] {
        ..128 => 8,
        128..192 => 16,
        _ => 24,
    };
    let network = mask.unwrap_or(Ipv4Cidr::new(own, class));
    let is_host = |address: &Ipv4Addr| {
        let is_near = network.contains_addr(address);
        let prefix_length = if is_near { network.prefix_len() } else { 0 };
        FixedAddress { address: address.octets(), prefix_length, gateway: None }.is_host()
    };
    let server = [message.server_identifier, Some(sender)].into_iter().flatten().find(is_host)?;
    let routers = routers.as_chunks().0.iter().copied().map(Ipv4Addr::from);
    let mut routers = routers.filter(|it| network.contains_addr(it) && is_host(it) && *it != own);
    if !is_host(&own) || own == server || own == sender {
        return None;
    }
    message.server_identifier = Some(server);
    message.router = routers.next();
    message.subnet_mask = Some(network.netmask());
    message.lease_duration = message.lease_duration.or(Some(LEASE)).max(Some(SHORTEST_LEASE));
    Some(message)
}

impl Lease {
    /// Reads a message of a server, and writes the one that the client gets in its place. Returns its length, 0 for none at all;
    /// `None` where the frame is another one.
    pub(crate) fn admits(
        &mut self,
        frame: &[u8],
        written: &mut [u8; LONGEST_MESSAGE],
    ) -> Option<usize> {
        let (header, packet) = message(frame, [DHCP_SERVER_PORT, DHCP_CLIENT_PORT])?;
        let message = DhcpRepr::parse(&packet).ok()?;
        let written = self.answers(&packet, message, header.src_addr).and_then(|mut message| {
            message.transaction_id = self.own;
            let times = packet.options().filter(|option| TIMES.contains(&option.kind));
            let times: heapless::Vec<DhcpOption<'_>, { TIMES.len() }> =
                times.take(TIMES.len()).collect();
            let addresses = [message.server_identifier?, Ipv4Addr::BROADCAST];
            let message = DhcpRepr { additional_options: &times, ..message };
            write(&message, frame, addresses, [DHCP_SERVER_PORT, DHCP_CLIENT_PORT], written)
        });
        Some(written.unwrap_or(0))
    }

    /// Notes a message of a server, and returns what the client may believe of it.
    fn answers<'a>(
        &mut self,
        packet: &DhcpPacket<&'a [u8]>,
        mut message: DhcpRepr<'a>,
        sender: Ipv4Addr,
    ) -> Option<DhcpRepr<'a>> {
        let to = Some(message.client_hardware_address);
        if (message.transaction_id, to) != (self.transaction, self.client) {
            return None;
        }
        if message.message_type == Kind::Nak {
            let server = message.server_identifier.unwrap_or(sender);
            self.asked.take_if(|_| self.server == Some(server))?;
            message.server_identifier = Some(server);
            return Some(message);
        }
        if message.message_type == Kind::Offer && self.server.is_some() {
            return None;
        }
        message.subnet_mask = message.subnet_mask.or(self.network);
        let known = self.router.map(|router| router.octets());
        let routers = packet.options().find(|option| option.kind == ROUTERS);
        let routers = routers.map(|option| option.data).or(known.as_ref().map(|it| &it[..]));
        let message = believed(message, routers.unwrap_or(&[]), sender)?;
        if message.message_type == Kind::Ack {
            let grant = [message.your_ip, message.server_identifier?];
            self.asked.take_if(|[address, at]| {
                *address == grant[0] && (at.is_broadcast() || *at == grant[1])
            })?;
            (self.server, self.restarts) = (message.server_identifier, 0);
        }
        (self.network, self.router) = (message.subnet_mask, message.router);
        Some(message)
    }

    /// Notes a frame of the client, and returns whether it may leave.
    pub(crate) fn releases(&mut self, frame: &mut [u8], now: Moment) -> bool {
        let Some((header, packet)) = message(frame, [DHCP_CLIENT_PORT, DHCP_SERVER_PORT]) else {
            return true;
        };
        let Ok(message) = DhcpRepr::parse(&packet) else { return true };
        let server = message.server_identifier;
        let is_within = |since: Option<Moment>, pause: Duration| {
            since.is_some_and(|since| now.saturating_duration_since(since) < pause)
        };
        (self.own, self.client) = (message.transaction_id, Some(message.client_hardware_address));
        // A beginning that is repeated keeps its number: its first one may be answered late.
        let mut is_new = message.message_type != Kind::Request || server.is_none();
        match message.message_type {
            Kind::Discover => {
                let pause = PAUSES[self.restarts.min(PAUSES.len() - 1)];
                if is_within(self.began, Duration::from_secs(pause)) {
                    return false;
                }
                self.restarts += usize::from(self.began.is_some());
                is_new = self.server.is_some() || self.began.is_none();
                (self.server, self.asked, self.began) = (None, None, Some(now));
                (self.network, self.router) = (None, None);
            }
            Kind::Request => {
                // A renewal names no server, but the one that was chosen goes on to be it.
                if server.is_none() && is_within(self.requested, RENEWAL) {
                    return false;
                }
                (self.server, self.requested) = (server.or(self.server), Some(now));
                self.asked =
                    Some([message.requested_ip.unwrap_or(message.client_ip), header.dst_addr]);
            }
            _ => {}
        }
        if is_new {
            self.transaction = self.own;
        }
        renumber(frame, self.transaction);
        true
    }
}

/// Gives the client's message another number, and no check sum (RFC 768 allows that).
fn renumber(frame: &mut [u8], transaction: u32) {
    let mut frame = EthernetFrame::new_unchecked(frame);
    let mut packet = Ipv4Packet::new_unchecked(frame.payload_mut());
    let mut datagram = UdpPacket::new_unchecked(packet.payload_mut());
    datagram.set_checksum(0);
    DhcpPacket::new_unchecked(datagram.payload_mut()).set_transaction_id(transaction);
}

/// Returns the DHCP message in a frame from and to these ports that is in order.
fn message(frame: &[u8], ports: [u16; 2]) -> Option<(Ipv4Repr, DhcpPacket<&[u8]>)> {
    let frame = EthernetFrame::new_checked(frame).ok()?;
    let packet = Ipv4Packet::new_checked(frame.payload()).ok()?;
    let datagram = UdpPacket::new_checked(packet.payload()).ok()?;
    let is_message = frame.ethertype() == EthernetProtocol::Ipv4
        && packet.next_header() == IpProtocol::Udp
        && [datagram.src_port(), datagram.dst_port()] == ports;
    if !is_message {
        return None;
    }
    let checks = ChecksumCapabilities::default();
    let header = Ipv4Repr::parse(&packet, &checks).ok()?;
    let [from, to] = [header.src_addr, header.dst_addr].map(Into::into);
    UdpRepr::parse(&datagram, &from, &to, &checks).ok()?;
    Some((header, DhcpPacket::new_checked(datagram.payload()).ok()?))
}

/// Returns the address that this message to the client grants, if it does.
pub(crate) fn granted(frame: &[u8]) -> Option<Ipv4Addr> {
    let (_, packet) = message(frame, [DHCP_SERVER_PORT, DHCP_CLIENT_PORT])?;
    let message = DhcpRepr::parse(&packet).ok()?;
    (message.message_type == Kind::Ack).then_some(message.your_ip)
}

/// Writes what declines this grant: a message to the server (RFC 2131, 4.4.4), and a refusal to the client, which begins anew.
/// Returns their lengths.
pub(crate) fn decline(
    grant: &[u8],
    robot: EthernetAddress,
    [to_server, to_client]: [&mut [u8; LONGEST_MESSAGE]; 2],
) -> Option<[usize; 2]> {
    let ports = [DHCP_SERVER_PORT, DHCP_CLIENT_PORT];
    let (header, packet) = message(grant, ports)?;
    let message = DhcpRepr::parse(&packet).ok()?;
    let (address, everybody) = (message.your_ip, [Ipv4Addr::UNSPECIFIED, Ipv4Addr::BROADCAST]);
    let nothing = DhcpRepr {
        your_ip: Ipv4Addr::UNSPECIFIED,
        router: None,
        subnet_mask: None,
        lease_duration: None,
        ..message
    };
    let declined = DhcpRepr {
        message_type: Kind::Decline,
        client_identifier: Some(robot),
        requested_ip: Some(address),
        ..nothing.clone()
    };
    let mut ethernet = [0; ETHERNET_HEADER];
    EthernetRepr {
        src_addr: robot,
        dst_addr: EthernetAddress::BROADCAST,
        ethertype: EthernetProtocol::Ipv4,
    }
    .emit(&mut EthernetFrame::new_unchecked(&mut ethernet[..]));
    let refused = DhcpRepr { message_type: Kind::Nak, ..nothing };
    let [server, client] = ports;
    Some([
        write(&declined, &ethernet, everybody, [client, server], to_server)?,
        write(&refused, grant, [header.src_addr, header.dst_addr], ports, to_client)?,
    ])
}

/// Writes a message below this Ethernet header, from one address and port to another. Returns its length, if it fits.
fn write(
    message: &DhcpRepr<'_>,
    ethernet: &[u8],
    [src_addr, dst_addr]: [Ipv4Addr; 2],
    [src_port, dst_port]: [u16; 2],
    written: &mut [u8; LONGEST_MESSAGE],
) -> Option<usize> {
    let ports = UdpRepr { src_port, dst_port };
    let length = message.buffer_len();
    let header = Ipv4Repr {
        src_addr,
        dst_addr,
        next_header: IpProtocol::Udp,
        payload_len: ports.header_len() + length,
        hop_limit: 64,
    };
    let whole = ETHERNET_HEADER + header.buffer_len() + header.payload_len;
    let (place, packet) = written.get_mut(..whole)?.split_at_mut(ETHERNET_HEADER);
    place.copy_from_slice(ethernet.get(..ETHERNET_HEADER)?);
    let checks = ChecksumCapabilities::default();
    let mut packet = Ipv4Packet::new_unchecked(packet);
    header.emit(&mut packet, &checks);
    let [from, to] = [src_addr, dst_addr].map(Into::into);
    let emit = |payload: &mut [u8]| message.emit(&mut DhcpPacket::new_unchecked(payload));
    let mut result = Ok(());
    ports.emit(
        &mut UdpPacket::new_unchecked(packet.payload_mut()),
        &from,
        &to,
        length,
        |payload| result = emit(payload),
        &checks,
    );
    result.ok().map(|()| whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const OURS: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 254);
    const OTHER: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 253);
    const GIVEN: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 7);
    const NUMBER: core::ops::Range<usize> = 46..50;

    /// Returns a message of this number from a client or a server, the latter where `server` is.
    fn numbered(kind: Kind, server: Option<Ipv4Addr>, number: u32) -> Vec<u8> {
        let is_reply = matches!(kind, Kind::Offer | Kind::Ack | Kind::Nak);
        let ports = [DHCP_CLIENT_PORT, DHCP_SERVER_PORT].map(u16::to_be_bytes);
        let [from, to] = if is_reply { [ports[1], ports[0]] } else { ports };
        let is_renewal = kind == Kind::Request && server.is_none();
        let mut payload = std::vec![0; 240];
        payload[..3].copy_from_slice(&[1 + u8::from(is_reply), 1, 6]);
        payload[4..8].copy_from_slice(&number.to_be_bytes());
        payload[if is_renewal { 12..16 } else { 16..20 }].copy_from_slice(&GIVEN.octets());
        payload[236..].copy_from_slice(&[99, 130, 83, 99]);
        payload.extend([53, 1, kind.into(), 0]);
        payload
            .extend([50, 4].into_iter().chain(GIVEN.octets()).filter(|_| !is_reply && !is_renewal));
        payload.extend(server.iter().flat_map(|it| [54, 4].into_iter().chain(it.octets())));
        payload.push(255);
        let length = 8 + payload.len();
        let header = Ipv4Repr {
            src_addr: server.unwrap_or(OTHER),
            dst_addr: if is_renewal { OURS } else { Ipv4Addr::BROADCAST },
            next_header: IpProtocol::Udp,
            payload_len: length,
            hop_limit: 64,
        };
        let mut frame = std::vec![0; ETHERNET_HEADER + 20];
        frame[12..14].copy_from_slice(&[0x08, 0x00]);
        let checks = ChecksumCapabilities::default();
        let lengths = (length as u16).to_be_bytes();
        frame.extend([from, to, lengths, [0, 0]].concat());
        frame.extend(payload);
        header.emit(&mut Ipv4Packet::new_unchecked(&mut frame[ETHERNET_HEADER..]), &checks);
        frame
    }

    fn frame(kind: Kind, server: Option<Ipv4Addr>) -> Vec<u8> {
        numbered(kind, server, 9)
    }

    /// Lets a message pass to the client; returns its number, where it does.
    fn hears(lease: &mut Lease, kind: Kind, server: Option<Ipv4Addr>, number: u32) -> Option<u32> {
        let mut written = [0; LONGEST_MESSAGE];
        let length = lease.admits(&numbered(kind, server, number), &mut written).unwrap();
        let (header, packet) = message(&written[..length], [DHCP_SERVER_PORT, DHCP_CLIENT_PORT])?;
        let message = DhcpRepr::parse(&packet).unwrap();
        assert_eq!(Some(header.src_addr), message.server_identifier);
        Some(message.transaction_id)
    }

    fn is_heard(lease: &mut Lease, kind: Kind, server: Option<Ipv4Addr>) -> bool {
        hears(lease, kind, server, 9).is_some()
    }

    /// Lets a message leave; returns its number, where it does.
    fn says(
        lease: &mut Lease,
        kind: Kind,
        server: Option<Ipv4Addr>,
        own: u32,
        ms: u64,
    ) -> Option<u32> {
        let mut out = numbered(kind, server, own);
        // A check sum of 0 is none, and one of other bytes is wrong.
        let leaves = lease.releases(&mut out, Moment::from_millis(ms));
        leaves.then(|| u32::from_be_bytes(out[NUMBER].try_into().unwrap()))
    }

    fn leaves(lease: &mut Lease, kind: Kind, server: Option<Ipv4Addr>, ms: u64) -> bool {
        says(lease, kind, server, 9, ms).is_some()
    }

    fn chosen() -> Lease {
        let mut lease = Lease::default();
        assert!(leaves(&mut lease, Kind::Discover, None, 10_000));
        assert!(leaves(&mut lease, Kind::Request, Some(OURS), 10_000));
        lease
    }

    #[test]
    fn only_the_chosen_server_refuses() {
        let mut lease = chosen();
        assert!(!is_heard(&mut lease, Kind::Nak, Some(OTHER)));
        assert!(!is_heard(&mut lease, Kind::Nak, None));
        assert!(is_heard(&mut lease, Kind::Nak, Some(OURS)));
        assert!(!is_heard(&mut lease, Kind::Nak, Some(OURS)), "nothing was asked");
    }

    #[test]
    fn a_renewal_is_answered_by_the_server_of_the_lease_alone() {
        for answer in [Kind::Ack, Kind::Nak] {
            let mut lease = chosen();
            assert!(is_heard(&mut lease, Kind::Ack, Some(OURS)));
            assert!(!is_heard(&mut lease, answer, Some(OURS)), "nothing was asked");
            assert!(leaves(&mut lease, Kind::Request, None, 99_000));
            assert!(!is_heard(&mut lease, answer, Some(OTHER)));
            assert!(is_heard(&mut lease, answer, Some(OURS)));
        }
    }

    /// Returns when a client begins that would every millisecond, or where `refused`, once it has requested and was refused, ms.
    fn beginnings(mut lease: Lease, until_ms: u64, refused: bool) -> Vec<u64> {
        let begins = |ms: &u64| {
            let begins = leaves(&mut lease, Kind::Discover, None, *ms);
            if begins && refused {
                assert!(leaves(&mut lease, Kind::Request, Some(OURS), *ms));
                assert!(is_heard(&mut lease, Kind::Nak, Some(OURS)));
            }
            begins
        };
        (0..until_ms).filter(begins).collect()
    }

    #[test]
    fn beginnings_without_an_address_are_paced() {
        for refused in [false, true] {
            let began = beginnings(Lease::default(), 120_000, refused);
            assert_eq!(began, [0, 2_000, 7_000, 18_000, 41_000, 64_000, 87_000, 110_000]);
        }
    }

    #[test]
    fn a_beginning_that_is_repeated_keeps_its_number_and_an_answer_to_it_finds_the_client() {
        let mut lease = Lease::default();
        let lease = &mut lease;
        assert_eq!(says(lease, Kind::Discover, None, 1, 10_000), Some(1));
        assert_eq!(says(lease, Kind::Discover, None, 2, 13_000), Some(1));
        // One too early does not leave, but the client goes by it.
        assert_eq!(says(lease, Kind::Discover, None, 3, 14_000), None);
        assert_eq!(hears(lease, Kind::Offer, Some(OURS), 1), Some(3));
        assert_eq!(hears(lease, Kind::Offer, Some(OURS), 3), None, "to somebody else");
        assert_eq!(says(lease, Kind::Request, Some(OURS), 3, 15_000), Some(1));
        assert_eq!(hears(lease, Kind::Ack, Some(OURS), 1), Some(3));
        // A renewal, and a new beginning, are others.
        assert_eq!(says(lease, Kind::Request, None, 4, 99_000), Some(4));
        assert_eq!(hears(lease, Kind::Ack, Some(OURS), 4), Some(4));
        assert_eq!(says(lease, Kind::Discover, None, 5, 200_000), Some(5));
        assert_eq!(says(lease, Kind::Discover, None, 6, 206_000), Some(5));
        assert_eq!(says(lease, Kind::Decline, Some(OURS), 8, 207_000), Some(8));
    }

    #[test]
    fn an_address_ends_the_pauses() {
        let mut lease = Lease::default();
        for s in [0, 2, 7, 18, 41] {
            assert!(leaves(&mut lease, Kind::Discover, None, s * 1_000));
        }
        assert!(leaves(&mut lease, Kind::Request, Some(OURS), 41_000));
        assert!(is_heard(&mut lease, Kind::Ack, Some(OURS)));
        assert!(!leaves(&mut lease, Kind::Discover, None, 42_999));
        assert!(leaves(&mut lease, Kind::Discover, None, 43_000));
    }

    #[test]
    fn the_server_that_granted_last_refuses() {
        let mut lease = chosen();
        assert!(is_heard(&mut lease, Kind::Ack, Some(OTHER)));
        assert!(leaves(&mut lease, Kind::Request, None, 99_000));
        assert!(!is_heard(&mut lease, Kind::Nak, Some(OURS)));
        assert!(is_heard(&mut lease, Kind::Nak, Some(OTHER)));
    }

    #[test]
    fn messages_to_other_clients_change_nothing() {
        let mut lease = chosen();
        for kind in [Kind::Ack, Kind::Nak] {
            assert_eq!(hears(&mut lease, kind, Some(OURS), 8), None);
            let mut to_another = frame(kind, Some(OURS));
            to_another[70] = 1;
            let mut written = [0; LONGEST_MESSAGE];
            assert_eq!(lease.admits(&to_another, &mut written), Some(0));
        }
        assert!(is_heard(&mut lease, Kind::Ack, Some(OURS)));
    }

    #[test]
    fn a_lease_that_is_to_be_renewed_at_once_is_not() {
        let mut lease = chosen();
        assert!(is_heard(&mut lease, Kind::Ack, Some(OURS)));
        assert!(!leaves(&mut lease, Kind::Request, None, 10_499));
        assert!(leaves(&mut lease, Kind::Request, None, 10_500));
        assert!(!leaves(&mut lease, Kind::Request, None, 10_999));
        assert!(leaves(&mut lease, Kind::Request, Some(OURS), 10_501));
    }

    #[test]
    fn other_frames_and_damaged_messages_are_left_to_the_stack() {
        let mut lease = chosen();
        let mut written = [0; LONGEST_MESSAGE];
        let refusal = frame(Kind::Nak, Some(OTHER));
        for length in 0..refusal.len() {
            assert_eq!(lease.admits(&refusal[..length], &mut written), None, "{length}");
        }
        // Kind of frame, protocol, check sum, ports, check sum, magic number.
        for at in [12, 23, 25, 35, 37, 41, 279] {
            let mut other = refusal.clone();
            other[at] ^= 1;
            assert_eq!(lease.admits(&other, &mut written), None, "{at}");
        }
        assert!(lease.releases(&mut frame(Kind::Offer, Some(OURS)), Moment::from_secs(10)));
    }
}
