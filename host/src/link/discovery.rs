//! Finds the robots that announce themselves on the local network (mDNS and DNS-SD).

use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use flix_protocol::frame::MAXIMUM_DATAGRAM;
use flix_protocol::session::{Key, StopSession};
use flix_protocol::units as protocol;
use flix_protocol::{DEFAULT_PORT, SERVICE_TYPE};
use mdns_sd::{ResolvedService, ServiceDaemon, ServiceEvent};

use super::transient;
use super::udp::ANSWERS_AT_ONCE;
use crate::system::interrupt::Interrupt;
use crate::system::text::printable;

/// Longest search for a name: mDNS answers within 0.1 s, and repeats its question after 1 s.
pub const FIND_PATIENCE: Duration = Duration::from_millis(2500);
/// Longest wait for the answer of a simulated robot on this computer.
const GREETING_PATIENCE: Duration = Duration::from_millis(300);
/// Time after the first proof in which others may prove the same.
pub(crate) const PROVERS: Duration = Duration::from_millis(300);
/// Rounds in which these addresses compete for the first answer.
const RACES: usize = 5;
/// Interval at which a round looks for an answer.
const LOOK: Duration = Duration::from_micros(200);
/// Interval of the checks for answers and interruption.
const SLICE: Duration = Duration::from_millis(10);
/// Most addresses that are greeted in a search.
const MOST_GREETED: usize = 200;

/// A robot that was found.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Found {
    /// Its name, as it was provisioned.
    pub name: String,
    /// Its addresses, IPv4 first.
    pub addresses: Vec<IpAddr>,
    /// Its UDP port.
    pub port: u16,
    /// Announced properties, for example `board` and `version`. Not authenticated.
    pub properties: BTreeMap<String, String>,
}

impl Found {
    /// Returns the first address for datagrams.
    #[must_use]
    pub fn socket_address(&self) -> Option<SocketAddr> {
        self.socket_addresses().next()
    }

    /// Returns one robot for each address of IPv4: a robot has one of these, so that several are as many robots of one name.
    fn by_address(self) -> Vec<Self> {
        let (ipv4, others): (Vec<_>, Vec<_>) =
            self.addresses.iter().partition(|address| address.is_ipv4());
        if ipv4.len() < 2 {
            return vec![self];
        }
        let with =
            |address| Self { addresses: [vec![address], others.clone()].concat(), ..self.clone() };
        ipv4.into_iter().map(with).collect()
    }

    fn socket_addresses(&self) -> impl Iterator<Item = SocketAddr> + '_ {
        self.addresses.iter().map(|address| SocketAddr::new(*address, self.port))
    }
}

/// Multicast does not work on this machine.
#[derive(Debug, thiserror::Error)]
#[error("the search for robots failed: {0}; give the robot's address instead of its name")]
pub struct DiscoveryError(#[from] mdns_sd::Error);

/// Searches for this time, and returns every robot found, by name and address: two robots may have one name.
///
/// # Errors
/// When multicast does not work on this machine.
pub fn browse(duration: Duration, interrupt: &Interrupt) -> Result<Vec<Found>, DiscoveryError> {
    let mut robots = BTreeMap::new();
    listen(duration, interrupt, |found| {
        let each = found.into_iter().flat_map(Found::by_address);
        robots.extend(each.map(|it| ((it.name.clone(), it.socket_address()), it)));
        false
    })?;
    // An announcement whose addresses came later.
    let has_address =
        |name: &str| robots.keys().any(|(it, address)| it == name && address.is_some());
    let is_whole = |it: &Found| it.socket_address().is_some() || !has_address(&it.name);
    Ok(robots.values().filter(|it| is_whole(it)).cloned().collect())
}

/// Returns, of each of these robots, whether it proves within 0.3 s that it has this key; `None` where there is no key.
#[must_use]
pub fn prove_all(robots: &[(Found, Option<Key>)]) -> Vec<Option<bool>> {
    let greet = |(found, key): &(Found, Option<Key>)| -> Option<Vec<Greeted>> {
        let key = key.as_ref()?;
        Some(found.socket_addresses().filter_map(|it| Greeted::new(it, key)).collect())
    };
    let mut greeted: Vec<_> = robots.iter().map(greet).collect();
    let is_open = |it: &Option<Vec<Greeted>>| {
        it.as_ref().is_some_and(|addresses| !addresses.iter().any(|it| it.has_proved))
    };
    let begin = Instant::now();
    while begin.elapsed() < GREETING_PATIENCE && greeted.iter().any(is_open) {
        greeted.iter_mut().flatten().flatten().for_each(|it| {
            it.newly_proves();
        });
        std::thread::sleep(SLICE);
    }
    let has_proved = |addresses: Vec<Greeted>| addresses.iter().any(|it| it.has_proved);
    greeted.into_iter().map(|it| it.map(has_proved)).collect()
}

/// Searches for one robot by its name, for at most [`FIND_PATIENCE`], and returns the address that proves to have one of these
/// keys; of several that do within 0.3 s, the one that answers soonest, because a relay in between is never quicker.
/// Any device in the network can answer without proof, and faster. Without any proof the first that answered is returned: its
/// handshake then names the error.
///
/// # Errors
/// When multicast does not work on this machine.
pub fn find<'a>(
    name: &str,
    keys: impl Iterator<Item = &'a Key>,
    interrupt: &Interrupt,
) -> Result<Option<SocketAddr>, DiscoveryError> {
    let keys: Vec<_> = keys.collect();
    let listen = |enough: &mut Enough| listen(FIND_PATIENCE, interrupt, enough);
    find_among(listen, name, &keys, interrupt)
}

