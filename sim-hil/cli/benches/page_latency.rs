//! From a command's leaving a page of `flix cockpit` to the first duty that it changes: a WebSocket and two UDP sockets
//! on loopback, and the served robot. Prints the quantiles; the target is a 99th percentile below 10 ms.

mod cockpit;
mod latency;
#[path = "../tests/cockpit/page.rs"]
mod page;

use std::io;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use cockpit::Cockpit;
use flix_protocol::session::Key;
use page::Page;
use serde_json::{Value, json};
use tungstenite::Error;

/// Longest wait for a snapshot.
const SLICE: Duration = Duration::from_millis(2);

fn main() {
    latency::measure(Driver::open);
}

/// A page that drives.
struct Driver {
    page: Page,
    walks: bool,
    cockpit: Cockpit,
}

impl Driver {
    fn open(robot: SocketAddr, key: Key) -> Self {
        let cockpit = Cockpit::start(robot, key);
        let mut page = Page::open(&cockpit.url).expect("a page");
        page.until("arm", "armed").expect("the robot arms");
        page.socket.get_ref().set_read_timeout(Some(SLICE)).expect("it is open");
        Self { page, walks: false, cockpit }
    }

    fn say(&mut self, request: Value) {
        self.page.say(request).expect("the cockpit listens");
    }

    /// Waits for a snapshot, which is answered.
    fn look(&mut self) {
        match self.page.snapshot() {
            Ok(_) => {}
            Err(error) => assert!(is_early(&*error), "the cockpit is gone: {error}"),
        }
    }
}

/// Returns whether nothing has come yet.
fn is_early(error: &(dyn std::error::Error + 'static)) -> bool {
    use io::ErrorKind::{TimedOut, WouldBlock};
    matches!(error.downcast_ref(), Some(Error::Io(error)) if matches!(error.kind(), TimedOut | WouldBlock))
}

impl latency::Operator for Driver {
    fn hold(&mut self, walks: bool, duration: Duration) {
        if self.walks != walks {
            self.walks = walks;
            self.say(if walks { json!({ "walk": "forward" }) } else { json!("rest") });
        }
        let begun = Instant::now();
        while begun.elapsed() < duration {
            self.look();
        }
    }

    fn leave(self) {
        self.cockpit.end();
    }
}
