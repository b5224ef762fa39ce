use std::f64::consts::PI;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use flix_protocol::units::Instant;
use natnet::command::{disconnect_datagram, keepalive_datagram};
use natnet::{PlannedBody, SyntheticServer, Version};

use super::*;
use crate::pose::geometry::PlanarPose;
use crate::pose::{PoseSample, PoseSource};
use crate::system::AtEnd;

const LAYOUTS: [Version; 4] = [
    Version::new(3, 0, 0, 0),
    Version::new(3, 1, 0, 0),
    Version::new(4, 0, 0, 0),
    Version::new(4, 1, 0, 0),
];

fn some_pose() -> Pose {
    Pose::planar(PlanarPose { x: 1.25, y: -0.5, heading: 0.7 }, 0.0625)
}

fn close(a: &Pose, b: &Pose) -> bool {
    let numbers = |pose: &Pose| {
        let (p, q) = (pose.position.coordinates(), pose.orientation.components());
        p.into_iter().chain(q)
    };
    numbers(a).zip(numbers(b)).all(|(a, b)| (a - b).abs() < 1e-6)
}

#[test]
fn motives_y_up_becomes_our_z_up() {
    // Half a metre above the floor, one metre towards Motive's -z, turned to the left by 90 degrees
    // about the vertical (Motive's y).
    let half = (PI / 4.0) as f32;
    let pose = UpAxis::Y.to_pose([0.0, 0.5, -1.0], [0.0, half.sin(), 0.0, half.cos()]);
    let seen = pose.on_the_floor();
    assert!((pose.position.z - 0.5).abs() < 1e-6 && (seen.y - 1.0).abs() < 1e-6);
    assert!((seen.heading - PI / 2.0).abs() < 1e-6, "{seen:?}");
}

#[test]
fn a_pose_survives_every_layout_and_axis() {
    for version in LAYOUTS {
        for up in [UpAxis::Y, UpAxis::Z] {
            let (position, orientation) = up.from_pose(&some_pose());
            let body = PlannedBody::tracked(7, position, orientation);
            let wire = SyntheticServer::new(version, 1000).datagram(42, 0.5, &[body]).unwrap();
            let read = NatNetReading::from_datagram(&wire, version, Some(7), up).unwrap().unwrap();
            let (pose, valid) = read.body.unwrap();
            assert!(valid && read.frame == 42 && close(&pose, &some_pose()), "{version:?} {up}");
        }
    }
}

fn read(bodies: &[PlannedBody], body: Option<i32>) -> NatNetReading {
    let wire = SyntheticServer::new(Version::V4_1, 1000).datagram(1, 0.0, bodies).unwrap();
    NatNetReading::from_datagram(&wire, Version::V4_1, body, UpAxis::Z).unwrap().unwrap()
}

#[test]
fn a_body_that_is_not_tracked_is_not_valid() {
    let reading = read(&[PlannedBody::dropout(7)], Some(7));
    assert!(!reading.body.unwrap().1);
}

#[test]
fn a_pose_that_is_not_finite_is_not_valid() {
    let body = PlannedBody::tracked(7, [f32::NAN, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]);
    assert!(!read(&[body], Some(7)).body.unwrap().1);
}

#[test]
fn another_body_is_not_taken_for_the_robot() {
    let body = PlannedBody::tracked(8, [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
    assert_eq!(read(&[body], Some(7)).body, None);
}

#[test]
fn damaged_datagrams_are_errors_and_never_poses() {
    let body = PlannedBody::tracked(7, [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
    let wire = SyntheticServer::new(Version::V4_1, 1000).datagram(1, 0.0, &[body]).unwrap();
    for length in 4..wire.len() {
        let cut = NatNetReading::from_datagram(&wire[..length], Version::V4_1, None, UpAxis::Z);
        assert!(cut.is_err(), "{length} of {} bytes were read as {cut:?}", wire.len());
    }
}

/// Runs a server beside `client` until the client is done.
fn beside_a_server<T>(settings: ServerSettings, client: impl FnOnce(SocketAddrV4) -> T) -> T {
    beside_a_server_and(|_| {}, settings, client)
}

/// Runs a server beside `client` until the client is done; `stranger` acts after each of its frames.
fn beside_a_server_and<T>(
    stranger: impl Fn(f64) + Sync,
    settings: ServerSettings,
    client: impl FnOnce(SocketAddrV4) -> T,
) -> T {
    let mut server =
        NatNetServer::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, 0)), settings).unwrap();
    let SocketAddr::V4(address) = server.local_addr().unwrap() else { panic!("IPv4") };
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let begin = std::time::Instant::now();
            while !done.load(Ordering::Relaxed) && begin.elapsed() < Duration::from_secs(20) {
                let now = Instant::from_micros(begin.elapsed().as_micros() as u64);
                server.serve(now).unwrap();
                server.stream(begin.elapsed().as_secs_f64(), Some(&some_pose())).unwrap();
                stranger(begin.elapsed().as_secs_f64());
                std::thread::yield_now();
            }
        });
        let result = client(address);
        done.store(true, Ordering::Relaxed);
        result
    })
}

