//! The robot's network task on a network without hardware ([`flix_sim::rig::network_task`]), with the robot's two halves at
//! rest.
mod conflict;
mod dhcp;
mod icmp;
mod silence;
mod twin;

use std::cell::{Cell, RefCell};
use std::future::Future;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::rc::Rc;

use embassy_futures::join::join;
use embassy_futures::select::{Either, select};
use embassy_net::udp::UdpSocket;
use embassy_net::{Config, IpAddress, IpEndpoint};
use embassy_time::{Duration, Timer};
use flix_firmware::board::DENGFOC_V3_01;
use flix_firmware::fast::exchange::Exchange;
use flix_firmware::hardware::{Encoder, EncoderAngle, EncoderReading, Sensors};
use flix_firmware::mdns;
use flix_firmware::net::{self, Station};
use flix_firmware::robot::{FastHalf, SlowHalf, halves};
use flix_protocol::DEFAULT_PORT;
use flix_protocol::frame::Frame;
use flix_protocol::message::{Command, Outcome, SCOPE_VALUES, ToOperator, ToRobot};
use flix_protocol::session::{
    Key, OperatorReceived, OperatorSession, Status, StopSession, StopStatus,
};
use flix_protocol::units::Instant;
use flix_sim::rig::network_task::{
    self as network, Arp, Network, OPERATOR, ROBOT, TICK, Wire, arp, now,
};
use flix_sim::rig::simulated::Flash;

/// The robot's two halves, with the fast one's ticks counted.
struct Brain {
    fast: RefCell<FastHalf>,
    slow: RefCell<SlowHalf<Flash>>,
    exchange: RefCell<Exchange>,
    ticks: Cell<u64>,
    /// Between two exchanges of the halves.
    longest_gap_us: Cell<u64>,
    /// Addresses of other robots of the same name that were reported.
    twins: RefCell<Vec<Ipv4Addr>>,
}

impl Brain {
    fn new(key: Option<Key>) -> Self {
        let (fast, slow, report) =
            halves(DENGFOC_V3_01.hardware, "daisy", key, [1; 32], Flash::default());
        let exchange = Exchange::new(report, [0; SCOPE_VALUES]);
        Self {
            fast: fast.into(),
            slow: slow.into(),
            exchange: exchange.into(),
            ticks: Cell::new(0),
            longest_gap_us: Cell::new(0),
            twins: RefCell::default(),
        }
    }

    /// Standing still, nothing wrong.
    fn tick(&self) {
        let zero = DENGFOC_V3_01.hardware.current_sense.map_or(0, |sense| sense.zero_count);
        let reading = Encoder::Reading(EncoderReading { angle: EncoderAngle::ZERO, age_us: 0 });
        let sensors = Sensors {
            magnets: Default::default(),
            encoders: [reading; 2],
            phase_current: Some([[zero; 2]; 2]),
            bus_voltage: None,
        };
        self.fast.borrow_mut().tick(now(), &sensors, &mut *self.exchange.borrow_mut());
        self.ticks.set(self.ticks.get() + 1);
    }
}

struct ChipStation {
    brain: Rc<Brain>,
    exchanged: u64,
}

impl Station for ChipStation {
    fn board(&self) -> &'static str {
        "bench"
    }

    fn now(&self) -> Instant {
        now()
    }
    fn exchange(&mut self) {
        let gap = now().as_micros() - self.exchanged;
        self.exchanged = now().as_micros();
        self.brain.longest_gap_us.set(self.brain.longest_gap_us.get().max(gap));
        self.brain.slow.borrow_mut().exchange(&mut *self.brain.exchange.borrow_mut());
    }
    fn receive(&mut self, from: SocketAddr, datagram: &[u8]) -> bool {
        self.brain.slow.borrow_mut().receive(now(), from, datagram)
    }
    fn transmit(&mut self, frame: &mut Frame) -> Option<SocketAddr> {
        self.brain.slow.borrow_mut().transmit(now(), frame)
    }
    fn poll_at(&self) -> Option<Instant> {
        self.brain.slow.borrow().poll_at(now())
    }
    fn meet_twin(&mut self, address: Ipv4Addr) {
        self.brain.twins.borrow_mut().push(address);
    }
}

/// What a test plays with.
struct World {
    network: Network,
    wire: Rc<Wire>,
    brain: Rc<Brain>,
}

/// Runs a scenario in virtual time until it is over.
fn play<Scenario: Future<Output = ()>>(key: Option<Key>, scenario: impl FnOnce(World) -> Scenario) {
    play_with(network::fixed(ROBOT), key, scenario);
}

