//! Who may see a live stream: what stands before the library that serves it.
//!
//! Every page that a browser on this computer shows may open a WebSocket to a port of this computer, and a name that was made
//! to point here (DNS rebinding) leads here too. The library checks neither `Origin` nor `Host`, takes no socket that was
//! accepted elsewhere, and has no hook before its answer. So it listens where nobody looks ([`hidden`]), and the front takes
//! the viewers: it reads what each asks, refuses whom it must, and passes the bytes of all others on.
//!
//! A viewer gets little time to ask, and few may wait or look at once. One more turns out the one who has waited or looked
//! longest in the [most crowded](most_crowded) place: whoever opens many and never leaves keeps nobody else out.

use std::io::{self, Read as _, Write as _};
use std::net::{IpAddr, Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use flix_host::teleop::page::connection_limits::most_crowded;

/// Pages that show streams: Foxglove's own and Lichtblick's.
const VIEWERS: [&str; 4] = [
    "https://app.foxglove.dev",
    "https://embed.foxglove.dev",
    "https://studio.foxglove.dev",
    "https://lichtblick-suite.github.io",
];
/// What programs state as their origin that are no page of a site: both desktop programs are built on Electron.
const PROGRAM: &str = "file://";
/// Time in which a viewer asks.
const PATIENCE: Duration = Duration::from_secs(5);
/// Those that have not asked yet.
const MOST_WAITING: usize = 32;
/// Those that see the stream.
const MOST_VIEWERS: usize = 16;
/// Longest question, bytes: a browser's has some 600.
const LONGEST_QUESTION: usize = 8 << 10;
/// Addresses of loopback that are tried for the library.
const ATTEMPTS: usize = 8;

/// Why a viewer is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// It does not ask as viewers do.
    #[error("400 Bad Request")]
    Malformed,
    /// It asks for this computer by a name that others may have made.
    #[error("421 Misdirected Request")]
    Host,
    /// It is the page of a site that was not named.
    #[error("403 Forbidden")]
    Origin,
}

impl Refusal {
    /// Returns what to do, for a person.
    const fn advice(self) -> &'static str {
        match self {
            Self::Malformed => "open this address as a WebSocket in Foxglove or Lichtblick",
            Self::Host => {
                "open the stream by an address of this computer, such as 127.0.0.1, or localhost"
            }
            Self::Origin => {
                "name the site of this page with --foxglove-origin to show it the stream"
            }
        }
    }
}

/// Checks what a viewer asks, from its first line to the empty one.
///
/// # Errors
/// When it may not see the stream.
pub fn check(question: &str, named: &[String]) -> Result<(), Refusal> {
    let mut lines = question.split("\r\n");
    if !lines.next().is_some_and(|line| line.starts_with("GET ") && line.ends_with(" HTTP/1.1")) {
        return Err(Refusal::Malformed);
    }
    let (mut hosts, mut origins) = (Vec::new(), Vec::new());
    for line in lines.take_while(|line| !line.is_empty()) {
        let (name, value) = line.split_once(':').ok_or(Refusal::Malformed)?;
        // What the library might read as another header than this reader.
        let is_plain =
            !name.is_empty() && !name.contains([' ', '\t']) && !line.contains(['\r', '\n']);
        if !is_plain {
            return Err(Refusal::Malformed);
        }
        match name {
            name if name.eq_ignore_ascii_case("host") => hosts.push(value.trim()),
            name if name.eq_ignore_ascii_case("origin") => origins.push(value.trim()),
            _ => {}
        }
    }
    match hosts[..] {
        [host] if is_address(host) || is_localhost(host) => {}
        [_] => return Err(Refusal::Host),
        _ => return Err(Refusal::Malformed),
    }
    match origins[..] {
        [] => Ok(()),
        [origin] if may_look(origin, named) => Ok(()),
        [_] => Err(Refusal::Origin),
        _ => Err(Refusal::Malformed),
    }
}

/// Returns the host of an authority, without its port.
fn host(authority: &str) -> &str {
    match authority.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((address, _)) => address,
        None => authority.split(':').next().unwrap_or_default(),
    }
}

fn is_address(authority: &str) -> bool {
    host(authority).parse::<IpAddr>().is_ok()
}

