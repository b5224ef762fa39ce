//! A network without hardware, in virtual time: the robot's network task ([`flix_firmware::net`]) and an operator's
//! computer, each on a stack of embassy-net behind a [`Guard`], with a wire between them.
//!
//! The task, the stacks and the guards are those of the chips. The wire can be cut, it loses frames, and anybody can put
//! frames on it ([`Wire::inject`]); the robot's frames can be watched ([`Wire::watch`]). [`play`] runs all of it on one
//! thread, [`TURNS`] turns in each tick: the same beginning gives the same end.

use core::net::{Ipv4Addr, SocketAddrV4};
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::{Mutex, PoisonError};

use embassy_futures::join::{join, join3, join4};
use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{Config, Ipv4Cidr, Stack, StackResources, StaticConfigV4};
use embassy_net_driver_channel::driver::{HardwareAddress, LinkState};
use embassy_net_driver_channel::{Device, Runner, RxRunner, State, StateRunner, TxRunner};
use embassy_time::{Duration, MockDriver};
use flix_firmware::hardware::TICK_US;
use flix_firmware::neighbours::{Guard, Guarded};
use flix_firmware::net::{self, Station};
use flix_protocol::units::Instant;

/// The robot's address, with the hardware address of card 1.
pub const ROBOT: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 1);
/// The operator's address, with the hardware address of card 2.
pub const OPERATOR: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 2);
/// The way to other networks; nobody has this address unless somebody claims it.
pub const ROUTER: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 254);
/// Bits that all addresses of the network share.
const PREFIX: u8 = 24;

/// Longest Ethernet frame, bytes.
const MTU: usize = 1514;
/// Frames that wait at a card, each way.
const QUEUE: usize = 64;
/// Time that passes between two ticks of the robot.
pub const TICK: Duration = Duration::from_micros(TICK_US as u64);
/// Turns that all tasks get in each tick: a datagram needs six from end to end.
pub const TURNS: usize = 12;

/// Virtual time is one for the whole process.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

type Driver = Guarded<Device<'static, MTU>>;
type Watcher = Box<dyn FnMut(&[u8])>;
type Follower = Box<dyn Fn(&[u8]) -> Vec<Vec<u8>>>;

/// What the wire does with frames.
#[derive(Default)]
pub struct Wire {
    is_cut: Cell<bool>,
    loses_one_in: Cell<u32>,
    random: Cell<u32>,
    injected: RefCell<VecDeque<Vec<u8>>>,
    watcher: RefCell<Option<Watcher>>,
    /// Somebody who sends frames at once after each of the operator's.
    follower: RefCell<Option<Follower>>,
}

impl Wire {
    /// Loses one frame in so many, each way; 0 for none.
    pub fn lose_one_in(&self, frames: u32) {
        self.loses_one_in.set(frames);
    }

    /// Puts a frame of somebody else on the wire, to the robot.
    pub fn inject(&self, frame: Vec<u8>) {
        self.injected.borrow_mut().push_back(frame);
    }

    /// Sends to the robot, at once after each frame of the operator, the frames that `follower` makes of it.
    pub fn follow(&self, follower: impl Fn(&[u8]) -> Vec<Vec<u8>> + 'static) {
        *self.follower.borrow_mut() = Some(Box::new(follower));
    }

    /// Lets the card of this number send a copy of each frame of the operator, at once, as its own.
    pub fn copy_from(&self, card: u8) {
        self.follow(move |frame| vec![[&frame[..6], &hardware(card), &frame[12..]].concat()]);
    }

    /// Shows this watcher each frame that the robot sends.
    pub fn watch(&self, watcher: impl FnMut(&[u8]) + 'static) {
        *self.watcher.borrow_mut() = Some(Box::new(watcher));
    }

    fn loses(&self) -> bool {
        let random = self.random.get().wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        self.random.set(random);
        let one_in = self.loses_one_in.get();
        self.is_cut.get() || (one_in > 0 && (random >> 8).is_multiple_of(one_in))
    }
}

/// The network beside the robot's own task.
pub struct Network {
    /// The stack of the operator's computer.
    pub stack: Stack<'static>,
    /// The robot's stack, to read its addresses.
    pub robot: Stack<'static>,
    /// What stands before the robot's driver.
    pub guard: &'static Guard,
    /// What lies between the two.
    pub wire: Rc<Wire>,
    links: [StateRunner<'static>; 2],
}

impl Network {
    /// Opens a socket of the operator's computer.
    ///
    /// # Panics
    /// For port 0.
    #[must_use]
    pub fn socket(&self, port: u16) -> UdpSocket<'static> {
        let buffer = || Box::leak(vec![0; 65_536].into_boxed_slice());
        let metadata = || Box::leak(vec![PacketMetadata::EMPTY; 256].into_boxed_slice());
        let mut socket = UdpSocket::new(self.stack, metadata(), buffer(), metadata(), buffer());
        socket.bind(port).expect("a new socket takes every port but 0");
        socket
    }

