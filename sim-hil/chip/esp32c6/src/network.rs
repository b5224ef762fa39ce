//! The network that the chip's radio is on: an access point and one peer at its address, who answers ARP and DHCP and
//! carries UDP to and from whoever runs the emulation. It delays, loses, and can go away.
//!
//! Its addresses are loopback addresses, so that the one that the station is given, and announces, is also where this
//! computer finds it.

use std::collections::VecDeque;

use pbkdf2::pbkdf2_hmac;
use sha1::Sha1;

use crate::block::CYCLES_PER_SECOND;

/// The peer, which is also gateway and DHCP server.
pub const PEER: [u8; 4] = [127, 0, 0, 1];
/// What DHCP gives to the station, unless [`Network::lease`] is changed.
const LEASE: [u8; 4] = [127, 0, 0, 7];
/// Group and port of multicast DNS (RFC 6762, section 3).
pub const GROUP: [u8; 4] = [224, 0, 0, 251];
/// See [`GROUP`].
pub const MDNS_PORT: u16 = 5353;
/// The group's address as Ethernet has it (RFC 1112, section 6.4).
const GROUP_MAC: [u8; 6] = [1, 0, 0x5E, GROUP[1] & 0x7F, GROUP[2], GROUP[3]];
const PEER_MAC: [u8; 6] = [2, 0, 0, 0, 0, 1];
const BROADCAST: [u8; 6] = [0xFF; 6];

const ARP: [u8; 2] = [8, 6];
const IPV4: [u8; 2] = [8, 0];
const UDP: u8 = 17;
/// Group management, and its report of a member (RFC 2236, section 2.1).
const IGMP: u8 = 2;
const IGMP_REPORT: u8 = 0x16;
const DHCP_SERVER: u16 = 67;
const DHCP_CLIENT: u16 = 68;
const DHCP_COOKIE: [u8; 4] = [99, 130, 83, 99];
/// Kinds of messages (RFC 2132, section 9.6).
pub const DISCOVER: u8 = 1;
const OFFER: u8 = 2;
/// See [`DISCOVER`].
pub const REQUEST: u8 = 3;
const ACKNOWLEDGEMENT: u8 = 5;
const REFUSAL: u8 = 6;
/// A DHCP server that is not asked.
const REFUSER: [u8; 4] = [127, 0, 0, 3];

/// How the air treats a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Air {
    /// Time from one end to the other, microseconds.
    pub delay_us: u64,
    /// Share of frames that are lost, each way, 0 to 1.
    pub loss: f64,
    /// Whether the access point can be reached.
    pub is_up: bool,
}

impl Default for Air {
    /// A quiet room: 2 ms, nothing lost.
    fn default() -> Self {
        Self { delay_us: 2_000, loss: 0.0, is_up: true }
    }
}

/// Channels that a scan goes through, in the world's rules.
pub const CHANNELS: u64 = 13;
/// The network's name, and the pass phrase that it has by default.
pub const NAME: &str = "lab";
/// See [`NAME`].
pub const PASSPHRASE: &str = "correct horse battery staple";
/// Another network, whose name is Latin-1 and not UTF-8; its pass phrase is [`PASSPHRASE`], too.
pub const LATIN_NAME: &[u8] = b"caf\xe9";
/// A network that asks for a user name, not for a pass phrase (802.1X).
pub const ENTERPRISE_NAME: &str = "school";
/// Rounds in which a pass phrase makes a key (IEEE 802.11, annex J).
const ROUNDS: u32 = 4_096;

/// How a network keeps others out (`wifi_auth_mode_t`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Security {
    /// Not at all.
    Open = 0,
    /// By a pass phrase.
    Wpa2 = 3,
    /// By user names.
    Enterprise = 5,
}

/// An access point.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AccessPoint {
    /// Name of its network; none where it is hidden.
    pub name: Vec<u8>,
    /// Its channel.
    pub channel: u8,
    /// Power at the station, dBm.
    pub dbm: i32,
    /// How it keeps others out.
    pub security: Security,
    /// Its pass phrase.
    pub passphrase: String,
}

