//! The robot's claim to its address (RFC 5227).
//!
//! The stack (smoltcp 0.13.1) takes every address that DHCP grants, without a probe or an announcement. [`Claim`] stands before it:
//!
//! - A new address is *probed* before the stack gets it: [`PROBES`] questions for its owner, [`PROBE_INTERVAL`] apart. An address
//!   that another machine has is declined; after [`DECLINED`] in a row the next one is taken all the same, because one
//!   machine that claims everything would keep the robot off the network. Probes of others count for nothing, unlike in 2.1.1:
//!   switches that track their devices (Cisco) probe the very address that a device has just got.
//! - The stack's address is *announced* twice when it is new (2.3), then every [`ANNOUNCEMENT`]: access points and routers forget
//!   stations that send nothing.
//! - Another machine that claims it is remembered for a report and answered by an announcement, at most every [`DEFENCE`] (2.4, b).

use core::net::Ipv4Addr;

use embassy_time::{Duration, Instant as Moment};
use smoltcp::wire::{
    ArpOperation, ArpPacket, ArpRepr, EthernetAddress, EthernetFrame, EthernetProtocol,
    EthernetRepr,
};

/// Probes of an address, and the wait after each: 0.5 s in all. RFC 5227 waits for up to 7 s, which is long for a person.
const PROBES: u8 = 2;
const PROBE_INTERVAL: Duration = Duration::from_millis(250);
/// Most addresses that are declined in a row.
const DECLINED: u8 = 3;
/// From the first announcement to the second, and from each further one to the next.
const SECOND_ANNOUNCEMENT: Duration = Duration::from_secs(2);
const ANNOUNCEMENT: Duration = Duration::from_secs(60);
/// Least time between two announcements that answer a rival (RFC 5227, `DEFEND_INTERVAL`).
const DEFENCE: Duration = Duration::from_secs(10);
/// Length of an Ethernet frame with an ARP packet.
pub(crate) const ARP_FRAME: usize = 14 + 28;

/// Another machine that claims the robot's address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rival {
    /// The address of both.
    pub address: Ipv4Addr,
    /// The hardware address of the other one.
    pub hardware: EthernetAddress,
}

/// What to do now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Step {
    /// Send an ARP probe for this address, with the sender's address zero.
    Probe(Ipv4Addr),
    /// Announce this address.
    Announce(Ipv4Addr),
    /// Send an ARP request from the first address, the robot's, for the second, the gateway's: a network that carries frames brings the
    /// reply.
    Ask(Ipv4Addr, Ipv4Addr),
    /// Take the address that was probed.
    Take,
    /// Decline it.
    Decline,
}

#[derive(Debug)]
struct Probed {
    address: Ipv4Addr,
    sent: u8,
    /// When to go on.
    at: Moment,
    is_taken: bool,
}

/// See the module's documentation.
#[derive(Debug, Default)]
pub(crate) struct Claim {
    /// The stack's address, when it is announced next, and whether it was announced before.
    own: Option<Ipv4Addr>,
    announce_at: Option<Moment>,
    gateway: Option<Ipv4Addr>,
    /// When the gateway is asked for: after each announcement.
    ask_at: Option<Moment>,
    is_announced: bool,
    defended: Option<Moment>,
    probed: Option<Probed>,
    declined: u8,
    rival: Option<Rival>,
}

impl Claim {
    /// Notes the stack's address and gateway.
    pub(crate) fn has(&mut self, own: Option<Ipv4Addr>, gateway: Option<Ipv4Addr>, now: Moment) {
        self.gateway = gateway;
        if self.own != own {
            (self.own, self.announce_at, self.is_announced) = (own, own.map(|_| now), false);
        }
    }

    /// Returns whether the gateway is asked for an answer after each announcement.
    pub(crate) const fn asks(&self) -> bool {
        self.own.is_some() && self.gateway.is_some()
    }

    /// Begins to probe an address that is granted. Returns false where the stack may have it at once.
    pub(crate) fn probe(&mut self, address: Ipv4Addr, now: Moment) -> bool {
        if self.own == Some(address) || self.declined >= DECLINED {
            (self.probed, self.declined) = (None, 0);
            return false;
        }
        self.probed = Some(Probed { address, sent: 0, at: now, is_taken: false });
        true
    }

