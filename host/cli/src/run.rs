//! A run in real time: link, poses, record and progress around a [`Pilot`].

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::net::{IpAddr, Ipv4Addr, SocketAddrV4, ToSocketAddrs as _};
use std::path::PathBuf;
use std::str::FromStr;
use std::time::{Duration, SystemTime};

use flix_protocol::message::{Command, Outcome};
use flix_protocol::units::Instant;
use indicatif::{ProgressBar, ProgressStyle};

use super::address::RobotArgs;
use super::status::TELEMETRY_PATIENCE;
use flix_host::link::udp::Connection;
use flix_host::link::{LinkError, RobotLink, StopState};
use flix_host::pilot::{Ending, Helm, Pilot, real_time};
use flix_host::pose::any::Poses;
use flix_host::pose::natnet::{Body, COMMAND_PORT, NatNetSettings, NatNetSource, UpAxis};
use flix_host::pose::udp::UdpSource;
use flix_host::pose::{PoseSample, rate};
use flix_host::record::{MEGABYTE, RecordError, Recorder, RunDescription};
use flix_host::system::interrupt::Interrupt;
use flix_host::system::text::printable;
use flix_shell::number::whole;
use flix_shell::outlet::drawn;
use flix_shell::output::{complain, waiting};
use flix_shell::stream::StreamArgs;
use flix_shell::{Error, Exit};

/// Address of the simulator's stream, and of Motive on this computer.
const LOCAL_SERVER: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::LOCALHOST, COMMAND_PORT);

/// Options of the pose source.
#[derive(Debug, Clone, clap::Args)]
pub struct PoseArgs {
    /// Source of the poses: `natnet` (OptiTrack), or `udp:PORT` for any tracker that sends them as text, `udp:PORT@ADDRESS`
    /// for the one at that address [default: natnet; for teleop and drive, none].
    #[arg(long, value_name = "SOURCE")]
    pub pose: Option<PoseKind>,
    /// Address of Motive's computer (or of the simulator), and its command port [default: 127.0.0.1].
    #[arg(long, value_name = "HOST[:PORT]", value_parser = server)]
    pub natnet_server: Option<SocketAddrV4>,
    /// Address of this computer's network card that reaches it [default: found; for udp, this computer alone].
    #[arg(long, value_name = "ADDRESS")]
    pub interface: Option<Ipv4Addr>,
    /// Name or streaming number of the robot's rigid body; not needed if there is only one.
    #[arg(long, value_name = "BODY", value_parser = body)]
    pub body: Option<Body>,
    /// Up axis of Motive, y or z, as in its streaming settings [default: y].
    #[arg(long, value_name = "AXIS")]
    pub up: Option<UpAxis>,
}

/// Kind of a source of poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PoseKind {
    /// OptiTrack.
    NatNet,
    /// Datagrams at this port, and of this address alone.
    Udp(u16, Option<IpAddr>),
}

impl FromStr for PoseKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let port = |text: &str| {
            let (port, tracker) = match text.split_once('@') {
                Some((port, tracker)) => (port, Some(tracker.parse().ok()?)),
                None => (text, None),
            };
            let port = port.parse().ok().filter(|port| *port > 0)?;
            Some(Self::Udp(port, tracker))
        };
        match text {
            "natnet" => Ok(Self::NatNet),
            _ => text.strip_prefix("udp:").and_then(port).ok_or_else(|| {
                format!("\"{text}\" is not a source of poses: write natnet, udp:PORT with a port from 1 to 65535, or udp:PORT@ADDRESS")
            }),
        }
    }
}

/// Options of the files of a run.
#[derive(Debug, Clone, clap::Args)]
pub struct FileArgs {
    /// Mode table of the robot: `flix identify` writes it, the other commands read it.
    #[arg(long, value_name = "FILE", default_value = "modes.toml")]
    pub modes: PathBuf,
    /// The record.
    #[command(flatten)]
    pub record: RecordArgs,
}

/// Options of the record of a run.
#[derive(Debug, Clone, clap::Args)]
pub struct RecordArgs {
    /// The record.
    #[command(flatten)]
    pub place: PlaceArgs,
    /// Go on without a record when it cannot be written any more, for example because the disk is full
    /// [default: stop the robot].
    #[arg(long)]
    pub unrecorded: bool,
    /// A stream.
    #[command(flatten)]
    pub stream: StreamArgs,
}