/// The same, with a robot that has its address by this configuration.
fn play_with<Scenario: Future<Output = ()>>(
    config: Config,
    key: Option<Key>,
    scenario: impl FnOnce(World) -> Scenario,
) {
    let brain = Rc::new(Brain::new(key));
    let mut station = ChipStation { brain: brain.clone(), exchanged: 0 };
    let world = |network: Network| {
        scenario(World { wire: network.wire.clone(), network, brain: brain.clone() })
    };
    network::play_with(config, "daisy", &mut station, || brain.tick(), world);
}

fn key() -> Key {
    Key::new([3; 32])
}

/// An operator who commands over a socket.
struct Operator {
    session: OperatorSession,
    robot: Ipv4Addr,
    socket: UdpSocket<'static>,
    outcomes: Vec<Outcome>,
    telemetry: usize,
}

impl Operator {
    fn new(world: &World) -> Self {
        Self::to(world, ROBOT)
    }

    /// The same, of a robot at this address.
    fn to(world: &World, robot: Ipv4Addr) -> Self {
        Self {
            session: OperatorSession::new(key(), [9; 32], now()),
            robot,
            socket: world.network.socket(40_000),
            outcomes: Vec::new(),
            telemetry: 0,
        }
    }

    async fn send(&self, datagram: &[u8]) {
        let robot = IpEndpoint::new(self.robot.into(), DEFAULT_PORT);
        self.socket.send_to(datagram, robot).await.unwrap();
    }

    /// Takes part for a millisecond.
    async fn live(&mut self) {
        if let Some(frame) = self.session.poll(now()) {
            self.send(&frame).await;
        }
        let mut buffer = [0; 1536];
        let pause = Timer::after(Duration::from_millis(1));
        if let Either::First(Ok((length, _))) =
            select(self.socket.recv_from(&mut buffer), pause).await
        {
            match self.session.receive(now(), &buffer[..length]) {
                OperatorReceived::Message(ToOperator::Reply(reply)) => {
                    self.outcomes.push(reply.outcome);
                }
                OperatorReceived::Message(ToOperator::Telemetry(_)) => self.telemetry += 1,
                _ => {}
            }
        }
    }

    /// Takes part until the session stands; how long that took, microseconds.
    async fn connect(&mut self) -> u64 {
        let begun = now().as_micros();
        while self.session.status(now()) != Status::Connected {
            if self.session.poll_at().is_none() {
                self.session.connect(now());
            }
            self.live().await;
        }
        now().as_micros() - begun
    }

    /// Takes part for so long and pings every 20 ms.
    async fn ping_for(&mut self, milliseconds: u64) {
        let end = now().as_micros() + milliseconds * 1000;
        let mut next = 0;
        let mut number = 0;
        while now().as_micros() < end {
            if now().as_micros() >= next {
                next = now().as_micros() + 20_000;
                number += 1;
                let command = ToRobot::request(number, Command::Ping(number));
                if let Ok(frame) = self.session.send(now(), &command) {
                    self.send(&frame).await;
                }
            }
            self.live().await;
        }
    }
}

#[test]
fn an_operator_is_connected_within_100_ms() {
    play(Some(key()), |world| async move {
        let took = Operator::new(&world).connect().await;
        assert!(took < 100_000, "{took} us");
    });
}

#[test]
fn commands_are_answered_and_telemetry_flows() {
    play(Some(key()), |world| async move {
        let mut operator = Operator::new(&world);
        operator.connect().await;
        operator.ping_for(1_000).await;
        let (answers, telemetry) = (operator.outcomes.len(), operator.telemetry);
        assert!(answers >= 48 && telemetry >= 48, "{answers} answers, {telemetry} telemetry");
    });
}

#[test]
fn a_third_of_all_frames_may_be_lost() {
    play(Some(key()), |world| async move {
        world.wire.lose_one_in(3);
        let mut operator = Operator::new(&world);
        let took = operator.connect().await;
        operator.ping_for(2_000).await;
        let answers = operator.outcomes.len();
        assert!(took < 3_000_000 && answers > 20, "{took} us, {answers} answers");
    });
}

#[test]
fn a_network_that_was_gone_for_minutes_comes_back_without_a_restart() {
    play(Some(key()), |world| async move {
        let mut operator = Operator::new(&world);
        operator.connect().await;
        operator.ping_for(200).await;
        world.network.plug(false);
        Timer::after(Duration::from_secs(120)).await;
        world.network.plug(true);
        operator.session.connect(now());
        let took = operator.connect().await;
        operator.outcomes.clear();
        operator.ping_for(200).await;
        let answers = operator.outcomes.len();
        assert!(took < 3_000_000 && answers > 5, "{took} us, {answers} answers");
    });
}

