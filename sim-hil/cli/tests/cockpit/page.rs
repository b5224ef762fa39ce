//! A page of `flix cockpit` without a browser: its WebSocket.

use std::net::TcpStream;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message, WebSocket};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Time after which it hangs.
const PATIENCE: Duration = Duration::from_secs(60);

/// An open page.
pub struct Page {
    /// Waits a minute for what it reads.
    pub socket: WebSocket<TcpStream>,
    seen: u64,
}

impl Page {
    /// Opens the page of this address.
    pub fn open(url: &str) -> Outcome<Self> {
        let (host, _) =
            url.trim_start_matches("http://").split_once('/').ok_or("an address without a path")?;
        let stream = TcpStream::connect(host)?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        let mut request =
            format!("{}socket", url.replacen("http", "ws", 1)).into_client_request()?;
        request.headers_mut().insert("Origin", format!("http://{host}").parse()?);
        let (socket, _) = tungstenite::client(request, stream).map_err(|it| it.to_string())?;
        Ok(Self { socket, seen: 0 })
    }

    /// Asks for something; for nothing, it answers a snapshot.
    pub fn say(&mut self, request: impl Serialize) -> Outcome<()> {
        let message = json!({ "seen": self.seen, "do": request });
        Ok(self.socket.send(Message::text(message.to_string()))?)
    }

    /// Takes the next message; answers and returns it where it is a snapshot.
    pub fn snapshot(&mut self) -> Outcome<Option<Value>> {
        let Message::Text(text) = self.socket.read()? else { return Ok(None) };
        let snapshot: Value = serde_json::from_str(&text)?;
        let Some(seen) = snapshot["stamp"].as_u64() else { return Ok(None) };
        self.seen = seen;
        self.say(Value::Null)?;
        Ok(Some(snapshot))
    }

    /// Asks for these, separated by spaces, with each snapshot, until the robot's state is this; `stopped` is a stop that is latched.
    /// Where the machine has no time for a page, a request is not done.
    pub fn until(&mut self, requests: &str, state: &str) -> Outcome<()> {
        let begun = Instant::now();
        loop {
            let Some(snapshot) = self.snapshot()? else { continue };
            let telemetry = &snapshot["telemetry"];
            let is_stopped = telemetry["stopped"] == true;
            if (state == "stopped" && is_stopped) || (telemetry["state"] == state && !is_stopped) {
                return Ok(());
            }
            if begun.elapsed() > PATIENCE {
                return Err(format!("not {state}: {telemetry}").into());
            }
            requests.split(' ').try_for_each(|request| self.say(request))?;
        }
    }
}
