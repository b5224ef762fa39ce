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
pub const PROVERS: Duration = Duration::from_millis(300);
/// How often it is found out then who answers first.
const RACES: usize = 5;
/// Interval of the looks for who that is.
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
    /// What it announces, for example `board` and `version`. Not authenticated.
    pub properties: BTreeMap<String, String>,
}

impl Found {
    /// Returns the first address for datagrams.
    #[must_use]
    pub fn socket_address(&self) -> Option<SocketAddr> {
        self.socket_addresses().next()
    }

    fn socket_addresses(&self) -> impl Iterator<Item = SocketAddr> + '_ {
        self.addresses.iter().map(|address| SocketAddr::new(*address, self.port))
    }
}

/// Multicast does not work on this machine.
#[derive(Debug, thiserror::Error)]
#[error("the search for robots failed: {0}; give the robot's address instead of its name")]
pub struct DiscoveryError(#[from] mdns_sd::Error);

/// Searches for this time, and returns every robot found, by name.
///
/// # Errors
/// When multicast does not work on this machine.
pub fn browse(duration: Duration, interrupt: &Interrupt) -> Result<Vec<Found>, DiscoveryError> {
    let mut robots = BTreeMap::new();
    listen(duration, interrupt, |found| {
        robots.extend(found.map(|found| (found.name.clone(), found)));
        false
    })?;
    Ok(robots.into_values().collect())
}

/// Searches for one robot by its name, for at most [`FIND_PATIENCE`], and returns the address that proves to have one of these
/// keys; of several that do within [`PROVERS`], the one that answers soonest: somebody in between is never the quicker way.
/// Whoever is in the network can answer for it, and faster; when nobody proves it, the first that answered is returned, whose
/// handshake says what is wrong.
///
/// # Errors
/// When multicast does not work on this machine.
pub fn find<'a>(
    name: &str,
    keys: impl Iterator<Item = &'a Key>,
    interrupt: &Interrupt,
) -> Result<Option<SocketAddr>, DiscoveryError> {
    let keys: Vec<_> = keys.collect();
    let mut proved = Vec::new();
    let mut since = None;
    let greeted = find_each(name, &keys, interrupt, |address| {
        proved.extend(address);
        since = since.or_else(|| address.map(|_| Instant::now()));
        since.is_some_and(|since| since.elapsed() > PROVERS)
    })?;
    let quickest = match proved[..] {
        [] => greeted,
        [only] => Some(only),
        _ => {
            let mut runners = proved.clone();
            let won = (0..RACES).filter_map(|_| {
                // None begins each time.
                let count = runners.len();
                runners.rotate_left(count.div_ceil(RACES) % count);
                race(&runners, &keys, interrupt)
            });
            let won: Vec<_> = won.collect();
            let wins = |address: &SocketAddr| won.iter().filter(|it| *it == address).count();
            proved.into_iter().max_by_key(wins)
        }
    };
    Ok(quickest)
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
    mut each: impl FnMut(Option<SocketAddr>) -> bool,
) -> Result<Option<SocketAddr>, DiscoveryError> {
    let mut greeted: Vec<Greeted> = Vec::new();
    let mut first = None;
    listen(FIND_PATIENCE, interrupt, |found| {
        let named = found.filter(|it| it.name.eq_ignore_ascii_case(name));
        for address in named.iter().flat_map(Found::socket_addresses) {
            let is_new = greeted.iter().all(|it| it.address != address);
            if is_new && greeted.len() < MOST_GREETED {
                first = first.or(Some(address));
                greeted.extend(keys.iter().filter_map(|key| Greeted::new(address, key)));
            }
        }
        let proved = greeted.iter_mut().filter(|it| !it.has_proved).filter_map(|it| {
            it.has_proved = it.proves().unwrap_or(false);
            it.has_proved.then_some(it.address)
        });
        // All before the next look, whatever `each` says of the first.
        let proved: Vec<_> = proved.map(Some).chain([None]).collect();
        proved.into_iter().filter(|it| each(*it)).count() > 0
    })?;
    Ok(first)
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
        let socket = super::udp::socket_to(address).ok()?;
        socket.set_nonblocking(true).ok()?;
        let greeting = StopSession::new(key, entropy, protocol::Instant::START);
        Some(Self { address, socket, greeting, begin: Instant::now(), has_proved: false })
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
