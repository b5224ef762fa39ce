//! Somebody who has seen everything, and makes datagrams of it.

use core::net::{Ipv4Addr, SocketAddr};

use flix_protocol::frame::{
    Datagram, HANDSHAKE_LENGTHS, HEAD, MAGIC, MAXIMUM_DATAGRAM, PUBLIC_KEY_LENGTH, RENEWAL, SEALED,
    SEALED_COUNTER, SEALED_HEADER, TAG_LENGTH,
};
use flix_protocol::session::{Key, OperatorSession};
use flix_protocol::units::Instant;
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::kind::Kind;
use super::renewal::foreign_renewals;
use crate::rig::operation::Towards;

/// Genuine datagrams that the attacker keeps: the newest of each way.
const KEPT: usize = 64;
/// Longest datagram that is made up: longer than any genuine one.
pub(super) const LONGEST: usize = MAXIMUM_DATAGRAM + 88;

/// Has seen everything, and makes datagrams of it.
pub(super) struct Attacker {
    pub(super) random: Xoshiro256PlusPlus,
    /// What arrived at the robot in the present session, and, at the operator.
    to_robot: Vec<Vec<u8>>,
    to_operator: Vec<Vec<u8>>,
    /// What an earlier session said to this robot, with a stop from outside it, and what one said to another.
    earlier: Vec<Vec<u8>>,
    elsewhere: Vec<Vec<u8>>,
    /// The stop that was obeyed.
    stop: Vec<u8>,
    /// Renewals of another session under the same key.
    renewals: Vec<Vec<u8>>,
}

/// Length of the sealed datagrams that are made up: with 8 bytes of ciphertext.
const SEALED_LENGTH: usize = SEALED_HEADER + 8 + TAG_LENGTH;

impl Attacker {
    /// Has heard what an earlier session said to this robot, and what one said to another.
    pub(super) fn new(seed: u64, earlier: Vec<Vec<u8>>, elsewhere: Vec<Vec<u8>>) -> Self {
        let random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let stop = earlier.iter().find(|it| matches!(Datagram::parse(it), Some(Datagram::Stop(_))));
        let stop = stop.cloned().unwrap_or_default();
        let (to_robot, to_operator) = (Vec::new(), Vec::new());
        let renewals = foreign_renewals();
        Self { random, to_robot, to_operator, earlier, elsewhere, stop, renewals }
    }

    pub(super) fn keep(&mut self, towards: Towards, datagram: &[u8]) {
        let kept = match towards {
            Towards::Robot => &mut self.to_robot,
            Towards::Operator => &mut self.to_operator,
        };
        if kept.len() < KEPT {
            kept.push(datagram.to_vec());
        } else {
            // The first few are the handshake: they stay.
            let place = 4 + (self.random.next_u64() % (KEPT as u64 - 4)) as usize;
            kept[place] = datagram.to_vec();
        }
    }

    pub(super) fn below(&mut self, limit: usize) -> usize {
        (self.random.next_u64() % limit.max(1) as u64) as usize
    }

    pub(super) fn address(&mut self) -> SocketAddr {
        let [a, b, c, d, ..] = self.random.next_u64().to_le_bytes();
        SocketAddr::from((Ipv4Addr::new(10, a, b, c), 1024 + u16::from(d)))
    }

    fn bytes(&mut self, length: usize) -> Vec<u8> {
        let mut bytes = vec![0; length];
        self.random.fill_bytes(&mut bytes);
        bytes
    }

    fn one_of(&mut self, pick: fn(&Self) -> &Vec<Vec<u8>>) -> Vec<u8> {
        let place = self.below(pick(self).len());
        match pick(self).get(place) {
            Some(datagram) => datagram.clone(),
            None => self.bytes(40),
        }
    }

    fn genuine(&mut self) -> Vec<u8> {
        self.one_of(|attacker| &attacker.to_robot)
    }