impl AccessPoint {
    fn new(name: &[u8], channel: u8, dbm: i32, security: Security) -> Self {
        let passphrase = if security == Security::Wpa2 { PASSPHRASE } else { "" };
        Self { name: name.to_vec(), channel, dbm, security, passphrase: passphrase.to_owned() }
    }

    /// Returns those that are there by default, in the order of their channels.
    #[must_use]
    pub fn all() -> Vec<Self> {
        vec![
            Self::new(NAME.as_bytes(), 1, -78, Security::Wpa2),
            Self::new(ENTERPRISE_NAME.as_bytes(), 3, -71, Security::Enterprise),
            Self::new(LATIN_NAME, 6, -35, Security::Wpa2),
            Self::new(b"", 9, -85, Security::Open),
            Self::new(NAME.as_bytes(), 11, -42, Security::Wpa2),
        ]
    }
}

/// Returns whether a password is the key itself, in 64 digits (IEEE 802.11, annex J).
pub(crate) fn is_key(password: &str) -> bool {
    password.len() == 64 && password.bytes().all(|it| it.is_ascii_hexdigit())
}

/// Returns the key that a network of this name has with this password; none for an open network.
#[must_use]
pub fn key_of(name: &[u8], password: &str) -> Option<[u8; 32]> {
    let mut key = [0; 32];
    if is_key(password) {
        for (byte, pair) in key.iter_mut().zip(password.as_bytes().chunks(2)) {
            *byte = u8::from_str_radix(core::str::from_utf8(pair).ok()?, 16).ok()?;
        }
    } else if password.is_empty() {
        return None;
    } else {
        pbkdf2_hmac::<Sha1>(password.as_bytes(), name, ROUNDS, &mut key);
    }
    Some(key)
}

/// Attempts to connect that the radio's library accepts, and of which nothing comes: no event, whatever is waited for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Silence {
    /// None.
    #[default]
    None,
    /// The next one.
    Once,
    /// All, until the library is taken down and started again.
    UntilRenewed,
    /// All, until the chip starts anew.
    UntilRestarted,
}

impl Silence {
    /// Returns whether an attempt comes to nothing.
    pub(crate) fn swallows(&mut self) -> bool {
        let swallows = *self != Self::None;
        self.end(Self::Once);
        swallows
    }

    /// Ends this kind.
    pub(crate) fn end(&mut self, kind: Self) {
        if *self == kind {
            *self = Self::None;
        }
    }
}

/// What DHCP does wrong.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DhcpTrouble {
    /// So many of the station's next messages are lost.
    pub lost: u32,
    /// The server refuses each request.
    pub refuses: bool,
    /// A second server, which was not chosen, refuses each request.
    pub has_refuser: bool,
}

/// A datagram between the station and a port of the peer, or from the station to all that listen in the group.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Datagram {
    /// The peer's port; [`MDNS_PORT`] is everybody's.
    pub port: u16,
    /// Contents.
    pub payload: Vec<u8>,
}

/// The network.
#[derive(Debug)]
pub struct Network {
    /// How the air treats frames from now on.
    pub air: Air,
    /// What DHCP gives to the station.
    pub lease: [u8; 4],
    /// The access points in reach, in the order of their channels.
    pub access_points: Vec<AccessPoint>,
    /// How often the radio's library does not start from now on.
    pub start_failures: u32,
    /// What becomes of attempts to connect.
    pub silence: Silence,
    /// What DHCP does wrong.
    pub trouble: DhcpTrouble,
    /// Messages of DHCP that the station sent: when, and of which kind.
    pub dhcp: Vec<(u64, u8)>,
    /// The host name that it gave with the last of them.
    pub host_name: Option<Vec<u8>>,
    /// Reports of the station that it is in the group of multicast DNS (IGMP).
    pub group_reports: u64,
    station: Option<([u8; 6], [u8; 4])>,
    to_station: VecDeque<(u64, Vec<u8>)>,
    from_station: VecDeque<(u64, Datagram)>,
    identification: u16,
    random: u64,
    /// Frames that reached the station, and that it sent.
    pub frames: [u64; 2],
}

