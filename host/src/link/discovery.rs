//! Finds the robots that announce themselves on the local network (mDNS and DNS-SD).

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use flix_protocol::frame::MAXIMUM_DATAGRAM;
use flix_protocol::session::{Key, OperatorReceived, OperatorSession};
use flix_protocol::units as protocol;
use flix_protocol::{DEFAULT_PORT, SERVICE_TYPE};
use mdns_sd::{ResolvedService, ServiceDaemon, ServiceEvent};

use crate::interrupt::Interrupt;

/// Longest search for a name: mDNS answers within 0.1 s, and repeats its question after 1 s.
pub const FIND_PATIENCE: Duration = Duration::from_millis(2500);
/// Longest wait for the answer of a simulated robot on this computer.
const GREETING_PATIENCE: Duration = Duration::from_millis(300);
/// Interval of the checks for interruption.
const SLICE: Duration = Duration::from_millis(50);

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
    /// Returns the address for datagrams.
    #[must_use]
    pub fn socket_address(&self) -> Option<SocketAddr> {
        self.addresses.first().map(|address| SocketAddr::new(*address, self.port))
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
        robots.insert(found.name.clone(), found);
        false
    })?;
    Ok(robots.into_values().collect())
}

/// Searches for one robot by its name, for at most [`FIND_PATIENCE`].
///
/// # Errors
/// When multicast does not work on this machine.
pub fn find(name: &str, interrupt: &Interrupt) -> Result<Option<Found>, DiscoveryError> {
    let mut wanted = None;
    listen(FIND_PATIENCE, interrupt, |found| {
        if found.name.eq_ignore_ascii_case(name) && found.socket_address().is_some() {
            wanted = Some(found);
        }
        wanted.is_some()
    })?;
    Ok(wanted)
}

/// Looks for a simulated robot with this key on this computer, where multicast seldom reaches. It is greeted only: its
/// session, if it has one, goes on.
#[must_use]
pub fn on_this_computer(name: &str, key: Key) -> Option<Found> {
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, DEFAULT_PORT));
    let mut entropy = [0; 32];
    getrandom::fill(&mut entropy).ok()?;
    let mut session = OperatorSession::new(key, entropy, protocol::Instant::START);
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).ok()?;
    socket.set_read_timeout(Some(GREETING_PATIENCE)).ok()?;
    socket.connect(address).ok()?;
    socket.send(&session.poll(protocol::Instant::START)?).ok()?;
    let mut answer = [0; MAXIMUM_DATAGRAM];
    let length = socket.recv(&mut answer).ok()?;
    let answered = session.receive(protocol::Instant::START, &answer[..length]);
    let is_robot = !matches!(answered, OperatorReceived::Dropped(_));
    is_robot.then(|| Found {
        name: name.to_owned(),
        addresses: vec![address.ip()],
        port: address.port(),
        properties: BTreeMap::from([("board".to_owned(), "simulated".to_owned())]),
    })
}

/// Passes every robot found to `enough`, until it returns true or the time is over.
fn listen(
    duration: Duration,
    interrupt: &Interrupt,
    mut enough: impl FnMut(Found) -> bool,
) -> Result<(), DiscoveryError> {
    let daemon = ServiceDaemon::new()?;
    let events = daemon.browse(SERVICE_TYPE)?;
    let deadline = Instant::now() + duration;
    while Instant::now() < deadline && !interrupt.is_raised() {
        if let Ok(ServiceEvent::ServiceResolved(service)) = events.recv_timeout(SLICE)
            && enough(found(&service))
        {
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
        name: name.unwrap_or(&service.fullname).to_owned(),
        addresses,
        port: service.port,
        properties: properties
            .map(|property| (property.key().to_owned(), property.val_str().to_owned()))
            .collect(),
    }
}
