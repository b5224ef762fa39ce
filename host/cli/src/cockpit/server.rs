//! The sockets: serves the page and its WebSocket on a thread of its own.
//!
//! The loop that drives the robot never waits for a page: pages get the newest snapshot when they can take one, and
//! what they say waits in a bounded queue.

use std::collections::BTreeSet;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::time::Duration;

use axum::Router;
use axum::extract::ws::{Message as Frame, WebSocket, WebSocketUpgrade};
use axum::extract::{Path, State};
use axum::http::header::{self, HeaderMap};
use axum::http::{HeaderName, StatusCode};
use axum::response::{Html, IntoResponse, Redirect, Response};
use axum::routing::get;
use futures_util::{SinkExt as _, StreamExt as _};
use tokio::sync::{Semaphore, watch};
use tokio::time::timeout;

use super::guard::{Guard, Refusal, hexadecimal};
use super::listener::{self, Visitor};
use crate::by_hand::drive::Gone;
use flix_host::teleop::page::html::Page;
use flix_host::teleop::page::message::Message;
use flix_host::teleop::page::pages::PageId;
use flix_host::teleop::page::snapshot::{self, EXTRAS};

/// How the page reaches this program.
const CONNECTION: &str = include_str!("connection.js");
/// Pages that are open at once.
const MOST_PAGES: usize = 16;
/// Longest message that is read at all, bytes: only messages of pages are obeyed, which are shorter.
const LONGEST_READ: usize = 4096;
/// Messages of pages that wait: a second of all pages. A page whose message finds no place is closed.
const QUEUE: usize = 1024;
/// Time in which a page takes and answers a snapshot; one that is out of reach, as a phone is beyond its radio, does neither and
/// gives its place back.
const LONGEST_SEND: Duration = Duration::from_secs(10);
/// Snapshots on the way to a page and back at once.
const UNANSWERED: u64 = 4;

/// What happens at the pages.
#[derive(Debug, Clone, PartialEq)]
pub enum FromPage {
    /// A page was opened.
    Opened,
    /// It says something.
    Said(Message),
    /// It says what no page says, and is closed.
    Misused,
    /// It is closed.
    Closed,
}

