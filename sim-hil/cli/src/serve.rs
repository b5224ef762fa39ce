//! `flix-sim serve`: the simulated robot on the network, in real time.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use std::time::{Duration, Instant as WallClock};

use flix_host::link::keys::{self, Keyring, SIMULATED_ROBOT};
use flix_host::link::transient;
use flix_host::pose::natnet::{NatNetServer, ServerSettings};
use flix_host::system::interrupt::Interrupt;
use flix_protocol::DEFAULT_PORT;
use flix_protocol::frame::{Frame, MAXIMUM_DATAGRAM};
use flix_protocol::message::OperatorName;
use flix_protocol::session::{Operator, Operators};
use flix_protocol::units::Instant;
use flix_shell::number::{whole, within};
use flix_shell::stream::StreamArgs;

use super::arguments::ModelArgs;
use super::console::Console;
use super::error::Error;
use super::live::Shown;
use super::output::{complain, print};
use flix_sim::experiment::walk::require_walker;
use flix_sim::model::RobotModel;
use flix_sim::plant::Plant;
use flix_sim::rig::motion_capture::MotionCapture;
use flix_sim::rig::simulated::{Flash, RobotParameters, SimulatedRobot};

/// Serve a simulated robot on the network, in real time
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  flix-sim serve\n  flix-sim serve --listen 0.0.0.0:13549 --key lab.key\n  flix-sim serve --natnet\n  flix-sim serve --natnet --hang --pose-rate 250\n  flix-sim serve --operator anna=anna.key --operator bob=bob.key\n\n\
                  Then, in another terminal: flix teleop 127.0.0.1\n\n\
                  Lines that it reads: `back` puts the robot back to its start, `drop MM` drops it from that height,\n\
                  `where` prints where it is, `operators` lists who may drive, and `revoke NAME` erases the\n\
                  key of one."
)]
pub struct Args {
    /// Address to listen on; the default is this machine alone
    #[arg(long, value_name = "ADDR:PORT", value_parser = listen_address, default_value_t = SocketAddr::from((Ipv4Addr::LOCALHOST, DEFAULT_PORT)))]
    listen: SocketAddr,
    /// Key file of the robot [default: the key `simulated` of your keyring, made when there is none]
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Operator with a key of its own, eight at most; instead of --key
    #[arg(long, value_name = "NAME=FILE", conflicts_with = "key")]
    operator: Vec<Holder>,
    #[command(flatten)]
    model: ModelArgs,
    /// Stream the robot's pose as OptiTrack does (NatNet), from this address or from 127.0.0.1:1510
    #[arg(long, value_name = "ADDR:PORT", value_parser = natnet_address, num_args = 0..=1, default_missing_value = NATNET_DEFAULT)]
    natnet: Option<SocketAddrV4>,
    /// Pictures that the cameras take a second, 1 to 1000
    #[arg(long, value_name = "HZ", default_value_t = 100.0, value_parser = within(1.0..=1000.0, "rate", " Hz"), requires = "natnet")]
    pose_rate: f64,
    #[command(flatten)]
    stream: StreamArgs,
    /// Assume what the motors are like, as in a new robot: it does not arm until `flix commission` has measured them
    #[arg(long)]
    assumed_motors: bool,
    /// Hang the robot on soft cords, without a floor, for `flix experiment air`
    #[arg(long)]
    hang: bool,
    /// Seed of the robot: its motors, wiring, sensor errors and noise
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    seed: u64,
}

/// An operator and the file of its key, such as `anna=anna.key`.
#[derive(Debug, Clone)]
struct Holder {
    name: OperatorName,
    file: PathBuf,
}

impl FromStr for Holder {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, file) =
            text.split_once('=').ok_or("write NAME=FILE, for example anna=anna.key")?;
        let name = name.trim().parse().map_err(|error| format!("{error}"))?;
        Ok(Self { name, file: file.into() })
    }
}

fn listen_address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| {
        format!("\"{text}\" is no ADDRESS:PORT: write 0.0.0.0:{DEFAULT_PORT} for every network of this computer")
    })
}

fn natnet_address(text: &str) -> Result<SocketAddrV4, String> {
    text.parse().map_err(|_| {
        format!(
            "\"{text}\" is no IPv4 ADDRESS:PORT: write {NATNET_DEFAULT}, or --natnet alone for that"
        )
    })
}