fn is_localhost(authority: &str) -> bool {
    host(authority).eq_ignore_ascii_case("localhost")
}

/// Returns whether pages of this origin may see the stream: those of this computer, of the two viewers, and of the sites that
/// were named.
fn may_look(origin: &str, named: &[String]) -> bool {
    let authority = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
    let is_here = authority.is_some_and(|authority| {
        let is_loopback = host(authority).parse().is_ok_and(|it: IpAddr| it.is_loopback());
        is_loopback || is_localhost(authority)
    });
    let is = |known: &str| known.eq_ignore_ascii_case(origin);
    is_here || is(PROGRAM) || VIEWERS.iter().any(|known| is(known)) || named.iter().any(|it| is(it))
}

/// Returns an address of loopback that no page finds: all of 127.0.0.0/8 leads here on Linux and Windows. Elsewhere it is
/// 127.0.0.1, where the library's port alone is not known.
pub fn hidden() -> Ipv4Addr {
    let random = || {
        let mut bytes = [0; 3];
        getrandom::fill(&mut bytes).ok()?;
        let [a, b, c] = bytes;
        let address = Ipv4Addr::new(127, a, b, c);
        TcpListener::bind((address, 0)).is_ok().then_some(address)
    };
    (0..ATTEMPTS).find_map(|_| random()).unwrap_or(Ipv4Addr::LOCALHOST)
}

/// Takes viewers at an address. Ends when it is dropped.
pub struct Front {
    address: SocketAddr,
    ends: Arc<AtomicBool>,
}

/// Who is here.
struct Visitor {
    number: u64,
    address: IpAddr,
    socket: TcpStream,
}

/// Those that are here, the longest first.
#[derive(Default)]
struct Hall {
    came: u64,
    /// Those that have not asked yet.
    waiting: Vec<Visitor>,
    /// Those that see the stream.
    viewers: Vec<Visitor>,
}

impl Hall {
    /// Takes in one more who has not asked.
    fn admit(&mut self, socket: TcpStream) -> u64 {
        if self.waiting.len() >= MOST_WAITING {
            self.turn_out();
        }
        self.came += 1;
        // None once its socket is at its end.
        let address = socket.peer_addr().map_or(Ipv4Addr::UNSPECIFIED.into(), |it| it.ip());
        self.waiting.push(Visitor { number: self.came, address, socket });
        self.came
    }

    /// Makes one a viewer, unless it was turned out while it asked.
    fn welcome(&mut self, number: u64) -> bool {
        let Some(place) = self.waiting.iter().position(|it| it.number == number) else {
            return false;
        };
        let viewer = self.waiting.remove(place);
        if self.viewers.len() >= MOST_VIEWERS {
            turn_out(&mut self.viewers);
        }
        self.viewers.push(viewer);
        true
    }

    /// Turns out one who waits.
    fn turn_out(&mut self) {
        turn_out(&mut self.waiting);
    }

    fn forget(&mut self, number: u64) {
        self.waiting.retain(|it| it.number != number);
        self.viewers.retain(|it| it.number != number);
    }
}

/// Turns out the first in the most crowded place.
fn turn_out(visitors: &mut Vec<Visitor>) {
    let addresses: Vec<_> = visitors.iter().map(|it| it.address).collect();
    if let Some(place) = most_crowded(&addresses) {
        let _ = visitors.remove(place).socket.shutdown(Shutdown::Both);
    }
}

impl Front {
    /// Takes viewers at this listener, and passes them on to the library's address.
    ///
    /// # Errors
    /// When the operating system refuses a thread.
    pub fn open(
        listener: TcpListener,
        library: SocketAddr,
        named: Vec<String>,
    ) -> io::Result<Self> {
        let address = listener.local_addr()?;
        let ends = Arc::new(AtomicBool::new(false));
        let (ended, named) = (Arc::clone(&ends), Arc::new(named));
        thread::Builder::new().name("viewers".to_owned()).spawn(move || {
            let hall = Arc::new(Mutex::new(Hall::default()));
            for socket in listener.incoming() {
                if ended.load(Ordering::SeqCst) {
                    return;
                }
                let Ok(socket) = socket else {
                    // Descriptors are short; one that waits gives his back.
                    in_hall(&hall, Hall::turn_out);
                    thread::sleep(Duration::from_millis(10));
                    continue;
                };
                let (hall, named) = (Arc::clone(&hall), Arc::clone(&named));
                let visit = move || {
                    let _ = visit(socket, library, &named, &hall);
                };
                // Where there is no thread for him, he is turned away.
                let _ = thread::Builder::new().name("viewer".to_owned()).spawn(visit);
            }
        })?;
        Ok(Self { address, ends })
    }

