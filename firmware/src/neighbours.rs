//! A driver for the network stack that keeps answers flowing while somebody forges ARP.
//!
//! The stack (smoltcp) sends a datagram to the link-layer address that ARP reported last for its IP address. It believes
//! every ARP packet, knows eight neighbours at a time, and after it asked for one asks for no other for a second. So
//! [`Guarded`] stands between the stack and the driver:
//!
//! - Whoever sends a datagram to [`DEFAULT_PORT`] becomes the stack's newest neighbour, at the link-layer address that
//!   the datagram came from: the answer goes there, and the stack has to ask nobody. Who sends a copy of another's does not.
//! - While a datagram is answered, its sender is *held*: nothing that others send in its name, nor any ARP packet, leads the
//!   answer elsewhere.
//! - The sender of an authentic datagram ([`Guard::confirm`]) is *pinned* for `PINNED`: an ARP packet that places its IP
//!   address elsewhere is dropped, and it is renewed in the stack before `RENEWED_AFTER` others can displace it.
//!
//! This covers operators in the robot's own network; one beyond a router depends on the router's ARP.
//!
//! Its own address is probed before the stack has it, announced and defended (`claim.rs`).
//!
//! The stack's DHCP client is kept from what networks do to it (`dhcp.rs`), others are kept from its ICMP (`icmp.rs`), and nothing
//! leaves before the stack knows that the link is up: it would begin twice, with two messages in a millisecond, and hear the
//! answer to neither if both are lost.

use core::cell::RefCell;
use core::future::Future;
use core::net::{IpAddr, Ipv4Addr, SocketAddr};
use core::pin::pin;
use core::task::Context;

use embassy_net::driver::{Capabilities, Driver, HardwareAddress, LinkState, RxToken, TxToken};
use embassy_time::{Duration, Instant as Moment, Timer};
use flix_protocol::DEFAULT_PORT;
use flix_protocol::session::HOLDER_SILENCE;
use heapless::Deque;
use smoltcp::wire::EthernetAddress;

pub use crate::claim::Rival;
use crate::claim::{self, ARP_FRAME, Claim, Step};
use crate::dhcp::{self, LONGEST_MESSAGE, Lease};
use crate::icmp::{Icmp, LONGEST_ERROR};
use crate::link::push_newest;

/// Time for which the sender of an authentic datagram stays pinned: as long as its session keeps others out.
const PINNED: Duration = Duration::from_millis(HOLDER_SILENCE.as_millis() as u64);
/// Other neighbours that the stack may take before the pinned one is renewed: half of those that it knows.
const RENEWED_AFTER: usize = 4;
/// Senders that are remembered: more than the session's socket holds datagrams.
const SENDERS: usize = 32;
/// Length of the end of a datagram by which it is recognized: that of its tag.
const MARK: usize = flix_protocol::frame::TAG_LENGTH;

const ETHERNET_HEADER: usize = 14;
const ETHERTYPE_IPV4: [u8; 2] = [0x08, 0x00];
const ETHERTYPE_ARP: [u8; 2] = [0x08, 0x06];
const PROTOCOL_UDP: u8 = 17;
/// Offset and "more fragments" of an IPv4 header.
const FRAGMENT: u16 = 0x3fff;
/// Ethernet and IPv4, lengths of their addresses, reply (RFC 826).
const ARP_REPLY: [u8; 8] = [0, 1, 0x08, 0x00, 6, 4, 0, 2];

/// Longest frame of the stack that is looked at.
const LONGEST_LOOKED_AT: usize =
    if LONGEST_ERROR > LONGEST_MESSAGE { LONGEST_ERROR } else { LONGEST_MESSAGE };

type Written = [u8; LONGEST_MESSAGE];
type Hardware = [u8; 6];
type Mark = [u8; MARK];

/// A machine in the robot's network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Neighbour {
    hardware: Hardware,
    address: Ipv4Addr,
    /// The robot's own address, to which it sends.
    robot: Ipv4Addr,
}