    pub(super) fn datagram(&mut self, kind: Kind, now: Instant) -> Vec<u8> {
        match kind {
            Kind::Noise => {
                let length = self.below(LONGEST);
                self.bytes(length)
            }
            Kind::Headed => self.headed(),
            Kind::Forged => {
                let mut datagram = self.genuine();
                let step = 1 + self.random.next_u64() % 1_000;
                advance_counter(&mut datagram, step);
                let body = datagram.len().min(SEALED_COUNTER.end);
                self.random.fill_bytes(&mut datagram[body..]);
                datagram
            }
            Kind::Flipped => {
                let mut datagram = self.genuine();
                for _ in 0..=self.below(3) {
                    let bit = self.below(8 * datagram.len());
                    datagram[bit / 8] ^= 1 << (bit % 8);
                }
                // Two flips may have met; then it is a replay, which must be dropped all the same.
                datagram
            }
            Kind::Truncated => {
                let mut datagram = self.genuine();
                let length = self.below(datagram.len());
                datagram.truncate(length);
                datagram
            }
            Kind::Extended => {
                let mut datagram = self.genuine();
                let more = 1 + self.below(64);
                datagram.extend(self.bytes(more));
                datagram
            }
            Kind::Spliced => {
                let (begin, end) = (self.genuine(), self.genuine());
                let place = self.below(begin.len().min(end.len()));
                [&begin[..place], &end[place..]].concat()
            }
            Kind::Replayed => self.genuine(),
            Kind::Recounted => {
                let mut datagram = self.genuine();
                let step = self.random.next_u64() >> self.below(64);
                advance_counter(&mut datagram, step);
                datagram
            }
            Kind::Reflected => self.one_of(|attacker| &attacker.to_operator),
            Kind::EarlierSession => self.one_of(|attacker| &attacker.earlier),
            Kind::OtherRobot => self.one_of(|attacker| &attacker.elsewhere),
            Kind::OtherKey => self.hello(Key::new([0x66; 32]), now),
            Kind::HelloFlood => {
                let mut hello = self.to_robot.first().cloned().unwrap_or_else(|| vec![0; 62]);
                // A nonce of its own, and the tag that it cannot make.
                let nonce = hello.len().min(14)..hello.len().min(30);
                self.random.fill_bytes(&mut hello[nonce]);
                hello
            }
            Kind::SecondOperator => self.hello(Key::new([0x5a; 32]), now),
            Kind::ForgedStop => {
                // Of the stop that was obeyed, or of the Confirm of the present session.
                let confirm = self.to_robot.iter().find(|it| is_confirm(it)).cloned();
                let mut datagram = self.stop.clone();
                if let Some(confirm) = confirm.filter(|_| self.below(2) == 0) {
                    // All but the ephemeral key, which a stop has not.
                    let (fields, tag) = confirm.split_at(confirm.len() - TAG_LENGTH);
                    let fields = &fields[HEAD..fields.len() - PUBLIC_KEY_LENGTH];
                    datagram = [&datagram[..HEAD.min(datagram.len())], fields, tag].concat();
                } else {
                    let bit =
                        8 * HEAD + self.below(8 * (datagram.len() - HEAD.min(datagram.len())));
                    if let Some(byte) = datagram.get_mut(bit / 8) {
                        *byte ^= 1 << (bit % 8);
                    }
                }
                datagram
            }
            Kind::ReplayedStop => self.stop.clone(),
            Kind::ForgedRenewal => {
                let mut datagram = self.genuine();
                let step = self.random.next_u64() % 3;
                advance_counter(&mut datagram, step);
                if let Some(kind) = datagram.get_mut(MAGIC.len()).filter(|kind| **kind == SEALED) {
                    *kind = RENEWAL;
                }
                datagram
            }
            Kind::ForeignRenewal => {
                let mut datagram = self.one_of(|attacker| &attacker.renewals);
                // As often as not under the present session's number.
                let session = HEAD..SEALED_COUNTER.start;
                let present = self.genuine();
                if self.below(2) == 0
                    && let (Some(to), Some(from)) =
                        (datagram.get_mut(session.clone()), present.get(session))
                {
                    to.copy_from_slice(from);
                }
                datagram
            }
            // The network's own: these are not made up.
            _ => self.genuine(),
        }
    }

    fn headed(&mut self) -> Vec<u8> {
        let index = self.below(HANDSHAKE_LENGTHS.len() + 1);
        let (kind, exact) =
            HANDSHAKE_LENGTHS.get(index).copied().unwrap_or((SEALED, SEALED_LENGTH));
        let length = if self.below(2) == 0 { exact } else { HEAD + self.below(LONGEST) };
        let mut datagram = self.bytes(length.max(HEAD));
        datagram[..MAGIC.len()].copy_from_slice(&MAGIC);
        datagram[MAGIC.len()] = kind;
        datagram
    }

    fn hello(&mut self, key: Key, now: Instant) -> Vec<u8> {
        let mut entropy = [0; 32];
        self.random.fill_bytes(&mut entropy);
        let hello = OperatorSession::new(key, entropy, now).poll(now);
        hello.map_or_else(Vec::new, |hello| hello.to_vec())
    }
}

fn is_confirm(datagram: &[u8]) -> bool {
    matches!(Datagram::parse(datagram), Some(Datagram::Confirm(_)))
}

fn advance_counter(datagram: &mut [u8], step: u64) {
    if let Some(place) = datagram.get_mut(SEALED_COUNTER)
        && let Ok(counter) = <[u8; 8]>::try_from(&*place)
    {
        let counter = u64::from_le_bytes(counter).wrapping_add(step);
        place.copy_from_slice(&counter.to_le_bytes());
    }
}