    /// Returns the address.
    pub const fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Front {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::SeqCst);
        // Wakes the thread.
        let ip = match self.address.ip() {
            ip if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
            ip => ip,
        };
        let _ = TcpStream::connect_timeout(&(ip, self.address.port()).into(), PATIENCE);
    }
}

fn in_hall<T>(hall: &Mutex<Hall>, act: impl FnOnce(&mut Hall) -> T) -> T {
    act(&mut hall.lock().unwrap_or_else(PoisonError::into_inner))
}

/// Reads what a viewer asks, and passes it on or refuses it.
fn visit(
    mut viewer: TcpStream,
    library: SocketAddr,
    named: &[String],
    hall: &Mutex<Hall>,
) -> io::Result<()> {
    let other = viewer.try_clone()?;
    let number = in_hall(hall, |hall| hall.admit(other));
    let visited = question(&mut viewer).and_then(|question| {
        let text = std::str::from_utf8(&question).map_err(|_| Refusal::Malformed);
        match text.and_then(|text| check(text, named)) {
            Err(refusal) => refuse(viewer, refusal),
            Ok(()) if in_hall(hall, |hall| hall.welcome(number)) => {
                pass_on(viewer, library, &question)
            }
            Ok(()) => Ok(()),
        }
    });
    in_hall(hall, |hall| hall.forget(number));
    visited
}

fn refuse(mut viewer: TcpStream, refusal: Refusal) -> io::Result<()> {
    let advice = refusal.advice();
    let length = advice.len() + 1;
    write!(
        viewer,
        "HTTP/1.1 {refusal}\r\nContent-Type: text/plain\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{advice}\n"
    )
}

/// Reads up to the empty line that ends a question.
fn question(viewer: &mut TcpStream) -> io::Result<Vec<u8>> {
    let begun = Instant::now();
    let mut question = Vec::new();
    let mut bytes = [0; 1024];
    while !question.ends_with(b"\r\n\r\n") {
        let left = PATIENCE.saturating_sub(begun.elapsed());
        if left.is_zero() || question.len() > LONGEST_QUESTION {
            return Err(io::ErrorKind::TimedOut.into());
        }
        viewer.set_read_timeout(Some(left))?;
        match viewer.read(&mut bytes)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            length => question.extend(&bytes[..length]),
        }
    }
    viewer.set_read_timeout(None)?;
    Ok(question)
}