fn body(text: &str) -> Result<Body, std::convert::Infallible> {
    text.parse()
}

fn server(text: &str) -> Result<SocketAddrV4, String> {
    let (host, port) = match text.split_once(':') {
        Some((host, port)) => (host, port.parse().ok()),
        None => (text, Some(COMMAND_PORT)),
    };
    // What is all numbers is no name, though some systems make an address of "1.2.3".
    let is_name = !host.chars().all(|it| it.is_ascii_digit() || it == '.');
    let resolved = || -> Option<Ipv4Addr> {
        (host, COMMAND_PORT).to_socket_addrs().ok()?.find_map(|it| match it.ip() {
            IpAddr::V4(ip) => Some(ip),
            IpAddr::V6(_) => None,
        })
    };
    let ip = host.parse::<Ipv4Addr>().ok().or_else(|| resolved().filter(|_| is_name));
    let is_one = |ip: &Ipv4Addr| !(ip.is_multicast() || ip.is_broadcast() || ip.is_unspecified());
    match (ip.filter(is_one), port.filter(|port| *port != 0)) {
        (Some(ip), Some(port)) => Ok(SocketAddrV4::new(ip, port)),
        _ => Err(format!(
            "\"{text}\" is no computer with an IPv4 address: write 192.168.1.5, 192.168.1.5:{COMMAND_PORT} or its name"
        )),
    }
}

impl PoseArgs {
    /// Returns the settings of a source of NatNet.
    pub fn settings(&self) -> NatNetSettings {
        let server = self.natnet_server.unwrap_or(LOCAL_SERVER);
        let own =
            if server.ip().is_loopback() { Ipv4Addr::LOCALHOST } else { Ipv4Addr::UNSPECIFIED };
        NatNetSettings {
            server,
            interface: self.interface.unwrap_or(own),
            body: self.body.clone().unwrap_or_default(),
            up: self.up.unwrap_or_default(),
            timeout: Duration::from_secs(2),
        }
    }

    /// Connects to the source, if --pose names one.
    pub fn open_if_named(&self) -> Result<Option<Poses>, Error> {
        match (self.pose, self.given()) {
            (Some(_), _) => self.open().map(Some),
            (None, Some(option)) => Err(Error::usage(format_args!(
                "{option} is for a source of poses, and this command has none by itself: add --pose natnet"
            ))),
            (None, None) => Ok(None),
        }
    }

    /// Returns an option that is given, and is for a source of poses.
    fn given(&self) -> Option<&'static str> {
        self.interface.map(|_| "--interface").or_else(|| self.given_for_natnet())
    }

    fn given_for_natnet(&self) -> Option<&'static str> {
        let server = self.natnet_server.map(|_| "--natnet-server");
        server.or(self.body.as_ref().map(|_| "--body")).or(self.up.map(|_| "--up"))
    }

    /// Connects to the source.
    pub fn open(&self) -> Result<Poses, Error> {
        if let (Some(PoseKind::Udp(..)), Some(option)) = (self.pose, self.given_for_natnet()) {
            return Err(Error::usage(format_args!("{option} is for --pose natnet alone")));
        }
        match self.pose.unwrap_or(PoseKind::NatNet) {
            PoseKind::NatNet => {
                let settings = self.settings();
                let server =
                    format_args!("{} to state its rigid bodies", settings.server).to_string();
                let source = waiting(server, || NatNetSource::connect(settings));
                source.map(|it| Poses::NatNet(Box::new(it))).map_err(Error::from)
            }
            PoseKind::Udp(port, tracker) => {
                let interface = self.interface.unwrap_or(Ipv4Addr::LOCALHOST);
                UdpSource::bind(interface, port, tracker).map(|it| Poses::Udp(Box::new(it))).map_err(|error| {
                    Error::usage(format_args!(
                        "cannot listen for poses at {interface}:{port}: {error}; choose another port, or the address of \
                         a network card of this computer as --interface"
                    ))
                })
            }
        }
    }
}

/// Reports once that poses are not those of a robot on the floor.
#[derive(Debug, Default)]
pub(super) struct HeightCheck {
    is_over: bool,
}