    /// Plugs the wire into both cards, or pulls it.
    pub fn plug(&self, is_plugged: bool) {
        self.wire.is_cut.set(!is_plugged);
        for link in self.links {
            link.set_link_state(if is_plugged { LinkState::Up } else { LinkState::Down });
        }
    }
}

/// Returns the time since [`play`] began.
#[must_use]
pub fn now() -> Instant {
    Instant::from_micros(embassy_time::Instant::now().as_micros())
}

/// Runs a scenario on a network of its own, with a robot of this name, until the scenario is over. `tick` is called
/// every [`TICK`], the first time at 0. Scenarios of one process wait for each other.
pub fn play<Scenario: Future>(
    name: &str,
    station: &mut impl Station,
    tick: impl FnMut(),
    scenario: impl FnOnce(Network) -> Scenario,
) -> Scenario::Output {
    play_with(fixed(ROBOT), name, station, tick, scenario)
}

/// Plays it as [`play`] does, with a robot that has its address by this configuration.
pub fn play_with<Scenario: Future>(
    robot: Config,
    name: &str,
    station: &mut impl Station,
    mut tick: impl FnMut(),
    scenario: impl FnOnce(Network) -> Scenario,
) -> Scenario::Output {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    MockDriver::get().reset();
    let guards = [(); 2].map(|()| &*Box::leak(Box::new(Guard::default())));
    let (robot, mut robot_runner, robot_card) = stack(robot, 1, guards[0]);
    let (operator, mut operator_runner, operator_card) = stack(fixed(OPERATOR), 2, guards[1]);
    let (robot_link, robot_rx, robot_tx) = robot_card.split();
    let (operator_link, operator_rx, operator_tx) = operator_card.split();
    let wire = Rc::new(Wire::default());
    let scenario = scenario(Network {
        stack: operator,
        robot,
        guard: guards[0],
        wire: wire.clone(),
        links: [robot_link, operator_link],
    });
    let clock = async {
        loop {
            for _ in 0..TURNS {
                yield_now().await;
            }
            tick();
            MockDriver::get().advance(TICK);
        }
    };
    let [operator_rx, robot_rx] = [operator_rx, robot_rx].map(RefCell::new);
    let watched = |frame: &[u8]| {
        if let Some(watcher) = &mut *wire.watcher.borrow_mut() {
            watcher(frame);
        }
    };
    let followed = |frame: &[u8]| {
        if let Some(follower) = &*wire.follower.borrow() {
            wire.injected.borrow_mut().extend(follower(frame));
        }
    };
    let wires = join3(
        carry(&wire, robot_tx, &operator_rx, watched),
        carry(&wire, operator_tx, &robot_rx, followed),
        intrude(&wire, &robot_rx),
    );
    let stacks = join(robot_runner.run(), operator_runner.run());
    let task = net::serve(robot, guards[0], name, station);
    let mut everything = pin!(select(scenario, join4(wires, stacks, task, clock)));
    let mut context = Context::from_waker(Waker::noop());
    loop {
        // The clock never waits, so all get their turn each time.
        if let Poll::Ready(Either::First(output)) = everything.as_mut().poll(&mut context) {
            return output;
        }
    }
}

/// Returns the configuration of a stack that has this address.
#[must_use]
pub fn fixed(address: Ipv4Addr) -> Config {
    Config::ipv4_static(StaticConfigV4 {
        address: Ipv4Cidr::new(address, PREFIX),
        gateway: Some(ROUTER),
        dns_servers: Default::default(),
    })
}

/// Drivers and stacks live as long as the process: sockets hold on to them.
fn stack(
    config: Config,
    card: u8,
    guard: &'static Guard,
) -> (Stack<'static>, embassy_net::Runner<'static, Driver>, Runner<'static, MTU>) {
    let state = Box::leak(Box::new(State::<MTU, QUEUE, QUEUE>::new()));
    let hardware = HardwareAddress::Ethernet(hardware(card));
    let (runner, device) = embassy_net_driver_channel::new(state, hardware);
    runner.state_runner().set_link_state(LinkState::Up);
    let resources = Box::leak(Box::new(StackResources::<8>::new()));
    let (stack, stack_runner) =
        embassy_net::new(Guarded::new(device, guard), config, resources, u64::from(card));
    (stack, stack_runner, runner)
}

/// Carries frames one way.
async fn carry(
    wire: &Wire,
    mut from: TxRunner<'static, MTU>,
    to: &RefCell<RxRunner<'static, MTU>>,
    watched: impl Fn(&[u8]),
) {
    loop {
        let frame = from.tx_buf().await.to_vec();
        from.tx_done();
        watched(&frame);
        if !wire.loses() {
            arrive(&frame, to);
        }
        yield_now().await;
    }
}