impl Neighbour {
    /// Returns the ARP reply with which it would answer the robot.
    fn reply(&self, own: Hardware) -> [u8; ARP_FRAME] {
        let mut frame = [0; ARP_FRAME];
        let parts: [&[u8]; 8] = [
            &own,
            &self.hardware,
            &ETHERTYPE_ARP,
            &ARP_REPLY,
            &self.hardware,
            &self.address.octets(),
            &own,
            &self.robot.octets(),
        ];
        let mut rest = frame.as_mut_slice();
        for part in parts {
            let Some((place, after)) = rest.split_at_mut_checked(part.len()) else { break };
            place.copy_from_slice(part);
            rest = after;
        }
        frame
    }
}

/// What the driver and the network task know together of the robot's neighbours.
#[derive(Debug, Default)]
pub struct Guard(RefCell<State>);

#[derive(Debug, Default)]
struct State {
    /// Senders of the newest datagrams, newest last.
    senders: Deque<(Neighbour, Mark), SENDERS>,
    pinned: Option<(Neighbour, Moment)>,
    /// The sender of the datagram that is answered now, and neighbours that the stack took since this one was reported.
    held: Option<(Neighbour, usize)>,
    /// To be reported to the stack before the next frame.
    due: Option<Neighbour>,
    /// The last that was reported.
    reported: Option<Neighbour>,
    /// Neighbours that the stack took since the pinned one was renewed.
    taken: usize,
    lease: Lease,
    icmp: Icmp,
    claim: Claim,
    /// The grant of an address that is probed, with its length.
    grant: Option<(Written, usize)>,
    /// The robot's own hardware address.
    robot: EthernetAddress,
    /// When the newest frame came in, or the link came up.
    heard: Option<Moment>,
}

impl Guard {
    /// Notes the robot's address, which is announced from now on, and the gateway, which is asked for as often.
    pub fn has(&self, address: Option<Ipv4Addr>, gateway: Option<Ipv4Addr>) {
        self.0.borrow_mut().claim.has(address, gateway, Moment::now());
    }

    /// Returns the time since the newest frame; `None` without an address or a gateway, where no machine is asked for an answer and
    /// silence is no fault.
    pub fn silence(&self) -> Option<core::time::Duration> {
        let state = self.0.borrow();
        state.heard.filter(|_| state.claim.asks()).map(|at| at.elapsed().into())
    }

    /// Returns the machine that newly claims the robot's address, or had one that was granted, once.
    pub fn rival(&self) -> Option<Rival> {
        self.0.borrow_mut().claim.rival()
    }

    /// Pins the sender of this datagram, which is authentic.
    pub fn confirm(&self, from: SocketAddr, datagram: &[u8]) {
        let mut state = self.0.borrow_mut();
        let Some(sender) = state.sender(from, datagram) else { return };
        if state.pinned.is_none_or(|(pinned, _)| pinned != sender) {
            state.taken = RENEWED_AFTER;
        }
        state.forget_due(sender);
        state.pinned = Some((sender, Moment::now()));
    }

    /// Holds the sender of this datagram, until [`Guard::release`]; nobody in the place of one who is pinned.
    pub fn hold(&self, from: SocketAddr, datagram: &[u8]) {
        let mut state = self.0.borrow_mut();
        let is_free = |it: &Neighbour| state.pinned().is_none_or(|pin| pin.address != it.address);
        let sender = state.sender(from, datagram).filter(is_free);
        if let Some(sender) = sender {
            state.forget_due(sender);
        }
        state.held = sender.map(|sender| (sender, RENEWED_AFTER));
    }

    /// Lets go of the sender that is held: its answer has left.
    pub fn release(&self) {
        self.0.borrow_mut().held = None;
    }
}

impl State {
    /// Returns who sent this datagram.
    fn sender(&self, from: SocketAddr, datagram: &[u8]) -> Option<Neighbour> {
        let (IpAddr::V4(address), Some(mark)) = (from.ip(), datagram.last_chunk::<MARK>()) else {
            return None;
        };
        let mut senders = self.senders.iter().rev();
        let sender = senders.find(|(it, end)| it.address == address && end == mark);
        // Forgotten when many came at once that the stack dropped: then it is where it was.
        let known = || self.pinned().filter(|it| it.address == address);
        sender.map(|(it, _)| *it).or_else(known)
    }