impl HeightCheck {
    pub(super) fn look(&mut self, sample: &PoseSample, is_planar: bool) {
        if self.is_over || sample.trusted().is_none() {
            return;
        }
        if let Some(trouble) = sample.pose.floating(is_planar) {
            self.is_over = true;
            complain(trouble);
        }
    }
}

/// Returns the remark on a tracked body whose axes are turned to the left by so many degrees.
fn of_turned_axes(degrees: f64) -> String {
    let (seen, turned) = if degrees > 0.0 { ("right", "left") } else { ("left", "right") };
    let degrees = degrees.abs();
    format!(
        "the robot walks {degrees:.0} degrees to the {seen} of its commands: the forward axis of the tracked body is turned by \
         {degrees:.0} degrees to the {turned}; turn it back in the tracker, or measure the modes by these axes with `flix identify`"
    )
}

/// A connected robot with its poses.
pub struct Run {
    connection: Connection,
    source: Poses,
    interrupt: Interrupt,
    heights: HeightCheck,
}

impl Run {
    /// Connects to the pose source, then to the robot.
    pub fn open(robot: &RobotArgs, poses: &PoseArgs) -> Result<Self, Error> {
        let interrupt = Interrupt::listen().map_err(Error::usage)?;
        let source = poses.open()?;
        let connection = robot.begin(&interrupt)?;
        Ok(Self { connection, source, interrupt, heights: HeightCheck::default() })
    }

    /// Accepts poses of any height: the robot hangs.
    pub fn above_the_floor(mut self) -> Self {
        self.heights.is_over = true;
        self
    }

    /// Drives to the end of the run. Returns the ending and the duration of driving, s. `message` is
    /// the text of the progress bar. Stops the robot before it returns an error.
    pub fn drive<H: Helm>(
        &mut self,
        pilot: &mut Pilot<H>,
        message: impl Fn(&Pilot<H>) -> String,
    ) -> Result<(Ending, f64), Error> {
        self.drive_keeping(pilot, message, |_| Ok(()))
    }

    /// Drives as [`Self::drive`], and offers the helm to `keep` after every step; why it could not keep something ends
    /// the run.
    pub fn drive_keeping<H: Helm>(
        &mut self,
        pilot: &mut Pilot<H>,
        message: impl Fn(&Pilot<H>) -> String,
        mut keep: impl FnMut(&H) -> Result<(), String>,
    ) -> Result<(Ending, f64), Error> {
        let bar = drawn(ProgressBar::new_spinner());
        if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed} {msg}") {
            bar.set_style(style);
        }
        let is_planar = self.source.is_planar();
        let (mut is_warned, mut is_remarked, mut is_turned) = (false, false, false);
        let heights = &mut self.heights;
        let watch = |pilot: &Pilot<H>, poses: &[PoseSample]| {
            for sample in poses {
                bar.suspend(|| heights.look(sample, is_planar));
            }
            if let Some(error) = pilot.unrecorded().filter(|_| !is_warned) {
                is_warned = true;
                bar.suspend(|| complain(error));
            }
            if !is_remarked
                && pilot.driving_since().is_some()
                && let Some(cost) = pilot.pose_rate().and_then(rate::cost)
            {
                is_remarked = true;
                bar.suspend(|| complain(cost));
            }
            if let Some(degrees) = pilot.helm().turned().filter(|_| !is_turned) {
                is_turned = true;
                bar.suspend(|| complain(of_turned_axes(degrees)));
            }
            bar.set_message(message(pilot));
            bar.tick();
            keep(pilot.helm())
        };
        let ended = real_time::drive::<H, Error>(
            &mut self.connection,
            &mut self.source,
            &self.interrupt,
            pilot,
            watch,
        );
        bar.finish_and_clear();
        ended
    }

    /// Returns the voltage below which the robot calls its battery low, V; `None` where it has no such setting.
    pub fn battery_low(&mut self) -> Result<Option<f32>, Error> {
        self.connection.wait_until_connected()?;
        Ok(battery_low(&mut self.connection)?)
    }

    /// Closes the session, and returns how far the stop of a run that failed has come. It stays latched until `flix clear`.
    pub fn leave(mut self) -> StopState {
        self.connection.leave();
        self.connection.client().stop_state()
    }

    /// Begins the record of the run, and its stream where one is asked for.
    pub fn record(
        &mut self,
        args: &RecordArgs,
        name: &str,
        settings: BTreeMap<String, String>,
    ) -> Result<Recorder, Error> {
        let poses = Some(self.source.name());
        let mut recorder = record(&args.place, &mut self.connection, poses, name, settings)?;
        args.stream.start(&mut recorder)?;
        Ok(recorder)
    }

    /// Returns the time of the run, which starts with the connection.
    pub fn now(&self) -> Instant {
        self.connection.now()
    }
}

