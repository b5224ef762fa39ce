//! How a robot is found: multicast DNS (RFC 6762) and service discovery (RFC 6763).
//!
//! The robot is an instance of the service `_flix._udp` named like itself, on the host
//! `flix-NAME.local`. Queries come in, answers go out; the sockets are [`crate::net`]'s.

use core::net::{Ipv4Addr, SocketAddr, SocketAddrV4};

use edge_mdns::domain::base::iana::{Class, Opcode, Rcode};
use edge_mdns::domain::base::message_builder::StaticCompressor;
use edge_mdns::domain::base::name::ToName;
use edge_mdns::domain::base::{Message, MessageBuilder, Question, Record, Rtype, Ttl};
use edge_mdns::domain::rdata::dnssec::RtypeBitmap;
use edge_mdns::domain::rdata::{A, AllRecordData, Nsec, Ptr, Srv};
use edge_mdns::{Buf, DNS_SD_OWNER, HostAnswer, NameSlice, RecordDataChain, Txt};
use flix_protocol::HOST_PREFIX;
use flix_protocol::message::{NAME_LENGTH, Name};
use heapless::String;

/// Port of multicast DNS.
pub const PORT: u16 = 5353;
/// Group of multicast DNS.
pub const GROUP: Ipv4Addr = Ipv4Addr::new(224, 0, 0, 251);
/// Most bytes in an answer.
pub const ANSWER_LENGTH: usize = 512;
/// How long others may remember an answer, seconds (RFC 6762, section 10: records with a host name).
const TIME_TO_LIVE_S: u32 = 120;
/// The same for a resolver that knows no multicast, and hears of no change (RFC 6762, section 6.7: 10 s at most).
const LEGACY_TIME_TO_LIVE_S: u32 = 10;
/// Class of records that nobody else has, in answers to all: what others remember of them is replaced (RFC 6762, section 10.2).
const UNIQUE: u16 = 0x8001;
/// Types of records that the host name has, as NSEC lists them: the first 8 types, A (1) alone (RFC 4034, section 4.1.2).
const HOST_TYPES: [u8; 3] = [0, 1, 0b0100_0000];
/// Most bytes of an answer for each byte of its question: what the shortest question for the service and the longest name
/// of a robot need. More would make the robot worth asking in somebody else's name.
pub const AMPLIFICATION: usize = 11;
/// Parts of the service's name.
const SERVICE: &str = "_flix";
const PROTOCOL: &str = "_udp";
const DOMAIN: &str = "local";
/// What a robot without a name is called.
const NAMELESS: &str = "robot";

/// Name of a host: bytes at most.
const HOST_LENGTH: usize = NAME_LENGTH + HOST_PREFIX.len();

/// Returns the host name of a robot, without its domain: `flix-` and the name, with hyphens for what no host name has.
#[must_use]
pub fn host_name(name: &str) -> String<HOST_LENGTH> {
    let name = if name.is_empty() { NAMELESS } else { name };
    let plain = |character: char| {
        if character.is_ascii_alphanumeric() { character.to_ascii_lowercase() } else { '-' }
    };
    let mut host = String::new();
    let _ = HOST_PREFIX.chars().chain(name.chars().map(plain)).try_for_each(|it| host.push(it));
    host
}

/// Answers queries about one robot.
#[derive(Debug, Clone)]
pub struct Responder {
    name: Name,
    board: &'static str,
    host: String<HOST_LENGTH>,
    port: u16,
}

impl Responder {
    /// Answers for a robot with this board that listens on this UDP port. An empty name becomes `robot`.
    #[must_use]
    pub fn new(name: &str, board: &'static str, port: u16) -> Self {
        let name = if name.is_empty() { NAMELESS } else { name };
        let host = host_name(name);
        Self { name: crate::settings::text(name), board, host, port }
    }

    /// Answers a datagram that came from `from`, when it asks for this robot at `address`. Gives
    /// where the answer goes, and its length in `answer`. Never panics.
    pub fn answer(
        &self,
        address: Ipv4Addr,
        from: SocketAddr,
        query: &[u8],
        answer: &mut [u8; ANSWER_LENGTH],
    ) -> Option<(SocketAddr, usize)> {
        // A resolver that knows no multicast asks from another port and wants the answer there.
        let legacy = from.port() != PORT;
        let message = Message::from_octets(query).ok()?;
        let header = message.header();
        if header.qr() || header.opcode() != Opcode::QUERY || header.rcode() != Rcode::NOERROR {
            return None;
        }
        let most = ANSWER_LENGTH.min(AMPLIFICATION * query.len());
        let length = self.respond(address, Some((&message, legacy)), &mut answer[..most])?;
        let everybody = SocketAddr::V4(SocketAddrV4::new(GROUP, PORT));
        Some((if legacy { from } else { everybody }, length))
    }