/// How far over the floor a robot hangs, m.
const HUNG_AT: f64 = 0.5;
/// Where OptiTrack is expected by `flix` when nothing else is given.
const NATNET_DEFAULT: &str = "127.0.0.1:1510";
/// Ticks that are made up for at once: 1 ms.
const BATCH: u32 = 10;
/// Batches in a row, without a look at the network, the keys and Ctrl-C: as many as are made up for.
const MOST_BATCHES: u32 = 50;
/// Behind by more than this, the robot's time is put off instead of being made up for.
const LARGEST_LAG: Duration = Duration::from_millis(50);
/// Shortest time between two reports of missed real time.
const COMPLAINT_INTERVAL: Duration = Duration::from_secs(5);

/// Runs the command.
///
/// # Errors
/// When address, key or model cannot be used, the network fails or the model diverges.
pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let model = args.model.load()?;
    let robot = robot(args, &model, operators(args)?)?;
    let interrupt = Interrupt::listen().map_err(Error::network)?;
    let socket = UdpSocket::bind(args.listen).map_err(cannot_listen("--listen", args.listen))?;
    let cameras = args.natnet.map(|address| Cameras::open(address.into(), args)).transpose()?;
    let mut shown = Shown::open(&args.stream, &model)?;
    introduce(args, &socket)?;
    let mut console = Console::open(&robot);
    serve(robot, &socket, cameras, &interrupt, |robot| {
        shown.as_mut().map_or(Ok(()), |shown| shown.show(robot))?;
        console.attend(robot)
    })?;
    console.close();
    print("The robot is switched off.\n")?;
    Ok(ExitCode::SUCCESS)
}

/// Makes the error of an address that cannot be had.
fn cannot_listen(option: &str, address: SocketAddr) -> impl Fn(io::Error) -> Error {
    move |error| {
        let (advice, all) = match error.kind() {
            io::ErrorKind::AddrInUse => {
                ("another program listens there, perhaps a robot: give another port", "")
            }
            io::ErrorKind::AddrNotAvailable => {
                ("it is no address of this computer: give one that is", ", or 0.0.0.0 for all")
            }
            io::ErrorKind::PermissionDenied => {
                ("ports below 1024 are for the system: give a higher one", "")
            }
            _ => ("give another", ""),
        };
        Error::usage(format_args!(
            "{option} {address}: cannot listen there: {error}; {advice} with {option}{all}"
        ))
    }
}

fn operators(args: &Args) -> Result<Operators, Error> {
    let mut operators = Operators::default();
    for Holder { name, file } in &args.operator {
        let operator = Operator::new(*name, &keys::read(file)?);
        if let Some(known) = operators.iter().find(|known| known.key() == operator.key()) {
            return Err(Error::usage(format_args!(
                "--operator {name}: the key of this file is that of {}; make one with `flix keygen FILE`",
                known.name()
            )));
        }
        let refused = |error| Error::usage(format_args!("--operator {name}: {error}"));
        operators.add(operator).map_err(refused)?;
    }
    if args.operator.is_empty() {
        operators = Some(match &args.key {
            Some(file) => keys::read(file)?,
            None => Keyring::of_user()?.key_or_new(SIMULATED_ROBOT)?,
        })
        .into();
    }
    Ok(operators)
}

fn robot(args: &Args, model: &RobotModel, operators: Operators) -> Result<SimulatedRobot, Error> {
    let mut mechanics = Plant::new(model)?;
    if args.hang {
        require_walker(model)?;
        mechanics.hang(HUNG_AT);
    }
    let mut parameters = RobotParameters::of(&model.electrical, operators, args.seed)?;
    if args.assumed_motors {
        parameters.flash = Flash::default();
    }
    // Sessions of an earlier run must not be replayed, though the plant is the same.
    parameters.entropy = keys::generate().map(|random| *random.as_bytes())?;
    Ok(SimulatedRobot::new(parameters, mechanics))
}