/// A group with a port of its own: another test on this computer must not be heard.
fn group(number: u8) -> (Ipv4Addr, u16) {
    (Ipv4Addr::new(239, 255, 42, number), 20_000 + (std::process::id() % 20_000) as u16)
}

fn multicast(group: (Ipv4Addr, u16)) -> ServerSettings {
    ServerSettings { multicast: Some(group), ..ServerSettings::default() }
}

/// Streams another pose to `group` from this address of this computer.
fn forger(address: [u8; 4], group: (Ipv4Addr, u16)) -> impl Fn(f64) + Sync {
    let socket = std::net::UdpSocket::bind((Ipv4Addr::from(address), 0)).unwrap();
    let elsewhere = Pose::planar(PlanarPose { x: 1.5, y: -0.5, heading: 0.7 }, 0.0625);
    let (position, orientation) = UpAxis::Y.from_pose(&elsewhere);
    let body = PlannedBody::tracked(1, position, orientation);
    move |seconds| {
        // By the server's clock, which all can read in its answers.
        let forged = SyntheticServer::new(Version::V4_1, 10_000_000).datagram(7, seconds, &[body]);
        socket.send_to(&forged.unwrap(), group).unwrap();
    }
}

/// The samples of a second, and on a busy computer of as many more as a stream is trusted after.
fn samples(source: &mut NatNetSource) -> Vec<PoseSample> {
    const ENOUGH: usize = 500;
    let begin = std::time::Instant::now();
    let mut samples = Vec::new();
    while begin.elapsed() < Duration::from_secs(1)
        || (samples.len() < ENOUGH && begin.elapsed() < Duration::from_secs(15))
    {
        let now = Instant::from_micros(begin.elapsed().as_micros() as u64);
        samples.extend(source.poll(now).unwrap());
    }
    samples
}

#[test]
fn poses_that_another_computer_streams_are_dropped_beside_the_true_ones() {
    let group = group(78);
    let (samples, seen) =
        beside_a_server_and(forger([127, 0, 0, 2], group), multicast(group), |server| {
            let mut source = NatNetSource::connect(to(server, Body::Only)).unwrap();
            (samples(&mut source), source.statistics())
        });
    assert!(samples.iter().any(|s| s.valid), "{seen:?}");
    assert!(samples.iter().all(|s| close(&s.pose, &some_pose())), "{seen:?}");
    assert!(seen.strangers > 0 && seen.stranger == Some([127, 0, 0, 2].into()), "{seen:?}");
}

#[test]
fn poses_that_are_forged_in_the_servers_name_beside_the_true_ones_are_never_trusted() {
    let group = group(79);
    let (samples, seen) =
        beside_a_server_and(forger([127, 0, 0, 1], group), multicast(group), |server| {
            let mut source = NatNetSource::connect(to(server, Body::Only)).unwrap();
            (samples(&mut source), source.statistics())
        });
    let forged = samples.iter().filter(|s| !close(&s.pose, &some_pose())).count();
    let trusted = samples.iter().filter(|s| s.valid && !close(&s.pose, &some_pose())).count();
    assert!(forged > 0 && trusted == 0 && seen.jumps > 0, "{forged} {trusted} {seen:?}");
}

fn to(server: SocketAddrV4, body: Body) -> NatNetSettings {
    NatNetSettings {
        server,
        interface: Ipv4Addr::LOCALHOST,
        body,
        up: UpAxis::Y,
        timeout: Duration::from_secs(5),
    }
}