/// Returns the voltage below which a robot calls its battery low, V; `None` where it has no such setting.
pub fn battery_low(connection: &mut Connection) -> Result<Option<f32>, LinkError> {
    match connection.parameter("battery_low") {
        Ok(parameter) => Ok(Some(parameter.value)),
        Err(LinkError::Refused(_)) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Where a record lies, and how long it may become.
#[derive(Debug, Clone, clap::Args)]
pub struct PlaceArgs {
    /// Folder for the record.
    #[arg(long, value_name = "DIR", default_value = "out")]
    pub out: PathBuf,
    /// End the record before less than this is free on its disk.
    #[arg(long, value_name = "MB", default_value = "500", value_parser = whole::<u64>(0..=1_000_000_000))]
    leave_free: u64,
}

/// Begins a record with the clock of a connection. `poses`: the name of their source, if there is one.
pub fn record(
    place: &PlaceArgs,
    connection: &mut Connection,
    poses: Option<String>,
    name: &str,
    settings: BTreeMap<String, String>,
) -> Result<Recorder, Error> {
    if !connection.client().is_connected(connection.now()) {
        connection.wait_until_connected()?;
    }
    let mut run = BTreeMap::from([("clock".into(), "real time".into())]);
    run.extend(poses.map(|poses| ("poses".into(), poses)));
    let mut versions =
        BTreeMap::from([("flix".into(), flix_host::system::program::version().into())]);
    if let Outcome::Identity(identity) = connection.ask(Command::Identify)? {
        run.insert("robot".into(), printable(&identity.name).into_owned());
        versions.insert("board".into(), printable(&identity.board).into_owned());
        versions.insert("firmware".into(), printable(&identity.version).into_owned());
    }
    if let Some(telemetry) = connection.wait_for_telemetry(TELEMETRY_PATIENCE, |_| true)? {
        run.insert("operator".into(), telemetry.operator.to_string());
    }
    let elapsed = Duration::from_micros(connection.now().as_micros());
    let description = RunDescription { name: name.to_owned(), run, settings, versions };
    // Of a clock that was not set, less may be shown than has gone by.
    let started = SystemTime::now().checked_sub(elapsed).unwrap_or(SystemTime::UNIX_EPOCH);
    let mut recorder = Recorder::create(&place.out, started, &description)?;
    match recorder.leave_free(MEGABYTE * place.leave_free) {
        Ok(()) => Ok(recorder),
        Err(error) => {
            recorder.discard();
            Err(error.into())
        }
    }
}

/// Returns an error for a run that did not finish; `stop`: how far the stop that ended it has come.
pub fn verdict(ending: &Ending, stop: StopState, record: Option<&PathBuf>) -> Result<(), Error> {
    let exit = match ending {
        Ending::Finished => return Ok(()),
        Ending::Robot(error) => Error::from(error.clone()).exit,
        Ending::Interrupted => Exit::Interrupted,
        Ending::NotRecorded(_) => Exit::Usage,
        Ending::Stopped(_) | Ending::OutOfTime(_) => Exit::NotNow,
    };
    let mut sentence = ending.to_string();
    if let Some(file) = record {
        let _ = write!(sentence, " (record: {})", file.display());
    }
    // Some sentences name the command already.
    let is_named = sentence.contains("flix clear");
    match stop {
        StopState::Acknowledged if !is_named => {
            sentence += "; the robot was stopped: `flix clear` makes it ready again";
        }
        StopState::Sending => {
            sentence +=
                "; the robot has not acknowledged the stop: without commands it stops by itself";
        }
        StopState::Acknowledged | StopState::None => {}
    }
    Err(Error::new(exit, sentence))
}

/// Returns an error for a record that is not complete, unless the run may go on without one: the
/// results were printed, and the trouble was reported when it arose.
pub fn unrecorded(error: Option<RecordError>, is_allowed: bool) -> Result<(), Error> {
    match error {
        Some(error) if !is_allowed => Err(error.into()),
        _ => Ok(()),
    }
}