/// As [`find`], among those that something else than the network's multicast names.
fn find_among(
    listen: impl FnOnce(&mut Enough) -> Result<(), DiscoveryError>,
    name: &str,
    keys: &[&Key],
    interrupt: &Interrupt,
) -> Result<Option<SocketAddr>, DiscoveryError> {
    let mut proved = Vec::new();
    let mut since = None;
    let greeted = each_among(listen, name, keys, |address| {
        proved.extend(address);
        since = since.or_else(|| address.map(|_| Instant::now()));
        since.is_some_and(|since| since.elapsed() > PROVERS)
    })?;
    Ok(quickest(&proved, keys, interrupt).or(greeted))
}

/// Returns the address that answers soonest of those that have proved a key.
fn quickest(proved: &[SocketAddr], keys: &[&Key], interrupt: &Interrupt) -> Option<SocketAddr> {
    if let [only] = proved {
        return Some(*only);
    }
    let mut runners = proved.to_vec();
    let won = (0..RACES).filter_map(|_| {
        // None begins each time.
        let count = runners.len().max(1);
        runners.rotate_left(count.div_ceil(RACES) % count);
        race(&runners, keys, interrupt)
    });
    let won: Vec<_> = won.collect();
    let wins = |address: &SocketAddr| won.iter().filter(|it| *it == address).count();
    proved.iter().copied().max_by_key(wins)
}

/// Searches for one robot by its name, for at most [`FIND_PATIENCE`], and passes to `each` every address that proves to have one
/// of these keys, and in between nothing, until it returns true. Returns the first address that answered at all.
///
/// # Errors
/// When multicast does not work on this machine.
pub fn find_each(
    name: &str,
    keys: &[&Key],
    interrupt: &Interrupt,
    each: impl FnMut(Option<SocketAddr>) -> bool,
) -> Result<Option<SocketAddr>, DiscoveryError> {
    each_among(|enough: &mut Enough| listen(FIND_PATIENCE, interrupt, enough), name, keys, each)
}

fn each_among(
    listen: impl FnOnce(&mut Enough) -> Result<(), DiscoveryError>,
    name: &str,
    keys: &[&Key],
    mut each: impl FnMut(Option<SocketAddr>) -> bool,
) -> Result<Option<SocketAddr>, DiscoveryError> {
    let mut search = Search { name, keys, greeted: Vec::new(), first: None };
    listen(&mut |found| {
        let proved = search.take(found);
        // All before the next look, whatever `each` says of the first.
        proved.into_iter().map(Some).chain([None]).filter(|it| each(*it)).count() > 0
    })?;
    Ok(search.first)
}

/// A search for the robots of a name.
struct Search<'a> {
    name: &'a str,
    keys: &'a [&'a Key],
    greeted: Vec<Greeted>,
    /// The first address that answered at all.
    first: Option<SocketAddr>,
}

