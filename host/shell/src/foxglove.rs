//! Live streams for Foxglove, Lichtblick and whatever else speaks their WebSocket protocol.
//!
//! A stream only shows: nobody can command through it. Who falls behind loses rows, and holds up nobody. Who may look is the
//! matter of [`foxglove_front`](crate::foxglove_front).

use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;

use foxglove::{
    ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServerHandle,
};

use log::{Level, LevelFilter, Log, Metadata, Record};

use crate::foxglove_front::{Front, hidden};
use crate::output::complain;
use flix_host::record::{Channel, Reader};

/// Rows that wait for a slow reader: some two seconds of a run.
const BACKLOG: usize = 512;
/// Time after which a row that holds is sent again, for those who came later, ns.
const AGAIN: u64 = 1_000_000_000;

/// Why nothing can be streamed.
#[derive(Debug, thiserror::Error)]
#[error(
    "cannot stream at {address}: {reason}; is another stream there? Give another port: --foxglove=127.0.0.1:8766"
)]
pub struct StreamError {
    /// Where.
    address: SocketAddr,
    /// Why.
    reason: String,
}

/// A stream of rows to whoever connects. It ends when it is dropped.
pub struct Stream {
    front: Front,
    server: Option<WebSocketServerHandle>,
    offers: Vec<Offer>,
    /// The server offers what is in here for as long as it lives.
    _context: Arc<Context>,
}

/// A channel, and its last row if that holds.
struct Offer {
    channel: Arc<RawChannel>,
    holds: bool,
    last: Vec<u8>,
    sent: u64,
}

impl Stream {
    /// Listens at an address and offers these channels. `name`: of the source, as it is shown; `origins`: of pages that may
    /// look besides the known viewers.
    ///
    /// # Errors
    /// When the address cannot be had.
    pub fn open(
        address: SocketAddr,
        name: &str,
        channels: &[Channel],
        origins: &[String],
    ) -> Result<Self, StreamError> {
        let failed =
            |error: foxglove::FoxgloveError| StreamError { address, reason: error.to_string() };
        let refused = |error: std::io::Error| StreamError { address, reason: error.to_string() };
        let listener = TcpListener::bind(address).map_err(refused)?;
        hear_of_refusals();
        let context = Context::new();
        let offers = channels
            .iter()
            .map(|offered| {
                let channel = ChannelBuilder::new(offered.topic)
                    .context(&context)
                    .message_encoding("json")
                    .schema(Schema::new(offered.schema, "jsonschema", offered.text.as_bytes()))
                    .build_raw()?;
                Ok(Offer { channel, holds: offered.holds, last: Vec::new(), sent: 0 })
            })
            .collect::<Result<_, foxglove::FoxgloveError>>()
            .map_err(failed)?;
        let host = hidden();
        let server = context
            .websocket_server()
            .name(name)
            .bind(host.to_string(), 0)
            .message_backlog_size(BACKLOG)
            .start_blocking()
            .map_err(failed)?;
        let library = SocketAddr::new(host.into(), server.port());
        let front = Front::open(listener, library, origins.to_vec()).map_err(refused)?;
        Ok(Self { front, server: Some(server), offers, _context: context })
    }

    /// Returns the port, which the system chose where 0 was asked for.
    #[must_use]
    pub fn port(&self) -> u16 {
        self.front.address().port()
    }
}

/// Says on stderr that a viewer was refused: to it, that is an HTTP status without a word.
struct Refusals;

impl Log for Refusals {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.level() == Level::Error && metadata.target().starts_with("foxglove")
    }

    fn log(&self, record: &Record<'_>) {
        if self.enabled(record.metadata())
            && let Some(sentence) = refusal(&record.args().to_string())
        {
            complain(sentence);
        }
    }

    fn flush(&self) {}
}

/// Has what the library reports of viewers explained, once for the program.
fn hear_of_refusals() {
    // Where another logger is set already, it hears of them.
    if log::set_logger(&Refusals).is_ok() {
        log::set_max_level(LevelFilter::Error);
    }
}

/// Returns a sentence about a viewer that the library refused, of what it reports.
fn refusal(report: &str) -> Option<&'static str> {
    // The address that it names is the front's.
    report.strip_prefix("Dropping client ")?.strip_suffix(": handshake failed")?;
    Some(
        "a viewer was refused: it does not speak foxglove.sdk.v1, as Foxglove and Lichtblick after 1.21 do: update it, \
         or open the record (`flix runs list`)",
    )
}