    /// Reports nobody else in the place of this neighbour.
    fn forget_due(&mut self, neighbour: Neighbour) {
        self.due.take_if(|it| it.address == neighbour.address && *it != neighbour);
    }

    fn pinned(&self) -> Option<Neighbour> {
        self.pinned.filter(|(_, at)| at.elapsed() < PINNED).map(|(pinned, _)| pinned)
    }

    /// Returns whether an IP address is another machine's than this.
    fn is_elsewhere(&self, address: Ipv4Addr, hardware: &[u8]) -> bool {
        let held = self.held.map(|(held, _)| held);
        let known = held.filter(|it| it.address == address).or_else(|| self.pinned());
        known.is_some_and(|it| it.address == address && it.hardware != hardware)
    }

    /// Returns whether another machine sent this datagram before, in the name of the same IP address.
    fn is_copy(&self, sender: &Neighbour, mark: &Mark) -> bool {
        self.senders.iter().any(|(first, end)| {
            first.address == sender.address && first.hardware != sender.hardware && end == mark
        })
    }

    /// Returns who is to be reported to the stack now.
    fn report(&self) -> Option<Neighbour> {
        let held = self.held.filter(|(_, taken)| *taken >= RENEWED_AFTER).map(|(held, _)| held);
        let pinned = || self.pinned().filter(|_| self.taken >= RENEWED_AFTER);
        held.or_else(pinned).or(self.due)
    }

    fn reported(&mut self, neighbour: Neighbour) {
        self.reported = Some(neighbour);
        if self.due == self.reported {
            self.due = None;
        }
        self.taken = if self.pinned() == self.reported { 0 } else { self.taken + 1 };
        if let Some((held, taken)) = &mut self.held {
            *taken = if *held == neighbour { 0 } else { *taken + 1 };
        }
    }

    /// Notes what a frame shows, and returns what the stack sees of it: it drops an empty frame.
    fn admits<'a>(&mut self, frame: &'a mut [u8], written: &'a mut Written) -> &'a mut [u8] {
        match frame.get(12..ETHERNET_HEADER) {
            Some(kind) if kind == ETHERTYPE_ARP => {
                self.taken += 1;
                if let Some((_, taken)) = &mut self.held {
                    *taken += 1;
                }
                self.claim.hear(frame, self.robot, Moment::now());
                let sender = arp_sender(frame);
                match sender.filter(|(address, hardware)| !self.is_elsewhere(*address, hardware)) {
                    Some(_) => frame,
                    None => &mut [],
                }
            }
            Some(kind) if kind == ETHERTYPE_IPV4 => {
                if !self.icmp.admits(frame, Moment::now()) {
                    return &mut [];
                }
                self.note_sender(frame);
                match self.lease.admits(frame, written) {
                    Some(length) if self.waits(written, length) => &mut [],
                    Some(length) => &mut written[..length],
                    None => frame,
                }
            }
            _ => frame,
        }
    }

    /// Keeps a message to the stack that grants a new address until that was probed. Returns whether it does.
    fn waits(&mut self, written: &Written, length: usize) -> bool {
        let granted = dhcp::granted(&written[..length]);
        let waits = granted.is_some_and(|address| self.claim.probe(address, Moment::now()));
        if waits {
            self.grant = Some((*written, length));
        }
        waits
    }

    /// Probes, announces or defends the robot's address, as is due. Returns a frame for the network with its length, 0 for none, and
    /// whether the stack is to take a grant or a refusal now.
    fn claim(&mut self, now: Moment) -> (Written, usize, bool) {
        let mut out = [0; LONGEST_MESSAGE];
        let mut ask = |own, asked| {
            out[..ARP_FRAME].copy_from_slice(&claim::request(self.robot, own, asked));
            ARP_FRAME
        };
        let (length, is_given) = match self.claim.step(now) {
            Some(Step::Probe(address)) => (ask(Ipv4Addr::UNSPECIFIED, address), false),
            Some(Step::Announce(address)) => (ask(address, address), false),
            Some(Step::Ask(own, gateway)) => (ask(own, gateway), false),
            Some(Step::Take) => (0, self.grant.is_some()),
            Some(Step::Decline) => (self.decline(&mut out).unwrap_or(0), self.grant.is_some()),
            None => (0, false),
        };
        (out, length, is_given)
    }

