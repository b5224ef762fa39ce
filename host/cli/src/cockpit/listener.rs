//! Takes in who connects to the server, within the [limits of connections](flix_host::teleop::page::connection_limits).

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::io;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::Router;
use flix_host::teleop::page::connection_limits::{DELIVERY, Number, PATIENCE, Visitors};
use hyper::server::conn::http1;
use hyper_util::rt::TokioIo;
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;
use tokio::time::sleep;

/// Pause after a socket that could not be taken: descriptors are short, and those that were turned out give theirs back.
const PAUSE: Duration = Duration::from_millis(10);

/// All who are here, and how each is asked to leave.
#[derive(Debug, Clone, Default)]
struct Connections(Arc<Mutex<Here>>);

#[derive(Debug, Default)]
struct Here {
    visitors: Visitors,
    turned_out: BTreeMap<Number, Arc<Notify>>,
}

/// A socket that has come in. It leaves when all of these are dropped.
#[derive(Debug, Clone)]
pub struct Visitor(Arc<Visit>);

#[derive(Debug)]
struct Visit {
    number: Number,
    turned_out: Arc<Notify>,
    connections: Connections,
}

impl Connections {
    fn here<T>(&self, act: impl FnOnce(&mut Here) -> T) -> T {
        // What a panic left is as whole as what it found: each change is one step.
        act(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Takes in a socket behind this address, if there is room.
    fn admit(&self, address: IpAddr) -> Option<Visitor> {
        let turned_out = Arc::new(Notify::new());
        let number = self.here(|here| {
            let (number, leaves) = here.visitors.admit(address)?;
            here.ask_to_leave(leaves);
            here.turned_out.insert(number, Arc::clone(&turned_out));
            Some(number)
        })?;
        Some(Visitor(Arc::new(Visit { number, turned_out, connections: self.clone() })))
    }
}

impl Here {
    fn ask_to_leave(&self, number: Option<Number>) {
        if let Some(visitor) = number.and_then(|number| self.turned_out.get(&number)) {
            visitor.notify_one();
        }
    }
}

impl Visitor {
    /// Takes that it has shown the token: from now on nobody else turns it out.
    pub fn welcome(&self) {
        self.0.connections.here(|here| here.visitors.welcome(self.0.number));
    }

    /// Waits until it must leave.
    async fn must_leave(&self) {
        tokio::select! {
            () = self.0.turned_out.notified() => return,
            () = sleep(PATIENCE) => {}
        }
        if self.0.connections.here(|here| here.visitors.is_guest(self.0.number)) {
            sleep(DELIVERY).await;
        }
    }

    /// Serves it until it leaves, becomes a page, or must leave.
    async fn visit(&self, socket: TcpStream, pages: Router) {
        let served = http1::Builder::new()
            .serve_connection(TokioIo::new(socket), TowerToHyperService::new(pages))
            .with_upgrades();
        tokio::select! {
            // Whatever a visitor does wrong ends its own socket alone.
            _ = served => {}
            () = self.must_leave() => {}
        }
    }
}

impl Drop for Visit {
    fn drop(&mut self) {
        self.connections.here(|here| {
            here.visitors.leave(self.number);
            here.turned_out.remove(&self.number);
        });
    }
}

/// Serves these pages to whoever comes to a listener, for as long as the program runs.
pub async fn serve(listener: TcpListener, pages: impl Fn(Visitor) -> Router) -> Infallible {
    let connections = Connections::default();
    loop {
        match listener.accept().await {
            Ok((socket, address)) => {
                if let Some(visitor) = connections.admit(address.ip()) {
                    // What it does not take is sent a little later.
                    let _ = socket.set_nodelay(true);
                    let pages = pages(visitor.clone());
                    tokio::spawn(async move { visitor.visit(socket, pages).await });
                }
            }
            Err(error) if is_of_one_socket(&error) => {}
            Err(_) => {
                connections.here(|here| {
                    let leaves = here.visitors.turn_out();
                    here.ask_to_leave(leaves);
                });
                sleep(PAUSE).await;
            }
        }
        // Those that were turned out close their sockets before the next is taken.
        tokio::task::yield_now().await;
    }
}

/// Returns whether this is the end of the one socket that came, and not of the listener.
fn is_of_one_socket(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset, Interrupted};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset | Interrupted)
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use axum::extract::State;
    use axum::routing::get;
    use flix_host::teleop::page::connection_limits::{MOST_GUESTS, MOST_STRANGERS};
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    use tokio::time::Instant;