impl Search<'_> {
    /// Takes a found robot, if any, greets one of the searched name, and returns the addresses that have proved a key since the last
    /// call.
    fn take(&mut self, found: Option<Found>) -> Vec<SocketAddr> {
        let named = found.filter(|it| it.name.eq_ignore_ascii_case(self.name));
        for address in named.iter().flat_map(Found::socket_addresses) {
            let is_new = self.greeted.iter().all(|it| it.address != address);
            if is_new && self.greeted.len() < MOST_GREETED {
                self.first = self.first.or(Some(address));
                self.greeted.extend(self.keys.iter().filter_map(|key| Greeted::new(address, key)));
            }
        }
        let proved =
            self.greeted.iter_mut().filter_map(|it| it.newly_proves().then_some(it.address));
        proved.collect()
    }
}

/// Greets all of these addresses at once, and returns the one that is the first to prove that it has one of these keys.
fn race(addresses: &[SocketAddr], keys: &[&Key], interrupt: &Interrupt) -> Option<SocketAddr> {
    let each = addresses.iter().flat_map(|address| keys.iter().map(|key| (*address, *key)));
    let mut greeted: Vec<_> =
        each.filter_map(|(address, key)| Greeted::new(address, key)).collect();
    let begin = Instant::now();
    while begin.elapsed() < GREETING_PATIENCE && !interrupt.is_raised() {
        if let Some(first) = greeted.iter_mut().find_map(|it| {
            let proves = it.proves().unwrap_or(false);
            proves.then_some(it.address)
        }) {
            return Some(first);
        }
        std::thread::sleep(LOOK);
    }
    None
}

/// Looks for a simulated robot with this key on this computer, where multicast seldom reaches.
#[must_use]
pub fn on_this_computer(name: &str, key: &Key) -> Option<Found> {
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, DEFAULT_PORT));
    if !proves(address, key, GREETING_PATIENCE) {
        return None;
    }
    Some(Found {
        name: name.to_owned(),
        addresses: vec![address.ip()],
        port: address.port(),
        properties: BTreeMap::from([("board".to_owned(), "simulated".to_owned())]),
    })
}

/// Returns whether a robot at this address proves within this time that it has this key.
#[must_use]
pub fn proves(address: SocketAddr, key: &Key, patience: Duration) -> bool {
    let Some(mut greeted) = Greeted::new(address, key) else { return false };
    let begin = Instant::now();
    loop {
        match greeted.proves() {
            Ok(true) => return true,
            Ok(false) if begin.elapsed() <= patience => std::thread::sleep(SLICE),
            _ => return false,
        }
    }
}

/// An address that may be the robot's. It is greeted like one that is to be stopped, and never asked to: its session, if
/// it has one, goes on.
struct Greeted {
    address: SocketAddr,
    socket: UdpSocket,
    greeting: StopSession,
    begin: Instant,
    has_proved: bool,
}

impl Greeted {
    /// Returns `None` when it cannot be reached.
    fn new(address: SocketAddr, key: &Key) -> Option<Self> {
        let mut entropy = [0; 32];
        getrandom::fill(&mut entropy).ok()?;
        let socket = super::path::connect(address).ok()?;
        socket.set_nonblocking(true).ok()?;
        let greeting = StopSession::new(key, entropy, protocol::Instant::START);
        Some(Self { address, socket, greeting, begin: Instant::now(), has_proved: false })
    }

    /// Greets the address when that is due, and returns whether the key was proved since the last call.
    fn newly_proves(&mut self) -> bool {
        let is_new = !self.has_proved && self.proves().unwrap_or(false);
        self.has_proved |= is_new;
        is_new
    }

    /// Greets it when that is due, and returns whether it has answered with its key.
    fn proves(&mut self) -> io::Result<bool> {
        let now = protocol::Instant::START + self.begin.elapsed();
        let mut answer = [0; MAXIMUM_DATAGRAM];
        for _ in 0..ANSWERS_AT_ONCE {
            let Some(length) = transient(self.socket.recv(&mut answer))? else { break };
            // One that is dropped is a stranger's.
            let _ = self.greeting.receive(now, &answer[..length]);
            if self.greeting.is_challenged() {
                return Ok(true);
            }
        }
        if let Some(hello) = self.greeting.poll(now) {
            transient(self.socket.send(&hello))?;
        }
        Ok(false)
    }
}

/// Takes a found robot, if any, and returns whether the search may end.
type Enough<'a> = dyn FnMut(Option<Found>) -> bool + 'a;

