//! How a robot is found: multicast DNS (RFC 6762) and service discovery (RFC 6763).
//!
//! The robot is an instance of the service `_flix._udp` named like itself, on the host
//! `flix-NAME.local`. Queries come in, answers go out; the sockets are [`crate::net`]'s.

use core::net::{Ipv4Addr, Ipv6Addr, SocketAddr, SocketAddrV4};

use edge_mdns::domain::base::Ttl;
use edge_mdns::host::{Host, Service, ServiceAnswers};
use edge_mdns::{HostAnswersMdnsHandler, MdnsHandler, MdnsRequest, MdnsResponse};
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
/// Most bytes of an answer for each byte of its question: what the shortest question for the service and the longest name
/// of a robot need. More would make the robot worth asking in somebody else's name.
pub const AMPLIFICATION: usize = 11;
const HOST_PREFIX: &str = "flix-";

/// Answers queries about one robot.
#[derive(Debug, Clone)]
pub struct Responder {
    name: Name,
    host: String<{ NAME_LENGTH + HOST_PREFIX.len() }>,
    port: u16,
}

impl Responder {
    /// Answers for a robot that listens on this UDP port. An empty name becomes `robot`.
    #[must_use]
    pub fn new(name: &str, port: u16) -> Self {
        let name = if name.is_empty() { "robot" } else { name };
        let mut host = String::new();
        let plain = |character: char| {
            if character.is_ascii_alphanumeric() { character.to_ascii_lowercase() } else { '-' }
        };
        for character in HOST_PREFIX.chars().chain(name.chars().map(plain)) {
            if host.push(character).is_err() {
                break;
            }
        }
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

    fn handle(
        &self,
        address: Ipv4Addr,
        request: MdnsRequest<'_>,
        answer: &mut [u8; ANSWER_LENGTH],
    ) -> Option<usize> {
        let host = Host {
            hostname: &self.host,
            ipv4: address,
            ipv6: Ipv6Addr::UNSPECIFIED,
            ttl: Ttl::from_secs(TIME_TO_LIVE_S),
        };
        let service = Service {
            name: &self.name,
            priority: 0,
            weight: 0,
            service: "_flix",
            protocol: "_udp",
            port: self.port,
            service_subtypes: &[],
            txt_kvs: &[("version", env!("CARGO_PKG_VERSION"))],
        };
        let mut handler = HostAnswersMdnsHandler::new(ServiceAnswers::new(&host, &service));
        match handler.handle(request, answer) {
            Ok(MdnsResponse::Reply { data, .. }) => Some(data.len()),
            Ok(MdnsResponse::None) | Err(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use edge_mdns::domain::base::iana::Class;
    use edge_mdns::domain::base::{Message, ParsedName, Question, Rtype};
    use edge_mdns::domain::rdata::Srv;
    use edge_mdns::{HostQuestion, HostQuestions, MdnsError, NameSlice};
    use std::vec::Vec;

    const ADDRESS: Ipv4Addr = Ipv4Addr::new(192, 168, 4, 20);
    const NEIGHBOUR: SocketAddr =
        SocketAddr::V4(SocketAddrV4::new(Ipv4Addr::new(192, 168, 4, 2), PORT));
    const LEGACY: SocketAddr =
        SocketAddr::V4(SocketAddrV4::new(Ipv4Addr::new(192, 168, 4, 2), 40_000));

    struct Ask(&'static [&'static str]);

    impl HostQuestions for Ask {
        fn visit<F, E>(&self, mut f: F) -> Result<(), E>
        where
            F: FnMut(HostQuestion) -> Result<(), E>,
            E: From<MdnsError>,
        {
            f(Question::new(NameSlice::new(self.0), Rtype::PTR, Class::IN))
        }
    }

    fn query(name: &'static [&'static str]) -> Vec<u8> {
        let mut query = [0; 256];
        let length = Ask(name).query(0, &mut query).unwrap();
        query[..length].to_vec()
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