fn first_trusted_pose(source: &mut NatNetSource) -> PoseSample {
    let begin = std::time::Instant::now();
    loop {
        let now = Instant::from_micros(begin.elapsed().as_micros() as u64);
        if let Some(sample) = source.poll(now).unwrap().filter(|s| s.valid) {
            return sample;
        }
        assert!(begin.elapsed() < Duration::from_secs(10), "{:?}", source.statistics());
        std::thread::yield_now();
    }
}

#[test]
fn a_unicast_stream_of_every_layout_is_followed() {
    for version in LAYOUTS {
        let settings = ServerSettings { version, multicast: None, ..ServerSettings::default() };
        let sample = beside_a_server(settings, |server| {
            let mut source =
                NatNetSource::connect(to(server, Body::Name("flix-walker".into()))).unwrap();
            first_trusted_pose(&mut source)
        });
        assert!(sample.valid && close(&sample.pose, &some_pose()), "{version:?}");
    }
}

#[test]
fn a_multicast_stream_is_followed_by_two_at_once() {
    beside_a_server(multicast(group(77)), |server| {
        let mut first = NatNetSource::connect(to(server, Body::Only)).unwrap();
        let mut second = NatNetSource::connect(to(server, Body::Number(1))).unwrap();
        for source in [&mut first, &mut second] {
            assert!(close(&first_trusted_pose(source).pose, &some_pose()));
        }
    });
}

#[test]
fn a_multicast_stream_to_no_group_is_explained() {
    let settings = multicast((Ipv4Addr::UNSPECIFIED, group(78).1));
    let said = beside_a_server(settings, |server| {
        NatNetSource::connect(to(server, Body::Only)).err().unwrap().to_string()
    });
    assert!(said.contains("0.0.0.0, which is no multicast group"), "{said}");
}

#[test]
fn a_wrong_name_is_answered_with_the_names_there_are() {
    let settings = ServerSettings { multicast: None, ..ServerSettings::default() };
    let said = beside_a_server(settings, |server| {
        NatNetSource::connect(to(server, Body::Name("drone".into()))).err().unwrap().to_string()
    });
    assert!(said.contains("drone") && said.contains("flix-walker"), "{said}");
}

#[test]
fn a_silent_server_is_explained() {
    let nobody = std::net::UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let SocketAddr::V4(address) = nobody.local_addr().unwrap() else { panic!("IPv4") };
    let settings = NatNetSettings { timeout: Duration::from_millis(50), ..to(address, Body::Only) };
    let said = NatNetSource::connect(settings).err().unwrap().to_string();
    assert!(said.contains("loopback") && said.contains("firewall"), "{said}");
}

#[test]
fn a_body_is_named_by_number_or_name() {
    assert_eq!("3".parse(), Ok(Body::Number(3)));
    assert_eq!("robot 3".parse(), Ok(Body::Name("robot 3".into())));
}

/// A body beside the robot.
const OTHER: &str = "other";

/// A Motive that speaks a newer version, written by hand from the description of the format and not with the codec that
/// reads it.
#[derive(Clone, Copy)]
struct Motive {
    /// The version that it speaks by itself.
    minor: u8,
    grants: bool,
    /// Whether the newer version describes bodies in another way, too.
    describes_anew: bool,
    is_paused: bool,
    /// Frames after which it starts anew.
    restarts_after: Option<i32>,
    /// The version that it speaks by itself from then on.
    restarts_as: Option<u8>,
    /// The number of its group from then on, or none.
    restarts_to: Option<Option<u8>>,
    /// Whether it then knows no client, too.
    forgets_clients: bool,
    /// Its bodies from then on, and whether its frames say that they have changed.
    becomes: Option<&'static [(&'static str, i32)]>,
    says_so: bool,
    /// Whether it sends its list of bodies then, unasked.
    lists_them: bool,
    /// Whether it then counts its frames from 1.
    counts_anew: bool,
    /// Number of its multicast group.
    multicast: Option<u8>,
    /// Datagrams of each kind that are lost before it hears one, and again once it starts anew.
    deaf_for: usize,
    bodies: &'static [(&'static str, i32)],
}