    /// Writes the message that declines the grant, and puts its refusal in its place. Returns the message's length.
    fn decline(&mut self, out: &mut Written) -> Option<usize> {
        let (grant, length) = self.grant.take()?;
        let mut refusal = [0; LONGEST_MESSAGE];
        let places = [out, &mut refusal];
        let [sent, given] = dhcp::decline(&grant[..length], self.robot, places)?;
        self.grant = Some((refusal, given));
        Some(sent)
    }

    /// Notes who sent a datagram to the robot's port, if one is in this frame.
    fn note_sender(&mut self, frame: &[u8]) {
        if let Some((sender, mark)) = datagram_sender(frame)
            && !self.is_copy(&sender, &mark)
        {
            push_newest(&mut self.senders, (sender, mark));
            let is_elsewhere = self.is_elsewhere(sender.address, &sender.hardware);
            if !is_elsewhere && self.reported != Some(sender) {
                self.due = Some(sender);
            }
        }
    }

    /// Notes a frame of the stack, and returns how many of its bytes may leave.
    fn releases(&mut self, frame: &mut [u8]) -> usize {
        let now = Moment::now();
        if self.lease.releases(frame, now) { self.icmp.releases(frame, now) } else { 0 }
    }
}

fn address(bytes: &[u8]) -> Option<Ipv4Addr> {
    <[u8; 4]>::try_from(bytes).ok().map(Ipv4Addr::from)
}

fn number(bytes: &[u8]) -> Option<u16> {
    <[u8; 2]>::try_from(bytes).ok().map(u16::from_be_bytes)
}

/// Returns where an ARP packet places its sender.
fn arp_sender(frame: &[u8]) -> Option<(Ipv4Addr, &[u8])> {
    let packet = frame.get(ETHERNET_HEADER..ARP_FRAME)?;
    Some((address(packet.get(14..18)?)?, packet.get(8..14)?))
}

/// Returns who sent a datagram to the robot's port, and its mark.
fn datagram_sender(frame: &[u8]) -> Option<(Neighbour, Mark)> {
    let packet = frame.get(ETHERNET_HEADER..)?;
    let is_whole = number(packet.get(6..8)?)? & FRAGMENT == 0;
    if !is_whole || *packet.get(9)? != PROTOCOL_UDP {
        return None;
    }
    let sender = Neighbour {
        hardware: frame.get(6..12)?.try_into().ok()?,
        address: address(packet.get(12..16)?)?,
        robot: address(packet.get(16..20)?)?,
    };
    let segment = packet.get(usize::from(packet.first()? & 0x0f) * 4..)?;
    let (port, length) = (number(segment.get(2..4)?)?, number(segment.get(4..6)?)?);
    let mark = *segment.get(..usize::from(length))?.last_chunk::<MARK>()?;
    (port == DEFAULT_PORT).then_some((sender, mark))
}

/// A driver under guard.
pub struct Guarded<D> {
    driver: D,
    guard: &'static Guard,
    /// What the stack knows of the link.
    is_up: bool,
}

impl<D: Driver> Guarded<D> {
    /// Stands before this driver; the network task gets the same guard.
    pub const fn new(driver: D, guard: &'static Guard) -> Self {
        Self { driver, guard, is_up: false }
    }

    /// Probes, announces or defends the robot's address, as is due. Returns whether the stack is to take a grant or a refusal now.
    fn claim(&mut self, cx: &mut Context<'_>) -> bool {
        let now = Moment::now();
        if let HardwareAddress::Ethernet(own) = self.driver.hardware_address() {
            self.guard.0.borrow_mut().robot = EthernetAddress(own);
        }
        while self.guard.0.borrow().claim.due().is_some_and(|due| due <= now) {
            let Some(token) = self.driver.transmit(cx) else { return false };
            let (frame, length, is_given) = self.guard.0.borrow_mut().claim(now);
            if length > 0 {
                token.consume(length, |place| place.copy_from_slice(&frame[..length]));
            }
            if is_given {
                return true;
            }
        }
        false
    }