/// Throws junk at the robot, as fast as the wire takes it.
async fn flood(socket: UdpSocket<'static>, thrown: Rc<Cell<u64>>) {
    let robot = IpEndpoint::new(ROBOT.into(), DEFAULT_PORT);
    let mut junk = [0x5a; 64];
    loop {
        for _ in 0..2 {
            thrown.set(thrown.get() + 1);
            junk[..8].copy_from_slice(&thrown.get().to_le_bytes());
            socket.send_to(&junk, robot).await.unwrap();
        }
        Timer::after(TICK).await;
    }
}

#[test]
fn a_flood_of_junk_keeps_nobody_out() {
    play(Some(key()), |world| async move {
        let mut operator = Operator::new(&world);
        let thrown = Rc::new(Cell::new(0));
        let work = async {
            let took = operator.connect().await;
            operator.ping_for(1_000).await;
            took
        };
        let junk = flood(world.network.socket(666), thrown.clone());
        let Either::First(took) = select(work, junk).await else { unreachable!() };
        let answers = operator.outcomes.len();
        assert!(thrown.get() > 10_000, "{} datagrams", thrown.get());
        assert!(took < 1_000_000 && answers > 25, "{took} us, {answers} answers");
    });
}

#[test]
fn the_fast_loop_keeps_time_in_a_flood_and_hears_its_orders() {
    play(Some(key()), |world| async move {
        let brain = world.brain.clone();
        let junk = flood(world.network.socket(666), Rc::new(Cell::new(0)));
        select(Timer::after(Duration::from_secs(1)), junk).await;
        let timing = brain.exchange.borrow().newest_report().timing;
        // Reported in the first tick and every tenth from there.
        let reported = (brain.ticks.get() - 1) / 10 * 10 + 1;
        assert_eq!((timing.overruns, timing.ticks), (0, reported));
        let allowed = (net::EXCHANGE_INTERVAL + TICK).as_micros();
        let gap = brain.longest_gap_us.get();
        assert!(gap <= allowed, "{gap} us between two exchanges");
    });
}

/// Claims the operator's address, and those of as many others, in ARP packets a second.
async fn forge_arp(wire: Rc<Wire>, a_second: u64) {
    for number in 0_u64.. {
        let address = match number % 14 {
            0 | 7 => OPERATOR,
            other => Ipv4Addr::new(10, 0, 0, 100 + other as u8),
        };
        let operation = if number % 2 == 0 { Arp::Request } else { Arp::Reply };
        wire.inject(arp(operation, 66, address, ROBOT));
        Timer::after(Duration::from_micros(1_000_000 / a_second)).await;
    }
}

#[test]
fn forged_arp_takes_no_answers_from_the_operator() {
    for a_second in [14, 1_000] {
        play(Some(key()), move |world| async move {
            let mut operator = Operator::new(&world);
            let work = async {
                let took = operator.connect().await;
                operator.ping_for(2_000).await;
                took
            };
            let forgery = forge_arp(world.wire.clone(), a_second);
            let Either::First(took) = select(work, forgery).await else { unreachable!() };
            let (answers, telemetry) = (operator.outcomes.len(), operator.telemetry);
            assert!(took < 1_000_000, "{took} us with {a_second} forgeries a second");
            assert!(answers >= 97 && telemetry >= 95, "{answers} answers, {telemetry} telemetry");
        });
    }
}

#[test]
fn datagrams_that_the_stack_drops_make_the_guard_forget_nobody() {
    play(Some(key()), |world| async move {
        let mut operator = Operator::new(&world);
        operator.connect().await;
        // More of them than senders are remembered, within one turn of the stack; the check sum of their headers is wrong.
        world.wire.follow(|_| {
            let dropped = |mut frame: Vec<u8>| {
                frame[24] ^= 1;
                frame
            };
            let claim = arp(Arp::Reply, 66, OPERATOR, ROBOT);
            strangers().map(dropped).chain([claim]).collect()
        });
        operator.ping_for(20_000).await;
        let (answers, telemetry) = (operator.outcomes.len(), operator.telemetry);
        assert!(answers >= 970 && telemetry >= 950, "{answers} answers, {telemetry} telemetry");
    });
}