impl Default for Network {
    fn default() -> Self {
        Self {
            air: Air::default(),
            lease: LEASE,
            access_points: AccessPoint::all(),
            start_failures: 0,
            silence: Silence::None,
            trouble: DhcpTrouble::default(),
            dhcp: Vec::new(),
            host_name: None,
            group_reports: 0,
            station: None,
            to_station: VecDeque::new(),
            from_station: VecDeque::new(),
            identification: 0,
            random: 0x2545_F491_4F6C_DD1D,
            frames: [0; 2],
        }
    }
}

impl Network {
    /// Returns the station's address, once it has sent something.
    #[must_use]
    pub fn station(&self) -> Option<[u8; 4]> {
        self.station.map(|(_, address)| address)
    }

    /// Returns how many channels are scanned to find a network of this name, and the access point that is
    /// taken: the strongest where all are scanned, else the first.
    pub(crate) fn found(&self, name: &[u8], scans_all: bool) -> Option<(u64, &AccessPoint)> {
        let mut named = self.heard().iter().filter(|it| it.name == name);
        match scans_all {
            true => named.max_by_key(|it| it.dbm).map(|it| (CHANNELS, it)),
            false => named.next().map(|it| (it.channel.into(), it)),
        }
    }

    /// Returns the access points that can be heard.
    pub(crate) fn heard(&self) -> &[AccessPoint] {
        if self.air.is_up { &self.access_points } else { &[] }
    }

    /// Gives the network [`NAME`] another pass phrase.
    pub fn change_passphrase(&mut self, passphrase: &str) {
        for it in self.access_points.iter_mut().filter(|it| it.name == NAME.as_bytes()) {
            it.passphrase = passphrase.to_owned();
        }
    }

    fn survives(&mut self) -> bool {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        let draw = (self.random >> 11) as f64 / (1_u64 << 53) as f64;
        self.air.is_up && draw >= self.air.loss
    }

    fn arrival(&self, now: u64) -> u64 {
        now + self.air.delay_us * (CYCLES_PER_SECOND / 1_000_000)
    }

    fn send(&mut self, frame: Vec<u8>, now: u64) {
        if self.survives() {
            let at = self.arrival(now);
            self.to_station.push_back((at, frame));
        }
    }

    /// Returns when the next frame reaches the station.
    pub(crate) fn next_event(&self) -> u64 {
        self.to_station.front().map_or(u64::MAX, |(at, _)| *at)
    }

    /// Returns the next frame that has reached the station.
    pub(crate) fn arrived(&mut self, now: u64) -> Option<Vec<u8>> {
        self.to_station.front().filter(|(at, _)| *at <= now)?;
        self.frames[0] += 1;
        self.to_station.pop_front().map(|(_, frame)| frame)
    }

    /// Sends a datagram from a port of the peer to a port of the station, if the station is known. That of multicast DNS is
    /// reached through its group.
    pub fn send_datagram(&mut self, datagram: &Datagram, station_port: u16, now: u64) {
        let group = (station_port == MDNS_PORT).then_some((GROUP_MAC, GROUP));
        if let Some((mac, address)) = group.or(self.station) {
            self.identification = self.identification.wrapping_add(1);
            let ports = [datagram.port, station_port];
            let packet = udp(PEER, address, ports, &datagram.payload, self.identification);
            self.send(ethernet(mac, IPV4, &packet), now);
        }
    }

    /// Returns the next datagram that has reached the peer.
    pub fn receive_datagram(&mut self, now: u64) -> Option<Datagram> {
        self.from_station.front().filter(|(at, _)| *at <= now)?;
        self.from_station.pop_front().map(|(_, datagram)| datagram)
    }