fn introduce(args: &Args, socket: &UdpSocket) -> Result<(), Error> {
    let address = socket.local_addr().map_err(Error::network)?;
    let host =
        if address.ip().is_unspecified() { Ipv4Addr::LOCALHOST.into() } else { address.ip() };
    let robot = if address.port() == DEFAULT_PORT {
        host.to_string()
    } else {
        SocketAddr::new(host, address.port()).to_string()
    };
    // Who runs this by cargo has no `flix` installed.
    let flix = if std::env::var_os("CARGO").is_some() { "cargo flix" } else { "flix" };
    let first = args.operator.first().map(|operator| &operator.file);
    let key = args.key.as_ref().or(first);
    let key = key.map_or_else(String::new, |file| format!(" --key {}", file.display()));
    let poses = args.natnet.map(natnet_option).unwrap_or_default();
    let mut text = format!(
        "A simulated Flix-Walker ({}, seed {}) listens on {address}.\nIn another terminal:\n\n",
        args.model.model, args.seed
    );
    let mut hint = |command: &str, options: &str| {
        let command = command.replace("{}", &robot);
        text += &format!("    {flix} {command}{key}{options}\n");
    };
    hint("teleop {}", "");
    if args.natnet.is_some() && args.hang {
        hint("experiment air {} lab", &poses);
    } else if args.natnet.is_some() {
        hint("identify {}", &poses);
        hint("track {} figure8", &poses);
    }
    text += "\nHere: `back` and Enter puts the robot back to its start, `drop` drops it, `where` prints where it\n\
             is, `operators` who may drive; `revoke NAME` erases the key of one. Ctrl-C switches it off.\n";
    Ok(print(&text)?)
}

/// Returns the option with which `flix` finds the poses of this server.
fn natnet_option(address: SocketAddrV4) -> String {
    let host = if address.ip().is_unspecified() { Ipv4Addr::LOCALHOST } else { *address.ip() };
    let server = SocketAddrV4::new(host, address.port()).to_string();
    if server == NATNET_DEFAULT { String::new() } else { format!(" --natnet-server {server}") }
}

/// Serves this robot at this socket, in real time, until interrupted. `attend` sees it about every millisecond.
///
/// # Errors
/// When the network fails or the model diverges.
pub fn serve(
    mut robot: SimulatedRobot,
    socket: &UdpSocket,
    mut cameras: Option<Cameras>,
    interrupt: &Interrupt,
    mut attend: impl FnMut(&mut SimulatedRobot) -> Result<(), Error>,
) -> Result<(), Error> {
    socket.set_nonblocking(true).map_err(Error::network)?;
    let mut clock = RealTime::started();
    let mut datagram = [0; MAXIMUM_DATAGRAM + 1];
    let mut frame = Frame::new();
    while !interrupt.is_raised() {
        // Sleeping is exact to some 0.1 ms; a socket's own timeout is rounded up to several.
        std::thread::sleep(clock.until(robot.now()));
        // Each is answered before the next is taken, as on the robot: among a stranger's many, no answer is lost.
        take_datagrams(socket, &mut datagram, |from, bytes| {
            robot.receive(from, bytes);
            send_due(&mut robot, socket, &mut frame);
        })
        .map_err(Error::network)?;
        clock.catch_up(robot.now());
        // On a computer that is too slow for real time it is always due.
        for _ in 0..MOST_BATCHES {
            if !clock.is_due(robot.now()) {
                break;
            }
            for _ in 0..BATCH {
                robot.tick()?;
            }
            if let Some(cameras) = &mut cameras {
                cameras.show(&robot, clock.put_off).map_err(Error::network)?;
            }
            send_due(&mut robot, socket, &mut frame);
        }
        attend(&mut robot)?;
    }
    Ok(())
}

/// A motion-capture system that watches the robot.
pub struct Cameras {
    server: NatNetServer,
    cameras: MotionCapture,
    period: Duration,
    next: Instant,
}

impl Cameras {
    /// On this computer alone the stream goes to each client by itself: loopback has no multicast
    /// everywhere.
    fn open(address: SocketAddr, args: &Args) -> Result<Self, Error> {
        let usual = ServerSettings::default();
        let multicast = usual.multicast.filter(|_| !address.ip().is_loopback());
        let server = NatNetServer::bind(address, ServerSettings { multicast, ..usual })
            .map_err(cannot_listen("--natnet", address))?;
        print(&format!("Its pose is streamed as OptiTrack does, by NatNet at {address}.\n"))?;
        let period = Duration::from_secs_f64(1.0 / args.pose_rate);
        Ok(Self { server, cameras: MotionCapture::new(args.seed), period, next: Instant::START })
    }

    /// Shows the robot by a clock of their own, which goes on while the robot's is put off.
    fn show(&mut self, robot: &SimulatedRobot, put_off: Duration) -> io::Result<()> {
        let now = robot.now();
        self.server.serve(now)?;
        if now < self.next {
            return Ok(());
        }
        self.next = now + self.period;
        let pose = self.cameras.measure(now, robot);
        self.server.stream((now + put_off).as_micros() as f64 * 1e-6, Some(&pose))
    }
}

