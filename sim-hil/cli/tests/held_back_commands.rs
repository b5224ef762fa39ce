//! The operator's own program, `flix drive`, on real sockets, over a network that keeps what it sends and releases it
//! when the program is gone: the robot comes to rest, and is free for the next operator.
//!
//! All times are of the robot's clock. It stands still when this machine has no time for the robot, so that a busy
//! machine changes no verdict. This program is its own operator: started with `drive` it is `flix`.

use std::collections::VecDeque;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::{Duration, Instant as WallClock};

use flix_host::link::keys;
use flix_host::system::interrupt::Interrupt;
use flix_protocol::frame::{Frame, MAXIMUM_DATAGRAM};
use flix_protocol::session::{Key, OperatorReceived, OperatorSession};
use flix_protocol::units::Instant;
use flix_sim::model::RobotModel;
use flix_sim::plant::Plant;
use flix_sim::reliability::adversary::MOVEMENT_LIMIT_S;
use flix_sim::reliability::fault_matrix::REST_HZ;
use flix_sim::rig::bench::{Base, learnt};
use flix_sim::rig::simulated::{RobotParameters, SimulatedRobot};
use flix_sim_cli::serve::serve;

type Outcome = Result<(), Box<dyn std::error::Error>>;

/// Time after the last intent at which the robot must have taken the next operator.
const FREE: Duration = Duration::from_millis(1_500);
/// How long the network keeps datagrams of a program that still runs.
const KEPT_BEFORE: Duration = Duration::from_millis(200);
/// How long it keeps each datagram, or all of them.
const KEPT: Duration = Duration::from_secs(3);
/// Keeps every deadline of silence.
const DRIP: Duration = Duration::from_millis(90);
/// Commanded, and reached, Hz.
const COMMANDED_HZ: &str = "35";
const REACHED_HZ: f64 = 34.5;
/// Wall time after which something hangs.
const PATIENCE: Duration = Duration::from_secs(120);
/// Seed of robot and plant.
const SEED: u64 = 1;

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    if words.first().is_some_and(|word| word == "drive") {
        return flix_cli::main();
    }
    let wanted = |name: &str| {
        let mut filters = words.iter().filter(|word| !word.starts_with('-')).peekable();
        filters.peek().is_none() || filters.any(|filter| name.contains(filter.as_str()))
    };
    let tests = [
        ("datagrams_released_one_by_one_at_once_move_no_robot", Duration::ZERO, DRIP),
        ("datagrams_released_one_by_one_after_3_s_move_no_robot", KEPT, DRIP),
        ("datagrams_released_in_a_burst_after_3_s_move_no_robot", KEPT, Duration::ZERO),
    ];
    let mut failed = false;
    for (name, after, interval) in tests.into_iter().filter(|(name, ..)| wanted(name)) {
        let verdict = experiment(Release { after, interval });
        println!("test {name} ... {}", if verdict.is_ok() { "ok" } else { "FAILED" });
        if let Err(error) = verdict {
            eprintln!("{name}: {error}");
            failed = true;
        }
    }
    ExitCode::from(u8::from(failed))
}

/// What the network does with what it keeps.
#[derive(Debug, Clone, Copy)]
struct Release {
    /// Time from when it begins to keep datagrams.
    after: Duration,
    /// Time between two of them.
    interval: Duration,
}

fn experiment(release: Release) -> Outcome {
    let key = Key::new([0x5a; 32]);
    let mut parameters =
        RobotParameters::of(&RobotModel::named("bench-fixed")?.electrical, key.clone(), SEED)?;
    parameters.flash.overwrite(learnt(Base::Fixed, SEED)?);
    parameters.entropy = *keys::generate()?.as_bytes();
    let robot = SimulatedRobot::new(parameters, Plant::new(&RobotModel::named("bench-fixed")?)?);

    let directory = tempfile::tempdir()?;
    let key_file = directory.path().join("robot.key");
    keys::write_new(&key_file, &key)?;
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    let mut network = Network::between(&socket, release)?;
    let program = Command::new(std::env::current_exe()?)
        .args(["drive", &network.to_operator.local_addr()?.to_string(), "--key"])
        .arg(&key_file)
        .args(["--frequency", COMMANDED_HZ, "--direction", "0", "--for", "1h", "--no-record"])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()?;
    network.program = Some(Program(program));
    let mut next = Next::new(key);
    let interrupt = Interrupt::never();
    let begun = WallClock::now();
    serve(robot, &socket, None, &interrupt, |robot| {
        network.attend(robot);
        if let Some(intent) = network.intent.filter(|_| network.program.is_none()) {
            next.attend(robot, intent);
            let is_over = robot.now().since(intent) > KEPT + Duration::from_secs(1);
            if is_over && network.kept.is_empty() {
                interrupt.raise();
            }
        }
        if begun.elapsed() > PATIENCE {
            interrupt.raise();
        }
        Ok(())
    })?;
    let intent = network.intent.filter(|_| network.program.is_none());
    let intent = intent.ok_or("the robot never reached its speed")?;
    let moved = network.moved.since(intent);
    let released = network.released;
    let taken = next.connected.ok_or("the next operator got no session")?.since(intent);
    println!("{released} released; moved for {moved:?}; the next operator after {taken:?}");
    if released < 5 {
        return Err(format!("only {released} datagrams were released").into());
    }
    if moved.as_secs_f64() > MOVEMENT_LIMIT_S {
        return Err(format!("moved for {moved:?} after the last intent").into());
    }
    if taken > FREE {
        return Err(format!("took the next operator only after {taken:?}").into());
    }
    Ok(())
}