    /// Announces the robot, once it has an address; returns the length of the announcement in `answer`.
    pub fn announcement(
        &self,
        address: Ipv4Addr,
        answer: &mut [u8; ANSWER_LENGTH],
    ) -> Option<usize> {
        self.respond(address, None, answer)
    }

    /// Asks whether a robot at another address has this robot's names, which that one then answers (RFC 6762, section 8.1); returns
    /// the length of the question in `probe`.
    pub fn probe(&self, address: Ipv4Addr, probe: &mut [u8; ANSWER_LENGTH]) -> Option<usize> {
        let target = StaticCompressor::new(Buf::new(&mut probe[..]));
        let mut questions = MessageBuilder::from_target(target).ok()?.question();
        let records = Records { responder: self, address, legacy: false };
        let mut pushed = Ok(());
        let own = |place| [ADDRESS, PLACE].contains(&place);
        records.each(|place, record| {
            if own(place) && pushed.is_ok() {
                pushed = questions.push(Question::new(record.owner(), Rtype::ANY, Class::IN));
            }
        });
        let mut authorities = questions.authority();
        records.each(|place, record| {
            if own(place) && pushed.is_ok() {
                pushed = authorities.push(record);
            }
        });
        pushed.ok()?;
        Some(authorities.finish().as_slice().len())
    }

    /// Returns the address of another robot of this name, where a datagram states one: an address of this host name that is not
    /// `address`. Never panics.
    #[must_use]
    pub fn twin(&self, address: Ipv4Addr, datagram: &[u8]) -> Option<Ipv4Addr> {
        let host = [self.host.as_str(), DOMAIN];
        let message = Message::from_octets(datagram).ok()?;
        message.iter().map_while(Result::ok).find_map(|(record, _)| {
            let record = record.to_record::<A>().ok()??;
            let stated = record.data().addr();
            let is_twin = stated != address && record.owner().name_eq(&NameSlice::new(&host));
            is_twin.then_some(stated)
        })
    }

    /// Writes each record that any question of a query asks for, once, then the records that the asker needs next (RFC 6763, section
    /// 12), as far as they fit; without a query, all records. `query` states whether the asker knows no multicast. Returns the
    /// length, or nothing where no record is asked for.
    fn respond(
        &self,
        address: Ipv4Addr,
        query: Option<(&Message<&[u8]>, bool)>,
        answer: &mut [u8],
    ) -> Option<usize> {
        let legacy = query.is_some_and(|(_, legacy)| legacy);
        let records = Records { responder: self, address, legacy };
        let mut asked = 0_u8;
        records.each(|place, record| {
            let is_asked = match query {
                Some((query, _)) => query.question().flatten().any(|it| asks_for(&it, &record)),
                None => place != NO_IPV6,
            };
            asked |= u8::from(is_asked) << place;
        });
        let leads_to = |place: u8, next: u8| if asked & 1 << place != 0 { next } else { 0 };
        let host = 1 << ADDRESS;
        let further = leads_to(ROBOT, 1 << PLACE | 1 << TEXT | host) | leads_to(PLACE, host);
        let target = StaticCompressor::new(Buf::new(answer));
        let mut builder = MessageBuilder::from_target(target).ok()?;
        let header = builder.header_mut();
        header.set_qr(true);
        header.set_aa(true);
        let mut questions = builder.question();
        if let Some((query, true)) = query {
            questions.header_mut().set_id(query.header().id());
            query.question().flatten().try_for_each(|it| questions.push(it)).ok()?;
        }
        let mut answers = questions.answer();
        records.each(|place, record| {
            // A record that does not fit is left out.
            let _ = if asked & 1 << place != 0 { answers.push(record) } else { Ok(()) };
        });
        if answers.counts().ancount() == 0 {
            return None;
        }
        let mut additional = answers.additional();
        records.each(|place, record| {
            let is_next = further & !asked & 1 << place != 0;
            let _ = if is_next { additional.push(record) } else { Ok(()) };
        });
        Some(additional.finish().as_slice().len())
    }
}

/// Returns whether a question asks for a record.
fn asks_for(question: &Question<impl ToName>, record: &HostAnswer<'_>) -> bool {
    let kind = match record.rtype() {
        // The record states that the host has no address of IPv6.
        Rtype::NSEC => question.qtype() == Rtype::AAAA,
        kind => [kind, Rtype::ANY].contains(&question.qtype()),
    };
    kind && question.qname().name_eq(record.owner())
}