impl Reader for Stream {
    fn row(&mut self, channel: usize, nanos: u64, row: &[u8]) {
        let metadata = PartialMetadata { log_time: Some(nanos) };
        for offer in &mut self.offers {
            if !offer.last.is_empty() && nanos.saturating_sub(offer.sent) >= AGAIN {
                offer.sent = nanos;
                offer.channel.log_with_meta(&offer.last, metadata);
            }
        }
        let offer = &mut self.offers[channel];
        offer.channel.log_with_meta(row, metadata);
        if offer.holds {
            (offer.last, offer.sent) = (row.to_owned(), nanos);
        }
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        if let Some(server) = self.server.take() {
            let _ = server.stop();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpStream;
    use std::time::Duration;

    use serde_json::{Value, json};
    use tungstenite::client::{IntoClientRequest, client};
    use tungstenite::{Message, WebSocket};

    use super::*;

    const CHANNELS: [Channel; 2] = [
        Channel { topic: "/a", schema: "flix.A", text: "{}", holds: false },
        Channel { topic: "/b", schema: "flix.B", text: "{}", holds: true },
    ];

    /// Another program that reads the stream.
    struct Client {
        socket: WebSocket<TcpStream>,
    }

    impl Client {
        /// Connects, and subscribes to every channel by the number of its topic's letter.
        fn subscribed(port: u16) -> Self {
            let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
            stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
            let mut request = format!("ws://127.0.0.1:{port}").into_client_request().unwrap();
            let protocol = "foxglove.sdk.v1".parse().unwrap();
            request.headers_mut().insert("Sec-WebSocket-Protocol", protocol);
            let (socket, _) = client(request, stream).unwrap();
            let mut this = Self { socket };
            assert_eq!(this.json("serverInfo")["name"], "robot");
            let mut offered = Vec::new();
            while offered.len() < CHANNELS.len() {
                let advertised = this.json("advertise");
                offered.extend(advertised["channels"].as_array().unwrap().clone());
            }
            let wanted: Vec<_> = offered
                .iter()
                .map(|channel| {
                    assert_eq!(channel["encoding"], "json");
                    assert_eq!(channel["schemaEncoding"], "jsonschema");
                    let letter = channel["topic"].as_str().unwrap().as_bytes()[1];
                    json!({ "id": letter, "channelId": channel["id"] })
                })
                .collect();
            let text = json!({ "op": "subscribe", "subscriptions": wanted }).to_string();
            this.socket.send(Message::text(text)).unwrap();
            this
        }

        /// Reads up to a message of this operation.
        fn json(&mut self, operation: &str) -> Value {
            loop {
                if let Message::Text(text) = self.socket.read().unwrap() {
                    let value: Value = serde_json::from_str(&text).unwrap();
                    if value["op"] == operation {
                        return value;
                    }
                }
            }
        }

        /// Reads the next row: the letter of its channel, its time, itself.
        fn row(&mut self) -> (u8, u64, Vec<u8>) {
            loop {
                if let Message::Binary(bytes) = self.socket.read().unwrap() {
                    assert_eq!(bytes[0], 1);
                    let nanos = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
                    return (bytes[1], nanos, bytes[13..].to_vec());
                }
            }
        }
    }

    #[test]
    fn readers_get_every_row_and_late_ones_what_still_holds() {
        let mut stream =
            Stream::open("127.0.0.1:0".parse().unwrap(), "robot", &CHANNELS, &[]).unwrap();
        stream.row(1, 5 * AGAIN, b"{\"path\":1}");
        stream.row(1, 5 * AGAIN, b"{\"path\":2}");
        let mut client = Client::subscribed(stream.port());
        while !stream.offers.iter().all(|offer| offer.channel.has_sinks()) {
            std::thread::yield_now();
        }
        stream.row(0, 5 * AGAIN + 1, b"{\"n\":1}");
        assert_eq!(client.row(), (b'a', 5 * AGAIN + 1, b"{\"n\":1}".to_vec()));
        stream.row(0, 6 * AGAIN, b"{\"n\":2}");
        assert_eq!(client.row(), (b'b', 6 * AGAIN, b"{\"path\":2}".to_vec()));
        assert_eq!(client.row(), (b'a', 6 * AGAIN, b"{\"n\":2}".to_vec()));
    }

    #[test]
    fn a_viewer_of_the_older_protocol_is_answered_with_a_sentence() {
        use std::io::{Read as _, Write as _};
        let stream = Stream::open("127.0.0.1:0".parse().unwrap(), "robot", &CHANNELS, &[]).unwrap();
        let mut viewer = TcpStream::connect(("127.0.0.1", stream.port())).unwrap();
        viewer.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let request = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
                       Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
                       Sec-WebSocket-Protocol: foxglove.websocket.v1\r\n\r\n";
        viewer.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        viewer.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 400"), "{answer}");
        let address = viewer.local_addr().unwrap();
        let sentence = refusal(&format!("Dropping client {address}: handshake failed")).unwrap();
        assert!(sentence.contains("update it"));
        assert_eq!(refusal("Dropping client: it left"), None);
        assert!(log::logger().enabled(
            &Metadata::builder().level(Level::Error).target("foxglove::websocket::server").build()
        ));
    }

    /// A page that somebody else serves looks from the operator's own browser.
    #[test]
    fn a_page_of_another_site_sees_no_stream() {
        let named = ["https://robots.example".to_owned()];
        let address = "127.0.0.1:0".parse().unwrap();
        let stream = Stream::open(address, "robot", &CHANNELS, &named).unwrap();
        let status = |host: &str, origin: &str| {
            let socket = TcpStream::connect(("127.0.0.1", stream.port())).unwrap();
            socket.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
            let mut request =
                format!("ws://{host}:{}", stream.port()).into_client_request().unwrap();
            let headers = request.headers_mut();
            headers.insert("Sec-WebSocket-Protocol", "foxglove.sdk.v1".parse().unwrap());
            headers.insert("Origin", origin.parse().unwrap());
            match client(request, socket) {
                Ok((_, response)) => response.status().as_u16(),
                Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(response))) => {
                    response.status().as_u16()
                }
                Err(error) => panic!("{error}"),
            }
        };
        for (host, origin, expected) in [
            ("127.0.0.1", "https://evil.example", 403),
            ("127.0.0.1", "null", 403),
            ("evil.example", "http://evil.example", 421),
            ("127.0.0.1", "https://app.foxglove.dev", 101),
            ("localhost", "http://localhost:8080", 101),
            ("127.0.0.1", "https://robots.example", 101),
        ] {
            assert_eq!(status(host, origin), expected, "{host} from {origin}");
        }
    }

    #[test]
    fn a_port_that_is_taken_is_named() {
        let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = taken.local_addr().unwrap();
        let error = Stream::open(address, "robot", &CHANNELS, &[]).err().unwrap().to_string();
        assert!(error.contains(&address.to_string()), "{error}");
    }
}