const MOTIVE: Motive = Motive {
    minor: 2,
    grants: true,
    describes_anew: true,
    is_paused: false,
    restarts_after: None,
    restarts_as: None,
    restarts_to: None,
    forgets_clients: true,
    becomes: None,
    says_so: false,
    lists_them: false,
    counts_anew: false,
    multicast: None,
    deaf_for: 0,
    bodies: &[("flix-walker", 3)],
};

fn packet(id: u16, payload: &[u8]) -> Vec<u8> {
    [&id.to_le_bytes()[..], &(payload.len() as u16).to_le_bytes(), payload].concat()
}

impl Motive {
    fn info(&self) -> Vec<u8> {
        let mut payload = vec![0; 256];
        payload[..6].copy_from_slice(b"Motive");
        payload.extend([3, self.minor, 0, 0, 4, self.minor, 0, 0]);
        payload.extend(10_000_000_u64.to_le_bytes());
        let (group, port) = group(self.multicast.unwrap_or(99));
        payload.extend(port.to_le_bytes());
        payload.push(self.multicast.is_some().into());
        payload.extend(group.octets());
        packet(1, &payload)
    }

    fn model(bodies: &[(&str, i32)], is_newer: bool) -> Vec<u8> {
        let mut payload = (bodies.len() as i32).to_le_bytes().to_vec();
        for (name, number) in bodies {
            let mut body = [name.as_bytes(), &[0], &number.to_le_bytes()].concat();
            body.extend((-1_i32).to_le_bytes());
            body.extend([0; 12]);
            body.extend(0_i32.to_le_bytes());
            if is_newer {
                // A later version may add any bytes after the name.
                body.splice(name.len() + 1..=name.len(), [0xff; 16]);
            }
            payload.extend(1_i32.to_le_bytes());
            payload.extend((body.len() as i32).to_le_bytes());
            payload.extend(body);
        }
        packet(5, &payload)
    }

    fn frame(bodies: &[(&str, i32)], number: i32, is_newer: bool, flags: i16) -> Vec<u8> {
        let mut payload = number.to_le_bytes().to_vec();
        let mut section = |count: usize, bytes: &[u8]| {
            payload.extend((count as i32).to_le_bytes());
            payload.extend((bytes.len() as i32).to_le_bytes());
            payload.extend(bytes);
        };
        section(0, &[]);
        section(0, &[]);
        let mut described = Vec::new();
        for (name, body) in bodies {
            let mut pose = some_pose();
            // So near that no jump gives it away.
            pose.position.x += if *name == OTHER { 0.01 } else { 0.0 };
            let (position, orientation) = UpAxis::Y.from_pose(&pose);
            described.extend(body.to_le_bytes());
            // A later version may add any bytes: before the pose they look like a false one.
            described.extend(vec![0x3e; if is_newer { 4 } else { 0 }]);
            for value in position.iter().chain(&orientation).chain(&[0.0002]) {
                described.extend(value.to_le_bytes());
            }
            described.extend(1_i16.to_le_bytes());
        }
        section(bodies.len(), &described);
        for _ in 0..5 {
            section(0, &[]);
        }
        payload.extend([0; 8]);
        payload.extend(f64::from(number).to_le_bytes());
        payload.extend([0; 24 + 8]);
        payload.extend(flags.to_le_bytes());
        payload.extend(0_i32.to_le_bytes());
        packet(7, &payload)
    }