    /// Notes an ARP packet of another machine than `robot`.
    pub(crate) fn hear(&mut self, frame: &[u8], robot: EthernetAddress, now: Moment) {
        let Some(rival) = sender(frame).filter(|rival| rival.hardware != robot) else { return };
        if let Some(probed) = self.probed.as_mut().filter(|it| it.address == rival.address) {
            (probed.is_taken, probed.at) = (true, now);
            self.rival = Some(rival);
        }
        let is_recent = |at: Moment| now.saturating_duration_since(at) < DEFENCE;
        if self.own == Some(rival.address) && !self.defended.is_some_and(is_recent) {
            (self.defended, self.announce_at) = (Some(now), Some(now));
            self.rival = Some(rival);
        }
    }

    /// Returns the newest rival, once.
    pub(crate) const fn rival(&mut self) -> Option<Rival> {
        self.rival.take()
    }

    /// Returns when there is something to do.
    pub(crate) fn due(&self) -> Option<Moment> {
        let probe = self.probed.as_ref().map(|probed| probed.at);
        [probe, self.ask_at, self.announce_at].into_iter().flatten().min()
    }

    /// Returns what to do, if it is due.
    pub(crate) fn step(&mut self, now: Moment) -> Option<Step> {
        if let Some(probed) = self.probed.as_mut().filter(|probed| probed.at <= now) {
            if !probed.is_taken && probed.sent < PROBES {
                (probed.sent, probed.at) = (probed.sent + 1, now + PROBE_INTERVAL);
                return Some(Step::Probe(probed.address));
            }
            let is_taken = probed.is_taken;
            self.probed = None;
            self.declined = if is_taken { self.declined + 1 } else { 0 };
            return Some(if is_taken { Step::Decline } else { Step::Take });
        }
        if self.ask_at.take_if(|at| *at <= now).is_some() {
            return self.own.zip(self.gateway).map(|(own, gateway)| Step::Ask(own, gateway));
        }
        self.announce_at.take_if(|at| *at <= now)?;
        self.ask_at = self.gateway.map(|_| now);
        let wait = if self.is_announced { ANNOUNCEMENT } else { SECOND_ANNOUNCEMENT };
        (self.announce_at, self.is_announced) = (Some(now + wait), true);
        self.own.map(Step::Announce)
    }
}

/// Returns the sender of an ARP packet.
fn sender(frame: &[u8]) -> Option<Rival> {
    let frame = EthernetFrame::new_checked(frame).ok()?;
    let packet = ArpPacket::new_checked(frame.payload()).ok()?;
    match ArpRepr::parse(&packet).ok()? {
        ArpRepr::EthernetIpv4 { source_hardware_addr, source_protocol_addr, .. } => {
            Some(Rival { address: source_protocol_addr, hardware: source_hardware_addr })
        }
        _ => None,
    }
}