    /// Takes a frame that the station sends.
    pub(crate) fn transmit(&mut self, frame: &[u8], now: u64) {
        self.frames[1] += 1;
        if frame.len() < 34 || !self.survives() {
            return;
        }
        let mac: [u8; 6] = array(&frame[6..]);
        match array(&frame[12..]) {
            ARP => self.answer_arp(mac, frame, now),
            IPV4 => self.take_ipv4(mac, frame, now),
            _ => {}
        }
    }

    /// Every address but the station's own is the peer's.
    fn answer_arp(&mut self, mac: [u8; 6], frame: &[u8], now: u64) {
        let is_request = frame.len() >= 42 && frame[20..22] == [0, 1];
        if !is_request {
            return;
        }
        let (sender, target): ([u8; 4], [u8; 4]) = (array(&frame[28..]), array(&frame[38..]));
        if sender == target || sender == [0; 4] {
            return;
        }
        let mut answer =
            [&[0, 1, 8, 0, 6, 4, 0, 2], &PEER_MAC[..], &target, &mac, &sender].concat();
        answer.resize(46, 0);
        self.send(ethernet(mac, ARP, &answer), now);
    }

    fn take_ipv4(&mut self, mac: [u8; 6], frame: &[u8], now: u64) {
        let packet = &frame[14..];
        let header = usize::from(packet[0] & 15) * 4;
        let (source, target): ([u8; 4], [u8; 4]) = (array(&packet[12..]), array(&packet[16..]));
        if source != [0; 4] {
            self.station = Some((mac, source));
        }
        let is_report = packet[9] == IGMP && packet.get(header) == Some(&IGMP_REPORT);
        if is_report && packet.get(header + 4..header + 8) == Some(&GROUP) {
            self.group_reports += 1;
        }
        let Some(datagram) = packet.get(header..).filter(|it| packet[9] == UDP && it.len() >= 8)
        else {
            return;
        };
        let word = |at: usize| u16::from_be_bytes([datagram[at], datagram[at + 1]]);
        let Some(payload) = datagram.get(8..usize::from(word(4))) else { return };
        if word(2) == DHCP_SERVER {
            self.answer_dhcp(mac, payload, now);
        } else if target == PEER || target == GROUP {
            let at = self.arrival(now);
            let payload = payload.to_vec();
            self.from_station.push_back((at, Datagram { port: word(2), payload }));
        }
    }

    /// Offers and grants the one lease there is.
    fn answer_dhcp(&mut self, mac: [u8; 6], message: &[u8], now: u64) {
        if message.len() < 240 || message[236..240] != DHCP_COOKIE {
            return;
        }
        let mut options = &message[240..];
        let mut kind = None;
        while let [code, length, rest @ ..] = options {
            match *code {
                53 => kind = rest.first(),
                12 => self.host_name = rest.get(..usize::from(*length)).map(<[u8]>::to_vec),
                _ => {}
            }
            options = rest.get(usize::from(*length)..).unwrap_or(&[]);
        }
        let Some(&kind) = kind else { return };
        self.dhcp.push((now, kind));
        if self.trouble.lost > 0 {
            self.trouble.lost -= 1;
            return;
        }
        // Discover is answered by an offer, request by an acknowledgement.
        match kind {
            DISCOVER => self.reply_dhcp(mac, message, OFFER, PEER, now),
            REQUEST => {
                if self.trouble.has_refuser {
                    self.reply_dhcp(mac, message, REFUSAL, REFUSER, now);
                }
                let answer = if self.trouble.refuses { REFUSAL } else { ACKNOWLEDGEMENT };
                self.reply_dhcp(mac, message, answer, PEER, now);
            }
            _ => {}
        }
    }