/// Sends what the robot has to say now.
fn send_due(robot: &mut SimulatedRobot, socket: &UdpSocket, frame: &mut Frame) {
    while let Some(to) = robot.transmit(frame) {
        // A datagram that cannot be sent is a datagram lost: the session deals with it.
        let _ = socket.send_to(frame, to);
    }
}

/// Gives every datagram that has come.
fn take_datagrams(
    socket: &UdpSocket,
    buffer: &mut [u8],
    mut take: impl FnMut(SocketAddr, &[u8]),
) -> io::Result<()> {
    while let Some((length, from)) = transient(socket.recv_from(buffer))? {
        take(from, &buffer[..length]);
    }
    Ok(())
}

/// The robot's time against the wall clock.
struct RealTime {
    start: WallClock,
    /// Real time that the robot did not live through.
    put_off: Duration,
    complained: Option<WallClock>,
    missed: Duration,
}

impl RealTime {
    fn started() -> Self {
        Self {
            start: WallClock::now(),
            put_off: Duration::ZERO,
            complained: None,
            missed: Duration::ZERO,
        }
    }

    fn now(&self) -> Duration {
        self.start.elapsed().saturating_sub(self.put_off)
    }

    fn is_due(&self, robot: flix_protocol::units::Instant) -> bool {
        self.now() >= Duration::from_micros(robot.as_micros())
    }

    fn until(&self, robot: flix_protocol::units::Instant) -> Duration {
        Duration::from_micros(robot.as_micros()).saturating_sub(self.now())
    }

    /// Puts the robot's time off when it is hopelessly behind, and says so.
    fn catch_up(&mut self, robot: flix_protocol::units::Instant) {
        let lag = self.now().saturating_sub(Duration::from_micros(robot.as_micros()));
        if lag > LARGEST_LAG {
            self.put_off += lag;
            self.missed += lag;
        }
        let may_complain = self.complained.is_none_or(|at| at.elapsed() >= COMPLAINT_INTERVAL);
        if !self.missed.is_zero() && may_complain {
            complain(format_args!(
                "this machine is too slow or too busy for real time: the robot's clock lost {} ms",
                self.missed.as_millis()
            ));
            self.complained = Some(WallClock::now());
            self.missed = Duration::ZERO;
        }
    }
}

#[cfg(test)]
mod tests {
    use flix_protocol::session::{Key, OperatorReceived, OperatorSession};

    use super::*;

    #[test]
    fn hints_name_the_cameras_where_flix_would_not_look() {
        let option = |address: &str| natnet_option(address.parse().unwrap());
        assert_eq!(option(NATNET_DEFAULT), "");
        assert_eq!(option("0.0.0.0:1510"), "");
        assert_eq!(option("127.0.0.1:1610"), " --natnet-server 127.0.0.1:1610");
        assert_eq!(option("192.168.1.5:1510"), " --natnet-server 192.168.1.5:1510");
    }

    #[test]
    fn an_operator_is_answered_among_strangers_who_are_all_there_first() {
        let key = Key::new([3; 32]);
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let [operator, stranger] = [(); 2].map(|()| {
            let one = UdpSocket::bind("127.0.0.1:0").unwrap();
            one.connect(socket.local_addr().unwrap()).unwrap();
            one
        });
        let mut session = OperatorSession::new(key.clone(), [1; 32], Instant::START);
        operator.send(&session.poll(Instant::START).unwrap()).unwrap();
        for number in 0..50 {
            let mut other = OperatorSession::new(Key::new([4; 32]), [number; 32], Instant::START);
            stranger.send(&other.poll(Instant::START).unwrap()).unwrap();
        }

        let mechanics = Plant::new(&RobotModel::named("A").unwrap()).unwrap();
        let robot = SimulatedRobot::new(RobotParameters::new(key, 1), mechanics);
        let interrupt = Interrupt::never();
        let mut rounds = 0;
        serve(robot, &socket, None, &interrupt, |_| {
            rounds += 1;
            if rounds == 2 {
                interrupt.raise();
            }
            Ok(())
        })
        .unwrap();

        let mut answer = [0; MAXIMUM_DATAGRAM];
        operator.set_nonblocking(true).unwrap();
        let length = operator.recv(&mut answer).unwrap();
        let received = session.receive(Instant::START, &answer[..length]);
        assert_eq!(received, OperatorReceived::Progress);
    }
}
