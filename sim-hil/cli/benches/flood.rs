//! How long a handshake takes on loopback, undisturbed and while a stranger sends the robot 10,000 datagrams a second.
//!
//! Starts `flix-sim serve`, connects over and over, then floods it with noise and with Hellos under another key and connects
//! again. Prints three lines; the limit is 1 s for each handshake.

mod served;

use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use flix_host::link::RobotLink;
use flix_host::link::udp::Connection;
use flix_host::system::interrupt::Interrupt;
use flix_protocol::session::{Key, OperatorSession};
use served::Robot;

/// Datagrams sent at once, and how often: 10,000 a second.
const BATCH: u64 = 10;
const PAUSE: Duration = Duration::from_millis(1);
/// Handshakes that are timed.
const HANDSHAKES: usize = 200;

/// Keeps its rate: what a slow moment held back is sent after it.
fn flood(robot: SocketAddr, ends: &AtomicBool, sent: &AtomicU64) {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a port is free");
    let now = flix_protocol::units::Instant::START;
    let began = Instant::now();
    for round in 0_u64.. {
        if ends.load(Ordering::Relaxed) {
            break;
        }
        for number in 0..BATCH {
            let mut entropy = [0; 32];
            entropy[..8].copy_from_slice(&(round * BATCH + number).to_le_bytes());
            let hello = OperatorSession::new(Key::new([1; 32]), entropy, now).poll(now);
            let datagram = hello.filter(|_| number % 2 == 0).map(|hello| hello.to_vec());
            // A full buffer drops it, as a network would.
            let _ = socket.send_to(&datagram.unwrap_or_else(|| vec![0xa5; 100]), robot);
            sent.fetch_add(1, Ordering::Relaxed);
        }
        thread::sleep((PAUSE * (round as u32 + 1)).saturating_sub(began.elapsed()));
    }
}

/// Times handshakes, and prints a line of them.
fn time(robot: &Robot, under: &str) {
    let mut times: Vec<Duration> = (0..HANDSHAKES)
        .map(|_| {
            let start = Instant::now();
            let mut connection =
                Connection::open(robot.address, robot.key.clone(), Interrupt::never())
                    .expect("a socket");
            connection.wait_until_connected().expect("the operator gets through");
            let took = start.elapsed();
            connection.leave();
            // The robot hears the goodbye.
            thread::sleep(Duration::from_millis(20));
            took
        })
        .collect();
    times.sort_unstable();
    let quantile =
        |share: f64| 1e3 * times[((HANDSHAKES - 1) as f64 * share).round() as usize].as_secs_f64();
    println!(
        "handshake on loopback, {under}: p50 {:.1} ms, p99 {:.1} ms, longest {:.1} ms of {HANDSHAKES}",
        quantile(0.5),
        quantile(0.99),
        quantile(1.0),
    );
}

fn main() {
    let robot = Robot::start();
    time(&robot, "undisturbed");

    let ends = Arc::new(AtomicBool::new(false));
    let sent = Arc::new(AtomicU64::new(0));
    let stranger = thread::spawn({
        let (address, ends, sent) = (robot.address, ends.clone(), sent.clone());
        move || flood(address, &ends, &sent)
    });
    let began = Instant::now();
    time(&robot, "flooded");
    let rate = sent.load(Ordering::Relaxed) as f64 / began.elapsed().as_secs_f64();
    ends.store(true, Ordering::Relaxed);
    stranger.join().expect("the stranger only sends");
    println!("flooded with {rate:.0} datagrams a second");
}