    /// Serves until `client` is done.
    fn beside<T>(&self, client: impl FnOnce(SocketAddrV4) -> T) -> T {
        let socket = std::net::UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        socket.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        let SocketAddr::V4(address) = socket.local_addr().unwrap() else { panic!("IPv4") };
        let done = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let mut heard = [0; 3];
                let (mut client, mut is_newer, mut number) = (None, self.minor > 1, 0);
                let (mut bodies, mut flags, mut lives) = (self.bodies, 0, 1);
                let mut motive = *self;
                let mut buffer = [0; 1024];
                while !done.load(Ordering::Relaxed) {
                    if let Ok((length, from)) = socket.recv_from(&mut buffer) {
                        let kind = match (buffer[0], length) {
                            (0, ..=4) => 0,
                            (0, _) => 1,
                            (4, _) => 2,
                            _ => continue,
                        };
                        heard[kind] += 1;
                        if heard[kind] > self.deaf_for {
                            if kind == 2 {
                                let model = Self::model(bodies, is_newer && self.describes_anew);
                                socket.send_to(&model, from).unwrap();
                            } else {
                                is_newer &=
                                    !(self.grants && buffer[4 + 265..][..2] == [4, 1] && kind == 1);
                                client = Some(motive.multicast.map_or(from, |it| group(it).into()));
                                socket.send_to(&motive.info(), from).unwrap();
                            }
                        }
                    }
                    if let Some(client) = client.filter(|_| !self.is_paused) {
                        number += 1;
                        let frame = Self::frame(bodies, number, is_newer, flags);
                        let _ = socket.send_to(&frame, client);
                    }
                    if self.restarts_after == Some(number) && lives > 0 {
                        lives -= 1;
                        heard = [0; 3];
                        client = client.filter(|_| !self.forgets_clients);
                        motive.minor = self.restarts_as.unwrap_or(self.minor);
                        motive.multicast = self.restarts_to.unwrap_or(self.multicast);
                        (is_newer, number) = (motive.minor > 1, number + 1);
                        bodies = self.becomes.unwrap_or(bodies);
                        flags = if self.says_so { 2 } else { 0 };
                        if let Some(client) = client.filter(|_| self.lists_them) {
                            socket.send_to(&Self::model(bodies, is_newer), client).unwrap();
                        }
                        number = if self.counts_anew { 0 } else { number };
                    }
                }
            });
            // Ends the server, also when its client panics.
            let _end = AtEnd(&done);
            client(address)
        })
    }

    fn refuses(&self, body: Body) -> String {
        let timeout = Duration::from_millis(500);
        self.beside(|server| {
            let settings = NatNetSettings { timeout, ..to(server, body) };
            NatNetSource::connect(settings).err().unwrap().to_string()
        })
    }
}

#[test]
fn a_newer_motive_is_asked_for_what_is_understood() {
    for minor in 2..=4 {
        Motive { minor, ..MOTIVE }.beside(|server| {
            let mut source = NatNetSource::connect(to(server, Body::Only)).unwrap();
            assert!(close(&first_trusted_pose(&mut source).pose, &some_pose()), "4.{minor}");
            assert_eq!(source.version(), format!("4.{minor}.0.0, asked for 4.1.0.0"));
        });
    }
}

#[test]
fn a_motive_that_ignores_the_wish_is_not_followed() {
    let said = Motive { minor: 3, grants: false, ..MOTIVE }.refuses(Body::Only);
    assert!(said.contains("speaks NatNet 4.3") && said.contains("asked for 4.1"), "{said}");
    // Where the descriptions are alike, the frames decide.
    let motive = Motive { grants: false, describes_anew: false, ..MOTIVE };
    let said = motive.refuses(Body::Only);
    assert!(said.contains("speaks NatNet 4.2") && said.contains("asked for 4.1"), "{said}");
    // Where no frames come, the descriptions decide.
    let said = Motive { grants: false, is_paused: true, ..MOTIVE }.refuses(Body::Only);
    assert!(said.contains("speaks NatNet 4.2") && said.contains("asked for 4.1"), "{said}");
}

/// The poses of a stream until one is trusted again after it was away, and how many frames could not be read.
fn across_a_restart(motive: &Motive) -> (Vec<PoseSample>, u64) {
    motive.beside(|server| {
        let mut source = NatNetSource::connect(to(server, Body::Only)).unwrap();
        let begin = std::time::Instant::now();
        let (mut samples, mut last) = (Vec::new(), Duration::ZERO);
        loop {
            let now = begin.elapsed();
            assert!(now < Duration::from_secs(10), "{:?}", source.statistics());
            let Some(sample) = source.poll(Instant::from_micros(now.as_micros() as u64)).unwrap()
            else {
                std::thread::yield_now();
                continue;
            };
            samples.push(sample);
            if now - last > Duration::from_millis(900) && samples.len() > 1 {
                return (samples, source.statistics().unreadable);
            }
            last = now;
        }
    })
}

#[test]
fn a_motive_that_starts_anew_is_asked_again() {
    for minor in [1, 2] {
        let motive = Motive { minor, restarts_after: Some(100), ..MOTIVE };
        let (samples, _) = across_a_restart(&motive);
        assert!(samples.iter().all(|it| close(&it.pose, &some_pose())), "4.{minor}");
    }
}

