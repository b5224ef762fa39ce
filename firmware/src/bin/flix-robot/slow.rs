//! The slow half's task: datagrams, and the values that cross to and from the fast loop.

use core::net::SocketAddr;

use embassy_futures::select::{Either, select};
use embassy_net::udp::{PacketMetadata, UdpMetadata, UdpSocket};
use embassy_net::{IpAddress, Stack};
use embassy_time::{Duration, Timer};
use esp_println::println;
use flix_firmware::hardware::SettingsStore;
use flix_firmware::robot::SlowHalf;
use flix_protocol::DEFAULT_PORT;
use flix_protocol::frame::{Frame, MAXIMUM_DATAGRAM};
use flix_protocol::message::State;

use crate::fast;
use crate::network::SIGNAL;

/// How often values cross when no datagram comes: well within the 10 ms that are allowed.
const EXCHANGE_INTERVAL: Duration = Duration::from_millis(2);
/// Datagrams that wait while one is looked at.
const QUEUE: usize = 4;

/// The slow half with what it needs to hand configurations over.
pub(crate) struct Exchange<S> {
    slow: SlowHalf<S>,
    offered: Option<u16>,
    state: Option<State>,
}

impl<S: SettingsStore> Exchange<S> {
    /// Before the fast loop's first report.
    pub(crate) const fn new(slow: SlowHalf<S>) -> Self {
        Self { slow, offered: None, state: None }
    }

    /// Lets values cross, the configuration before the order that came with it.
    fn cross(&mut self) {
        if let Some(report) = fast::REPORT.newest() {
            self.slow.observe(&report);
            if self.state != Some(report.state) {
                self.state = Some(report.state);
                match report.first_fault {
                    Some(fault) => println!("robot: {} ({fault})", report.state),
                    None => println!("robot: {}", report.state),
                }
            }
        }
        if let Some(revision) = fast::CONFIGURED.take() {
            self.slow.configured(revision);
        }
        if let Some(offer) = self.slow.configuration()
            && self.offered != Some(offer.revision)
        {
            self.offered = Some(offer.revision);
            fast::CONFIGURATION.put(offer);
        }
        self.slow.set_signal(SIGNAL.newest());
        fast::ORDER.put(self.slow.order());
    }

    /// For ever, without a network: settings and faults still cross.
    pub(crate) async fn run_alone(mut self) -> ! {
        loop {
            self.cross();
            Timer::after(EXCHANGE_INTERVAL).await;
        }
    }

    /// For ever, on a network that may come and go.
    pub(crate) async fn run(mut self, stack: Stack<'static>) -> ! {
        let mut received = [PacketMetadata::EMPTY; QUEUE];
        let mut receive = [0; QUEUE * MAXIMUM_DATAGRAM];
        let mut sent = [PacketMetadata::EMPTY; QUEUE];
        let mut send = [0; QUEUE * MAXIMUM_DATAGRAM];
        let mut socket = UdpSocket::new(stack, &mut received, &mut receive, &mut sent, &mut send);
        while let Err(error) = socket.bind(DEFAULT_PORT) {
            println!("network: the port {DEFAULT_PORT} cannot be bound: {error:?}");
            Timer::after(Duration::from_secs(1)).await;
        }
        let mut datagram = [0; MAXIMUM_DATAGRAM];
        loop {
            let arrival = select(socket.recv_from(&mut datagram), Timer::after(EXCHANGE_INTERVAL));
            if let Either::First(Ok((length, from))) = arrival.await
                && let Some(from) = socket_address(from)
            {
                self.slow.receive(fast::now(), from, &datagram[..length]);
            }
            self.cross();
            let mut frame = Frame::new();
            while let Some(to) = self.slow.transmit(fast::now(), &mut frame) {
                // A datagram that the network does not take is lost, as on the air.
                if let SocketAddr::V4(to) = to {
                    let _ = socket.send_to(&frame, to).await;
                }
                frame.clear();
            }
        }
    }
}

/// IPv4 is all that the stack speaks here.
fn socket_address(from: UdpMetadata) -> Option<SocketAddr> {
    let IpAddress::Ipv4(address) = from.endpoint.addr;
    Some(SocketAddr::new(address.into(), from.endpoint.port))
}