/// Ended when it is dropped, as by SIGKILL: without a word.
struct Program(Child);

impl Drop for Program {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The network between the program and the robot.
struct Network {
    release: Release,
    to_operator: UdpSocket,
    to_robot: UdpSocket,
    operator: Option<SocketAddr>,
    program: Option<Program>,
    /// Since when it keeps what the operator sends.
    keeps: Option<Instant>,
    kept: VecDeque<(Instant, Vec<u8>)>,
    last_release: Instant,
    released: usize,
    /// Arrival of the operator's newest datagram.
    intent: Option<Instant>,
    /// When a rotor last turned.
    moved: Instant,
}

impl Network {
    fn between(robot: &UdpSocket, release: Release) -> std::io::Result<Self> {
        let [to_operator, to_robot] = [
            UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?,
            UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?,
        ];
        to_robot.connect(robot.local_addr()?)?;
        to_operator.set_nonblocking(true)?;
        to_robot.set_nonblocking(true)?;
        Ok(Self {
            release,
            to_operator,
            to_robot,
            operator: None,
            program: None,
            keeps: None,
            kept: VecDeque::new(),
            last_release: Instant::START,
            released: 0,
            intent: None,
            moved: Instant::START,
        })
    }

    /// What it does each millisecond of the robot's.
    fn attend(&mut self, robot: &SimulatedRobot) {
        let (now, truth) = (robot.now(), robot.truth());
        if !truth.is_slower_than(REST_HZ) {
            self.moved = now;
        }
        self.carry(now);
        match self.keeps {
            None if truth.frequency() > REACHED_HZ => self.keeps = Some(now),
            Some(since) if self.program.is_some() && now.since(since) > KEPT_BEFORE => {
                self.program = None;
                // What it had sent before it ended.
                self.carry(now);
            }
            _ => {}
        }
    }

    /// Takes what has arrived from both, and passes on what is due. What cannot be sent is lost.
    fn carry(&mut self, now: Instant) {
        let mut buffer = [0; MAXIMUM_DATAGRAM];
        while let Ok((length, from)) = self.to_operator.recv_from(&mut buffer) {
            self.operator = Some(from);
            self.intent = Some(now);
            self.kept.push_back((now, buffer[..length].to_vec()));
        }
        while let Ok(length) = self.to_robot.recv(&mut buffer) {
            if let Some(operator) = self.operator {
                let _ = self.to_operator.send_to(&buffer[..length], operator);
            }
        }
        while let Some((arrived, datagram)) = self.kept.front() {
            let is_due = |since| {
                now.since(since) >= self.release.after
                    && now.since(self.last_release) >= self.release.interval
            };
            if !self.keeps.is_none_or(is_due) {
                break;
            }
            self.released += usize::from(self.keeps.is_some_and(|since| *arrived >= since));
            let _ = self.to_robot.send(datagram);
            self.last_release = now;
            self.kept.pop_front();
        }
    }
}

/// The next operator, who waits for the robot.
struct Next {
    session: OperatorSession,
    connected: Option<Instant>,
}

impl Next {
    fn new(key: Key) -> Self {
        Self { session: OperatorSession::new(key, [9; 32], Instant::START), connected: None }
    }

    /// Where nobody listens: what the robot answers there is taken here before it is sent.
    const ADDRESS: (Ipv4Addr, u16) = (Ipv4Addr::LOCALHOST, 9);

    /// Tries once the robot had the time to come to rest.
    fn attend(&mut self, robot: &mut SimulatedRobot, intent: Instant) {
        let now = robot.now();
        if self.connected.is_some() || now.since(intent).as_secs_f64() < MOVEMENT_LIMIT_S {
            return;
        }
        if self.session.poll_at().is_none() {
            self.session.connect(now);
        }
        let address = SocketAddr::from(Self::ADDRESS);
        let mut out = self.session.poll(now).map(|frame| frame.to_vec());
        while let Some(datagram) = out.take() {
            robot.receive(address, &datagram);
            let mut frame = Frame::new();
            while let Some(to) = robot.transmit(&mut frame) {
                if to == address && self.session.receive(now, &frame) == OperatorReceived::Connected
                {
                    self.connected = Some(now);
                }
            }
            out = self.session.poll(now).map(|frame| frame.to_vec());
        }
    }
}