/// Returns the frame of a datagram that a card sends in the operator's name.
fn named_operator(card: u8, payload: &[u8]) -> Vec<u8> {
    let [from, to] = [(OPERATOR, 40_000), (ROBOT, DEFAULT_PORT)];
    let [from, to] = [from, to].map(|(address, port)| SocketAddrV4::new(address, port));
    network::datagram(card, from, to, payload)
}

/// Returns the frames of 48 strangers, each with a datagram of its own: more than the guard remembers.
fn strangers() -> impl Iterator<Item = Vec<u8>> {
    (100..148).map(|number: u8| {
        let from = SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, number), 1);
        network::datagram(66, from, SocketAddrV4::new(ROBOT, DEFAULT_PORT), &[number; 64])
    })
}

/// Sends what no robot obeys, in the operator's name, at once behind each of his datagrams.
fn pretend(world: &World) {
    world.wire.follow(|frame| {
        let junk = |number: u8| named_operator(66, &[&frame[..40], &[number; 24]].concat());
        let mut frames: Vec<_> = (0..4).map(junk).collect();
        frames.push(arp(Arp::Reply, 66, OPERATOR, ROBOT));
        frames
    });
}

#[test]
fn what_others_send_in_an_operators_name_keeps_no_answer_from_him() {
    play(Some(key()), |world| async move {
        pretend(&world);
        let mut operator = Operator::new(&world);
        let patience = Timer::after(Duration::from_millis(300));
        let connected = select(operator.connect(), patience).await;
        assert!(matches!(connected, Either::First(_)), "not within 300 ms");
    });
}

#[test]
fn what_is_answered_to_others_in_an_operators_name_takes_no_telemetry_from_him() {
    play(Some(key()), |world| async move {
        let mut operator = Operator::new(&world);
        operator.connect().await;
        operator.ping_for(100).await;
        // A Hello with another key is refused: that is an answer, too.
        let stranger = OperatorSession::new(Key::new([4; 32]), [4; 32], now()).poll(now()).unwrap();
        world.wire.follow(move |_| vec![named_operator(66, &stranger)]);
        operator.outcomes.clear();
        operator.telemetry = 0;
        operator.ping_for(2_000).await;
        let (answers, telemetry) = (operator.outcomes.len(), operator.telemetry);
        assert!(answers >= 97 && telemetry >= 95, "{answers} answers, {telemetry} telemetry");
    });
}

#[test]
fn copies_whose_first_the_guard_was_made_to_forget_keep_no_answer_from_an_operator() {
    play(Some(key()), |world| async move {
        // The first answer is lost; then strangers send more than the guard remembers, and a copy of what was asked.
        let (first, wire) = (Cell::new(true), world.wire.clone());
        world.wire.follow(move |frame| {
            wire.lose_one_in(0);
            let copy = [&frame[..6], &network::hardware(66), &frame[12..]].concat();
            let is_first = frame[12..14] == [0x08, 0x00] && first.replace(false);
            if is_first { strangers().chain([copy]).collect() } else { Vec::new() }
        });
        let (mut is_answered, wire) = (false, world.wire.clone());
        world.wire.watch(move |frame| {
            let is_answer = frame[12..14] == [0x08, 0x00] && frame[30..34] == OPERATOR.octets();
            if is_answer && !std::mem::replace(&mut is_answered, true) {
                wire.lose_one_in(1);
            }
        });
        let mut operator = Operator::new(&world);
        let patience = Timer::after(Duration::from_millis(900));
        let connected = select(operator.connect(), patience).await;
        assert!(matches!(connected, Either::First(_)), "not within 900 ms");
    });
}

#[test]
fn copies_of_an_operators_datagrams_take_no_answers_from_him() {
    play(Some(key()), |world| async move {
        world.wire.copy_from(66);
        let astray = Rc::new(Cell::new(0));
        let counted = astray.clone();
        world.wire.watch(move |frame| {
            counted.set(counted.get() + u32::from(frame[..6] == network::hardware(66)));
        });
        let mut operator = Operator::new(&world);
        operator.connect().await;
        operator.ping_for(2_000).await;
        let (answers, telemetry) = (operator.outcomes.len(), operator.telemetry);
        assert!(answers >= 97 && telemetry >= 95, "{answers} answers, {telemetry} telemetry");
        let astray = astray.get();
        assert!(astray <= 2, "{astray} answers to whoever copies");
    });
}

