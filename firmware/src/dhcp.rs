//! What stands between the stack's DHCP client and a network that is not in order.
//!
//! The client (smoltcp 0.13.1, `dhcpv4`) takes a refusal (DHCPNAK) from any server, also from one that it did not choose
//! (RFC 2131, section 3.1.5, lets others answer a broadcast request), gives its address up, and begins anew at once, as fast
//! as the network answers. Where no server answers, it repeats itself at one rate for ever; a lease that is to be renewed at once
//! it renews as fast as the network answers. [`Lease`] looks at its messages, both ways, and passes over those to other clients:
//!
//! - A refusal of a server that was not chosen (option 54) does not reach it.
//! - From one beginning to the next pass at least [`PAUSES`], longer each time until an address is given: what it sends
//!   before is dropped, and it repeats that by itself.
//! - Nor does a renewal leave sooner than [`RENEWAL`] after the request before.

use core::net::Ipv4Addr;

use embassy_time::{Duration, Instant as Moment};

/// Least time from one beginning to the next, s; the last one from then on. The client repeats itself every 3 s, so that it begins
/// after 3, 6, 12 and 24 s (RFC 2131, section 4.1, doubles likewise).
const PAUSES: [u64; 4] = [2, 5, 11, 23];
/// Least time from a request to a renewal. The client asks again after a minute, or when it may ask any server.
const RENEWAL: Duration = Duration::from_millis(500);

/// Ports of servers and clients.
const SERVER_PORT: u16 = 67;
const CLIENT_PORT: u16 = 68;
/// Ethernet, IPv4 without options, UDP.
const ETHERNET_HEADER: usize = 14;
const UDP_HEADER: usize = 8;
const ETHERTYPE_IPV4: [u8; 2] = [0x08, 0x00];
const PROTOCOL_UDP: u8 = 17;
/// Where in a message its exchange's number is, and where its options begin, behind their magic number (RFC 2131, figure 1).
const TRANSACTION: core::ops::Range<usize> = 4..8;
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
    /// How often it began anew since the link is up, or an address was given.
    restarts: usize,
    /// When it last requested.
    requested: Option<Moment>,
    /// Number of the exchange in which the client is, on the wire and as the client counts it.
    transaction: [u8; 4],
    own: [u8; 4],
}

/// What is looked at in a message.
struct Message {
    kind: u8,
    server: Option<Ipv4Addr>,
    transaction: [u8; 4],
}

impl Lease {
    /// Notes a frame for the client, and returns whether it may see it.
    pub(crate) fn admits(&mut self, frame: &mut [u8]) -> bool {
        let Some(Message { kind, server, transaction }) = message(frame, CLIENT_PORT) else {
            return true;
        };
        // One to another client says nothing about this one's server.
        if transaction != self.transaction {
            return true;
        }
        renumber(frame, self.own);
        match kind {
            ACKNOWLEDGEMENT => {
                // A request to any server (rebinding) may be granted by another one.
                self.server = server.or(self.server);
                self.restarts = 0;
                true
            }
            REFUSAL => self.server.is_none() || server == self.server,
            _ => true,
        }
    }

    /// Notes a frame of the client, and returns whether it may leave.
    pub(crate) fn releases(&mut self, frame: &mut [u8], now: Moment) -> bool {
        let Some(Message { kind, server, transaction }) = message(frame, SERVER_PORT) else {
            return true;
        };
        let is_within = |since: Option<Moment>, pause: Duration| {
            since.is_some_and(|since| now.saturating_duration_since(since) < pause)
        };
        self.own = transaction;
        // A beginning that is repeated keeps its number: its first one may be answered late.
        let mut is_new = kind != REQUEST || server.is_none();
        match kind {
            DISCOVER => {
                let pause = PAUSES[self.restarts.min(PAUSES.len() - 1)];
                if is_within(self.began, Duration::from_secs(pause)) {
                    return false;
                }
                self.restarts += usize::from(self.began.is_some());
                is_new = self.server.is_some() || self.began.is_none();
                (self.server, self.began) = (None, Some(now));
            }
            REQUEST => {
                // A renewal names no server, but the one that was chosen goes on to be it.
                if server.is_none() && is_within(self.requested, RENEWAL) {
                    return false;
                }
                (self.server, self.requested) = (server.or(self.server), Some(now));
            }
            _ => {}
        }
        if is_new {
            self.transaction = transaction;
        }
        renumber(frame, self.transaction);
        true
    }
}

/// Gives a message another number, and no check sum (RFC 768 allows that).
fn renumber(frame: &mut [u8], transaction: [u8; 4]) {
    let Some(segment) = segment(frame).and_then(|it| frame.get_mut(it)) else { return };
    let Some((head, payload)) = segment.split_at_mut_checked(UDP_HEADER) else { return };
    if let Some(number) = payload.get_mut(TRANSACTION)
        && *number != transaction
    {
        number.copy_from_slice(&transaction);
        head[6..].fill(0);
    }
}

