//! From a command's leaving a page of `flix cockpit` to the first duty that it changes: a WebSocket and two UDP sockets
//! on loopback, and the served robot. Prints the quantiles; the target is a 99th percentile below 10 ms.

mod latency;

use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::sync::mpsc::channel;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use flix_cli::by_hand::drive::{Drive, Extras};
use flix_cli::cockpit::desk;
use flix_cli::cockpit::server::Server;
use flix_host::link::udp::Connection;
use flix_host::system::interrupt::Interrupt;
use flix_protocol::session::Key;
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::http::HeaderValue;
use tungstenite::{Error, Message, WebSocket};

/// Longest wait for a snapshot.
const SLICE: Duration = Duration::from_millis(2);

fn main() {
    latency::measure(Page::open);
}

/// A page that drives.
struct Page {
    socket: WebSocket<TcpStream>,
    seen: u64,
    walks: bool,
    interrupt: Interrupt,
    cockpit: JoinHandle<()>,
}

impl Page {
    fn open(robot: SocketAddr, key: Key) -> Self {
        let interrupt = Interrupt::never();
        let (sender, served) = channel();
        let cockpit = {
            let interrupt = interrupt.clone();
            std::thread::spawn(move || {
                let mut connection =
                    Connection::open(robot, key, Interrupt::never()).expect("loopback");
                connection.wait_until_connected().expect("a session");
                let server =
                    Server::start((Ipv4Addr::LOCALHOST, 0).into(), false).expect("a free port");
                sender.send(server.urls().remove(0)).expect("the page waits");
                let mut extras = Extras::default();
                let mut drive = Drive::new(&mut connection, "simulated", &mut extras);
                desk::run(&mut drive, &server, &interrupt).expect("loopback");
            })
        };
        let url = served.recv().expect("it serves");
        let (host, _) = url.trim_start_matches("http://").split_once('/').expect("it has a path");
        let stream = TcpStream::connect(host).expect("loopback");
        stream.set_nodelay(true).expect("it is open");
        let mut request = format!("{}socket", url.replacen("http", "ws", 1))
            .into_client_request()
            .expect("an address");
        let origin = HeaderValue::from_str(&format!("http://{host}")).expect("plain text");
        request.headers_mut().insert("Origin", origin);
        let (socket, _) = tungstenite::client(request, stream).expect("it is taken");
        socket.get_ref().set_read_timeout(Some(SLICE)).expect("it is open");
        let mut page = Self { socket, seen: 0, walks: false, interrupt, cockpit };
        loop {
            match page.look().as_deref() {
                Some("armed") => break,
                Some("disarmed") => page.say(Some(json!("arm"))),
                _ => {}
            }
        }
        page
    }

    fn say(&mut self, request: Option<Value>) {
        let message = json!({ "seen": self.seen, "do": request });
        self.socket.send(Message::text(message.to_string())).expect("the cockpit listens");
    }

    /// Waits for a snapshot and answers it; returns the robot's state.
    fn look(&mut self) -> Option<String> {
        match self.socket.read() {
            Ok(Message::Text(text)) => {
                let snapshot: Value = serde_json::from_str(&text).expect("JSON");
                self.seen = snapshot["stamp"].as_u64()?;
                self.say(None);
                snapshot["telemetry"]["state"].as_str().map(str::to_owned)
            }
            Ok(_) => None,
            Err(Error::Io(error))
                if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) =>
            {
                None
            }
            Err(error) => panic!("the cockpit is gone: {error}"),
        }
    }
}

impl latency::Operator for Page {
    fn hold(&mut self, walks: bool, duration: Duration) {
        if self.walks != walks {
            self.walks = walks;
            self.say(Some(if walks { json!({ "walk": "forward" }) } else { json!("rest") }));
        }
        let begun = Instant::now();
        while begun.elapsed() < duration {
            self.look();
        }
    }

    fn leave(self) {
        self.interrupt.raise();
        self.cockpit.join().expect("it ends");
    }
}
