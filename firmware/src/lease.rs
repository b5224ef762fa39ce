//! What stands between the stack's DHCP client and a network that is not in order.
//!
//! The client (smoltcp 0.13.1, `dhcpv4`) takes a refusal (DHCPNAK) from any server, also from one that it did not choose
//! (RFC 2131, section 3.1.5, lets others answer a broadcast request), gives its address up, and begins anew at once, as fast
//! as the network answers. [`Lease`] looks at its messages, both ways:
//!
//! - A refusal of a server that was not chosen (option 54) does not reach it.
//! - After a refusal that does, it begins anew no sooner than [`RESTART`] after it last began: what it sends before is
//!   dropped, and it repeats that by itself.

use core::net::Ipv4Addr;

use embassy_time::{Duration, Instant as Moment};

/// Least time from one beginning to the next after a refusal.
const RESTART: Duration = Duration::from_secs(2);

/// Ports of servers and clients.
const SERVER_PORT: u16 = 67;
const CLIENT_PORT: u16 = 68;
/// Ethernet, IPv4 without options, UDP.
const ETHERNET_HEADER: usize = 14;
const UDP_HEADER: usize = 8;
const ETHERTYPE_IPV4: [u8; 2] = [0x08, 0x00];
const PROTOCOL_UDP: u8 = 17;
/// Where a message's options begin, behind their magic number (RFC 2131, figure 1).
const OPTIONS: usize = 240;
/// Options (RFC 2132): padding, end, kind of message, server.
const PADDING: u8 = 0;
const END: u8 = 255;
const KIND: u8 = 53;
const SERVER: u8 = 54;
/// Kinds of message.
const DISCOVER: u8 = 1;
const REQUEST: u8 = 3;
const ACKNOWLEDGEMENT: u8 = 5;
const REFUSAL: u8 = 6;

/// Shortest and longest frame with a message of the client: what else is as long is looked at, and nothing more.
pub(crate) const SHORTEST_MESSAGE: usize = ETHERNET_HEADER + 20 + UDP_HEADER + OPTIONS;
/// See [`SHORTEST_MESSAGE`].
pub(crate) const LONGEST_MESSAGE: usize = SHORTEST_MESSAGE + 160;

/// What the messages so far have shown.
#[derive(Debug, Default)]
pub(crate) struct Lease {
    /// The server that the client chose.
    server: Option<Ipv4Addr>,
    /// When the client last began.
    began: Option<Moment>,
    /// Whether its request was refused since.
    is_refused: bool,
}

impl Lease {
    /// Notes a frame for the client, and returns whether it may see it.
    pub(crate) fn admits(&mut self, frame: &[u8]) -> bool {
        let Some((kind, server)) = message(frame, CLIENT_PORT) else { return true };
        match kind {
            ACKNOWLEDGEMENT => {
                // A request to any server (rebinding) may be granted by another one.
                self.server = server.or(self.server);
                true
            }
            REFUSAL if self.server.is_some() && server != self.server => false,
            REFUSAL => {
                self.is_refused = true;
                true
            }
            _ => true,
        }
    }

    /// Notes a frame of the client, and returns whether it may leave.
    pub(crate) fn releases(&mut self, frame: &[u8], now: Moment) -> bool {
        match message(frame, SERVER_PORT) {
            Some((DISCOVER, _)) => {
                let is_early =
                    self.began.is_some_and(|began| now.saturating_duration_since(began) < RESTART);
                if is_early && self.is_refused {
                    return false;
                }
                (self.server, self.began, self.is_refused) = (None, Some(now), false);
                true
            }
            // A renewal names no server, but the one that was chosen goes on to be it.
            Some((REQUEST, server)) => {
                self.server = server.or(self.server);
                true
            }
            _ => true,
        }
    }
}

fn number(bytes: &[u8]) -> Option<u16> {
    <[u8; 2]>::try_from(bytes).ok().map(u16::from_be_bytes)
}