    use super::super::guard::Refusal;
    use super::*;

    const NEAR: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    /// A server whose pages all show the token.
    async fn server() -> SocketAddr {
        let listener = TcpListener::bind((NEAR, 0)).await.unwrap();
        let address = listener.local_addr().unwrap();
        let pages = |visitor: Visitor| {
            let page = |State(visitor): State<Visitor>| async move {
                visitor.welcome();
                "page"
            };
            let wrong = || async { Refusal::Token };
            Router::new().route("/", get(page)).route("/wrong", get(wrong)).with_state(visitor)
        };
        tokio::spawn(async move { serve(listener, pages).await });
        address
    }

    /// Time until the server closes this socket.
    async fn closed(socket: &mut TcpStream) -> Duration {
        let begun = Instant::now();
        let _ = socket.read_to_end(&mut Vec::new()).await;
        begun.elapsed()
    }

    #[tokio::test(start_paused = true)]
    async fn a_socket_that_says_nothing_is_closed_and_one_that_says_it_slowly_too() {
        let address = server().await;
        let mut idle = TcpStream::connect(address).await.unwrap();
        let took = closed(&mut idle).await;
        assert!(took >= PATIENCE && took < 2 * PATIENCE, "{took:?}");
        let (mut hears, mut says) = TcpStream::connect(address).await.unwrap().into_split();
        tokio::spawn(async move {
            for byte in b"GET / HTTP/1.1\r\nHost: a".iter().cycle() {
                if says.write_all(&[*byte]).await.is_err() {
                    return;
                }
                sleep(PATIENCE / 10).await;
            }
        });
        let begun = Instant::now();
        let _ = hears.read_to_end(&mut Vec::new()).await;
        assert!(begun.elapsed() < 2 * PATIENCE, "{:?}", begun.elapsed());
    }

    #[tokio::test(start_paused = true)]
    async fn a_page_is_served_among_sockets_without_end_and_leaves_room_again() {
        let address = server().await;
        let mut idle = Vec::new();
        for _ in 0..3 * MOST_STRANGERS {
            idle.push(TcpStream::connect(address).await.unwrap());
        }
        for _ in 0..2 * MOST_GUESTS {
            let mut page = TcpStream::connect(address).await.unwrap();
            let request = b"GET / HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n";
            page.write_all(request).await.unwrap();
            let mut answer = String::new();
            page.read_to_string(&mut answer).await.unwrap();
            assert!(answer.starts_with("HTTP/1.1 200") && answer.ends_with("page"), "{answer}");
        }
        let mut open = 0;
        for socket in &mut idle {
            open += usize::from(socket.try_read(&mut [0]).is_err());
        }
        assert!(open <= MOST_STRANGERS, "{open} idle sockets are still open");
    }

    #[tokio::test(start_paused = true)]
    async fn whoever_shows_a_wrong_token_is_answered_once_and_closed() {
        let mut stranger = TcpStream::connect(server().await).await.unwrap();
        stranger.write_all(&b"GET /wrong HTTP/1.1\r\nHost: a\r\n\r\n".repeat(2)).await.unwrap();
        let mut answer = String::new();
        stranger.read_to_string(&mut answer).await.unwrap();
        assert_eq!(answer.matches("HTTP/1.1 403").count(), 1, "{answer}");
        assert!(answer.contains("connection: close"), "{answer}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_guest_that_takes_nothing_is_closed() {
        let address = server().await;
        let mut guest = TcpStream::connect(address).await.unwrap();
        guest.write_all(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n").await.unwrap();
        let took = closed(&mut guest).await;
        assert!(took >= PATIENCE + DELIVERY && took < 2 * (PATIENCE + DELIVERY), "{took:?}");
    }
}