/// Places of the records in their order.
const ADDRESS: u8 = 0;
const NO_IPV6: u8 = 1;
const PLACE: u8 = 2;
const TEXT: u8 = 3;
const KIND: u8 = 4;
const ROBOT: u8 = 5;

/// The records of a robot.
struct Records<'a> {
    responder: &'a Responder,
    address: Ipv4Addr,
    legacy: bool,
}

impl Records<'_> {
    /// Calls `visit` with each record and the record's place.
    fn each(&self, mut visit: impl FnMut(u8, HostAnswer<'_>)) {
        let Responder { name, board, host, port } = self.responder;
        let (host, service) = ([host.as_str(), DOMAIN], [SERVICE, PROTOCOL, DOMAIN]);
        let instance = [name.as_str(), SERVICE, PROTOCOL, DOMAIN];
        let host = || NameSlice::new(&host);
        let service = || NameSlice::new(&service);
        let instance = || NameSlice::new(&instance);
        let (unique, seconds) = match self.legacy {
            false => (Class::from_int(UNIQUE), TIME_TO_LIVE_S),
            true => (Class::IN, LEGACY_TIME_TO_LIVE_S),
        };
        let ttl = Ttl::from_secs(seconds);
        let next = RecordDataChain::Next;
        let address = AllRecordData::A(A::new(self.address));
        visit(ADDRESS, Record::new(host(), unique, ttl, next(address)));
        // Nobody has to wait for an address of IPv6. Only who asks gets it: with every answer it would make the robot
        // worth asking in somebody else's name.
        if let Ok(types) = RtypeBitmap::from_octets(&HOST_TYPES[..]) {
            let only_ipv4 = AllRecordData::Nsec(Nsec::new(host(), types));
            visit(NO_IPV6, Record::new(host(), unique, ttl, next(only_ipv4)));
        }
        let place = AllRecordData::Srv(Srv::new(0, 0, *port, host()));
        visit(PLACE, Record::new(instance(), unique, ttl, next(place)));
        let properties = [("version", env!("CARGO_PKG_VERSION")), ("board", board)];
        let text = RecordDataChain::This(Txt::new(&properties));
        visit(TEXT, Record::new(instance(), unique, ttl, text));
        // Every robot has these.
        let kind = AllRecordData::Ptr(Ptr::new(service()));
        visit(KIND, Record::new(DNS_SD_OWNER, Class::IN, ttl, RecordDataChain::Next(kind)));
        let robot = AllRecordData::Ptr(Ptr::new(instance()));
        visit(ROBOT, Record::new(service(), Class::IN, ttl, RecordDataChain::Next(robot)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use edge_mdns::domain::base::ParsedName;
    use edge_mdns::{HostQuestion, HostQuestions, MdnsError};
    use std::vec;
    use std::vec::Vec;

    const ADDRESS: Ipv4Addr = Ipv4Addr::new(192, 168, 4, 20);
    const NEIGHBOUR: SocketAddr =
        SocketAddr::V4(SocketAddrV4::new(Ipv4Addr::new(192, 168, 4, 2), PORT));
    const LEGACY: SocketAddr =
        SocketAddr::V4(SocketAddrV4::new(Ipv4Addr::new(192, 168, 4, 2), 40_000));

    /// As long as the longest name of a board.
    const BOARD: &str = "a board with thirty-two letters!";

    struct Ask(&'static [&'static str], Rtype);

    impl HostQuestions for Ask {
        fn visit<F, E>(&self, mut f: F) -> Result<(), E>
        where
            F: FnMut(HostQuestion) -> Result<(), E>,
            E: From<MdnsError>,
        {
            f(Question::new(NameSlice::new(self.0), self.1, Class::IN))
        }
    }

    fn query_for(name: &'static [&'static str], kind: Rtype) -> Vec<u8> {
        let mut query = [0; 256];
        let length = Ask(name, kind).query(0, &mut query).unwrap();
        query[..length].to_vec()
    }

    fn query(name: &'static [&'static str]) -> Vec<u8> {
        query_for(name, Rtype::PTR)
    }

    /// Types, classes and times of all records of an answer.
    fn records(answer: &[u8]) -> Vec<(Rtype, u16, u32)> {
        let message = Message::from_octets(answer).unwrap();
        let all = message.iter().map(|record| record.unwrap().0);
        all.map(|it| (it.rtype(), it.class().to_int(), it.ttl().as_secs())).collect()
    }

    #[test]
    fn who_asks_for_an_address_of_ipv6_hears_that_there_is_none() {
        let responder = Responder::new("Daisy", BOARD, 13549);
        let mut answer = [0; ANSWER_LENGTH];
        for (kind, hears) in [(Rtype::AAAA, true), (Rtype::A, false)] {
            let query = query_for(&["flix-daisy", "local"], kind);
            let (_, length) = responder.answer(ADDRESS, NEIGHBOUR, &query, &mut answer).unwrap();
            let found = records(&answer[..length]);
            assert_eq!(found.iter().any(|(kind, ..)| *kind == Rtype::NSEC), hears, "{kind}");
        }
    }

    /// Returns a query of these names and types, as resolvers put several questions into a packet.
    fn questions(asked: &[(&[&str], Rtype)]) -> Vec<u8> {
        let mut query = [0; 512];
        let target = StaticCompressor::new(Buf::new(&mut query));
        let mut builder = MessageBuilder::from_target(target).unwrap().question();
        for (name, kind) in asked {
            builder.push(Question::new(NameSlice::new(name), *kind, Class::IN)).unwrap();
        }
        builder.finish().as_slice().to_vec()
    }

    #[test]
    fn several_questions_in_a_packet_are_answered_each_record_once() {
        for letters in 1..NAME_LENGTH {
            let name = "n".repeat(letters);
            let (host, responder) = (host_name(&name), Responder::new(&name, BOARD, 13549));
            let host = [host.as_str(), DOMAIN];
            let instance = [name.as_str(), SERVICE, PROTOCOL, DOMAIN];
            let asked = [
                (&instance[..], Rtype::SRV),
                (&instance[..], Rtype::TXT),
                (&host[..], Rtype::A),
                (&host[..], Rtype::AAAA),
            ];
            let service: (&[&str], _) = (&[SERVICE, PROTOCOL, DOMAIN], Rtype::PTR);
            let lists: [(Vec<_>, &[Rtype]); 6] = [
                (asked[..2].to_vec(), &[Rtype::A, Rtype::SRV, Rtype::TXT]),
                (asked[2..].to_vec(), &[Rtype::A, Rtype::NSEC]),
                (asked.to_vec(), &[Rtype::A, Rtype::NSEC, Rtype::SRV, Rtype::TXT]),
                (vec![service], &[Rtype::A, Rtype::SRV, Rtype::TXT, Rtype::PTR]),
                (
                    [&[service, service], &asked[..]].concat(),
                    &[Rtype::A, Rtype::NSEC, Rtype::SRV, Rtype::TXT, Rtype::PTR],
                ),
                (vec![(&host[..], Rtype::TXT)], &[]),
            ];
            for from in [NEIGHBOUR, LEGACY] {
                for (asked, wanted) in &lists {
                    let mut answer = [0; ANSWER_LENGTH];
                    let query = questions(asked);
                    let answered = responder.answer(ADDRESS, from, &query, &mut answer);
                    let length = answered.map_or(0, |(_, length)| length);
                    let found = answered.map_or_else(Vec::new, |_| records(&answer[..length]));
                    let mut found: Vec<_> = found.into_iter().map(|(kind, ..)| kind).collect();
                    found.sort_by_key(|kind| wanted.iter().position(|it| it == kind));
                    assert_eq!(found, *wanted, "{letters} letters from {from}: {asked:?}");
                    assert!(length <= AMPLIFICATION * query.len());
                }
            }
        }
    }

    #[test]
    fn records_that_nobody_else_has_replace_what_is_remembered() {
        let (_, answer) = ask(NEIGHBOUR, &["_flix", "_udp", "local"]).unwrap();
        for (kind, class, seconds) in records(&answer) {
            let is_shared = kind == Rtype::PTR;
            assert_eq!((class, seconds), (if is_shared { 1 } else { 0x8001 }, 120), "{kind}");
        }
    }

    #[test]
    fn a_resolver_without_multicast_remembers_for_10_s() {
        let (_, answer) = ask(LEGACY, &["_flix", "_udp", "local"]).unwrap();
        let found = records(&answer);
        assert!(found.len() >= 4);
        assert!(found.iter().all(|(_, class, seconds)| *class == 1 && *seconds <= 10), "{found:?}");
    }

    fn ask(from: SocketAddr, name: &'static [&'static str]) -> Option<(SocketAddr, Vec<u8>)> {
        let mut answer = [0; ANSWER_LENGTH];
        Responder::new("Daisy", BOARD, 13549)
            .answer(ADDRESS, from, &query(name), &mut answer)
            .map(|(to, length)| (to, answer[..length].to_vec()))
    }

    fn port_told(answer: &[u8]) -> Option<u16> {
        let message = Message::from_octets(answer).unwrap();
        let mut records = message.additional().unwrap().limit_to::<Srv<ParsedName<_>>>();
        records.next().map(|record| record.unwrap().data().port())
    }

    #[test]
    fn a_robot_that_is_looked_for_tells_everybody_its_port() {
        let (to, answer) = ask(NEIGHBOUR, &["_flix", "_udp", "local"]).unwrap();
        let everybody = SocketAddr::V4(SocketAddrV4::new(GROUP, PORT));
        assert_eq!((to, port_told(&answer)), (everybody, Some(13549)));
    }

    #[test]
    fn a_resolver_without_multicast_is_answered_alone() {
        assert_eq!(ask(LEGACY, &["_flix", "_udp", "local"]).unwrap().0, LEGACY);
    }

    #[test]
    fn questions_about_others_are_left_to_others() {
        assert_eq!(ask(NEIGHBOUR, &["_ipp", "_tcp", "local"]), None);
    }

    #[test]
    fn no_answer_is_longer_than_its_question_allows() {
        let longest = "n".repeat(NAME_LENGTH);
        let responder = Responder::new(&longest, BOARD, 13549);
        let question = query(&["_flix", "_udp", "local"]);
        let mut answer = [0; ANSWER_LENGTH];
        let answered = |question: &[u8], answer: &mut _| {
            responder.answer(ADDRESS, LEGACY, question, answer).map(|(_, length)| length)
        };
        let length = answered(&question, &mut answer).unwrap();
        assert!(length <= AMPLIFICATION * question.len(), "{length} for {}", question.len());
        // A name that is one pointer back into the header, as short as a question can be.
        let mut short = question[..12].to_vec();
        short.extend([0xc0, 12, 0, 255, 0, 1]);
        let all = [&short[..], &query(&["local"]), &question[..]];
        for question in all {
            let length = answered(question, &mut answer).unwrap_or_default();
            assert!(length <= AMPLIFICATION * question.len());
        }
    }

    #[test]
    fn a_twin_is_who_has_the_same_host_name_at_another_address() {
        let (robot, twin) = (Responder::new("Daisy", BOARD, 1), Responder::new("daisy", BOARD, 1));
        let other = Responder::new("rose", BOARD, 1);
        let there = Ipv4Addr::new(192, 168, 4, 9);
        let mut datagram = [0; ANSWER_LENGTH];
        for (from, address, found) in
            [(&twin, there, Some(there)), (&twin, ADDRESS, None), (&other, there, None)]
        {
            let length = from.announcement(address, &mut datagram).unwrap();
            assert_eq!(robot.twin(ADDRESS, &datagram[..length]), found);
            let length = from.probe(address, &mut datagram).unwrap();
            assert_eq!(robot.twin(ADDRESS, &datagram[..length]), found);
        }
        // The answer to a twin's probe tells it of this robot.
        let length = twin.probe(there, &mut datagram).unwrap();
        let (from, mut answer) = (SocketAddr::from((there, PORT)), [0; ANSWER_LENGTH]);
        let (_, length) = robot.answer(ADDRESS, from, &datagram[..length], &mut answer).unwrap();
        assert_eq!(twin.twin(there, &answer[..length]), Some(ADDRESS));
    }

    #[test]
    fn damaged_queries_are_survived() {
        let responder = Responder::new("Daisy", BOARD, 13549);
        let mut probe = [0; ANSWER_LENGTH];
        let length = responder.probe(ADDRESS, &mut probe).unwrap();
        for intact in [query(&["_flix", "_udp", "local"]), probe[..length].to_vec()] {
            survives_damage(&responder, &intact);
        }
    }

    fn survives_damage(responder: &Responder, intact: &[u8]) {
        for length in 0..intact.len() {
            for value in [0, 0x3f, 0xc0, 0xff] {
                let mut damaged = intact.to_vec();
                damaged[length] = value;
                let mut answer = [0; ANSWER_LENGTH];
                responder.answer(ADDRESS, NEIGHBOUR, &damaged, &mut answer);
                responder.answer(ADDRESS, LEGACY, &damaged[..length], &mut answer);
                let _ = responder.twin(ADDRESS, &damaged);
            }
        }
    }

    #[test]
    fn a_name_of_any_letters_makes_a_host_name() {
        let responder = Responder::new("Gänse Blümchen 7", BOARD, 1);
        assert_eq!(responder.host.as_str(), "flix-g-nse-bl-mchen-7");
    }
}
