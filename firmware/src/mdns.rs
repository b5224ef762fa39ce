//! How a robot is found: multicast DNS (RFC 6762) and service discovery (RFC 6763).
//!
//! The robot is an instance of the service `_flix._udp` named like itself, on the host
//! `flix-NAME.local`. Queries come in, answers go out; the sockets are [`crate::net`]'s.

use core::net::{Ipv4Addr, SocketAddr, SocketAddrV4};

use edge_mdns::domain::base::iana::Class;
use edge_mdns::domain::base::name::ToName;
use edge_mdns::domain::base::{Message, Record, Rtype, Ttl};
use edge_mdns::domain::rdata::dnssec::RtypeBitmap;
use edge_mdns::domain::rdata::{A, AllRecordData, Nsec, Ptr, Srv};
use edge_mdns::{
    DNS_SD_OWNER, HostAnswer, HostAnswers, HostAnswersMdnsHandler, MdnsError, MdnsHandler,
    MdnsRequest, MdnsResponse, NameSlice, RecordDataChain, Txt,
};
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
const HOST_PREFIX: &str = "flix-";
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
    host: String<HOST_LENGTH>,
    port: u16,
}

impl Responder {
    /// Answers for a robot that listens on this UDP port. An empty name becomes `robot`.
    #[must_use]
    pub fn new(name: &str, port: u16) -> Self {
        let name = if name.is_empty() { NAMELESS } else { name };
        let host = host_name(name);
        Self { name: crate::settings::text(name), host, port }
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
        let request = MdnsRequest::Request { legacy, multicast: true, data: query };
        let length = self
            .handle(address, request, answer)
            .filter(|length| *length <= AMPLIFICATION * query.len())?;
        let everybody = SocketAddr::V4(SocketAddrV4::new(GROUP, PORT));
        Some((if legacy { from } else { everybody }, length))
    }

    /// Announces the robot, once it has an address; returns the length of the announcement in `answer`.
    pub fn announcement(
        &self,
        address: Ipv4Addr,
        answer: &mut [u8; ANSWER_LENGTH],
    ) -> Option<usize> {
        self.handle(address, MdnsRequest::None, answer)
    }

    /// Returns whether a query asks for the host's address of IPv6.
    fn asks_for_ipv6(&self, query: &[u8]) -> bool {
        let name = [self.host.as_str(), DOMAIN];
        let name = NameSlice::new(&name);
        Message::from_octets(query).is_ok_and(|message| {
            let mut questions = message.question().filter_map(Result::ok);
            questions.any(|asked| asked.qtype() == Rtype::AAAA && asked.qname().name_eq(&name))
        })
    }

    fn handle(
        &self,
        address: Ipv4Addr,
        request: MdnsRequest<'_>,
        answer: &mut [u8; ANSWER_LENGTH],
    ) -> Option<usize> {
        let legacy = matches!(request, MdnsRequest::Request { legacy: true, .. });
        let asks_for_ipv6 = match &request {
            MdnsRequest::Request { data, .. } => self.asks_for_ipv6(data),
            _ => false,
        };
        let records = Records { responder: self, address, legacy, asks_for_ipv6 };
        let mut handler = HostAnswersMdnsHandler::new(records);
        match handler.handle(request, answer) {
            Ok(MdnsResponse::Reply { data, .. }) => Some(data.len()),
            Ok(MdnsResponse::None) | Err(_) => None,
        }
    }
}

/// What the robot's names stand for.
struct Records<'a> {
    responder: &'a Responder,
    address: Ipv4Addr,
    legacy: bool,
    asks_for_ipv6: bool,
}

impl HostAnswers for Records<'_> {
    fn visit<F, E>(&self, mut f: F) -> Result<(), E>
    where
        F: FnMut(HostAnswer) -> Result<(), E>,
        E: From<MdnsError>,
    {
        let Responder { name, host, port } = self.responder;
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
        f(Record::new(host(), unique, ttl, next(address)))?;
        // Nobody has to wait for an address of IPv6. Only who asks gets it: with every answer it would make the robot
        // worth asking in somebody else's name.
        if self.asks_for_ipv6
            && let Ok(types) = RtypeBitmap::from_octets(&HOST_TYPES[..])
        {
            let only_ipv4 = AllRecordData::Nsec(Nsec::new(host(), types));
            f(Record::new(host(), unique, ttl, next(only_ipv4)))?;
        }
        let place = AllRecordData::Srv(Srv::new(0, 0, *port, host()));
        f(Record::new(instance(), unique, ttl, next(place)))?;
        let text = RecordDataChain::This(Txt::new(&[("version", env!("CARGO_PKG_VERSION"))]));
        f(Record::new(instance(), unique, ttl, text))?;
        // Every robot has these.
        let kind = AllRecordData::Ptr(Ptr::new(service()));
        f(Record::new(DNS_SD_OWNER, Class::IN, ttl, RecordDataChain::Next(kind)))?;
        let robot = AllRecordData::Ptr(Ptr::new(instance()));
        f(Record::new(service(), Class::IN, ttl, RecordDataChain::Next(robot)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use edge_mdns::domain::base::{ParsedName, Question};
    use edge_mdns::{HostQuestion, HostQuestions};
    use std::vec::Vec;

    const ADDRESS: Ipv4Addr = Ipv4Addr::new(192, 168, 4, 20);
    const NEIGHBOUR: SocketAddr =
        SocketAddr::V4(SocketAddrV4::new(Ipv4Addr::new(192, 168, 4, 2), PORT));
    const LEGACY: SocketAddr =
        SocketAddr::V4(SocketAddrV4::new(Ipv4Addr::new(192, 168, 4, 2), 40_000));

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
        let responder = Responder::new("Daisy", 13549);
        let mut answer = [0; ANSWER_LENGTH];
        for (kind, hears) in [(Rtype::AAAA, true), (Rtype::A, false)] {
            let query = query_for(&["flix-daisy", "local"], kind);
            let (_, length) = responder.answer(ADDRESS, NEIGHBOUR, &query, &mut answer).unwrap();
            let found = records(&answer[..length]);
            assert_eq!(found.iter().any(|(kind, ..)| *kind == Rtype::NSEC), hears, "{kind}");
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
        Responder::new("Daisy", 13549)
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
        let responder = Responder::new(&longest, 13549);
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
    fn damaged_queries_are_survived() {
        let intact = query(&["_flix", "_udp", "local"]);
        let responder = Responder::new("Daisy", 13549);
        for length in 0..intact.len() {
            for value in [0, 0x3f, 0xc0, 0xff] {
                let mut damaged = intact.clone();
                damaged[length] = value;
                let mut answer = [0; ANSWER_LENGTH];
                responder.answer(ADDRESS, NEIGHBOUR, &damaged, &mut answer);
                responder.answer(ADDRESS, LEGACY, &damaged[..length], &mut answer);
            }
        }
    }

    #[test]
    fn a_name_of_any_letters_makes_a_host_name() {
        let responder = Responder::new("Gänse Blümchen 7", 1);
        assert_eq!(responder.host.as_str(), "flix-g-nse-bl-mchen-7");
    }
}
