//! `flix cockpit` in this process: its server, and the loop that drives the robot.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::mpsc::channel;
use std::thread::{self, JoinHandle};

use flix_cli::by_hand::drive::{Drive, Extras};
use flix_cli::cockpit::drive_loop;
use flix_cli::cockpit::server::Server;
use flix_host::link::RobotLink;
use flix_host::link::udp::Connection;
use flix_host::system::interrupt::Interrupt;
use flix_protocol::session::Key;

/// A cockpit that is served.
pub struct Cockpit {
    /// The address of its page.
    pub url: String,
    interrupt: Interrupt,
    thread: JoinHandle<()>,
}

impl Cockpit {
    /// Connects to this robot, and serves pages on loopback.
    pub fn start(robot: SocketAddr, key: Key) -> Self {
        let interrupt = Interrupt::never();
        let (sender, served) = channel();
        let ends = interrupt.clone();
        let thread = thread::spawn(move || {
            let mut connection =
                Connection::open(robot, key, Interrupt::never()).expect("loopback");
            connection.wait_until_connected().expect("a session");
            let server =
                Server::start((Ipv4Addr::LOCALHOST, 0).into(), &[], false).expect("a free port");
            sender.send(server.urls().remove(0)).expect("the page waits");
            let mut extras = Extras::default();
            let mut drive = Drive::new(&mut connection, "simulated", &mut extras);
            drive_loop::run(&mut drive, &server, &ends).expect("loopback");
        });
        Self { url: served.recv().expect("it serves"), interrupt, thread }
    }

    /// Ends it as an operator does.
    pub fn end(self) {
        self.interrupt.raise();
        self.thread.join().expect("it ends");
    }
}