/// Returns where the UDP header and what follows it are in an IPv4 frame.
fn segment(frame: &[u8]) -> Option<core::ops::RangeFrom<usize>> {
    let words = frame.get(ETHERNET_HEADER)? & 0x0f;
    Some(ETHERNET_HEADER + usize::from(words) * 4..)
}

fn number(bytes: &[u8]) -> Option<u16> {
    <[u8; 2]>::try_from(bytes).ok().map(u16::from_be_bytes)
}

/// Returns the DHCP message in a frame to this port.
fn message(frame: &[u8], port: u16) -> Option<Message> {
    let is_ipv4 = frame.get(12..ETHERNET_HEADER)? == ETHERTYPE_IPV4;
    if !is_ipv4 || *frame.get(ETHERNET_HEADER + 9)? != PROTOCOL_UDP {
        return None;
    }
    let segment = frame.get(segment(frame)?)?;
    if number(segment.get(2..4)?)? != port {
        return None;
    }
    let payload = segment.get(UDP_HEADER..)?;
    let transaction = payload.get(TRANSACTION)?.try_into().ok()?;
    let mut options = payload.get(OPTIONS..)?;
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
    Some(Message { kind: kind?, server, transaction })
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
        frame[46..50].copy_from_slice(&[0, 0, 0, 9]);
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
        assert!(lease.releases(&mut frame(SERVER_PORT, DISCOVER, None), at));
        assert!(lease.releases(&mut frame(SERVER_PORT, REQUEST, Some(OURS)), at));
        lease
    }

    #[test]
    fn only_the_chosen_server_refuses() {
        let mut lease = chosen();
        assert!(!lease.admits(&mut frame(CLIENT_PORT, REFUSAL, Some(OTHER))));
        assert!(!lease.admits(&mut frame(CLIENT_PORT, REFUSAL, None)));
        assert!(lease.admits(&mut frame(CLIENT_PORT, REFUSAL, Some(OURS))));
    }

    #[test]
    fn a_renewal_is_refused_by_the_server_of_the_lease_alone() {
        let mut lease = chosen();
        assert!(lease.admits(&mut frame(CLIENT_PORT, ACKNOWLEDGEMENT, Some(OURS))));
        assert!(lease.releases(&mut frame(SERVER_PORT, REQUEST, None), Moment::from_secs(99)));
        assert!(!lease.admits(&mut frame(CLIENT_PORT, REFUSAL, Some(OTHER))));
        assert!(lease.admits(&mut frame(CLIENT_PORT, REFUSAL, Some(OURS))));
    }

    /// Returns when a client begins that would every millisecond, or where `refused`, once it has requested and was refused, ms.
    fn beginnings(mut lease: Lease, until_ms: u64, refused: bool) -> Vec<u64> {
        let discover = frame(SERVER_PORT, DISCOVER, None);
        let begins = |ms: &u64| {
            let begins = lease.releases(&mut discover.clone(), Moment::from_millis(*ms));
            if begins && refused {
                assert!(lease.releases(
                    &mut frame(SERVER_PORT, REQUEST, Some(OURS)),
                    Moment::from_millis(*ms)
                ));
                assert!(lease.admits(&mut frame(CLIENT_PORT, REFUSAL, Some(OURS))));
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

    /// Returns the number of a message on the wire, or as the client gets it.
    fn numbered(mut frame: Vec<u8>, own: u8, pass: impl FnOnce(&mut [u8]) -> bool) -> Option<u8> {
        frame[49] = own;
        // A check sum.
        frame[41] = 1;
        let is_passed = pass(&mut frame);
        assert_eq!(frame[41] == 1, frame[49] == own, "a check sum of other bytes");
        is_passed.then_some(frame[49])
    }

    #[test]
    fn a_beginning_that_is_repeated_keeps_its_number_and_an_answer_to_it_finds_the_client() {
        let mut lease = Lease::default();
        let says = |lease: &mut Lease, kind, server, own, s| {
            let out = frame(SERVER_PORT, kind, server);
            numbered(out, own, |it| lease.releases(it, Moment::from_secs(s)))
        };
        let hears = |lease: &mut Lease, kind, number| {
            numbered(frame(CLIENT_PORT, kind, Some(OURS)), number, |it| lease.admits(it))
        };
        const OFFER: u8 = 2;
        assert_eq!(says(&mut lease, DISCOVER, None, 1, 10), Some(1));
        assert_eq!(says(&mut lease, DISCOVER, None, 2, 13), Some(1));
        // One too early does not leave, but the client goes by it.
        assert_eq!(says(&mut lease, DISCOVER, None, 3, 14), None);
        assert_eq!(hears(&mut lease, OFFER, 1), Some(3));
        assert_eq!(hears(&mut lease, OFFER, 7), Some(7), "to somebody else");
        assert_eq!(says(&mut lease, REQUEST, Some(OURS), 3, 15), Some(1));
        assert_eq!(hears(&mut lease, ACKNOWLEDGEMENT, 1), Some(3));
        // A renewal, and a new beginning, are others.
        assert_eq!(says(&mut lease, REQUEST, None, 4, 99), Some(4));
        assert_eq!(hears(&mut lease, ACKNOWLEDGEMENT, 4), Some(4));
        assert_eq!(says(&mut lease, DISCOVER, None, 5, 200), Some(5));
        assert_eq!(says(&mut lease, DISCOVER, None, 6, 206), Some(5));
        const DECLINE: u8 = 4;
        assert_eq!(says(&mut lease, DECLINE, Some(OURS), 8, 207), Some(8));
    }

    #[test]
    fn an_address_ends_the_pauses() {
        let mut lease = Lease::default();
        for s in [0, 2, 7, 18, 41] {
            assert!(lease.releases(&mut frame(SERVER_PORT, DISCOVER, None), Moment::from_secs(s)));
        }
        assert!(lease.admits(&mut frame(CLIENT_PORT, ACKNOWLEDGEMENT, Some(OURS))));
        assert!(
            !lease.releases(&mut frame(SERVER_PORT, DISCOVER, None), Moment::from_millis(42_999))
        );
        assert!(lease.releases(&mut frame(SERVER_PORT, DISCOVER, None), Moment::from_secs(43)));
    }

    #[test]
    fn who_granted_last_refuses() {
        let mut lease = chosen();
        assert!(lease.admits(&mut frame(CLIENT_PORT, ACKNOWLEDGEMENT, Some(OTHER))));
        assert!(!lease.admits(&mut frame(CLIENT_PORT, REFUSAL, Some(OURS))));
        assert!(lease.admits(&mut frame(CLIENT_PORT, REFUSAL, Some(OTHER))));
    }

    #[test]
    fn a_client_that_begins_anew_has_chosen_nobody() {
        let mut lease = chosen();
        assert!(lease.releases(&mut frame(SERVER_PORT, DISCOVER, None), Moment::from_secs(30)));
        assert!(lease.admits(&mut frame(CLIENT_PORT, REFUSAL, Some(OTHER))));
    }

    #[test]
    fn messages_to_other_clients_change_nothing() {
        let to_another = |kind, server| {
            let mut frame = frame(CLIENT_PORT, kind, Some(server));
            frame[46] = 1;
            frame
        };
        let mut lease = chosen();
        assert!(lease.admits(&mut to_another(ACKNOWLEDGEMENT, OTHER)));
        assert!(lease.admits(&mut to_another(REFUSAL, OTHER)));
        assert!(!lease.admits(&mut frame(CLIENT_PORT, REFUSAL, Some(OTHER))));
        assert!(lease.admits(&mut frame(CLIENT_PORT, REFUSAL, Some(OURS))));
    }

    #[test]
    fn a_lease_that_is_to_be_renewed_at_once_is_not() {
        let mut lease = chosen();
        assert!(lease.admits(&mut frame(CLIENT_PORT, ACKNOWLEDGEMENT, Some(OURS))));
        let renewal = frame(SERVER_PORT, REQUEST, None);
        assert!(!lease.releases(&mut renewal.clone(), Moment::from_millis(10_499)));
        assert!(lease.releases(&mut renewal.clone(), Moment::from_millis(10_500)));
        assert!(!lease.releases(&mut renewal.clone(), Moment::from_millis(10_999)));
        assert!(
            lease.releases(
                &mut frame(SERVER_PORT, REQUEST, Some(OURS)),
                Moment::from_millis(10_501)
            )
        );
    }

    #[test]
    fn other_frames_and_damaged_messages_pass() {
        let mut lease = chosen();
        let refusal = frame(CLIENT_PORT, REFUSAL, Some(OTHER));
        for length in 0..refusal.len() - 8 {
            assert!(lease.admits(&mut refusal[..length].to_vec()), "{length}");
        }
        assert!(lease.admits(&mut frame(CLIENT_PORT + 1, REFUSAL, Some(OTHER))));
        for (at, byte) in [(12, 0x86), (23, 6)] {
            let mut other = refusal.clone();
            other[at] = byte;
            assert!(lease.admits(&mut other), "{at}");
        }
        assert!(lease.releases(&mut frame(CLIENT_PORT, DISCOVER, None), Moment::from_secs(10)));
    }
}