/// Returns kind and server of a DHCP message in a frame to this port.
fn message(frame: &[u8], port: u16) -> Option<(u8, Option<Ipv4Addr>)> {
    let is_ipv4 = frame.get(12..ETHERNET_HEADER)? == ETHERTYPE_IPV4;
    let packet = frame.get(ETHERNET_HEADER..)?;
    if !is_ipv4 || *packet.get(9)? != PROTOCOL_UDP {
        return None;
    }
    let segment = packet.get(usize::from(packet.first()? & 0x0f) * 4..)?;
    if number(segment.get(2..4)?)? != port {
        return None;
    }
    let mut options = segment.get(UDP_HEADER + OPTIONS..)?;
    let (mut kind, mut server) = (None, None);
    loop {
        options = match options {
            [PADDING, rest @ ..] => rest,
            [END, ..] | [] | [_] => break,
            [code, length, rest @ ..] => {
                let value = rest.get(..usize::from(*length))?;
                match *code {
                    KIND => kind = value.first().copied(),
                    SERVER => {
                        server = <[u8; 4]>::try_from(value).ok().map(Ipv4Addr::from);
                    }
                    _ => {}
                }
                rest.get(usize::from(*length)..)?
            }
        };
    }
    Some((kind?, server))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const OURS: [u8; 4] = [10, 0, 0, 254];
    const OTHER: [u8; 4] = [10, 0, 0, 253];

    fn frame(port: u16, kind: u8, server: Option<[u8; 4]>) -> Vec<u8> {
        let mut frame = std::vec![0; ETHERNET_HEADER + 20 + UDP_HEADER + OPTIONS];
        frame[12..14].copy_from_slice(&ETHERTYPE_IPV4);
        frame[14] = 0x45;
        frame[23] = PROTOCOL_UDP;
        frame[36..38].copy_from_slice(&port.to_be_bytes());
        frame.extend([KIND, 1, kind]);
        if let Some(server) = server {
            frame.extend([PADDING, SERVER, 4]);
            frame.extend(server);
        }
        frame.push(END);
        frame
    }

    fn chosen() -> Lease {
        let mut lease = Lease::default();
        let at = Moment::from_secs(10);
        assert!(lease.releases(&frame(SERVER_PORT, DISCOVER, None), at));
        assert!(lease.releases(&frame(SERVER_PORT, REQUEST, Some(OURS)), at));
        lease
    }

    #[test]
    fn only_the_chosen_server_refuses() {
        let mut lease = chosen();
        assert!(!lease.admits(&frame(CLIENT_PORT, REFUSAL, Some(OTHER))));
        assert!(!lease.admits(&frame(CLIENT_PORT, REFUSAL, None)));
        assert!(lease.admits(&frame(CLIENT_PORT, REFUSAL, Some(OURS))));
    }

    #[test]
    fn a_renewal_is_refused_by_the_server_of_the_lease_alone() {
        let mut lease = chosen();
        assert!(lease.admits(&frame(CLIENT_PORT, ACKNOWLEDGEMENT, Some(OURS))));
        assert!(lease.releases(&frame(SERVER_PORT, REQUEST, None), Moment::from_secs(99)));
        assert!(!lease.admits(&frame(CLIENT_PORT, REFUSAL, Some(OTHER))));
        assert!(lease.admits(&frame(CLIENT_PORT, REFUSAL, Some(OURS))));
    }

    #[test]
    fn beginnings_after_a_refusal_are_paced() {
        let mut lease = chosen();
        let discover = frame(SERVER_PORT, DISCOVER, None);
        assert!(lease.admits(&frame(CLIENT_PORT, REFUSAL, Some(OURS))));
        assert!(!lease.releases(&discover, Moment::from_millis(10_001)));
        assert!(!lease.releases(&discover, Moment::from_millis(11_999)));
        assert!(lease.releases(&discover, Moment::from_millis(12_000)));
    }

    #[test]
    fn other_frames_and_damaged_messages_pass() {
        let mut lease = chosen();
        let refusal = frame(CLIENT_PORT, REFUSAL, Some(OTHER));
        for length in 0..refusal.len() - 8 {
            assert!(lease.admits(&refusal[..length]), "{length}");
        }
        assert!(lease.admits(&frame(CLIENT_PORT + 1, REFUSAL, Some(OTHER))));
        assert!(lease.releases(&frame(CLIENT_PORT, DISCOVER, None), Moment::from_secs(10)));
    }
}