/// Carries bytes both ways until one end closes.
fn pass_on(mut viewer: TcpStream, library: SocketAddr, question: &[u8]) -> io::Result<()> {
    let mut server = TcpStream::connect(library)?;
    server.set_nodelay(true)?;
    viewer.set_nodelay(true)?;
    server.write_all(question)?;
    let (mut from_server, mut to_viewer) = (server.try_clone()?, viewer.try_clone()?);
    let answers = thread::Builder::new().name("viewer".to_owned()).spawn(move || {
        let _ = io::copy(&mut from_server, &mut to_viewer);
        let _ = to_viewer.shutdown(Shutdown::Both);
        let _ = from_server.shutdown(Shutdown::Both);
    })?;
    let _ = io::copy(&mut viewer, &mut server);
    let _ = server.shutdown(Shutdown::Both);
    let _ = viewer.shutdown(Shutdown::Both);
    // A thread that panics has carried all that it could.
    let _ = answers.join();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(headers: &str) -> Result<(), Refusal> {
        let named = ["https://robots.example".to_owned()];
        check(&format!("GET / HTTP/1.1\r\n{headers}\r\n\r\n"), &named)
    }

    #[test]
    fn viewers_of_this_computer_and_the_two_known_ones_and_named_ones_may_look() {
        for origin in [
            "http://localhost:8080",
            "http://127.0.0.1",
            "https://[::1]:9",
            "https://app.foxglove.dev",
            "https://lichtblick-suite.github.io",
            "https://robots.example",
            "file://",
        ] {
            for host in ["localhost:8765", "127.0.0.1:8765", "192.168.1.7:8765", "[::1]:8765"] {
                let asked = asked(&format!("Host: {host}\r\nOrigin: {origin}"));
                assert_eq!(asked, Ok(()), "{host}, {origin}");
            }
        }
        assert_eq!(asked("host:127.0.0.1"), Ok(()), "a program states no origin");
    }

    #[test]
    fn pages_of_other_sites_may_not() {
        for origin in [
            "null",
            "https://evil.example",
            "http://localhost.evil.example",
            "http://127.0.0.1.evil.example",
            "https://app.foxglove.dev.evil.example",
            "http://app.foxglove.dev",
            "https://robots.example:8443",
            "http://192.168.1.9",
            "ftp://localhost",
            "",
        ] {
            let asked = asked(&format!("Host: 127.0.0.1:8765\r\nOrigin: {origin}"));
            assert_eq!(asked, Err(Refusal::Origin), "{origin}");
        }
    }

    #[test]
    fn names_that_others_can_make_lead_nowhere() {
        for host in ["evil.example:8765", "127.0.0.1.evil.example", "walker", "localhost.evil", ""]
        {
            assert_eq!(asked(&format!("Host: {host}")), Err(Refusal::Host), "{host}");
        }
    }

    #[test]
    fn what_two_readers_may_read_differently_is_refused() {
        for headers in [
            "Accept: all",
            "Host: 127.0.0.1\r\nHost: evil.example",
            "Host: 127.0.0.1\r\nOrigin: file://\r\nOrigin: https://evil.example",
            "Host: 127.0.0.1\r\nOrigin : https://evil.example",
            "Host: 127.0.0.1\r\n Origin: https://evil.example",
            "Host: 127.0.0.1\r\nX: y\nOrigin: https://evil.example",
            "Host: 127.0.0.1\r\nnothing",
        ] {
            let asked = asked(headers);
            assert_eq!(asked, Err(Refusal::Malformed), "{headers:?}");
        }
        assert_eq!(
            check("POST / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", &[]),
            Err(Refusal::Malformed)
        );
    }

    #[test]
    fn those_that_wait_turn_out_none_who_look() {
        let library = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let to = library.local_addr().unwrap();
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let front = Front::open(listener, to, Vec::new()).unwrap();
        let come = || TcpStream::connect(front.address()).unwrap();
        let mut viewer = come();
        viewer.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
        let (mut served, _) = library.accept().unwrap();
        let idle: Vec<_> = (0..3 * MOST_WAITING).map(|_| come()).collect();
        let mut late = come();
        late.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
        drop(library.accept().unwrap());
        served.write_all(b"row").unwrap();
        let mut row = [0; 3];
        viewer.read_exact(&mut row).unwrap();
        assert_eq!((&row, idle.len()), (b"row", 3 * MOST_WAITING));
    }

    #[test]
    fn viewers_that_never_leave_keep_out_no_other() {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let mut hall = Hall::default();
        let mut look = |address: [u8; 4]| {
            let viewer = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
            let number = hall.admit(listener.accept().unwrap().0);
            hall.waiting.last_mut().unwrap().address = address.into();
            assert!(hall.welcome(number));
            viewer.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
            viewer
        };
        let lone = look([10, 0, 2, 1]);
        let many: Vec<_> =
            (0..2 * MOST_VIEWERS).map(|number| look([10, 0, 1, number as u8])).collect();
        let late = look([10, 0, 3, 1]);
        let looks_on = |mut viewer: &TcpStream| viewer.read(&mut [0]).is_err();
        assert!(looks_on(&lone) && looks_on(&late));
        // Who stays: 15 of them beside the first, 14 beside the late one too, the newest.
        let stay: Vec<_> = many.iter().map(looks_on).collect();
        let newest: Vec<_> = (0..many.len()).map(|it| it >= many.len() - 14).collect();
        assert_eq!(stay, newest);
    }
}