fn arrive(frame: &[u8], to: &RefCell<RxRunner<'static, MTU>>) {
    let mut to = to.borrow_mut();
    if let Some(buffer) = to.try_rx_buf() {
        buffer[..frame.len()].copy_from_slice(frame);
        to.rx_done(frame.len());
    }
}

/// Puts somebody else's frames on the wire.
async fn intrude(wire: &Wire, to: &RefCell<RxRunner<'static, MTU>>) {
    loop {
        while let Some(frame) = wire.injected.borrow_mut().pop_front() {
            arrive(&frame, to);
        }
        yield_now().await;
    }
}

/// Returns the hardware address of the card of this number.
#[must_use]
pub const fn hardware(card: u8) -> [u8; 6] {
    [2, 0, 0, 0, 0, card]
}

/// What an ARP packet is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arp {
    /// Asks who has an address.
    Request = 1,
    /// Answers that.
    Reply = 2,
}

/// Returns the frame of an ARP packet to the robot in which a card claims `claimed` and asks for `asked`.
#[must_use]
pub fn arp(operation: Arp, card: u8, claimed: Ipv4Addr, asked: Ipv4Addr) -> Vec<u8> {
    let (robot, sender) = (hardware(1), hardware(card));
    let head = [0x08, 0x06, 0, 1, 0x08, 0, 6, 4, 0, operation as u8];
    [&robot[..], &sender, &head, &sender, &claimed.octets(), &robot, &asked.octets()].concat()
}

/// Protocols of IPv4.
pub(crate) const PROTOCOL_ICMP: u8 = 1;
pub(crate) const PROTOCOL_UDP: u8 = 17;
/// Bytes of a frame before the payload of its datagram: Ethernet, IPv4 and UDP.
pub(crate) const DATAGRAM_HEADER: usize = 14 + 20 + 8;

/// Returns the frame of an IPv4 packet of this protocol from this card to the robot.
#[must_use]
pub fn packet(card: u8, protocol: u8, from: Ipv4Addr, to: Ipv4Addr, payload: &[u8]) -> Vec<u8> {
    let total = ((20 + payload.len()) as u16).to_be_bytes();
    let mut header = [0x45, 0, total[0], total[1], 0, 0, 0x40, 0, 64, protocol, 0, 0].to_vec();
    header.extend(from.octets());
    header.extend(to.octets());
    let sum = check_sum(&header);
    header[10..12].copy_from_slice(&sum);
    [&hardware(1)[..], &hardware(card), &[0x08, 0], &header, payload].concat()
}

/// Returns the Internet check sum of these bytes (RFC 1071).
fn check_sum(bytes: &[u8]) -> [u8; 2] {
    let pair = |pair: &[u8]| u32::from_be_bytes([0, 0, pair[0], *pair.get(1).unwrap_or(&0)]);
    let sum: u32 = bytes.chunks(2).map(pair).sum();
    (!((sum & 0xffff) + (sum >> 16)) as u16).to_be_bytes()
}

/// Returns the frame of a datagram from this card to the robot.
#[must_use]
pub fn datagram(card: u8, from: SocketAddrV4, to: SocketAddrV4, payload: &[u8]) -> Vec<u8> {
    let port = |of: SocketAddrV4| of.port().to_be_bytes();
    let length = ((8 + payload.len()) as u16).to_be_bytes();
    // A checksum of 0: none.
    let udp = [port(from), port(to), length, [0, 0]].concat();
    packet(card, PROTOCOL_UDP, *from.ip(), *to.ip(), &[&udp, payload].concat())
}

/// Returns the frame of an echo request (ICMP) from this card to the robot.
#[must_use]
pub fn ping(card: u8, from: Ipv4Addr, to: Ipv4Addr, number: u16, payload: &[u8]) -> Vec<u8> {
    let mut request = [&[8, 0, 0, 0, 0, 1][..], &number.to_be_bytes(), payload].concat();
    let sum = check_sum(&request);
    request[2..4].copy_from_slice(&sum);
    packet(card, PROTOCOL_ICMP, from, to, &request)
}

/// Returns ports and payload of the datagram in a frame, if one is in it.
#[must_use]
pub fn ports_and_payload(frame: &[u8]) -> Option<(u16, u16, &[u8])> {
    let number = |at: usize| Some(u16::from_be_bytes([*frame.get(at)?, *frame.get(at + 1)?]));
    let is_datagram = frame.get(12..15)? == [0x08, 0x00, 0x45] && *frame.get(23)? == PROTOCOL_UDP;
    let payload = frame.get(DATAGRAM_HEADER..34 + usize::from(number(38)?))?;
    is_datagram.then_some((number(34)?, number(36)?, payload))
}