#[test]
fn a_motive_that_starts_anew_in_another_version_is_followed() {
    let follow = |(minor, other, forgets_clients)| {
        let motive = Motive { minor, restarts_after: Some(100), forgets_clients, ..MOTIVE };
        let motive = Motive { restarts_as: Some(other), ..motive };
        let (samples, _) = across_a_restart(&motive);
        let close = |it: &PoseSample| close(&it.pose, &some_pose());
        assert!(samples.iter().all(close), "4.{minor} as 4.{other}, {forgets_clients}");
    };
    // Side by side: each waits in real time.
    std::thread::scope(|scope| {
        for case in [(1, 2, true), (1, 2, false), (2, 1, true), (2, 4, true), (2, 4, false)] {
            scope.spawn(move || follow(case));
        }
    });
}

#[test]
fn a_motive_that_starts_anew_and_streams_another_way_is_followed() {
    let follow = |(multicast, other)| {
        let motive = Motive { multicast, restarts_to: Some(other), minor: 1, ..MOTIVE };
        let (samples, _) = across_a_restart(&Motive { restarts_after: Some(100), ..motive });
        let close = |it: &PoseSample| close(&it.pose, &some_pose());
        assert!(samples.iter().all(close), "{multicast:?} to {other:?}");
    };
    // Side by side: each waits in real time.
    std::thread::scope(|scope| {
        for case in [(None, Some(82)), (Some(83), None), (Some(84), Some(85))] {
            scope.spawn(move || follow(case));
        }
    });
}

#[test]
fn a_stream_that_changes_its_layout_later_gives_no_wrong_pose() {
    // Another program has it send the newer layout: it forgets the requested one, and not the client.
    let motive = Motive { restarts_after: Some(100), forgets_clients: false, ..MOTIVE };
    let (samples, unreadable) = across_a_restart(&motive);
    assert!(samples.iter().all(|it| close(&it.pose, &some_pose())) && unreadable > 0);
}

#[test]
fn a_body_that_gets_another_number_is_followed_and_its_old_number_is_not_trusted() {
    let swapped = Motive {
        minor: 1,
        bodies: &[("flix-walker", 3), (OTHER, 4)],
        becomes: Some(&[(OTHER, 3), ("flix-walker", 4)]),
        restarts_after: Some(300),
        forgets_clients: false,
        ..MOTIVE
    };
    let said = Motive { says_so: true, ..swapped };
    let motives = [
        Motive { multicast: Some(81), ..said },
        Motive { counts_anew: true, ..swapped },
        Motive { lists_them: true, ..swapped },
        Motive { forgets_clients: true, ..swapped },
        Motive { minor: 2, forgets_clients: true, ..swapped },
        Motive { deaf_for: 1, ..said },
        said,
    ];
    let follow = |server| {
        let mut source =
            NatNetSource::connect(to(server, Body::Name("flix-walker".into()))).unwrap();
        let begin = std::time::Instant::now();
        let mut since = 0;
        while since < 100 {
            let now = Instant::from_micros(begin.elapsed().as_micros() as u64);
            assert!(begin.elapsed() < Duration::from_secs(20), "{:?}", source.statistics());
            let Some(sample) = source.poll(now).unwrap().filter(|it| it.valid) else {
                std::thread::sleep(Duration::from_millis(1));
                continue;
            };
            assert!(close(&sample.pose, &some_pose()), "{:?}", source.statistics());
            since += u32::from(source.bodies()[0].0 == OTHER);
        }
        assert_eq!(source.bodies(), [(OTHER.to_owned(), 3), ("flix-walker".to_owned(), 4)]);
    };
    // Side by side: each waits in real time.
    std::thread::scope(|scope| {
        for motive in &motives {
            scope.spawn(|| motive.beside(follow));
        }
    });
}

#[test]
#[cfg(target_os = "linux")]
fn an_answer_of_somebody_else_is_none() {
    let bind = |last| std::net::UdpSocket::bind((Ipv4Addr::new(127, 0, 0, last), 0)).unwrap();
    let (server, stranger) = (bind(1), bind(2));
    let SocketAddr::V4(address) = server.local_addr().unwrap() else { panic!("IPv4") };
    let timeout = Duration::from_millis(300);
    let settings = NatNetSettings { timeout, ..to(address, Body::Only) };
    let client = std::thread::spawn(move || NatNetSource::connect(settings).err());
    let (_, from) = server.recv_from(&mut [0; 1024]).unwrap();
    stranger.send_to(&MOTIVE.info(), from).unwrap();
    assert!(matches!(client.join().unwrap(), Some(NatNetError::NoAnswer(_))));
}