    fn report(&self) -> Option<(Neighbour, Hardware)> {
        let HardwareAddress::Ethernet(own) = self.driver.hardware_address() else { return None };
        self.guard.0.borrow().report().map(|neighbour| (neighbour, own))
    }
}

impl<D: Driver> Driver for Guarded<D> {
    type RxToken<'a>
        = Received<D::RxToken<'a>>
    where
        Self: 'a;
    type TxToken<'a>
        = Sent<D::TxToken<'a>>
    where
        Self: 'a;

    fn receive(&mut self, cx: &mut Context<'_>) -> Option<(Self::RxToken<'_>, Self::TxToken<'_>)> {
        if self.is_up && self.claim(cx) {
            let transmit = self.driver.transmit(cx)?;
            return Some((Received::Grant(self.guard), Sent(transmit, self.guard)));
        }
        if let Some((neighbour, own)) = self.report() {
            let transmit = self.driver.transmit(cx)?;
            self.guard.0.borrow_mut().reported(neighbour);
            return Some((Received::Report(neighbour.reply(own)), Sent(transmit, self.guard)));
        }
        let Some((receive, transmit)) = self.driver.receive(cx) else {
            if let Some(due) = self.guard.0.borrow().claim.due() {
                // Polled once, so that the stack gets its next turn by then.
                let _ = pin!(Timer::at(due)).poll(cx);
            }
            return None;
        };
        self.guard.0.borrow_mut().heard = Some(Moment::now());
        Some((Received::Frame(receive, self.guard), Sent(transmit, self.guard)))
    }

    fn transmit(&mut self, cx: &mut Context<'_>) -> Option<Self::TxToken<'_>> {
        if !self.is_up {
            return None;
        }
        Some(Sent(self.driver.transmit(cx)?, self.guard))
    }

    fn link_state(&mut self, cx: &mut Context<'_>) -> LinkState {
        let state = self.driver.link_state(cx);
        let is_up = state == LinkState::Up;
        if is_up && !self.is_up {
            // It may be another network.
            let mut state = self.guard.0.borrow_mut();
            (state.lease, state.grant) = (Lease::default(), None);
            state.heard = Some(Moment::now());
            // What was held back is sent in the stack's next turn.
            cx.waker().wake_by_ref();
        }
        self.is_up = is_up;
        state
    }

    fn capabilities(&self) -> Capabilities {
        self.driver.capabilities()
    }

    fn hardware_address(&self) -> HardwareAddress {
        self.driver.hardware_address()
    }
}

/// Takes a frame of the stack to the driver.
pub struct Sent<T>(T, &'static Guard);

impl<T: TxToken> TxToken for Sent<T> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, make: F) -> R {
        let Self(token, guard) = self;
        // It may be one that does not leave, or not whole.
        let mut buffer = [0; LONGEST_LOOKED_AT];
        let Some(frame) = buffer.get_mut(..length) else { return token.consume(length, make) };
        let made = make(frame);
        let length = guard.0.borrow_mut().releases(frame);
        if length > 0 {
            token.consume(length, |place| place.copy_from_slice(&frame[..length]));
        }
        made
    }
}

/// What the stack is given: a frame of the driver, or a report of a neighbour.
pub enum Received<R> {
    /// Came in.
    Frame(R, &'static Guard),
    /// An ARP reply made here.
    Report([u8; ARP_FRAME]),
    /// The grant of an address that was probed, or its refusal.
    Grant(&'static Guard),
}

impl<R: RxToken> RxToken for Received<R> {
    fn consume<T, F: FnOnce(&mut [u8]) -> T>(self, take: F) -> T {
        match self {
            Self::Frame(token, guard) => token.consume(|frame| {
                let mut written = [0; LONGEST_MESSAGE];
                let seen = guard.0.borrow_mut().admits(frame, &mut written);
                take(seen)
            }),
            Self::Report(mut frame) => take(&mut frame),
            Self::Grant(guard) => {
                let grant = guard.0.borrow_mut().grant.take();
                let (mut frame, length) = grant.unwrap_or(([0; LONGEST_MESSAGE], 0));
                take(&mut frame[..length])
            }
        }
    }
}