/// Passes every robot found, and in between nothing, to `enough`, until it returns true or the time is over.
fn listen(
    duration: Duration,
    interrupt: &Interrupt,
    mut enough: impl FnMut(Option<Found>) -> bool,
) -> Result<(), DiscoveryError> {
    let daemon = ServiceDaemon::new()?;
    let events = daemon.browse(SERVICE_TYPE)?;
    let deadline = Instant::now() + duration;
    while Instant::now() < deadline && !interrupt.is_raised() {
        let found = match events.recv_timeout(SLICE) {
            Ok(ServiceEvent::ServiceResolved(service)) => Some(found(&service)),
            _ => None,
        };
        if enough(found) {
            break;
        }
    }
    // The daemon's thread ends by itself when asked; nothing depends on when.
    let _ = daemon.shutdown();
    Ok(())
}

fn found(service: &ResolvedService) -> Found {
    let name = service.fullname.strip_suffix(&format!(".{SERVICE_TYPE}"));
    let mut addresses: Vec<IpAddr> =
        service.addresses.iter().map(mdns_sd::ScopedIp::to_ip_addr).collect();
    addresses.sort();
    let properties = service.txt_properties.iter();
    Found {
        name: printable(name.unwrap_or(&service.fullname)).into_owned(),
        addresses,
        port: service.port,
        properties: properties
            .map(|property| (property.key(), property.val_str()))
            .map(|(key, value)| (printable(key).into_owned(), printable(value).into_owned()))
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::system::AtEnd;
    use flix_protocol::session::{RobotReceived, RobotSession};
    use std::sync::atomic::{AtomicBool, Ordering};

    fn key(number: u8) -> Key {
        Key::new([number; 32])
    }

    /// Answers greetings as a robot with this key, after this time.
    fn robot(socket: &UdpSocket, number: u8, late: Duration, done: &AtomicBool) {
        let mut session = RobotSession::new(Some(key(number)), [number; 32]);
        let begin = Instant::now();
        let mut datagram = [0; MAXIMUM_DATAGRAM];
        socket.set_read_timeout(Some(Duration::from_millis(5))).unwrap();
        while !done.load(Ordering::Relaxed) {
            let Ok((length, from)) = socket.recv_from(&mut datagram) else { continue };
            let now = protocol::Instant::START + begin.elapsed();
            if let RobotReceived::Answer(frame) | RobotReceived::Dropped(_, Some(frame)) =
                session.receive(now, from, &datagram[..length])
            {
                std::thread::sleep(late);
                socket.send_to(&frame, from).unwrap();
            }
        }
    }

    /// Calls with the addresses of robots that have these keys and answer so late.
    fn beside<const N: usize>(robots: [(u8, u64); N], act: impl FnOnce([SocketAddr; N])) {
        let sockets = robots.map(|_| UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap());
        let done = AtomicBool::new(false);
        std::thread::scope(|scope| {
            for (socket, (number, late)) in sockets.iter().zip(robots) {
                let done = &done;
                scope.spawn(move || robot(socket, number, Duration::from_millis(late), done));
            }
            // Ends the robots, also when a test fails.
            let _end = AtEnd(&done);
            act(std::array::from_fn(|it| sockets[it].local_addr().unwrap()));
        });
    }

    fn found(name: &str, address: SocketAddr) -> Found {
        let (addresses, port) = (vec![address.ip()], address.port());
        Found { name: name.to_owned(), addresses, port, properties: BTreeMap::new() }
    }

    #[test]
    fn of_all_that_bear_the_name_those_are_found_that_prove_one_of_the_keys_each_once() {
        beside([(9, 0), (1, 0), (2, 0), (1, 0)], |[stranger, one, two, other_name]| {
            let keys = [1, 2].map(key);
            let keys: Vec<_> = keys.iter().collect();
            let mut search =
                Search { name: "walker", keys: &keys, greeted: Vec::new(), first: None };
            let mut proved = Vec::new();
            for (name, address) in [
                ("Walker", stranger),
                ("walker", one),
                ("walker", one),
                ("WALKER", two),
                ("other", other_name),
            ] {
                proved.extend(search.take(Some(found(name, address))));
            }
            let begin = Instant::now();
            // A while longer: no address proves twice.
            while proved.len() < 2 || begin.elapsed() < Duration::from_millis(300) {
                assert!(begin.elapsed() < Duration::from_secs(10), "{proved:?}");
                proved.extend(search.take(None));
                std::thread::sleep(LOOK);
            }
            proved.sort();
            let mut both = [one, two];
            both.sort();
            assert_eq!(proved, both);
            assert_eq!(search.first, Some(stranger));
        });
    }

    /// Names these robots again and again until that is enough; returns whether it was within some seconds.
    fn named(found: &[Found], enough: &mut Enough) -> bool {
        let begin = Instant::now();
        while begin.elapsed() < Duration::from_secs(10) {
            if found.iter().cloned().map(Some).chain([None]).any(&mut *enough) {
                return true;
            }
            std::thread::sleep(LOOK);
        }
        false
    }

    #[test]
    fn the_quickest_of_those_that_prove_a_key_in_time_is_found_and_else_whoever_answered() {
        beside([(9, 0), (1, 150), (1, 0), (2, 0)], |[stranger, slow, quick, other]| {
            let (key, never) = (key(1), Interrupt::never());
            let robots = [stranger, slow, quick, other].map(|it| found("walker", it));
            let begin = Instant::now();
            let all = |enough: &mut Enough| {
                assert!(named(&robots, enough), "it is waited for others for ever");
                Ok(())
            };
            assert_eq!(find_among(all, "walker", &[&key], &never).unwrap(), Some(quick));
            assert!(begin.elapsed() > PROVERS, "slower ones have no chance");
            let strangers = |enough: &mut Enough| {
                // So that there is time to prove a key.
                for _ in 0..50 {
                    assert!(!enough(Some(robots[0].clone())));
                    std::thread::sleep(LOOK);
                }
                Ok(())
            };
            let answered = find_among(strangers, "walker", &[&key], &never).unwrap();
            assert_eq!(answered, Some(stranger));
            assert_eq!(find_among(|_| Ok(()), "walker", &[&key], &never).unwrap(), None);
        });
    }

    #[test]
    fn each_that_proves_a_key_is_passed_on_until_that_is_enough() {
        beside([(1, 0), (1, 0), (9, 0), (9, 0)], |[one, two, ..]| {
            let key = key(1);
            let robots = [one, two].map(|it| found("walker", it));
            let mut passed = Vec::new();
            let listen = |enough: &mut Enough| {
                assert!(named(&robots, enough), "passed on is enough");
                Ok(())
            };
            let each = |address: Option<SocketAddr>| {
                passed.extend(address);
                passed.len() == 2
            };
            assert_eq!(each_among(listen, "walker", &[&key], each).unwrap(), Some(one));
            passed.sort();
            let mut both = [one, two];
            both.sort();
            assert_eq!(passed, both);
        });
    }

    #[test]
    fn robots_of_one_name_are_told_apart_by_address_and_key() {
        beside([(1, 0), (2, 0)], |[own, other]| {
            let both = Found {
                addresses: vec![own.ip(), Ipv4Addr::new(127, 0, 0, 2).into()],
                ..found("walker", own)
            };
            let each: Vec<_> = both.by_address().into_iter().map(|it| it.addresses.len()).collect();
            assert_eq!(each, [1, 1]);
            let robots = [(own, Some(key(1))), (other, Some(key(1))), (other, None)];
            let robots = robots.map(|(address, key)| (found("walker", address), key));
            assert_eq!(prove_all(&robots), [Some(true), Some(false), None]);
        });
    }

    #[test]
    fn no_more_are_greeted_than_may_be() {
        let keys = [key(1)];
        let keys: Vec<_> = keys.iter().collect();
        let mut search = Search { name: "walker", keys: &keys, greeted: Vec::new(), first: None };
        for port in 0..250 {
            search.take(Some(found("walker", SocketAddr::from(([127, 0, 0, 1], 20_000 + port)))));
        }
        assert_eq!(search.greeted.len(), MOST_GREETED);
    }

    #[test]
    fn of_those_that_prove_a_key_the_one_is_taken_that_answers_soonest() {
        beside([(1, 60), (1, 0), (1, 60), (9, 0)], |[slow, quick, slower, stranger]| {
            let (key, never) = (key(1), Interrupt::never());
            for proved in [vec![slow, quick, slower], vec![quick, slow], vec![slow, slower, quick]]
            {
                assert_eq!(quickest(&proved, &[&key], &never), Some(quick));
            }
            assert_eq!(quickest(&[slow], &[&key], &never), Some(slow));
            assert_eq!(quickest(&[], &[&key], &never), None);
            assert_eq!(race(&[stranger], &[&key], &never), None);
            assert!(proves(quick, &key, Duration::from_secs(5)));
            assert!(!proves(stranger, &key, Duration::from_millis(100)));
        });
    }
}