/// Why pages cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address cannot be used.
    #[error(
        "cannot serve at {address}: {source}; choose an address of this computer and a free port with --bind (port 0: any free)"
    )]
    Bind {
        /// The address.
        address: SocketAddr,
        /// What the system said.
        source: io::Error,
    },
    /// The operating system gave no randomness for the token.
    #[error("the operating system gave no random numbers for the token: {0}")]
    Random(#[from] getrandom::Error),
    /// The thread cannot run.
    #[error("the page cannot be served: {0}")]
    Thread(#[from] io::Error),
}

/// A server of pages. When it is dropped, all pages are closed.
pub struct Server {
    address: SocketAddr,
    token: String,
    snapshots: watch::Sender<Arc<str>>,
    extras: [watch::Sender<Arc<str>>; EXTRAS.len()],
    /// Pages that are asked to close, and have not yet.
    closing: watch::Sender<BTreeSet<PageId>>,
    events: Receiver<(PageId, FromPage)>,
}

#[derive(Clone)]
struct Shared {
    guard: Arc<Guard>,
    snapshots: watch::Receiver<Arc<str>>,
    extras: [watch::Receiver<Arc<str>>; EXTRAS.len()],
    closing: watch::Receiver<BTreeSet<PageId>>,
    events: SyncSender<(PageId, FromPage)>,
    next: Arc<AtomicU32>,
    places: Arc<Semaphore>,
    holds_to_run: bool,
}

impl Server {
    /// Begins to serve at this address, and by these names ([`Guard::with_names`]); port 0 is any free port. Pages that hold to run
    /// let the robot rest when the key or button of a walk is released.
    ///
    /// # Errors
    /// When the address cannot be used, or the operating system refuses a thread or randomness.
    pub fn start(
        address: SocketAddr,
        names: &[String],
        holds_to_run: bool,
    ) -> Result<Self, ServeError> {
        let bind = |source| ServeError::Bind { address, source };
        let listener = TcpListener::bind(address).map_err(bind)?;
        listener.set_nonblocking(true)?;
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build()?;
        Self::on_a_thread(listener.local_addr()?, names, holds_to_run, move |shared| {
            let mut closed = shared.snapshots.clone();
            runtime.block_on(async {
                let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
                tokio::select! {
                    never = listener::serve(listener, |visitor| shared.pages(visitor)) => match never {},
                    () = async { while closed.changed().await.is_ok() {} } => {}
                }
            });
        })
    }

    /// Begins to serve at this address by this work, on a thread of its own.
    fn on_a_thread(
        address: SocketAddr,
        names: &[String],
        holds_to_run: bool,
        work: impl FnOnce(Shared) + Send + 'static,
    ) -> Result<Self, ServeError> {
        let mut entropy = [0; 16];
        getrandom::fill(&mut entropy)?;
        let guard = Guard::new(address, entropy).with_names(names);
        let token = guard.token().to_owned();
        let (snapshots, shown) = watch::channel(Arc::from(""));
        let extras = EXTRAS.map(|_| watch::Sender::new(Arc::from("")));
        let (closing, asked_to_close) = watch::channel(BTreeSet::new());
        let (sender, events) = sync_channel(QUEUE);
        let shared = Shared {
            guard: Arc::new(guard),
            snapshots: shown,
            extras: extras.each_ref().map(watch::Sender::subscribe),
            closing: asked_to_close,
            events: sender,
            next: Arc::default(),
            places: Arc::new(Semaphore::new(MOST_PAGES)),
            holds_to_run,
        };
        std::thread::Builder::new().name("pages".to_owned()).spawn(move || work(shared))?;
        Ok(Self { address, token, snapshots, extras, closing, events })
    }

    /// Returns the addresses of the page for a browser: the one that is bound, or where every one is, all that other computers
    /// may reach this one by, the likeliest first.
    #[must_use]
    pub fn urls(&self) -> Vec<String> {
        let addresses = if self.address.ip().is_unspecified() {
            let known = if_addrs::get_if_addrs().unwrap_or_default();
            let known = known.into_iter().filter(if_addrs::Interface::is_oper_up);
            let known = known.map(|card| (card.ip(), is_virtual(&card.name)));
            reachable(self.address.ip(), outward(self.address), known.collect())
        } else {
            vec![self.address.ip()]
        };
        let url = |address| {
            format!("http://{}/{}/", SocketAddr::new(address, self.address.port()), self.token)
        };
        addresses.into_iter().map(url).collect()
    }

    /// Returns whether other computers can reach it.
    #[must_use]
    pub const fn is_public(&self) -> bool {
        !self.address.ip().to_canonical().is_loopback()
    }

    /// Shows a snapshot to all pages.
    pub fn show(&self, snapshot: String) {
        self.snapshots.send_replace(snapshot.into());
    }

    /// Shows one of the [`EXTRAS`] to all pages, also to those that open later.
    pub fn show_extra(&self, extra: usize, value: serde_json::Value) {
        let text = serde_json::json!({ EXTRAS[extra]: value }).to_string();
        self.extras[extra].send_replace(text.into());
    }

    /// Closes a page, whatever it still has to say.
    pub fn close(&self, page: PageId) {
        self.closing.send_if_modified(|closing| closing.insert(page));
    }

    /// Returns what has happened at a page, oldest first.
    ///
    /// # Errors
    /// When no page can say anything any more, as the thread that serves them has ended.
    pub fn event(&self) -> Result<Option<(PageId, FromPage)>, Gone> {
        match self.events.try_recv() {
            Ok((page, event)) => {
                if matches!(event, FromPage::Closed | FromPage::Misused) {
                    // Which nobody waits for.
                    self.closing.send_if_modified(|closing| {
                        closing.remove(&page);
                        false
                    });
                }
                Ok(Some((page, event)))
            }
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(Gone),
        }
    }

    /// Serves by a thread that fails at once.
    #[cfg(test)]
    pub(super) fn that_fails() -> Self {
        let address = (std::net::Ipv4Addr::LOCALHOST, 0).into();
        Self::on_a_thread(address, &[], false, |_| panic!("a page that cannot be served")).unwrap()
    }
}

/// Returns the address of this computer on the way to the internet, without sending anything.
fn outward(bound: SocketAddr) -> Option<IpAddr> {
    let socket = UdpSocket::bind((bound.ip(), 0)).ok()?;
    socket.connect(("192.0.2.1", 9)).ok()?;
    Some(socket.local_addr().ok()?.ip())
}

/// Returns whether a network card of this name leads to a virtual private network or to virtual machines and containers, which a
/// phone in the room does not reach. Names as Linux, macOS and Windows give them.
fn is_virtual(name: &str) -> bool {
    const BEGINNINGS: [&str; 12] =
        ["br-", "cni", "docker", "ipsec", "lxc", "ppp", "tap", "tun", "utun", "veth", "wg", "zt"];
    const PARTS: [&str; 12] = [
        "hyper-v",
        "nordlynx",
        "podman",
        "proton",
        "tailscale",
        "vbox",
        "virbr",
        "virtualbox",
        "vmnet",
        "vmware",
        "vpn",
        "wsl",
    ];
    let name = name.to_lowercase();
    BEGINNINGS.iter().any(|it| name.starts_with(it)) || PARTS.iter().any(|it| name.contains(it))
}

/// Returns those of a computer's addresses that others reach it by, of the kind that is bound; loopback where it has none. Those of
/// network cards come before those of virtual ones, and both before addresses that the computer chose for want of DHCP (RFC 3927);
/// among equals `first` is first.
fn reachable(bound: IpAddr, first: Option<IpAddr>, mut known: Vec<(IpAddr, bool)>) -> Vec<IpAddr> {
    if let Some(first) = first {
        let is_virtual = known.iter().any(|(address, is_virtual)| *address == first && *is_virtual);
        known.insert(0, (first, is_virtual));
    }
    known.sort_by_key(|(address, is_virtual)| {
        let is_without_dhcp = matches!(address, IpAddr::V4(it) if it.is_link_local());
        (is_without_dhcp, *is_virtual)
    });
    let mut addresses = Vec::new();
    for address in known.into_iter().map(|(address, _)| address.to_canonical()) {
        // Of no use without the name of the card, which no browser takes.
        let is_link_local = matches!(address, IpAddr::V6(it) if it.is_unicast_link_local());
        // What is bound to IPv6 serves both.
        let is_served = bound.is_ipv6() || address.is_ipv4();
        let is_of_use = is_served && !address.is_loopback() && !address.is_unspecified();
        if is_of_use && !is_link_local && !addresses.contains(&address) {
            addresses.push(address);
        }
    }
    if addresses.is_empty() {
        addresses.push(std::net::Ipv4Addr::LOCALHOST.into());
    }
    addresses
}

fn text_of(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

impl Shared {
    /// What a visitor may ask for.
    fn pages(&self, visitor: Visitor) -> Router {
        Router::new()
            .route("/{token}", get(slash))
            .route("/{token}/", get(page))
            .route("/{token}/socket", get(socket))
            .with_state(Asked { shared: self.clone(), visitor })
    }
}

/// A visitor asks.
#[derive(Clone)]
struct Asked {
    shared: Shared,
    visitor: Visitor,
}

impl Asked {
    fn check(&self, token: &str, headers: &HeaderMap, needs_origin: bool) -> Result<(), Refusal> {
        if headers.get_all(header::HOST).iter().count() > 1 {
            return Err(Refusal::Hosts);
        }
        let (host, origin) = (text_of(headers, header::HOST), text_of(headers, header::ORIGIN));
        self.shared.guard.check(token, host, origin, needs_origin)?;
        self.visitor.welcome();
        Ok(())
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        // Whoever guesses comes anew each time.
        let close = [(header::CONNECTION, "close")];
        let status = match self {
            Self::Hosts => StatusCode::BAD_REQUEST,
            _ => StatusCode::FORBIDDEN,
        };
        (status, close, format!("{self}\n")).into_response()
    }
}

/// Redirects an address without its last slash to the page.
async fn slash(
    State(asked): State<Asked>,
    Path(token): Path<String>,
    headers: HeaderMap,
) -> Response {
    match asked.check(&token, &headers, false) {
        Ok(()) => Redirect::permanent(&format!("{token}/")).into_response(),
        Err(refusal) => refusal.into_response(),
    }
}

async fn page(
    State(asked): State<Asked>,
    Path(token): Path<String>,
    headers: HeaderMap,
) -> Response {
    if let Err(refusal) = asked.check(&token, &headers, false) {
        return refusal.into_response();
    }
    let mut entropy = [0; 16];
    if getrandom::fill(&mut entropy).is_err() {
        return StatusCode::INTERNAL_SERVER_ERROR.into_response();
    }
    let nonce = hexadecimal(entropy);
    let holds_to_run = asked.shared.holds_to_run;
    let html = Page { connection: CONNECTION, holds_to_run, ..Page::default() }.to_html(&nonce);
    let host = text_of(&headers, header::HOST).unwrap_or_default();
    // Older browsers take 'self' for no WebSocket; the grammar has no addresses of IPv6.
    let socket =
        if host.starts_with('[') { String::new() } else { format!(" ws://{host} wss://{host}") };
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; img-src data:; \
         connect-src 'self'{socket}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    let secure = [
        (header::CONTENT_SECURITY_POLICY, policy.as_str()),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ]
    .map(|(name, value)| (name, value.to_owned()));
    (secure, Html(html)).into_response()
}

async fn socket(
    State(asked): State<Asked>,
    Path(token): Path<String>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if let Err(refusal) = asked.check(&token, &headers, true) {
        return refusal.into_response();
    }
    let shared = asked.shared;
    let Ok(place) = Arc::clone(&shared.places).try_acquire_owned() else {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many pages are open\n").into_response();
    };
    upgrade.max_message_size(LONGEST_READ).max_frame_size(LONGEST_READ).on_upgrade(
        async move |socket| {
            let id = shared.next.fetch_add(1, Ordering::Relaxed);
            // The receiver is gone only when the program ends.
            if shared.events.try_send((id, FromPage::Opened)).is_ok() {
                let ended = talk(id, socket, &shared).await;
                // Whatever the queue holds, this must not be lost: it leaves the robot without an operator.
                let _ = shared.events.send((id, ended));
            }
            drop(place);
        },
    )
}

/// Talks with a page until it is closed; returns how it ended. A page answers each snapshot: where [`UNANSWERED`] are under way
/// the next one waits, so that what a slow connection shows is late by no more than these.
async fn talk(id: PageId, socket: WebSocket, shared: &Shared) -> FromPage {
    let (mut to_page, mut from_page) = socket.split();
    let (mut snapshots, mut extras) = (shared.snapshots.clone(), shared.extras.clone());
    for extra in extras.iter_mut().filter(|extra| !extra.borrow().is_empty()) {
        extra.mark_changed();
    }
    let [mut settings, mut scope] = extras;
    let (answered, mut answers) = watch::channel(0_u64);
    let show = async {
        let mut sent = 0;
        let mut text = snapshot::hello(id);
        while let Ok(Ok(())) = timeout(LONGEST_SEND, to_page.send(Frame::text(text))).await {
            let picture = async {
                let is_heard = answers.wait_for(|answered| *answered + UNANSWERED > sent);
                timeout(LONGEST_SEND, is_heard).await.ok()?.ok()?;
                snapshots.changed().await.ok()
            };
            // What is long comes after pictures that state whether a stop was heard with which the page has begun.
            let has_begun = sent > 2 * UNANSWERED;
            let newest = tokio::select! {
                changed = settings.changed(), if has_begun => changed.ok().map(|()| settings.borrow_and_update().to_string()),
                changed = scope.changed(), if has_begun => changed.ok().map(|()| scope.borrow_and_update().to_string()),
                changed = picture => changed.map(|()| {
                    sent += 1;
                    snapshots.borrow_and_update().to_string()
                }),
            };
            let Some(newest) = newest else { break };
            text = newest;
        }
    };
    let hear = async {
        while let Some(frame) = from_page.next().await {
            let said = match frame {
                Ok(Frame::Text(text)) => Message::parse(&text),
                Ok(Frame::Ping(_) | Frame::Pong(_)) => continue,
                Ok(Frame::Close(_)) => break,
                Ok(Frame::Binary(_)) => None,
                // A connection that breaks is a page that is closed.
                Err(_) => break,
            };
            let Some(said) = said else { return FromPage::Misused };
            if said.request.is_none() {
                answered.send_modify(|answered| *answered += 1);
            }
            if shared.events.try_send((id, FromPage::Said(said))).is_err() {
                return FromPage::Misused;
            }
        }
        FromPage::Closed
    };
    let mut closing = shared.closing.clone();
    tokio::select! {
        _ = closing.wait_for(|closing| closing.contains(&id)) => FromPage::Closed,
        () = show => FromPage::Closed,
        ended = hear => ended,
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read as _, Write as _};
    use std::net::TcpStream;

    use super::*;

    #[test]
    fn a_server_whose_thread_has_failed_says_so() {
        let server = Server::that_fails();
        let event = loop {
            match server.event() {
                Ok(None) => std::thread::yield_now(),
                event => break event,
            }
        };
        assert_eq!(event, Err(Gone));
    }

    /// Waits for what happens next at a page.
    fn next(server: &Server) -> (PageId, FromPage) {
        loop {
            match server.event().unwrap() {
                Some(event) => return event,
                None => std::thread::yield_now(),
            }
        }
    }

    fn serve() -> Server {
        Server::start((std::net::Ipv4Addr::LOCALHOST, 0).into(), &[], false).unwrap()
    }

    fn open(server: &Server) -> (PageId, TcpStream) {
        let mut socket = TcpStream::connect(server.address).unwrap();
        let request = format!(
            "GET /{1}/socket HTTP/1.1\r\nHost: {0}\r\nOrigin: http://{0}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n",
            server.address, server.token
        );
        socket.write_all(request.as_bytes()).unwrap();
        let (page, event) = next(server);
        assert_eq!(event, FromPage::Opened);
        (page, socket)
    }

    /// Returns the text of the next frame: its kind, its length below 126, its text.
    fn text(socket: &mut TcpStream) -> String {
        let mut head = [0; 2];
        socket.read_exact(&mut head).unwrap();
        let mut text = vec![0; head[1].into()];
        socket.read_exact(&mut text).unwrap();
        String::from_utf8(text).unwrap()
    }

    fn answer(socket: &mut TcpStream) {
        // Masked by zeros.
        let answer = br#"{"seen":0}"#;
        socket.write_all(&[&[0x81, 0x80 | 10, 0, 0, 0, 0], answer.as_slice()].concat()).unwrap();
    }

    #[test]
    fn a_page_that_answers_no_picture_gets_no_more_and_then_the_newest() {
        let server = serve();
        let mut pages = [open(&server), open(&server)];
        for (page, socket) in &mut pages {
            // What begins the connection ends with an empty line.
            let (mut last, mut byte) = ([0; 4], [0]);
            while last != *b"\r\n\r\n" {
                socket.read_exact(&mut byte).unwrap();
                last = [last[1], last[2], last[3], byte[0]];
            }
            assert_eq!(text(socket), snapshot::hello(*page));
        }
        let [(_, slow), (_, quick)] = &mut pages;
        for picture in 1..=UNANSWERED {
            server.show(picture.to_string());
            assert_eq!([&mut *slow, quick].map(text), [picture.to_string(), picture.to_string()]);
            answer(quick);
        }
        for picture in ["late", "newest"] {
            server.show(picture.to_owned());
            assert_eq!(text(quick), picture);
            answer(quick);
        }
        answer(slow);
        assert_eq!(text(slow), "newest");
    }

    #[test]
    fn a_page_is_closed_on_demand_and_the_others_stay() {
        let server = serve();
        let ((first, mut one), (_second, other)) = (open(&server), open(&server));
        server.close(first);
        assert_eq!(next(&server), (first, FromPage::Closed));
        // To its end.
        one.read_to_end(&mut Vec::new()).unwrap();
        assert_eq!((server.event(), server.closing.borrow().len()), (Ok(None), 0));
        drop(other);
    }

    /// Cards are an address, or a name and an address.
    fn of(bound: &str, first: Option<&str>, known: &[&str]) -> Vec<String> {
        let read = |text: &str| text.parse::<IpAddr>().ok();
        let card = |text: &&str| {
            let (name, address) = text.rsplit_once(' ').unwrap_or(("eth0", text));
            Some((read(address)?, is_virtual(name)))
        };
        let known = known.iter().filter_map(card).collect();
        let found = read(bound).map(|bound| reachable(bound, first.and_then(read), known));
        found.into_iter().flatten().map(|address| address.to_string()).collect()
    }

    #[test]
    fn every_address_that_others_may_use_is_named_once_the_likeliest_first() {
        let cards = ["127.0.0.1", "10.8.0.2", "192.168.1.7", "::1", "fe80::1", "fd00::7"];
        assert_eq!(of("0.0.0.0", Some("192.168.1.7"), &cards), ["192.168.1.7", "10.8.0.2"]);
        assert_eq!(of("0.0.0.0", None, &cards), ["10.8.0.2", "192.168.1.7"]);
        assert_eq!(of("::", None, &cards), ["10.8.0.2", "192.168.1.7", "fd00::7"]);
        let first = of("::", Some("::ffff:192.168.1.7"), &cards);
        assert_eq!(first, ["192.168.1.7", "10.8.0.2", "fd00::7"]);
        assert_eq!(of("0.0.0.0", None, &["127.0.0.1"]), ["127.0.0.1"]);
    }

    #[test]
    fn addresses_of_virtual_networks_and_those_without_dhcp_come_last() {
        for name in
            ["tun0", "utun4", "wg0", "docker0", "br-1f2e3d", "vEthernet (WSL)", "tailscale0"]
        {
            let (tunnel, own) = (format!("{name} 10.8.0.2"), "wlan0 192.168.1.7");
            let chosen = "eth0 169.254.3.4";
            let found = of("0.0.0.0", Some("10.8.0.2"), &[chosen, &tunnel, own]);
            assert_eq!(found, ["192.168.1.7", "10.8.0.2", "169.254.3.4"], "{name}");
        }
        for name in ["eth0", "enp3s0", "wlan0", "wlp2s0", "en0", "br0", "Wi-Fi", "Ethernet 2"] {
            assert!(!is_virtual(name), "{name}");
        }
    }
}