/// Returns the frame in which the robot asks everybody for `asked`, as `own`: an announcement where both are one.
pub(crate) fn request(robot: EthernetAddress, own: Ipv4Addr, asked: Ipv4Addr) -> [u8; ARP_FRAME] {
    let mut bytes = [0; ARP_FRAME];
    let mut frame = EthernetFrame::new_unchecked(&mut bytes[..]);
    let header = EthernetRepr {
        src_addr: robot,
        dst_addr: EthernetAddress::BROADCAST,
        ethertype: EthernetProtocol::Arp,
    };
    header.emit(&mut frame);
    let packet = ArpRepr::EthernetIpv4 {
        operation: ArpOperation::Request,
        source_hardware_addr: robot,
        source_protocol_addr: own,
        target_hardware_addr: EthernetAddress::default(),
        target_protocol_addr: asked,
    };
    packet.emit(&mut ArpPacket::new_unchecked(frame.payload_mut()));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const ROBOT: EthernetAddress = EthernetAddress([2, 0, 0, 0, 0, 1]);
    const OTHER: EthernetAddress = EthernetAddress([2, 0, 0, 0, 0, 7]);
    const ADDRESS: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 77);
    const FREE: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 78);

    const fn at(ms: u64) -> Moment {
        Moment::from_millis(ms)
    }

    /// Returns all steps of these milliseconds, each with its time.
    fn steps(claim: &mut Claim, ms: core::ops::Range<u64>) -> Vec<(u64, Step)> {
        ms.filter_map(|ms| claim.step(at(ms)).map(|step| (ms, step))).collect()
    }

    #[test]
    fn a_free_address_is_taken_after_two_probes_within_half_a_second() {
        let mut claim = Claim::default();
        assert!(claim.probe(ADDRESS, at(0)));
        let probe = Step::Probe(ADDRESS);
        let taken = [(0, probe), (250, probe), (500, Step::Take)];
        assert_eq!(steps(&mut claim, 0..9_000), taken);
    }

    #[test]
    fn an_address_is_announced_twice_then_every_minute_and_again_where_it_is_new() {
        let mut claim = Claim::default();
        claim.has(Some(ADDRESS), None, at(0));
        claim.has(Some(ADDRESS), None, at(5));
        let found = steps(&mut claim, 0..130_000);
        let announced = [0, 2_000, 62_000, 122_000].map(|ms| (ms, Step::Announce(ADDRESS)));
        assert_eq!(found, announced);
        claim.has(None, None, at(130_000));
        assert_eq!(steps(&mut claim, 130_000..300_000), []);
        claim.has(Some(FREE), None, at(300_000));
        assert_eq!(claim.due(), Some(at(300_000)));
    }

    #[test]
    fn an_address_that_another_machine_has_is_declined_and_questions_are_not_minded() {
        let mut claim = Claim::default();
        claim.probe(ADDRESS, at(0));
        assert_eq!(steps(&mut claim, 0..100).len(), 1);
        for (machine, own) in [(ROBOT, ADDRESS), (OTHER, FREE), (OTHER, Ipv4Addr::UNSPECIFIED)] {
            claim.hear(&request(machine, own, ADDRESS), ROBOT, at(90));
            assert_eq!((claim.rival(), claim.step(at(90))), (None, None));
        }
        claim.hear(&request(OTHER, ADDRESS, FREE), ROBOT, at(100));
        assert_eq!(steps(&mut claim, 100..9_000), [(100, Step::Decline)]);
        assert_eq!(claim.rival(), Some(Rival { address: ADDRESS, hardware: OTHER }));
    }

    #[test]
    fn a_machine_that_claims_every_address_does_not_keep_the_robot_without_one() {
        let mut claim = Claim::default();
        for _ in 0..DECLINED {
            assert!(claim.probe(ADDRESS, at(0)));
            claim.hear(&request(OTHER, ADDRESS, FREE), ROBOT, at(0));
            assert_eq!(claim.step(at(0)), Some(Step::Decline));
        }
        assert!(!claim.probe(ADDRESS, at(0)));
    }

    #[test]
    fn an_address_is_defended_every_10_s_and_its_renewal_is_not_probed() {
        let mut claim = Claim::default();
        claim.has(Some(ADDRESS), None, at(0));
        assert!(!claim.probe(ADDRESS, at(0)));
        assert_eq!(steps(&mut claim, 0..5_000).len(), 2);
        let mut defences = 0;
        for ms in (5_000..35_000).step_by(100) {
            claim.hear(&request(OTHER, ADDRESS, ADDRESS), ROBOT, at(ms));
            let is_reported = claim.rival().is_some();
            let is_announced = claim.step(at(ms)).is_some();
            assert_eq!(is_reported, is_announced, "{ms} ms");
            defences += usize::from(is_announced);
        }
        assert_eq!(defences, 3);
    }

    #[test]
    fn damaged_arp_is_no_rival() {
        let mut claim = Claim::default();
        claim.has(Some(ADDRESS), None, at(0));
        let frame = request(OTHER, ADDRESS, ADDRESS);
        for length in 0..frame.len() {
            claim.hear(&frame[..length], ROBOT, at(0));
        }
        assert_eq!(claim.rival(), None);
    }
}