#[test]
fn a_server_hears_four_times_a_second_who_listens_and_when_nobody_does() {
    let motive = Motive { minor: 1, ..MOTIVE };
    let server = std::net::UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    server.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let SocketAddr::V4(address) = server.local_addr().unwrap() else { panic!("IPv4") };
    std::thread::spawn(move || {
        let mut source = NatNetSource::connect(to(address, Body::Only)).unwrap();
        for quarter in 0..12 {
            source.poll(Instant::from_micros(250_000 * quarter)).unwrap();
        }
    });
    let (mut signs, mut buffer) = (0, [0; 1024]);
    loop {
        let (length, from) = server.recv_from(&mut buffer).unwrap();
        match &buffer[..length] {
            [0, ..] => drop(server.send_to(&motive.info(), from).unwrap()),
            [4, ..] => drop(server.send_to(&Motive::model(motive.bodies, false), from).unwrap()),
            datagram if *datagram == keepalive_datagram() => signs += 1,
            datagram if *datagram == disconnect_datagram() => break,
            datagram => panic!("{datagram:?}"),
        }
    }
    assert_eq!(signs, 12);
}

#[test]
fn a_body_that_is_gone_is_not_trusted_by_its_number() {
    let motive = Motive {
        minor: 1,
        becomes: Some(&[(OTHER, 3)]),
        restarts_after: Some(300),
        forgets_clients: false,
        says_so: true,
        ..MOTIVE
    };
    motive.beside(|server| {
        let mut source =
            NatNetSource::connect(to(server, Body::Name("flix-walker".into()))).unwrap();
        let begin = std::time::Instant::now();
        let mut doubted = 0;
        while doubted < 500 {
            let now = Instant::from_micros(begin.elapsed().as_micros() as u64);
            assert!(begin.elapsed() < Duration::from_secs(20), "{:?}", source.statistics());
            let Some(sample) = source.poll(now).unwrap() else { continue };
            assert!(!sample.valid || close(&sample.pose, &some_pose()));
            doubted += u32::from(source.bodies()[0].0 == OTHER);
        }
    });
}

#[test]
fn a_newer_motive_is_asked_for_unicast() {
    let said = Motive { minor: 4, multicast: Some(99), ..MOTIVE }.refuses(Body::Only);
    assert!(said.contains("4.4") && said.contains("to unicast"), "{said}");
}

#[test]
fn questions_that_are_lost_are_asked_again() {
    Motive { deaf_for: 2, ..MOTIVE }.beside(|server| {
        let mut source = NatNetSource::connect(to(server, Body::Only)).unwrap();
        assert!(close(&first_trusted_pose(&mut source).pose, &some_pose()));
    });
}

#[test]
fn bodies_that_are_mistaken_for_each_other_are_named() {
    const CASES: [(&[(&str, i32)], &str); 4] = [
        (&[("a", 1), ("b", 1)], "a"),
        (&[("a", 1), ("b", 1)], "1"),
        (&[("a", 1), ("a", 2)], "a"),
        (&[("7", 1), ("b", 7)], "7"),
    ];
    for (bodies, word) in CASES {
        let said = Motive { bodies, ..MOTIVE }.refuses(word.parse().unwrap());
        let both =
            bodies.iter().all(|(name, n)| said.contains(&format!("\"{name}\" (number {n})")));
        assert!(both && said.contains("ambiguous"), "{word}: {said}");
    }
}

#[test]
fn a_body_with_a_number_for_a_name_is_found() {
    Motive { bodies: &[("7", 2), ("b", 1)], ..MOTIVE }.beside(|server| {
        let mut source = NatNetSource::connect(to(server, Body::Number(7))).unwrap();
        assert!(first_trusted_pose(&mut source).valid);
    });
    assert_eq!("007".parse(), Ok(Body::Name("007".into())));
}

#[test]
fn of_two_bodies_with_one_number_neither_is_taken() {
    let body = PlannedBody::tracked(7, [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
    assert_eq!(read(&[body, body], Some(7)).body, None);
    assert_eq!(read(&[body, body], None).body, None);
}