#[test]
fn an_operator_who_gets_another_network_card_is_answered_there() {
    play(Some(key()), |world| async move {
        let mut operator = Operator::new(&world);
        operator.connect().await;
        operator.ping_for(100).await;
        // From another card, and then the old one again.
        let command = ToRobot::request(900, Command::Ping(900));
        let sealed = operator.session.send(now(), &command).unwrap();
        world.wire.inject(named_operator(3, &sealed));
        Timer::after(Duration::from_millis(1)).await;
        operator.outcomes.clear();
        operator.ping_for(500).await;
        let answers = operator.outcomes.len();
        assert!(answers >= 23, "{answers} answers");
    });
}

#[test]
fn addresses_that_nobody_has_hold_up_no_session() {
    play(Some(key()), |world| async move {
        let mut operator = Operator::new(&world);
        operator.connect().await;
        // What a hello from such an address leaves behind: an answer that cannot be delivered.
        for number in 100..200_u8 {
            let from = SocketAddr::from(([10, 0, 0, number], 1));
            let hello = OperatorSession::new(Key::new([4; 32]), [number; 32], now()).poll(now());
            world.brain.slow.borrow_mut().receive(now(), from, &hello.unwrap());
        }
        operator.ping_for(1_000).await;
        let answers = operator.outcomes.len();
        assert!(answers >= 45, "{answers} answers");
    });
}

/// Hellos from addresses that nobody has, 1,000 a second: of a stranger, and one that was recorded.
async fn hellos_from_nowhere(brain: Rc<Brain>) {
    let stranger = OperatorSession::new(Key::new([4; 32]), [4; 32], now()).poll(now()).unwrap();
    let recorded = StopSession::new(&key(), [5; 32], now()).poll(now()).unwrap();
    loop {
        for (number, hello) in
            (100..250_u8).zip([stranger.clone(), recorded.clone()].iter().cycle())
        {
            let from = SocketAddr::from(([10, 0, 0, number], 1));
            brain.slow.borrow_mut().receive(now(), from, hello);
            Timer::after(Duration::from_millis(1)).await;
        }
    }
}

#[test]
fn a_stop_is_acknowledged_within_300_ms_while_addresses_that_nobody_has_ask_1000_times_a_second() {
    play(Some(key()), |world| async move {
        let mut driver = Operator::new(&world);
        driver.connect().await;
        let socket = world.network.socket(40_001);
        let stop = async {
            Timer::after(Duration::from_millis(500)).await;
            let begun = now();
            let mut stop = StopSession::new(&key(), [6; 32], begun);
            let mut buffer = [0; 64];
            while stop.status() == StopStatus::Asking {
                if let Some(frame) = stop.poll(now()) {
                    let robot = IpEndpoint::new(ROBOT.into(), DEFAULT_PORT);
                    socket.send_to(&frame, robot).await.unwrap();
                }
                let pause = Timer::after(Duration::from_millis(1));
                let received = select(socket.recv_from(&mut buffer), pause).await;
                if let Either::First(Ok((length, _))) = received {
                    let _ = stop.receive(now(), &buffer[..length]);
                }
            }
            (stop.status(), now().since(begun))
        };
        let flood = hellos_from_nowhere(world.brain.clone());
        let driving = driver.ping_for(5_000);
        let Either::First((status, took)) = select(stop, join(flood, driving)).await else {
            unreachable!("the flood never ends")
        };
        assert_eq!(status, StopStatus::Latched);
        assert!(took.as_millis() <= 300, "{took:?}");
    });
}

#[test]
fn a_robot_without_a_key_lets_nobody_in() {
    play(None, |world| async move {
        let mut operator = Operator::new(&world);
        let end = now().as_micros() + 3_500_000;
        while now().as_micros() < end {
            operator.live().await;
        }
        assert!(operator.session.status(now()) != Status::Connected);
    });
}

#[test]
fn a_robot_answers_with_its_name_when_somebody_looks_for_robots() {
    play(Some(key()), |world| async move {
        world.network.stack.join_multicast_group(mdns::GROUP).unwrap();
        let socket = world.network.socket(mdns::PORT);
        // What it announced by itself does not count.
        Timer::after(Duration::from_secs(2)).await;
        let mut buffer = [0; 1536];
        while socket.may_recv() {
            socket.recv_from(&mut buffer).await.unwrap();
        }
        let query = b"\0\0\0\0\0\x01\0\0\0\0\0\0\x05_flix\x04_udp\x05local\0\0\x0c\0\x01";
        let everybody = IpEndpoint::new(mdns::GROUP.into(), mdns::PORT);
        socket.send_to(query, everybody).await.unwrap();
        let (length, _) = socket.recv_from(&mut buffer).await.unwrap();
        let answer = &buffer[..length];
        assert!(answer.windows(5).any(|part| part == b"daisy"), "{answer:?}");
    });
}