    fn reply_dhcp(&mut self, mac: [u8; 6], message: &[u8], answer: u8, server: [u8; 4], now: u64) {
        let mut reply = vec![2, 1, 6, 0];
        reply.extend(&message[4..8]);
        reply.extend([0; 8]);
        reply.extend(if answer == REFUSAL { [0; 4] } else { self.lease });
        reply.extend(server);
        reply.extend([0; 4]);
        reply.extend(mac);
        reply.resize(236, 0);
        reply.extend(DHCP_COOKIE);
        reply.extend([53, 1, answer, 54, 4]);
        reply.extend(server);
        if answer != REFUSAL {
            reply.extend([51, 4, 0, 1, 81, 128, 1, 4, 255, 255, 255, 0, 3, 4]);
            reply.extend(PEER);
        }
        reply.push(255);
        self.identification = self.identification.wrapping_add(1);
        let ports = [DHCP_SERVER, DHCP_CLIENT];
        let packet = udp(server, [255; 4], ports, &reply, self.identification);
        self.send(ethernet(BROADCAST, IPV4, &packet), now);
    }
}

fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes.first_chunk().copied().unwrap_or([0; N])
}

fn ethernet(target: [u8; 6], kind: [u8; 2], payload: &[u8]) -> Vec<u8> {
    [&target[..], &PEER_MAC, &kind, payload].concat()
}

/// An IPv4 packet with a datagram without check sum, which UDP allows.
fn udp(
    source: [u8; 4],
    target: [u8; 4],
    ports: [u16; 2],
    payload: &[u8],
    identification: u16,
) -> Vec<u8> {
    let length = payload.len() as u16 + 8;
    let mut packet = vec![0x45, 0];
    packet.extend((length + 20).to_be_bytes());
    packet.extend(identification.to_be_bytes());
    packet.extend([0, 0, 64, UDP, 0, 0]);
    packet.extend(source);
    packet.extend(target);
    let sum = check_sum(&packet).to_be_bytes();
    packet[10..12].copy_from_slice(&sum);
    ports.iter().for_each(|port| packet.extend(port.to_be_bytes()));
    packet.extend(length.to_be_bytes());
    packet.extend([0, 0]);
    packet.extend(payload);
    packet
}

fn check_sum(bytes: &[u8]) -> u16 {
    let words = bytes
        .chunks(2)
        .map(|pair| u32::from(pair[0]) << 8 | u32::from(pair.get(1).copied().unwrap_or(0)));
    let mut sum: u32 = words.sum();
    while sum >> 16 != 0 {
        sum = (sum & 0xFFFF) + (sum >> 16);
    }
    !(sum as u16)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STATION_MAC: [u8; 6] = [2, 0, 0, 0, 0, 9];

    fn request(target: [u8; 4]) -> Vec<u8> {
        let body = [&[0, 1, 8, 0, 6, 4, 0, 1], &STATION_MAC[..], &LEASE, &[0; 6], &target].concat();
        [&BROADCAST[..], &STATION_MAC, &ARP, &body].concat()
    }

    #[test]
    fn answers_arp_for_others_after_the_airs_delay() {
        let mut network = Network::default();
        network.transmit(&request(PEER), 0);
        assert_eq!(network.arrived(319_999), None);
        let answer = network.arrived(320_000).unwrap();
        assert_eq!(answer[..6], STATION_MAC);
        assert_eq!(answer[22..28], PEER_MAC);
        network.transmit(&request(LEASE), 0);
        assert_eq!(network.next_event(), u64::MAX, "asks whether its own address is free");
    }

    #[test]
    fn carries_nothing_while_it_is_down() {
        let mut network = Network::default();
        network.air.is_up = false;
        network.transmit(&request(PEER), 0);
        assert_eq!(network.next_event(), u64::MAX);
    }

    #[test]
    fn a_packet_has_the_check_sum_that_the_standard_asks_for() {
        // The sum over a header with its check sum is zero.
        assert_eq!(check_sum(&udp(PEER, LEASE, [1, 2], b"abc", 7)[..20]), 0);
    }
}
