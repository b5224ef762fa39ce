//! How long a stop takes from a page of `flix cockpit` while strangers keep 2,000 sockets open at its port, idle and slow ones.
//!
//! Starts `flix-sim serve`, and a cockpit in this process, which gets the descriptors for both ends. Prints one line; the limit
//! is 0.3 s for each stop.

mod cockpit;
#[path = "../tests/cockpit/page.rs"]
mod page;
mod served;

use std::io::Write as _;
use std::net::TcpStream;
use std::time::{Duration, Instant};

use cockpit::Cockpit;
use page::Page;
use served::Robot;

/// Sockets of strangers.
const SOCKETS: usize = 2_000;
/// Stops that are timed.
const STOPS: usize = 30;
/// Longest time to a latched stop.
const LIMIT: Duration = Duration::from_millis(300);

fn main() {
    raise_descriptors();
    let robot = Robot::start();
    let cockpit = Cockpit::start(robot.address, robot.key.clone());
    let url = &cockpit.url;
    let (host, _) = url.trim_start_matches("http://").split_once('/').expect("it has a path");
    let mut driver = Page::open(url).expect("a page");
    driver.until("rest", "disarmed").expect("a robot at rest");
    let mut sockets: Vec<TcpStream> = Vec::new();
    let mut times: Vec<Duration> = Vec::new();
    for _ in 0..STOPS {
        // Those that were turned out come again.
        sockets.clear();
        std::thread::scope(|scope| {
            let strangers = scope.spawn(|| strangers(host));
            // A page that answers nothing would be closed after a while.
            while !strangers.is_finished() {
                driver.snapshot().expect("a page that is served");
            }
            sockets = strangers.join().expect("sockets");
        });
        let asked = Instant::now();
        driver.say("stop").expect("the cockpit listens");
        driver.until("stop", "stopped").expect("a stop");
        times.push(asked.elapsed());
        driver.until("clear", "disarmed").expect("a robot that is cleared");
    }
    let begun = Instant::now();
    drop(Page::open(url).expect("a page that comes late"));
    let opened = begun.elapsed();
    cockpit.end();
    times.sort_unstable();
    let longest = times[STOPS - 1];
    println!(
        "stop from a page beside {SOCKETS} idle and slow sockets: median {:.1} ms, longest {:.1} ms of {STOPS}; another page \
         opens in {:.1} ms",
        1e3 * times[STOPS / 2].as_secs_f64(),
        1e3 * longest.as_secs_f64(),
        1e3 * opened.as_secs_f64(),
    );
    assert!(longest <= LIMIT, "a stop took longer than {LIMIT:?}");
}

/// Opens the sockets of strangers; every second one says something, slowly.
fn strangers(host: &str) -> Vec<TcpStream> {
    (0..SOCKETS)
        .map(|number| {
            let mut socket = TcpStream::connect(host).expect("a socket");
            if number % 2 == 0 {
                let _ = socket.write_all(b"GET / HTTP/1.1\r\nHost: a");
            }
            socket
        })
        .collect()
}

/// Lets this process have as many descriptors as it may.
fn raise_descriptors() {
    #[cfg(unix)]
    {
        use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
        let limit = getrlimit(Resource::Nofile);
        let most = Rlimit { current: limit.maximum, ..limit };
        setrlimit(Resource::Nofile, most).expect("what is allowed");
    }
}
